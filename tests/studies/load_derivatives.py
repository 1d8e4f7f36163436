"""Derivatives by loads and by what depends on the speed against differences: python tests/studies/load_derivatives.py.

Random pairs in x and y under two engine orders, with mean loads, stiffnesses that grow with the speed and a gap that
untwist changes, are run until they settle on an orbit; of the first ten that do, and touch, the derivatives of P_d, of
P_d_vibration and of x_peak by the numbers of `WRT` are compared with differences on orbits followed from scene to
scene. Those of P_d and P_d_vibration are fourth-order central ones at two step sizes, of which the better counts.

Those of x_peak are extrapolated from central differences at steps that halve. The march gives samples only: by NumPy
the mean is that of the samples, and the peak that of a polynomial fitted to those about the largest, where the judged
derivative seeks the zero of the rate by secants. Which extrapolation counts is decided by how far it moves, without a
look at the judged derivative, and this doubt is told beside the errors. Scenes in which another peak is nearly as
large, or the contact changes where the polynomial is fitted, are left out and counted.
"""

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.polynomial import Polynomial

import jaxshroud as js
from jaxshroud.orbits.gradient import scenes_around
from jaxshroud.orbits.shooting import nearby_orbits
from jaxshroud.scene.vary import level_of, with_numbers
from jaxshroud.verbs.gradient import differences

WRT = (
    *(f"drive.harmonic[{i}].{name}[0]" for i in (0, 1) for name in ("F", "phase")),
    *("drive.F_x_mean[0]", "shroud.gap_at", "blades.B_x[0]", "drive.speed"),
)
STEPS = (1e-3, 1e-4)  # relative, of the differences of the reductions
METHOD = js.RungeKutta("dopri8", steps=160)
METHOD_FOR_PEAKS = js.RungeKutta("dopri8", steps=480)  # whose orbits close when sampled more finely, too
HALVED_STEPS = 2e-3 * 0.5 ** np.arange(6)  # relative, of the differences of x_peak
# Where contact begins or ends between two samples their mean is off by the fourth power of their distance, which the
# differences multiply: in two of the scenes by up to 4e-7 of a derivative at 480 in a period, by 3e-10 at 5760.
SAMPLING = js.RungeKutta("dopri8", steps=5760)
FIT_HALF, FIT_DEGREE = 12, 8  # samples on either side of the largest, and the degree of the polynomial through them
CLOSED = 1e-12  # largest closing error of an orbit that is sampled
NEARLY = 0.999  # of the largest peak, from which on another one is too near
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


class Top(NamedTuple):
    """The largest distance of samples from their mean."""

    height: float
    tied: bool  # whether another local maximum is nearly as large
    fitted: np.ndarray  # places of the samples that the polynomial is fitted to


def top_of(x: np.ndarray) -> Top:
    """The peak of samples (n,) over whole periods, without the last, which is the first again."""
    away = np.abs(x - x.mean())
    maxima = np.sort(away[(away > np.roll(away, 1)) & (away >= np.roll(away, -1))])
    about = np.arange(-FIT_HALF, FIT_HALF + 1)
    fitted = (away.argmax() + about) % len(x)
    curve = Polynomial.fit(about, away[fitted], FIT_DEGREE)
    roots = curve.deriv().roots()
    flat = roots[np.isreal(roots) & (np.abs(roots) <= 1)].real
    return Top(float(np.max(curve(flat))), bool(np.sum(maxima > NEARLY * maxima[-1]) > 1), fitted)


class Sampled(NamedTuple):
    """The orbits of some scenes, by their samples."""

    tops: list[Top]
    contact_changes: np.ndarray  # (scenes,) whether the state of contact changes where the polynomial is fitted
    closing: np.ndarray  # (scenes,) distance of the last sample from the first, relative to the largest


def sampled(scenes: Any, starts: Any, q: int) -> Sampled:
    """The tops of the left blade of scenes (leading axis) over `q` periods from starts on their orbits."""
    run = js.simulate(scenes, starts, n_periods=q, method=SAMPLING)
    x = np.asarray(run.motion.x)[..., 0]
    tops = [top_of(one[:-1]) for one in x]
    states = np.stack([run.mode, run.case], axis=-1).reshape(*x.shape, -1)
    changes = [np.any(np.diff(one[top.fitted], axis=0) != 0) for one, top in zip(states, tops, strict=True)]
    return Sampled(tops, np.array(changes), np.abs(x[:, -1] - x[:, 0]) / np.abs(x).max(axis=1))


def why_no_peak(found: Any) -> str:
    """Why the peak of an orbit has no derivative that differences can know; empty if it has one."""
    cycle = found.cycle()
    own = sampled(*jax.tree.map(lambda a: np.asarray(a)[None], (cycle.scene, cycle.start)), cycle.q)
    if own.tops[0].tied:
        return "two peaks nearly tie"
    return "the contact changes at the peak" if own.contact_changes[0] else ""


class Difference(NamedTuple):
    """A derivative by differences."""

    value: float
    doubt: float  # how far the last extrapolation moved it; what the samples miss is not in it


def extrapolated(quotients: np.ndarray) -> Difference:
    """The limit of central differences (n,) at steps that halve, by the extrapolation that moves it least.

    Those that are not known are NaN, and nothing is extrapolated from them.

    Source:
        Ridders (1982), Accurate computation of F'(x) and F'(x) F''(x), Adv. Eng. Software 4.
    """
    best, column = Difference(np.nan, np.inf), quotients
    for power in range(1, len(quotients)):
        finer = column[1:] + np.diff(column) / (4**power - 1)
        moved = np.maximum(np.abs(finer - column[1:]), np.abs(finer - column[:-1]))
        least = int(np.where(np.isnan(moved), np.inf, moved).argmin())
        if moved[least] < best.doubt:
            best = Difference(float(finer[least]), float(moved[least]))
        column = finer
    return best


def peak_differences(found: Any) -> dict[str, Difference]:
    """The derivatives of x_peak of an orbit by its samples and those of orbits nearby, by numbers."""
    cycle = found.cycle()
    scene, sides = with_numbers(cycle.scene, WRT), np.outer(HALVED_STEPS, [-1, 1])
    answer = {}
    for key in WRT:
        number = level_of(scene, key)
        steps = (abs(number) or 1.0) * sides
        scenes = scenes_around(scene, [key], number + steps.reshape(-1, 1))
        own = sampled(scenes, nearby_orbits(cycle, scenes).starts, cycle.q)
        known = (own.closing < CLOSED) & ~own.contact_changes & [not top.tied for top in own.tops]
        heights = np.where(known, [top.height for top in own.tops], np.nan).reshape(steps.shape)
        answer[key] = extrapolated(np.diff(heights)[:, 0] / np.diff(steps)[:, 0])
    return answer


def errors_of_reduction(found: Any, of: str) -> dict[str, float]:
    """The least relative errors of the derivatives of a reduction on an orbit over the steps, by numbers."""
    exact = js.gradient(found.scene, WRT, of=of, orbit=found).value
    quotients = [differences(found, WRT, step, of) for step in STEPS]
    return {key: float(np.fmin.reduce([abs(one[key] / exact[key] - 1) for one in quotients])) for key in WRT}


def errors_of_peak(found: Any) -> tuple[dict[str, float], dict[str, float]]:
    """The relative errors of the derivatives of x_peak on an orbit, and the doubts of the differences, by numbers."""
    exact = js.gradient(found.scene, WRT, of="x_peak", orbit=found).value
    known = peak_differences(found)
    errors = {key: abs(one.value / exact[key] - 1) for key, one in known.items()}
    return errors, {key: abs(one.doubt / exact[key]) for key, one in known.items()}


def is_apart(found: Any) -> bool:
    """Whether the blades of an orbit never touch."""
    return js.gradient(found.scene, "contact.gamma", orbit=found).value["contact.gamma"] == 0


def study(scenes: int, seed: int = 5) -> dict[str, Any]:
    """The largest relative errors by quantities and numbers, over so many settled scenes."""
    by_scene: list[dict[str, dict[str, float]]] = []
    left_out: Counter[str] = Counter()
    told: list[dict[str, Any]] = []
    for scene in random_scenes(np.random.default_rng(seed)):
        if len(told) == scenes or sum(left_out.values()) + len(told) == TRIED:
            break
        found = js.orbit(scene, most_periods=MOST_PERIODS, method=METHOD)
        fine = js.orbit(scene, most_periods=MOST_PERIODS, method=METHOD_FOR_PEAKS)
        reason = ", ".join((*found.flags, *fine.flags)) or ("apart" if is_apart(found) else why_no_peak(fine))
        if reason:
            left_out[reason] += 1
            continue
        errors = {of: errors_of_reduction(found, of) for of in ("P_d", "P_d_vibration")}
        errors["x_peak"], errors["doubt of differences of x_peak"] = errors_of_peak(fine)
        by_scene.append(errors)
        largest = {of: float(np.max([*of_scene.values()])) for of, of_scene in errors.items()}
        told.append({"P_d": float(found.P_d), "q": int(found.q), "largest": largest})
        print(told[-1], file=sys.stderr, flush=True)
    largest = {of: {key: float(np.max([one[of][key] for one in by_scene])) for key in WRT} for of in by_scene[0]}
    return {"scenes": told, "left out": dict(left_out), "largest relative error": largest}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SCENES
    answer = study(count)
    print(json.dumps(answer, indent=1))
    if count == SCENES:
        Path(__file__).with_suffix(".json").write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
