"""Derivatives by loads and by what depends on the speed against differences: python tests/studies/load_derivatives.py.

Random pairs in x and y under two engine orders, with mean loads, stiffnesses that grow with the speed and a gap that
untwist changes, are run until they settle on an orbit; of the first ten that do, and touch, the derivatives of P_d, of
P_d_vibration and of x_peak by the numbers of `WRT` are compared with fourth-order central differences on orbits
followed from scene to scene, at two step sizes, of which the best counts.
"""

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.verbs.gradient import differences

WRT = (
    *(f"drive.harmonic[{i}].{name}[0]" for i in (0, 1) for name in ("F", "phase")),
    *("drive.F_x_mean[0]", "shroud.gap_at", "blades.B_x[0]", "drive.speed"),
)
STEPS = (1e-3, 1e-4)
# Peaks are read off cubics between steps, whose error the differences multiply: they take finer steps.
METHODS = {
    **dict.fromkeys(("P_d", "P_d_vibration"), js.RungeKutta("dopri8", steps=160)),
    "x_peak": js.RungeKutta("dopri8", steps=480),
}
SCENES, TRIED, MOST_PERIODS = 10, 80, 64
SCENE = """
[blades]
m = 0.08
I = 2.46e-3
k_x = 1e5
k_y = 3e6
k_T = 2000.0
c_x = 20.0
c_y = 40.0
c_T = 0.5
B_x = [{B}, 1.0]
B_y = 0.6
[shroud]
alpha = "60 deg"
l_oa = 0.05
l_ab = 0.035
gap = {gap}
gap_at = {gap_at}
gap_at_speed = "1500 rpm"
[contact]
gamma = {gamma}
[friction]
k_d = 5e5
mu = {mu}
[drive]
engine_order = 4
speed = {speed}
phase = [0.0, {phase}]
F_x_mean = [{mean}, -1.0]
F_y_mean = 3.0
[[drive.harmonic]]
engine_order = 4
F = [40.0, {F}]
beta = 0.5
phase = [0.0, 0.4]
[[drive.harmonic]]
engine_order = 8
F = {second}
beta = 0.3
phase = [{psi}, 0.5]
[parts]
motion = ["x", "y"]
[run]
periods = 8
"""


def random_scenes(rng: np.random.Generator) -> Iterator[Any]:
    """Scenes with random numbers."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        while True:
            numbers = {
                **{"B": rng.uniform(0.5, 2.0), "gap": rng.uniform(0, 3e-5), "gap_at": rng.uniform(-3e-5, 5e-5)},
                **{"gamma": rng.uniform(0.4, 2.0), "mu": rng.uniform(0.1, 0.5), "speed": rng.uniform(110.0, 170.0)},
                **{"phase": rng.uniform(2.0, 3.5), "mean": rng.uniform(-3.0, 5.0), "F": rng.uniform(20.0, 50.0)},
                **{"second": rng.uniform(3.0, 15.0), "psi": rng.uniform(0.0, 6.0)},
            }
            file.write_text(SCENE.format(**numbers), encoding="utf-8")
            yield js.load(str(file)).scene


def relative_errors(found: Any, of: str) -> dict[str, float]:
    """The least errors of the derivatives of `of` on an orbit over the steps, by numbers, relative to their size.

    A derivative that is small beside that of its level over its number is compared with a millionth of the latter.
    """
    gradient = js.gradient(found.scene, WRT, of=of, orbit=found)
    quotients = [differences(found, WRT, step, of) for step in STEPS]
    errors = {}
    for key in WRT:
        exact, number = gradient.value[key], abs(js.value_of(found.scene, key)) or 1.0
        size = max(abs(exact), 1e-3 * abs(float(gradient.level)) / number)
        errors[key] = float(np.fmin.reduce([abs(one[key] - exact) / size for one in quotients]))
    return errors


def is_apart(found: Any) -> bool:
    """Whether the blades of an orbit never touch."""
    return js.gradient(found.scene, "contact.gamma", orbit=found).value["contact.gamma"] == 0


def study(scenes: int, seed: int = 5) -> dict[str, Any]:
    """The largest errors by quantities and numbers, over so many settled scenes."""
    largest = {of: dict.fromkeys(WRT, 0.0) for of in METHODS}
    left_out: Counter[str] = Counter()
    told: list[dict[str, Any]] = []
    for scene in random_scenes(np.random.default_rng(seed)):
        if len(told) == scenes or sum(left_out.values()) + len(told) == TRIED:
            break
        found = js.orbit(scene, most_periods=MOST_PERIODS, method=METHODS["P_d"])
        verdict = ", ".join(found.flags)
        if verdict or is_apart(found):
            left_out[verdict or "apart"] += 1
            continue
        fine = js.orbit(scene, most_periods=MOST_PERIODS, method=METHODS["x_peak"])
        of_scene = {of: relative_errors(fine if of == "x_peak" else found, of) for of in METHODS}
        worst = max(error for errors in of_scene.values() for error in errors.values())
        told.append({"P_d": float(found.P_d), "q": int(found.q), "worst": worst})
        print(told[-1], file=sys.stderr, flush=True)
        for of, errors in of_scene.items():
            largest[of] = {key: max(largest[of][key], error) for key, error in errors.items()}
    return {"scenes": told, "left out": dict(left_out), "largest relative error": largest}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SCENES
    answer = study(count)
    print(json.dumps(answer, indent=1))
    if count == SCENES:
        Path(__file__).with_suffix(".json").write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
