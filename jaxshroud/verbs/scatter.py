"""The distribution of P_d where numbers of a scene scatter, and the share of each number in its variance."""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress
from jaxshroud.linear.held_contact import LinearState
from jaxshroud.march.method import FOR_P_D
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.scatter import Scatter
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import InputError, Precision, count_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.quantities import Quantity, amplitude_of, check_only_P_d, counted_amplitude, is_reduction
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.typed import typed
from jaxshroud.scene.vary import value_of, with_numbers
from jaxshroud.signals.amplitudes import check_vibration, counted_reduction
from jaxshroud.signals.averages import stiffnesses
from jaxshroud.signals.period import CLOSING_ROUNDINGS
from jaxshroud.signals.statistics import SobolIndices, saltelli_rows, variance_indices
from jaxshroud.verbs.arguments import MethodArgument, ResolvedOptions, plan_march, resolve_options
from jaxshroud.verbs.design_problem import check_bounds, check_condition, check_objective
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.scattering import Spread, probability_values, scatter_bounds
from jaxshroud.verbs.settled import default_state, in_state
from jaxshroud.verbs.sweep import sweep

QUANTILES = (0.05, 0.5, 0.95)  # of P_d


@typed
def scatter(
    scene: Scene | SceneFile,
    scatters: Mapping[str, Spread],
    *,
    conditions: Mapping[str, Sequence[float]] | None = None,
    of: Quantity | None = None,
    linear: LinearState | None = None,
    at_least: float | None = None,
    draws: int = 256,
    seed: int = 0,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Scatter:
    """The distribution of P_d, or of `of`, where numbers scatter uniformly and independently, and whence its variance.

    The motion need not be smooth or periodic: where motions jump or are chaotic, gradients say little, but the
    distribution is still meaningful.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        scatters: Keys as for `vary`, each with a half width about the scene's value (a number in SI units, or a share
            such as "20%"), or with its lower and upper bound in SI units. `row.mistuning` scatters for each blade of a
            row by itself, with a sample matrix for each.
        conditions: Operating conditions: keys with their values in SI units. Every draw is run in all combinations, and
            its P_d is the least of them, another quantity the largest. A condition that scatters does so about each of
            its values, in proportion to its value in the scene.
        of: By default P_d, and of a scene with a mean load or interference P_d_vibration: "P_d", "P", or an amplitude
            of the left blade, "x_peak" or another of `gradient`; of a row P_d and P of all blades, "P_d_worst" of the
            blade that gains the least, or the largest RMS value or peak.
        linear: "apart" or "stuck": in closed form, of contact that stays in this state; by default where that of all
            draws does, see `power`.
        at_least: P_d, or P_d_worst, [percent] whose probability is computed.
        draws: Rows of each of the two sample matrices, rounded up to a power of 2; there are (2 + keys) times as many
            runs in every condition.
        seed: Seed of the draws.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods in all).
        throw: Raise where a lane stops before its end, rather than warn.

    Returns:
        P_d of the draws, and `level` where `of` is another quantity, the quantiles, the probability, the largest normal
        force of any run, and for each number its share of the variance alone (`first`) and including its interactions
        (`total`), with 95 % intervals, whose estimated ends may lie outside 0 to 1. Draws that stopped count as missing
        `at_least`, and as the mean of all others in the shares. Shares are NaN where the quantity varies by no more
        than rounding (`Scatter.undefined`).

    Raises:
        KeyError: The scene has no such number.
        ValueError: Bounds are not in order, a count is too small, many scenes are given, or `of` is a reduction where
            in some condition no blade vibrates without contact.
        NumericalError: With `throw`: a draw stopped.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> short = dict(draws=8, n_periods=2, transient=2, method=js.RungeKutta(steps=100))
        >>> found = js.scatter(scene, {"shroud.gap": 1e-5, "friction.mu": (0.2, 0.4)}, at_least=0.0, **short)
        >>> found.P_d.shape, found.total.shape
        ((16,), (2,))
    """
    scene = in_state(scene, linear)
    nominal = one_scene("scatter", scene)
    check_row(nominal)
    of = of or counted_reduction(nominal)
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method)
    for key, of_condition in (conditions or {}).items():
        check_condition(key, of_condition, nominal.layout)
    condition_values = {key: np.ravel(values).astype(float) for key, values in (conditions or {}).items()}
    per_draw = math.prod(map(len, condition_values.values()))
    check_objective(of, nominal)
    check_only_P_d("at_least", at_least, of)
    bounds = scatter_bounds(nominal, scatters)
    rows = draw_rows(nominal, bounds, at_least, draws, seed, resolved, per_draw)
    lanes = rows.shape[0] * rows.shape[1] * per_draw
    ends = np.array(list(bounds.values()), float)
    scenes = _scenes(nominal, list(bounds), rows.reshape(-1, len(bounds)), condition_values)
    require_sector(scenes)
    if is_reduction(of):
        check_vibration(of, scenes, lambda lacks: lacks.reshape(per_draw, -1).all(axis=1).any())  # all of a condition
    if linear is None and state is None:
        linear = default_state(scenes, method)
        scenes = in_state(scenes, linear)
        resolved = resolved._replace(scene=in_state(resolved.scene, linear))
    march = plan_march(resolved, scenes, FOR_P_D)
    run = sweep(
        scenes,
        n_periods=resolved.n_periods,
        transient=resolved.transient,
        method=march.again,
        state=state,
        amplitudes=amplitude_of(of) is not None,
        keep_samples=False,
        progress=progress,
        throw=throw,
    )

    def reshaped(a):
        return np.asarray(a).reshape(per_draw, *rows.shape[:2])

    P_d = reshaped(run.P_d).astype(float)
    P_d_ci = reshaped(run.P_d_ci).astype(float)
    status = reshaped(run.status)
    P_d_ci = np.take_along_axis(P_d_ci, np.argmin(P_d, axis=0)[None], axis=0)[0]  # of the least
    stopped = int(np.sum(status != Status.OK))
    status = status.max(axis=0)
    P_d = np.where(status == Status.OK, P_d.min(axis=0), np.nan)
    alone = np.where(status == Status.OK, reshaped(run.P_d_vibration).min(axis=0), np.nan)
    values: dict[str, object] = {"P_d": np.ravel(P_d[:2]), "P_d_ci": np.ravel(P_d_ci[:2]), "of": of}
    values |= {"P_d_vibration": np.ravel(alone[:2])}
    level = P_d
    if of != "P_d":
        every = reshaped(_levels(run, of, nominal.layout))
        worst = every.min(axis=0) if is_reduction(of) else every.max(axis=0)
        level = np.where(status == Status.OK, worst, np.nan)
        values |= {"level": np.ravel(level[:2])}
    precision = march.method.precision
    values |= _statistics(level, at_least) | _shares(level, of, seed, precision)._asdict()
    values |= {"low": ends[:, 0], "high": ends[:, 1], "drawn": np.concatenate(rows[:2]), "status": np.ravel(status[:2])}
    forces = stiffnesses(scenes) * run.penetrations
    values |= {"v_max": np.nanmax(run.v_max, initial=0), "N_max": np.nanmax(forces, initial=0)}
    values |= {"conditions_json": json.dumps({key: at.tolist() for key, at in condition_values.items()})}
    settings: dict[str, object] = {**march.attributes, "seed": seed, "stopped": stopped, "runs": lanes}
    attrs = {"title": "", "scene": resolved.provenance(march.steps)[0]["scene"]}
    return Scatter.from_values({**values, **settings}, coords={"key": list(bounds)}, attrs=attrs)


def _levels(run: SweepResult, of: Quantity, layout: Layout) -> np.ndarray:
    """A quantity other than P_d of all lanes, of the blades that count."""
    values = np.asarray(getattr(run, of), float)
    if is_reduction(of):
        return values
    return values[..., layout.counting].sum(axis=-1) if of == "P" else counted_amplitude(values, layout)


def draw_rows(
    scene: Scene,
    bounds: Mapping[str, tuple[float, float]],
    at_least: float | None,
    draws: int,
    seed: int,
    resolved: ResolvedOptions,
    per_draw: int = 1,
) -> np.ndarray:
    """The numbers of all draws of a scatter, (2 + keys, n, keys), after a check of the arguments.

    Each draw is run `per_draw` times.

    Raises:
        KeyError: The scene has no such number.
        ValueError: See `scatter`.
    """
    check_bounds(bounds, scene)
    with_numbers(scene, list(bounds))
    seed_argument(seed)
    count_argument("draws", draws, 2)
    check_at_least(at_least)
    n = 1 << (draws - 1).bit_length()
    lanes = (2 + len(bounds)) * n * per_draw
    check_size(lanes, resolved.transient, resolved.n_periods, lanes, scene.layout.blades)
    return saltelli_rows(n, np.array(list(bounds.values()), float), seed)


def check_at_least(at_least: float | None) -> None:
    """Raise an InputError unless it is a finite number or None."""
    if at_least is not None and not np.isfinite(at_least):
        raise InputError(f"Argument `at_least` must be a number, but is {at_least}.")


def _scenes(nominal: Scene, keys: Sequence[str], rows: np.ndarray, condition_values: Mapping[str, np.ndarray]) -> Scene:
    """The scenes of all draws (draws, keys) in every condition, (conditions * draws,), the draws varying fastest."""
    others = [key for key in condition_values if key not in keys]
    numbered = with_numbers(nominal, [*keys, *others])
    table = []
    for values in product(*condition_values.values()):
        condition = dict(zip(condition_values, values, strict=True))
        drawn = [rows[:, i] * _ratio_to_scene(numbered, key, condition.get(key)) for i, key in enumerate(keys)]
        table.append(np.stack([*drawn, *(np.full(len(rows), condition[key]) for key in others)], axis=1))
    return scenes_at(numbered, [*keys, *others], np.concatenate(table))


def _ratio_to_scene(scene: Scene, key: str, value: float | None) -> float:
    """The value of a condition over that of the scene; 1 for a number that is no condition."""
    if value is None:
        return 1.0
    nominal = value_of(scene, key)
    if nominal == 0:
        raise InputError(
            f"{key} scatters and is an operating condition, but is 0 in the scene: no condition has a ratio to that."
        )
    return value / nominal


def _shares(level: np.ndarray, of: Quantity, seed: int, precision: Precision) -> SobolIndices:
    """The shares of the variance of a quantity, with the rounding of the precision in which it was computed."""
    values = _with_mean(level)
    size = 100.0 if is_reduction(of) else float(np.abs(values).max())  # a reduction is a difference from 100 %
    return variance_indices(values, seed, CLOSING_ROUNDINGS * float(np.finfo(precision).eps) * size)


def _with_mean(level: np.ndarray) -> np.ndarray:
    """The quantity, with the mean of the others where a run stopped."""
    finite = np.isfinite(level)
    return np.where(finite, level, level[finite].mean() if finite.any() else 0.0)


def _statistics(level: np.ndarray, at_least: float | None) -> dict[str, object]:
    """The statistics of the independent draws, which are the first two rows."""
    independent = np.ravel(level[:2])
    finite = independent[np.isfinite(independent)]
    low, middle, high = np.quantile(finite, QUANTILES) if finite.size else (np.nan,) * 3
    mean = finite.mean() if finite.size else np.nan
    statistics: dict[str, object] = {"mean": mean, "median": middle, "likely_low": low, "likely_high": high}
    if at_least is None:
        return statistics
    return {**statistics, **probability_values(independent, at_least)}
