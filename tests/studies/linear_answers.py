"""Are closed forms of settled motions what marches settle to? python tests/studies/linear_answers.py

Scenes without torsion, drawn at random: pairs under one harmonic and chains of three blades under two, pressed together
or apart, with mean loads. Of those of which a closed form is claimed, from the static start on, 40 are marched until
they have settled, and compared: power, mean, RMS value and peak of x and y, relative to the largest of the kind. Then
40 scenes whose loads are within a fifth of the limit, on either side, are marched from the static start: none that is
claimed may slip, open or touch. `linear_answers.json` tells what was found; the exit status is 1 if a bound is broken.
"""

import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.linear.held_contact import held_contact
from jaxshroud.linear.linear_motion import linear_motions
from jaxshroud.linear.linear_transient import outlasts_transient
from jaxshroud.scene.config import parse
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.verbs.settled import in_state

FILE = Path(__file__).with_suffix(".json")
AGREES = 1e-9
DRAWN, COUNT = 64, 20  # scenes drawn of a layout, and how many of them are compared
MARCH = js.RungeKutta("dopri8", steps=600)  # the error of its peaks falls with the fourth power of the step
ROUGH = js.RungeKutta("dopri8", steps=100)
SETTLED = {"n_periods": 2, "transient": 200}
QUANTITIES = ("P", "x_mean", "y_mean", "x_rms", "y_rms", "x_peak", "y_peak")
SCENE = """
initial = "static"
[blades]
m = 0.08
I = 2.46e-5
k_x = 1e5
k_y = 3e6
k_T = 2000.0
c_x = 9.0
c_y = 50.0
c_T = 0.0
[shroud]
alpha = "60 deg"
l_oa = 0.05
l_ab = 0.035
gap = 0.0
[contact]
gamma = 2.5
[friction]
k_d = 1e5
mu = 0.5
[parts]
motion = ["x", "y"]
[run]
periods = 2
[drive]
omega = 500.0
F_x_mean = 0.0
F_y_mean = 0.0
"""
LAYOUTS = {
    "pairs": """F_0 = 1.0
beta = "30 deg"
M_0 = 0.0
phase = ["0 deg", "130 deg"]
""",
    "chains": """phase = ["0 deg", "70 deg", "200 deg"]
[[drive.harmonic]]
order = 1
F = 3.0
beta = "20 deg"
M = 0.0
[[drive.harmonic]]
order = 2
F = 2.0
beta = "50 deg"
M = 0.0
phase = "40 deg"
[row]
blades = 3
""",
}


def drawn(layout: str, state: str, rng: np.random.Generator) -> Scene:
    """Scenes of a layout (leading axis) whose faces are pressed together, or apart, at rest."""
    scene = parse(SCENE + LAYOUTS[layout], layout).scene
    gap = rng.uniform(-6e-4, -2e-4, DRAWN) if state == "stuck" else rng.uniform(3e-4, 1e-3, DRAWN)
    numbers = {
        "shroud.gap": gap,
        "contact.gamma": rng.uniform(0.5, 6.0, DRAWN),
        "friction.mu": rng.uniform(0.4, 1.2, DRAWN),
        "friction.k_d": rng.uniform(1e4, 4e5, DRAWN),
        "drive.omega": rng.uniform(200.0, 1500.0, DRAWN),
        "drive.F_x_mean[0]": rng.uniform(-4.0, 4.0, DRAWN),
        "drive.F_y_mean[1]": rng.uniform(-4.0, 4.0, DRAWN),
    }
    numbers |= {"drive.F_0": rng.uniform(0.5, 6.0, DRAWN)} if layout == "pairs" else {}
    return js.scenes_from(numbers, scene)


def claimed(scenes: Scene, state: str) -> np.ndarray:
    """Of which scenes (leading axis) the closed form is claimed by default."""
    lanes = jax.tree.map(np.asarray, without_given(scenes))
    held = held_contact(lanes, state)  # pyright: ignore[reportArgumentType]
    motion = linear_motions(lanes, held)
    every = range(len(motion.power))
    each = (jax.tree.map(lambda a, i=i: np.asarray(a)[i : i + 1], (lanes, held, motion)) for i in every)
    return motion.margins.holds & np.array([outlasts_transient(*one) for one in each])


def some(scenes: Scene, at: np.ndarray) -> Scene:
    """The scenes of these lanes."""
    return jax.tree.map(lambda a: np.asarray(a)[at], scenes)


def differences(scenes: Scene, state: str) -> dict[str, float]:
    """The largest difference of each quantity of scenes (leading axis) in a state, by its largest value."""
    marched = js.sweep(scenes, **SETTLED, method=MARCH, amplitudes=True)
    closed = js.sweep(in_state(scenes, state), n_periods=2, transient=0, amplitudes=True)  # pyright: ignore
    told = {}
    for name in QUANTITIES:
        now, then = (np.asarray(run.data[name], float) for run in (closed, marched))
        then = np.broadcast_to(then, now.shape)
        told[name] = float(np.abs(now - then).max() / max(np.abs(then).max(), 1e-300))
    return told


def is_left(scenes: Scene) -> np.ndarray:
    """Whether a march from the static start leaves its state of contact: any event at all."""
    run = js.sweep(scenes, n_periods=80, transient=0, method=ROUGH)
    counts = [run.data[name] for name in ("stick_slip", "onsets", "separations") if name in run.data]
    count = len(np.asarray(scenes.drive.omega))
    return np.sum([np.asarray(a).reshape(count, -1).sum(axis=1) for a in counts], axis=0) > 0


def level_at_limit(scenes: Scene, state: str) -> np.ndarray:
    """The level of the drive at which each scene (leading axis) is no longer claimed, by bisection."""
    low, high = np.zeros(len(scenes.drive.omega)), np.full(len(scenes.drive.omega), 400.0)
    for _ in range(30):
        middle = (low + high) / 2
        keeps = claimed(at_level(scenes, middle), state)
        low, high = np.where(keeps, middle, low), np.where(keeps, high, middle)
    return low


def at_level(scenes: Scene, level: np.ndarray) -> Scene:
    """The scenes (leading axis) with their harmonics multiplied."""
    return js.vary(scenes, "drive.level", level)


def compared(layout: str, state: str, seed: int, count: int = COUNT) -> dict[str, Any]:
    """What is found of the scenes of a layout that are pressed together, or apart."""
    rng = np.random.default_rng(seed)
    scenes = drawn(layout, state, rng)
    chosen = np.flatnonzero(claimed(scenes, state))[: count // 2]
    own = some(scenes, chosen)
    near = at_level(own, level_at_limit(own, state) * rng.uniform(0.8, 1.2, len(chosen)))
    said, left = claimed(near, state), is_left(near)
    return {
        "layout": layout,
        "state": state,
        "scenes": len(chosen),
        "difference": max(differences(own, state).values()),
        "near the limit": len(chosen),
        "claimed": int(said.sum()),
        "left": int(left.sum()),
        "claimed and left": int((said & left).sum()),
    }


def main() -> int:
    """Compare all, and write what is found."""
    jax.config.update("jax_enable_x64", True)
    groups = [
        compared(layout, state, seed)
        for seed, (layout, state) in enumerate((layout, state) for layout in LAYOUTS for state in ("stuck", "apart"))
    ]
    for group in groups:
        print(group)
    told = {"command": "python tests/studies/linear_answers.py", "version": js.__version__, "groups": groups}
    FILE.write_text(json.dumps(told, indent=1) + "\n", "utf-8")
    return 0 if all(g["difference"] < AGREES and not g["claimed and left"] for g in groups) else 1


if __name__ == "__main__":
    sys.exit(main())
