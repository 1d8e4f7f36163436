"""Contact stiffness, friction and gap from noisy responses: python tests/studies/identify.py.

Forty tries, half of them with the article's large inertia (`table1`) and half with the blocks' own (`realistic`), whose
faces stay nearly parallel. Each draws k, mu, gap, force and moment at random, from scenes that settle on an orbit and
slip. What is measured is x and y of both blades, from rest through the first periods, 16 times a period, with noise of
1 % of each signal's root mean square: computed by RK8 with twice the steps of the model that is fitted. What is known
beforehand is 10 to 20 % off in each number. The fit is by least squares in the numbers' logarithms, with the exact
slopes of `rollout` through all events (Levenberg-Marquardt). A response has other minima: of 64 points within 25 %,
and the first, the three best are starts, and the best end is the fit. Intervals are those of the fit made linear, with
Student's t and the noise that the residuals show; nobody tells the fit how large it is.

A second experiment on the same scenes looks at as many periods of the settled motion alone.
"""

import json
import math
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

import jaxshroud as js
from jaxshroud.march.method import Method

KEYS = ("contact.k", "friction.mu", "shroud.gap")
FAMILIES = {"table1": [], "realistic": ['blades.I="block"']}
TRIES, SEED = 20, 15  # of each family
NOISE = 0.01  # of each signal's root mean square
PERIODS, A_PERIOD = 12, 16  # that are measured, and how often
SETTLED = 24  # periods that pass before the second experiment looks
SCANNED, REACH, STARTS = 64, 0.25, 3  # points around the first guess, how far from it, and how many of them are starts
MOST = 50  # evaluations from one start
STEPS = 400
MODEL = js.RungeKutta()
FINER = {
    "method": js.RungeKutta("dopri8", locate="bisection"),
    "steps": 2 * STEPS,
}  # what is measured owes nothing to the model's own errors
SLIPS = 0.05  # of the time, at least
Signals = Any  # (samples, 4): x and y of both blades [m]


class Fit(NamedTuple):
    """What a fit says of the logarithms of the three numbers."""

    value: np.ndarray
    half: np.ndarray  # of the 95 % interval
    noise: float  # that the residuals show, over each signal's root mean square
    runs: int


def random_scene(family: str, rng: np.random.Generator) -> js.Scene:
    """A scene with random numbers where designs and tests differ."""
    scene = js.load("table1", ["contact.k=1e5", *FAMILIES[family]]).scene
    k = math.exp(rng.uniform(math.log(3e4), math.log(4e5)))
    drawn = {
        "contact.k": k,
        "friction.mu": rng.uniform(0.1, 0.6),
        "shroud.gap": rng.uniform(5e-6, 6e-5),
        "drive.F_0": rng.uniform(20, 80),
        "drive.M_0": rng.uniform(0.1, 1.0),
    }
    for key, value in drawn.items():
        scene = js.vary(scene, key, value)
    return scene


def regular_scenes(family: str, count: int, rng: np.random.Generator) -> list[js.Scene]:
    """The first scenes drawn that settle on an orbit and slip on it."""
    drawn = [random_scene(family, rng) for _ in range(2 * count)]
    seen = js.sweep(js.stack_scenes(drawn), n_periods=64, transient=300, method=js.RungeKutta(steps=STEPS))
    good = (seen.status == js.Status.OK) & (seen.period_number > 0) & (seen.time_slip > SLIPS)
    return [scene for scene, is_good in zip(drawn, good, strict=True) if is_good][:count]


def at(scene: js.Scene, logs: Any) -> js.Scene:
    """The scene with other numbers."""
    for i, key in enumerate(KEYS):
        scene = js.vary(scene, key, jnp.exp(logs[i]))
    return scene


def logs_of(scene: js.Scene) -> np.ndarray:
    """Logarithms of the scene's numbers."""
    return np.log([js.value_of(scene, key) for key in KEYS])


@partial(jax.jit, static_argnames=("skipped", "steps", "method"))
def signals(scene: js.Scene, skipped: int = 0, steps: int = STEPS, method: Method = MODEL) -> Signals:
    """What sensors would see from rest, without noise."""
    save = lambda now: jnp.concatenate([now.state.motion.x, now.state.motion.y])
    how = {"every": steps // A_PERIOD, "method": method.replace(steps=steps)}
    return js.rollout(scene, None, skipped + PERIODS, save=save, **how).saved[skipped * A_PERIOD :]


@partial(jax.jit, static_argnames="skipped")
def misfit(logs: Any, scene: js.Scene, measured: Signals, skipped: int) -> Any:
    """Differences of signals over each one's root mean square."""
    size = jnp.sqrt(jnp.mean(measured**2, axis=0))
    return jnp.ravel((signals(at(scene, logs), skipped) - measured) / size)


slopes = partial(jax.jit, static_argnames="skipped")(jax.jacfwd(misfit))
misfits = partial(jax.jit, static_argnames="skipped")(jax.vmap(misfit, in_axes=(0, None, None, None)))


def starts(scene: js.Scene, measured: Signals, first: np.ndarray, skipped: int, rng: np.random.Generator) -> np.ndarray:
    """Of points around the first guess, and itself, those that fit best."""
    around = first + np.log1p(rng.uniform(-REACH, REACH, (SCANNED, len(KEYS))))
    points = np.concatenate([first[None], around])
    costs = np.sum(np.asarray(misfits(points, scene, measured, skipped)) ** 2, axis=1)
    return points[np.argsort(costs)[:STARTS]]


def fitted(scene: js.Scene, measured: Signals, first: np.ndarray, skipped: int, rng: np.random.Generator) -> Fit:
    """The numbers that fit best, and their intervals."""
    of = lambda f: lambda logs: np.asarray(f(logs, scene, measured, skipped))
    ends = [
        least_squares(of(misfit), start, of(slopes), method="lm", max_nfev=MOST)
        for start in starts(scene, measured, first, skipped, rng)
    ]
    found = min(ends, key=lambda end: end.cost)
    free = len(found.fun) - len(KEYS)
    noise = math.sqrt(2 * found.cost / free)
    scatter = noise * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return Fit(found.x, student.ppf(0.975, free) * scatter, noise, sum(end.nfev + end.njev for end in ends))


def tried(scene: js.Scene, skipped: int, rng: np.random.Generator) -> dict[str, Any]:
    """One try: what was true, what the fit says of it."""
    exact = np.asarray(signals(scene, skipped, **FINER))
    measured = exact + NOISE * np.sqrt(np.mean(exact**2, axis=0)) * rng.standard_normal(exact.shape)
    off = rng.uniform(0.1, 0.2, len(KEYS)) * rng.choice([-1, 1], len(KEYS))
    truth = logs_of(scene)
    fit = fitted(scene, measured, truth + np.log1p(off), skipped, rng)
    error = fit.value - truth
    return {
        "truth": np.exp(truth).tolist(),
        "start off": off.tolist(),
        "error": error.tolist(),
        "half width": fit.half.tolist(),
        "covered": (np.abs(error) <= fit.half).tolist(),
        "noise": fit.noise,
        "runs": fit.runs,
    }


def figures(tries: int, skipped: int, seed: int) -> dict[str, Any]:
    """Both families; covered tries of each number, and how wide the intervals are."""
    rng, found = np.random.default_rng(seed), []
    for family in FAMILIES:
        for scene in regular_scenes(family, tries, rng):
            found.append({"family": family, **tried(scene, skipped, rng)})
            print(json.dumps(found[-1]), flush=True)
    covered, half = (np.array([one[name] for one in found]) for name in ("covered", "half width"))
    return {
        "tries": len(found),
        "covered": dict(zip(KEYS, covered.sum(axis=0).tolist(), strict=True)),
        "median half width": dict(zip(KEYS, np.median(half, axis=0).tolist(), strict=True)),
        "largest half width": dict(zip(KEYS, half.max(axis=0).tolist(), strict=True)),
        "noise, least and largest": [min(one["noise"] for one in found), max(one["noise"] for one in found)],
        "each": found,
    }


def main() -> None:
    """Both experiments."""
    jax.config.update("jax_enable_x64", True)
    told = {"command": "python tests/studies/identify.py", "version": js.__version__, "seed": SEED}
    for name, skipped in (("from rest", 0), ("settled", SETTLED)):
        told[name] = figures(TRIES, skipped, SEED)
        print(json.dumps({name: told[name] | {"each": ...}}, default=str), flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
