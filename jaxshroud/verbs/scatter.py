"""How P_d scatters where numbers of a scene do, and which of them it owes that to."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Progress
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.gradient import with_numbers
from jaxshroud.motion.scatter import draws, indices
from jaxshroud.results.attractors import share_interval
from jaxshroud.results.scatter import Scatter
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.design import check_bounds
from jaxshroud.verbs.door import asked
from jaxshroud.verbs.lanes import one_scene
from jaxshroud.verbs.sweep import sweep

LIKELY = (0.05, 0.5, 0.95)


def scatter(
    scene: Scene | SceneFile,
    over: Mapping[str, tuple[float, float]],
    *,
    at_least: float | None = None,
    samples: int = 256,
    seed: int = 0,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Scatter:
    """The distribution of P_d where numbers are uniform between bounds, each on its own, and what it comes from.

    It does not ask for a smooth or periodic motion: where motions jump or are chaotic, gradients say little, and this
    does.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        over: Keys as for `vary`, each with its lower and upper bound in SI units.
        at_least: P_d [percent] whose probability is asked for.
        samples: Rows of each of the design's matrices, rounded up to a power of 2; (2 + keys) times as many runs.
        seed: Of the draws.
        n_periods: Drive periods that each P_d is averaged over; by default 64.
        transient: Drive periods run before; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest draw needs, as where only a
            method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method.
        state: Where all start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods in all).
        throw: Raise where a draw stops before its end, rather than warn.

    Returns:
        P_d of the draws, its quantiles, the probability, and of each number its share of the variance alone (`first`)
        and with all that it takes part in (`total`), with 95 % intervals. Draws that stopped count as missing
        `at_least`, and as the mean of all others in the shares.

    Raises:
        KeyError: The scene has no such number.
        ValueError: Bounds are not in order, a count is too small, or many scenes are given.
        NumericalError: With `throw`: a draw stopped.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> short = dict(samples=8, n_periods=2, transient=2, steps_per_period=100)
        >>> found = js.scatter(scene, {"shroud.gap": (1e-5, 3e-5), "friction.mu": (0.2, 0.4)}, at_least=0, **short)
        >>> found.P_d.shape, found.total.shape
        ((16,), (2,))
    """
    own = one_scene("scatter", scene)
    check_bounds(over)
    ends = np.array(list(over.values()), float)
    count_argument("samples", samples, 2)
    if at_least is not None and not np.isfinite(at_least):
        raise InputError(f"Argument `at_least` must be a number, but is {at_least}.")
    given = {"n_periods": n_periods, "transient": transient, "steps_per_period": steps_per_period}
    door = asked(scene, **given, method=method, accuracy=accuracy)
    n = 1 << (samples - 1).bit_length()
    lanes = (2 + len(over)) * n
    fits(lanes, door.transient, door.n_periods, lanes)
    rows = draws(n, ends, seed)
    many = scenes_at(with_numbers(own, list(over)), list(over), rows.reshape(-1, len(over)))
    run = sweep(
        many,
        n_periods=door.n_periods,
        transient=door.transient,
        steps_per_period=door.steps,
        method=door.method,
        accuracy=door.accuracy,
        state=state,
        samples=False,
        progress=progress,
        throw=throw,
    )
    P_d, status = (a.reshape(rows.shape[:2]) for a in (np.asarray(run.P_d, float), run.status))
    P_d = np.where(status == Status.OK, P_d, np.nan)
    values = _statistics(P_d, at_least) | indices(_filled(P_d), seed)._asdict()
    values |= {"low": ends[:, 0], "high": ends[:, 1], "drawn": np.concatenate(rows[:2]), "status": np.ravel(status[:2])}
    how = {"method": str(run.method), "steps_per_period": run.steps_per_period, "seed": seed}
    how |= {"stopped": int(np.sum(status != Status.OK)), "runs": lanes}
    attrs = {"title": "", "scene": door.about(door.transient, run.steps_per_period)[0]["scene"]}
    return Scatter.from_values({**values, **how}, coords={"key": list(over)}, attrs=attrs)


def _filled(P_d: np.ndarray) -> np.ndarray:
    """P_d with the mean of the others where a run stopped."""
    fine = np.isfinite(P_d)
    return np.where(fine, P_d, P_d[fine].mean() if fine.any() else 0.0)


def _statistics(P_d: np.ndarray, at_least: float | None) -> dict[str, Any]:
    """Of the independent draws, which are the first two rows."""
    independent = np.ravel(P_d[:2])
    fine = independent[np.isfinite(independent)]
    low, middle, high = np.quantile(fine, LIKELY) if fine.size else (np.nan,) * 3
    told = {"P_d": independent, "mean": fine.mean() if fine.size else np.nan}
    told |= {"median": middle, "likely_low": low, "likely_high": high}
    if at_least is None:
        return told
    met = np.array([np.sum(fine >= at_least)])
    ends = share_interval(met, independent.size)
    share = {"probability": met[0] / independent.size, "probability_low": ends[0][0], "probability_high": ends[1][0]}
    return {**told, "at_least": at_least, **share}
