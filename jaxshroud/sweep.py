"""Many scenes at once: bifurcation diagrams and power curves over any number of a scene."""

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.absent import filled
from jaxshroud.analysis.period import PERIOD_TOLERANCE, Periodicity, periodicity
from jaxshroud.analysis.power import Reduction, reduction
from jaxshroud.checks import count_argument, in_precision, word_argument
from jaxshroud.events import Counters
from jaxshroud.extent import fits
from jaxshroud.free import free_runs
from jaxshroud.integrate import FAST, Lane, Method
from jaxshroud.lanes import best
from jaxshroud.linear import area, free_power
from jaxshroud.periods import BLOCK, CHUNK, Clock, Sample, begin_lanes, run_block
from jaxshroud.rhs import whole
from jaxshroud.scene import Motion, Scene, vary
from jaxshroud.stability import Steps, steps_for
from jaxshroud.state import State, Status, start
from jaxshroud.tableau import Tableau

Direction = Literal["independent", "forward", "backward"]
Progress = Callable[[int, int], None]  # lane-periods done so far, and in all


@dataclass(frozen=True)
class SweepResult:
    """A sweep's stroboscopic samples and statistics.

    Arrays start with one dimension per axis of the sweep. Samples have a dimension `period` after these, and a last one
    for the blade where each blade has its own value. Statistics are over the kept periods.
    """

    axes: dict[str, np.ndarray]  # key -> values, in SI
    period: np.ndarray  # absolute count of each kept period
    motion: Motion  # at the drive phase `phase` of each kept period (..., period, 2); NaN after a lane has stopped
    phase: float  # [rad]
    gap: np.ndarray  # [m]
    P: np.ndarray  # (..., 2) [m^4], Eq. (23)
    P_0: np.ndarray  # (..., 2) [m^4]
    P_d: np.ndarray  # left blade, Eq. (24) [%]
    P_d_ci: np.ndarray  # half width of its 95 % interval [percentage points]
    P_d_settled: np.ndarray
    period_number: np.ndarray  # 0: aperiodic
    settled: np.ndarray  # False: transient not over
    period_tol: float
    status: np.ndarray
    energy_residual: np.ndarray | None  # largest of any kept period over the drive's mean work; None without a ledger
    time_apart: np.ndarray  # fractions of the time
    time_stick: np.ndarray
    time_slip: np.ndarray
    v_max: np.ndarray  # largest penetration, of the whole run [m]
    counters: dict[str, np.ndarray]
    steps_per_period: int
    method: Method


def sweep(
    scene: Scene,
    along: Mapping[str, ArrayLike | Sequence[float]],
    *,
    n_periods: int,
    transient: int = 0,
    steps_per_period: Steps = 400,
    direction: Direction = "independent",
    phase: float = 0.0,
    period_tol: float = PERIOD_TOLERANCE,
    method: Method = FAST,
    progress: Progress | None = None,
) -> SweepResult:
    """Simulate `scene` for every value (or pair of values) of one or two of its numbers.

    Args:
        scene: What all lanes have in common.
        along: One or two keys as for `vary`, each with its values (n,) in SI units; two make a grid.
        n_periods: Drive periods kept.
        transient: Drive periods run and discarded before these.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        direction: "independent": every lane starts from `scene.initial`. "forward" or "backward": along the first key
            each value starts from its neighbour's final state, slider and mode included.
        phase: Drive phase omega t at which samples are taken, 0 <= phase < 2 pi [rad].
        period_tol: Tolerance of the period number, see `periodicity`.
        method: Static choices of the march.
        progress: Called with (lane-periods done, lane-periods in all) after every block.

    Returns:
        Samples and statistics of every lane. A lane that failed has a status and NaN; the others are not affected.

    Raises:
        ValueError: A count is too small, an axis is empty, the phase is out of range, the direction is not known, the
            run would be too long or too large (see `extent`), or float64 is not to be had.
        KeyError: The scene has no such number.
    """
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    if not 0 <= phase < 2 * np.pi:
        raise ValueError(f"Argument `phase` must be in [0, 2 pi), but is {phase}.")
    word_argument("direction", direction, Direction)
    axes = {key: np.atleast_1d(np.asarray(values, dtype=float)) for key, values in along.items()}
    if not 1 <= len(axes) <= 2 or any(v.ndim != 1 or v.size == 0 for v in axes.values()):
        raise ValueError("Argument `along` must name one or two keys, each with at least one value.")
    fits(math.prod(v.size for v in axes.values()), transient, n_periods)
    scenes = in_precision(grid_of_scenes(scene, axes), method.precision)
    steps = steps_for(scenes, len(axes), steps_per_period, stepper(scene, method))
    plan = Plan(transient, n_periods, steps, phase, method)
    shape = tuple(len(v) for v in axes.values())
    total = int(np.prod(shape)) * (transient + n_periods)
    ticker = Ticker(total, progress)
    if direction == "independent":
        flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), scenes)
        runs = run_lanes(flat, starts(flat), plan, ticker)
        runs = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), runs)
    else:
        runs = continued(scenes, shape, direction, plan, ticker)
    return _result(scenes, axes, runs, plan, period_tol)


def grid_of_scenes(scene: Scene, axes: Mapping[str, np.ndarray]) -> Scene:
    """Scenes with one leading dimension per axis."""
    build = lambda *values: varied(scene, axes, values)  # noqa: E731
    for i in reversed(range(len(axes))):
        build = jax.vmap(build, in_axes=[0 if j == i else None for j in range(len(axes))])
    return jax.jit(build)(*(jnp.asarray(v) for v in axes.values()))


def varied(scene: Scene, keys: Iterable[str], values: Iterable[Any]) -> Scene:
    """`scene` with several numbers replaced, one after the other."""
    for key, value in zip(keys, values, strict=True):
        scene = vary(scene, key, value)
    return scene


def scenes_at(scene: Scene, keys: Sequence[str], values: np.ndarray) -> Scene:
    """Scenes (leading axis) with the numbers `keys` set to each row of `values` (n, keys)."""
    return _scenes_at(scene, tuple(keys), jnp.asarray(values, scene.drive.omega.dtype))


@partial(jax.jit, static_argnames="keys")
def _scenes_at(scene: Scene, keys: tuple[str, ...], rows) -> Scene:
    return jax.vmap(lambda row: varied(scene, keys, row))(rows)


def starts(scenes: Scene) -> State:
    """The state of each scene at t = 0."""
    return jax.vmap(lambda scene: start(scene.initial))(scenes)


@dataclass(frozen=True)
class Plan:
    """How long to run, on which time grid."""

    transient: int
    kept: int
    steps_per_period: int
    phase: float
    method: Method

    @property
    def clock(self) -> Clock:
        """The grid of whole periods, from the sampling phase."""
        n = self.steps_per_period
        return Clock(jnp.asarray(self.phase / (2 * np.pi)), jnp.int32(n), jnp.asarray(float(n)))

    @property
    def lead_in(self) -> Clock | None:
        """The grid from phase 0 to the sampling phase, of steps no longer than the others."""
        turns = self.phase / (2 * np.pi)
        steps = int(np.ceil(turns * self.steps_per_period))
        return Clock(jnp.asarray(0.0), jnp.int32(steps), jnp.asarray(steps / turns)) if steps else None


def stepper(scene: Scene, method: Method) -> Tableau | None:
    """What steps through a scene: nothing where there is a closed form."""
    return None if scene.parts.contact == "none" else method.tableau


class Ticker:
    """Sums up the lane-periods done and passes them on."""

    def __init__(self, total: int, report: Progress | None):
        self.total, self.done, self.report = total, 0, report

    def __call__(self, lane_periods: int) -> None:
        """Report `lane_periods` more as done."""
        self.done += lane_periods
        if self.report is not None:
            self.report(self.done, self.total)


@dataclass(frozen=True)
class Runs:
    """What came out of a batch of lanes."""

    samples: Any  # Sample of arrays (lanes, kept, ...)
    before: Any  # Tally when the kept periods began
    last: Any  # Lane at the end


jax.tree_util.register_dataclass(Runs, ["samples", "before", "last"], [])


def run_lanes(scenes: Scene, states: State, plan: Plan, ticker: Callable[[int], None]) -> Runs:
    """All lanes (leading axis), in chunks that share one compiled function, one thread per core."""
    lanes = len(scenes.drive.omega)
    if scenes.parts.contact == "none":
        samples, last = free_runs(scenes, states, plan.transient, plan.kept, plan.phase, plan.method)
        ticker(lanes * (plan.transient + plan.kept))
        return Runs(samples, last.tally, last)
    width = 1 if lanes == 1 else CHUNK
    pieces = [np.minimum(np.arange(i, i + width), lanes - 1) for i in range(0, lanes, width)]
    real = [min(width, lanes - i) for i in range(0, lanes, width)]
    run = lambda at, n: _run_chunk(_take((scenes, states), at), plan, lambda p: ticker(p * n))  # noqa: E731
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        done = list(pool.map(run, pieces, real))
    return jax.tree.map(lambda *a: np.concatenate(a)[:lanes], *done)


def _take(tree, at):
    return jax.tree.map(lambda a: np.asarray(a)[at], tree)


def _run_chunk(chunk: tuple[Scene, State], plan: Plan, tick: Callable[[int], None]) -> Runs:
    scenes, states = chunk
    lanes = begin_lanes(scenes, states, plan.method)
    if plan.lead_in is not None:
        lanes, _ = run_block(scenes, lanes, plan.lead_in, jnp.int32(1), plan.method, BLOCK, best())
    lanes, _ = _blocks(scenes, lanes, plan.transient, plan, tick, keep=False)
    lanes = eqx.tree_at(_times, lanes, jax.tree.map(jnp.zeros_like, _times(lanes)))  # late in float32, sums lose digits
    before = lanes.tally
    lanes, samples = _blocks(scenes, lanes, plan.kept, plan, tick, keep=True)
    return jax.tree.map(np.asarray, Runs(samples, before, lanes))


def _times(lanes: Any):
    log = lanes.tally.log
    return log.time_apart, log.time_stick, log.time_slip


def _blocks(scenes: Scene, lanes: Lane, periods: int, plan: Plan, tick, keep: bool):
    kept: list[Sample] = []
    for done in range(0, periods, BLOCK):
        n = min(BLOCK, periods - done)
        lanes, sample = run_block(scenes, lanes, plan.clock, jnp.int32(n), plan.method, BLOCK, best())
        jax.block_until_ready(lanes.status)
        if keep:
            kept.append(jax.tree.map(lambda a, n=n: _in_full(a)[:n].T, sample))
        tick(n)
    return lanes, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *kept) if kept else None


def continued(scenes: Scene, shape: tuple[int, ...], direction: Direction, plan: Plan, ticker: Ticker) -> Runs:
    """Lanes along the first axis one after the other, each from the final state of the one before."""
    order = range(shape[0]) if direction == "forward" else range(shape[0] - 1, -1, -1)
    runs: list[Any] = [None] * shape[0]
    state = None
    for i in order:
        here = jax.tree.map(lambda a, i=i: a[i].reshape(-1, *a.shape[len(shape) :]), scenes)
        fresh = starts(here)
        runs[i] = run_lanes(here, fresh if state is None else state, plan, ticker)
        state = _carried_on(runs[i].last, fresh)
    return jax.tree.map(lambda *a: np.stack(a).reshape(*shape, *a[0].shape[1:]), *runs)


def final_states(last: Lane) -> State:
    """The states that lanes have come to, as a start for others."""
    state = whole(last.state)
    motion = Motion(*(np.stack(pair, axis=-1) for pair in state.motion))
    return State(motion, state.u_s, state.mode, state.case)


def _carried_on(last: Lane, fresh: State) -> State:
    """The final states, but a fresh start for lanes that had stopped."""
    ok = last.status == Status.OK
    choose = lambda a, b: np.where(ok.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b)  # noqa: E731
    return jax.tree.map(choose, final_states(last), fresh)


def relative_residual(samples: Sample) -> np.ndarray:
    """Largest energy residual of any period over the mean work of the drive in one, (lanes,)."""
    work = np.abs(samples.work).mean(axis=-1)
    return np.abs(samples.residual).max(axis=-1) / np.where(work > 0, work, 1.0)


@jax.jit
def _closed_forms(scenes: Scene):
    return jax.vmap(lambda scene: (area(scene.shroud), free_power(scene)))(scenes)


def averages(scenes: Scene, samples: Sample) -> tuple[Periodicity, Reduction, Any]:
    """Period number and power of lanes (one leading axis of lanes) over their kept periods, and P_0 (lanes, 2)."""
    A, P_0 = (np.asarray(f, float) for f in _closed_forms(scenes))
    orbit = periodicity(np.asarray(samples.motion.x[0], float), PERIOD_TOLERANCE)
    return orbit, reduction(A[:, None, None] * np.stack(samples.power, axis=-1), P_0, orbit.number), P_0


def _in_full(a) -> np.ndarray:
    return np.asarray(a, float) if np.issubdtype(np.asarray(a).dtype, np.floating) else np.asarray(a)


def _result(scenes: Scene, axes: dict[str, np.ndarray], runs: Runs, plan: Plan, period_tol: float) -> SweepResult:
    shape = tuple(len(v) for v in axes.values())
    flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), scenes)
    A, P_0 = (np.asarray(f, float).reshape(*shape, -1) for f in _closed_forms(flat))
    runs = jax.tree.map(_in_full, runs)
    stack = lambda pair: np.stack(pair, axis=-1)  # noqa: E731
    motion = Motion(*map(stack, runs.samples.motion))
    orbit = periodicity(motion.x[..., 0], period_tol)
    power = reduction(A[..., None] * stack(runs.samples.power), P_0, orbit.number)
    log, before = runs.last.tally.log, runs.before.log
    spent = [getattr(log, n) - getattr(before, n) for n in ("time_apart", "time_stick", "time_slip")]
    whole = sum(spent)
    with np.errstate(invalid="ignore", divide="ignore"):
        times = [t / whole for t in spent]
        residual = relative_residual(runs.samples) if plan.method.ledger else None
    counts = [filled(of.counters, runs.last.status) for of in (log, before)]
    counters = {n: np.asarray(getattr(counts[0], n) - getattr(counts[1], n)) for n in Counters.__annotations__}
    return SweepResult(
        axes=axes,
        period=np.arange(plan.transient + 1, plan.transient + plan.kept + 1),
        motion=motion,
        phase=plan.phase,
        gap=np.asarray(scenes.shroud.gap),
        P=power.P,
        P_0=P_0,
        P_d=power.P_d,
        P_d_ci=power.ci,
        P_d_settled=power.settled,
        period_number=orbit.number,
        settled=orbit.settled,
        period_tol=period_tol,
        status=np.asarray(runs.last.status),
        energy_residual=residual,
        time_apart=times[0],
        time_stick=times[1],
        time_slip=times[2],
        v_max=np.asarray(log.v_max),
        counters=counters,
        steps_per_period=plan.steps_per_period,
        method=plan.method,
    )
