"""Many scenes at once: bifurcation diagrams and power curves over any number of a scene."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.absent import Scalar, filled
from jaxshroud.analysis.period import PERIOD_TOLERANCE, Repetition, repetition
from jaxshroud.analysis.power import Reduction, reduction
from jaxshroud.analysis.settling import YES
from jaxshroud.chatter import chatter
from jaxshroud.checks import count_argument, in_precision, tolerance_argument, word_argument
from jaxshroud.events import Counters
from jaxshroud.extent import fits
from jaxshroud.free import free_runs
from jaxshroud.geometry import corners
from jaxshroud.integrate import FAST, Lane, Method
from jaxshroud.lanes import best
from jaxshroud.linear import area, free_power
from jaxshroud.periods import BLOCK, CHUNK, Clock, Sample, begin_lanes, periods_at_once, run_block
from jaxshroud.rhs import whole
from jaxshroud.scene import Motion, Scene, Shroud, vary
from jaxshroud.stability import Steps, steps_for
from jaxshroud.state import State, Status, start
from jaxshroud.tableau import Tableau
from jaxshroud.threads import Check, Interrupted, in_threads

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
    P_d_settled: np.ndarray  # True: on evidence
    period_number: np.ndarray  # 0: aperiodic
    settled: np.ndarray  # True: the transient is over, on evidence
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
    settling: np.ndarray  # 0: the transient is not over, 1: it is, 2: unknown
    periods_more: np.ndarray  # of transient until it is; NaN if unknown
    P_d_settling: np.ndarray  # 0: P_d still drifts, 1: it does not, 2: unknown
    P_d_periods_more: np.ndarray  # of transient until it no longer does; NaN if unknown
    P_d_ci_short: np.ndarray  # True: fewer than 30 correlation times, too few to trust the interval
    energy_dropped: np.ndarray | None = None  # by flat contact, largest of any kept period over the drive's gross work
    chatter: str | None = None  # what alternated in the first lane that stopped with TOO_MANY_EVENTS

    @property
    def complete(self) -> bool:
        """Whether all lanes were run; False only in the result that an interruption leaves."""
        return not np.any(self.status == Status.NOT_RUN)

    def __repr__(self) -> str:
        along = " x ".join(f"{key} ({len(v)}: {v[0]:g} to {v[-1]:g})" for key, v in self.axes.items())
        ended = ", ".join(
            f"{n} {Status(s).name}" for s, n in zip(*np.unique(self.status, return_counts=True), strict=True)
        )
        best = np.nanmax(self.P_d, initial=-np.inf, where=self.status == Status.OK)
        return (
            f"SweepResult along {along}: {len(self.period)} periods kept of each lane; {ended}; "
            f"largest P_d {best:.4g} %; {self.method}, {self.steps_per_period} steps a period"
        )


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
        ValueError: A count is too small, an axis is empty, the phase or the tolerance is out of range, the direction is
            not known, the run would be too long or too large (see `extent`), or float64 is not to be had.
        KeyError: The scene has no such number.
        Interrupted: Ctrl-C; its `done` is the result with the lanes that had ended, the others with status NOT_RUN, or
            None where none had.
    """
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    if not 0 <= phase < 2 * np.pi:
        raise ValueError(f"Argument `phase` must be in [0, 2 pi), but is {phase}.")
    tolerance_argument("period_tol", period_tol)
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
    run = independent if direction == "independent" else partial(continued, direction=direction)
    try:
        runs = run(scenes, shape, plan=plan, ticker=Ticker(total, progress))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and _result(scenes, axes, stopped.done, plan, period_tol)) from None
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


def run_lanes(
    scenes: Scene, states: State, plan: Plan, ticker: Callable[[int], None], arrived: np.ndarray | None = None
) -> Runs:
    """All lanes (leading axis), in chunks that share one compiled function, one thread per core.

    Args:
        scenes: The scenes.
        states: Where they start, at drive phase 0.
        plan: How long to run.
        ticker: Told after every block how many lane-periods it had.
        arrived: Which lanes start at the plan's phase instead (lanes,); by default none.

    Raises:
        Interrupted: Ctrl-C; `done` has the lanes that had ended, the others with status NOT_RUN.
    """
    lanes = len(scenes.drive.omega)
    arrived = np.zeros(lanes, bool) if arrived is None else arrived
    if scenes.parts.contact == "none":
        begin = np.where(arrived, plan.phase, 0.0)
        samples, last = free_runs(scenes, states, plan.transient, plan.kept, plan.phase, plan.method, begin)
        ticker(lanes * (plan.transient + plan.kept))
        return Runs(samples, jax.tree.map(np.zeros_like, last.tally), last)
    width = 1 if lanes == 1 else CHUNK
    pieces = [np.minimum(np.arange(i, i + width), lanes - 1) for i in range(0, lanes, width)]
    joined = lambda done: jax.tree.map(lambda *a: np.concatenate(a)[:lanes], *done)  # noqa: E731

    def run(check: Check, at: np.ndarray) -> Runs:
        n = min(width, lanes - int(at[0]))

        def tick(periods: int) -> None:
            ticker(periods * n)
            check()

        return _run_chunk(_take((scenes, states, arrived), at), plan, tick)

    try:
        return joined(in_threads(run, pieces))
    except Interrupted as stopped:
        raise Interrupted(_completed(stopped.done, joined)) from None


def _completed(runs: list[Runs | None], joined: Callable[[list[Runs]], Runs]) -> Runs | None:
    """All runs, those that are missing with status NOT_RUN; None if all are."""
    known = next((run for run in runs if run is not None), None)
    return None if known is None else joined([_not_run(known) if run is None else run for run in runs])


def _not_run(like: Runs) -> Runs:
    """As many lanes, none of which has run."""
    fill = lambda a: np.full_like(a, np.nan if np.issubdtype(a.dtype, np.floating) else 0)  # noqa: E731
    empty = jax.tree.map(fill, like)
    status = np.full_like(like.last.status, Status.NOT_RUN)
    return replace(empty, last=eqx.tree_at(lambda lane: lane.status, empty.last, status))


def _take(tree, at):
    return jax.tree.map(lambda a: np.asarray(a)[at], tree)


def _run_chunk(chunk: tuple[Scene, State, np.ndarray], plan: Plan, tick: Callable[[int], None]) -> Runs:
    scenes, states, arrived = chunk
    lanes = begin_lanes(scenes, states, plan.method)
    if plan.lead_in is not None and not arrived.all():
        led, _ = run_block(scenes, lanes, plan.lead_in, jnp.int32(1), plan.method, BLOCK, best())
        lanes = _chosen(arrived, lanes, led)
    lanes, _ = _blocks(scenes, lanes, plan.transient, plan, tick, keep=False)
    lanes = eqx.tree_at(_times, lanes, jax.tree.map(jnp.zeros_like, _times(lanes)))  # late in float32, sums lose digits
    before = lanes.tally
    lanes, samples = _blocks(scenes, lanes, plan.kept, plan, tick, keep=True)
    return jax.tree.map(np.asarray, Runs(samples, before, lanes))


def _chosen(which: np.ndarray, a: Any, b: Any) -> Any:
    """Trees of arrays with a leading axis: `a` where `which`, else `b`."""
    return jax.tree.map(lambda a, b: np.where(which.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), a, b)


def _times(lanes: Any):
    log = lanes.tally.log
    return log.time_apart, log.time_stick, log.time_slip


def _blocks(scenes: Scene, lanes: Lane, periods: int, plan: Plan, tick, keep: bool):
    kept: list[Sample] = []
    longest = min(periods_at_once(len(lanes.status), plan.steps_per_period, plan.method), BLOCK)
    for done in range(0, periods, longest):
        n = min(longest, periods - done)
        lanes, sample = run_block(scenes, lanes, plan.clock, jnp.int32(n), plan.method, BLOCK, best())
        jax.block_until_ready(lanes.status)
        if keep:
            kept.append(jax.tree.map(lambda a, n=n: _in_full(a)[:n].T, sample))
        tick(n)
    return lanes, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *kept) if kept else None


def independent(scenes: Scene, shape: tuple[int, ...], plan: Plan, ticker: Ticker) -> Runs:
    """All lanes at once, each from its scene's start.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), scenes)
    shaped = lambda runs: jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), runs)  # noqa: E731
    try:
        return shaped(run_lanes(flat, starts(flat), plan, ticker))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and shaped(stopped.done)) from None


def continued(scenes: Scene, shape: tuple[int, ...], plan: Plan, ticker: Ticker, direction: Direction) -> Runs:
    """Lanes along the first axis one after the other, each from the final state of the one before.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    order = range(shape[0]) if direction == "forward" else range(shape[0] - 1, -1, -1)
    joined = lambda runs: jax.tree.map(lambda *a: np.stack(a).reshape(*shape, *a[0].shape[1:]), *runs)  # noqa: E731
    runs: list[Runs | None] = [None] * shape[0]
    state = arrived = None
    for i in order:
        here = jax.tree.map(lambda a, i=i: a[i].reshape(-1, *a.shape[len(shape) :]), scenes)
        fresh = starts(here)
        try:
            runs[i] = run = run_lanes(here, fresh if state is None else state, plan, ticker, arrived)
        except Interrupted as stopped:
            runs[i] = stopped.done
            raise Interrupted(_completed(runs, joined)) from None
        arrived = run.last.status == Status.OK  # a lane that had stopped starts afresh
        state = _chosen(arrived, final_states(run.last), fresh)
    return joined(runs)


def final_states(last: Lane) -> State:
    """The states that lanes have come to, as a start for others."""
    state = whole(last.state)
    motion = Motion(*(np.stack(pair, axis=-1) for pair in state.motion))
    return State(motion, state.u_s, state.mode, state.case)


def relative_residual(samples: Sample) -> np.ndarray:
    """Largest energy residual of any period over the mean work of the drive in one, (lanes,)."""
    work = np.abs(samples.work).mean(axis=-1)
    return np.abs(samples.residual).max(axis=-1) / np.where(work > 0, work, 1.0)


def relative_drop(samples: Sample) -> np.ndarray:
    """Largest energy that flat contact dropped in any period over the drive's gross work in it, (lanes,)."""
    gross = np.asarray(samples.gross)
    return (samples.dropped / np.where(gross > 0, gross, 1.0)).max(axis=-1)


def told_chatter(scenes: Scene, runs: Runs, plan: Plan) -> str | None:
    """What alternated in the first of the lanes (leading axis) that stopped with TOO_MANY_EVENTS."""
    if scenes.parts.contact == "none":
        return None
    whole = np.isfinite(runs.samples.power[0]).sum(axis=-1)
    period = np.where((whole > 0) | (plan.transient == 0), plan.transient + whole + 1, 0)
    return chatter(scenes, runs.last, period, plan.clock, plan.method)


@jax.jit
def _closed_forms(scenes: Scene):
    """Area, power without contact and half the diagonal of each lane's blocks."""
    return jax.vmap(lambda scene: (area(scene.shroud), free_power(scene), half_diagonal(scene.shroud)))(scenes)


def half_diagonal(shroud: Shroud) -> Scalar:
    """Half the longer diagonal of a block [m]: how far its corners go when it turns by a radian."""
    block = corners(shroud)
    return jnp.hypot(block.a_x, block.h_y)


def displacements(samples: Sample) -> np.ndarray:
    """x, y and theta of both blades at the ends of periods, (lanes, n, 6)."""
    z = samples.motion
    return np.stack([np.asarray(a, float) for pair in (z.x, z.y, z.theta) for a in pair], axis=-1)


def sizes_of(samples: Sample) -> np.ndarray:
    """The largest magnitude of each of the `displacements` within each period, (lanes, n, 6)."""
    if samples.largest is None:
        return np.abs(displacements(samples))
    return np.stack([np.asarray(a, float) for pair in samples.largest for a in pair], axis=-1)


def averages(
    scenes: Scene, samples: Sample, period_tol: float = PERIOD_TOLERANCE
) -> tuple[Repetition, Reduction, np.ndarray]:
    """Period number and power of lanes (one leading axis of lanes) over their kept periods, and P_0 (lanes, 2)."""
    A, P_0, lever = (np.asarray(f, float) for f in _closed_forms(scenes))
    orbit = repetition(
        displacements(samples), sizes_of(samples).max(axis=-2), lever, period_tol, scenes.drive.omega.dtype
    )
    return orbit, reduction(A[:, None, None] * np.stack(samples.power, axis=-1), P_0, orbit.number), P_0


def _in_full(a) -> np.ndarray:
    return np.asarray(a, float) if np.issubdtype(np.asarray(a).dtype, np.floating) else np.asarray(a)


def _result(scenes: Scene, axes: dict[str, np.ndarray], runs: Runs, plan: Plan, period_tol: float) -> SweepResult:
    shape = tuple(len(v) for v in axes.values())
    in_line = lambda tree: jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), tree)  # noqa: E731
    alternating = told_chatter(in_line(scenes), in_line(runs), plan)
    runs = jax.tree.map(_in_full, runs)
    motion = Motion(*(np.stack(pair, axis=-1) for pair in runs.samples.motion))
    got = averages(in_line(scenes), in_line(runs.samples), period_tol)
    (number, told), power, P_0 = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), got)
    log, before = runs.last.tally.log, runs.before.log
    spent = [getattr(log, n) - getattr(before, n) for n in ("time_apart", "time_stick", "time_slip")]
    whole = sum(spent)
    with np.errstate(invalid="ignore", divide="ignore"):
        times = [t / whole for t in spent]
        residual = relative_residual(runs.samples) if plan.method.ledger else None
        dropped = relative_drop(runs.samples) if plan.method.ledger else None
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
        period_number=number,
        settled=told.verdict == YES,
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
        energy_dropped=dropped,
        chatter=alternating,
        settling=told.verdict,
        periods_more=told.periods_more,
        P_d_settling=power.settling,
        P_d_periods_more=power.periods_more,
        P_d_ci_short=power.ci_short,
    )
