"""Many lanes over many periods: in chunks that share one compiled function, one thread per core."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.chatter import chatter
from jaxshroud.batch.free import free_runs
from jaxshroud.batch.periods import BLOCK, CHUNK, Clock, Sample, begin_lanes, periods_at_once, run_block
from jaxshroud.batch.threads import Check, Interrupted, in_chunks, joined
from jaxshroud.batch.xla import Tree, best
from jaxshroud.march.lane import Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import Tableau
from jaxshroud.march.taylor import Taylor
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State, start
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.scene import Scene

Tick = Callable[[int], None]  # told how many lane-periods were done
Progress = Callable[[int, int], None]  # lane-periods done so far, and in all


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
    method: Choices

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


def stepper(scene: Scene, method: Choices) -> Tableau | Taylor | None:
    """What steps through a scene: nothing where there is a closed form.

    Raises:
        InputError: It is smooth contact, of which power series know nothing.
    """
    if method.taylor and scene.parts.contact in ("smooth", "own"):
        what = "smooth contact" if scene.parts.contact == "smooth" else "own laws"
        raise InputError(f"The method taylor knows located contact, not {what}; take a Runge-Kutta method.")
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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Runs:
    """What came out of a batch of lanes."""

    samples: Any  # Sample of arrays (lanes, kept, ...)
    before: Any  # Tally when the kept periods began
    last: Any  # Lane at the end


def run_lanes(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray | None = None) -> Runs:
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
    try:
        return chunk_by_chunk(lambda chunk, tick: _run_chunk(chunk, plan, tick), (scenes, states, arrived), ticker)
    except Interrupted as stopped:
        raise Interrupted(completed(stopped.done, lambda runs: joined(runs, lanes))) from None


def chunk_by_chunk(run: Callable[[Any, Tick], Tree], lanes: Any, ticker: Tick) -> Tree:
    """`run` of some lanes at a time, and of what tells that so much of each is done; all lanes of the results.

    Args:
        run: Its program is compiled for one lane alone, or for `CHUNK`.
        lanes: A tree of arrays with a leading axis.
        ticker: Told how much is done, summed over lanes.

    Raises:
        Interrupted: As in `in_chunks`.
    """
    count = len(jax.tree.leaves(lanes)[0])
    width = 1 if count == 1 else CHUNK

    def one(check: Check, at: np.ndarray) -> Tree:
        n = min(width, count - int(at[0]))

        def tick(done: int) -> None:
            ticker(done * n)
            check()

        return run(jax.tree.map(lambda a: np.asarray(a)[at], lanes), tick)

    return in_chunks(one, count, width)


def completed(runs: list[Runs | None], joined: Callable[[list[Runs]], Runs]) -> Runs | None:
    """All runs, those that are missing with status NOT_RUN; None if all are."""
    known = next((run for run in runs if run is not None), None)
    return None if known is None else joined([_not_run(known) if run is None else run for run in runs])


def _not_run(like: Runs) -> Runs:
    """As many lanes, none of which has run."""
    fill = lambda a: np.full_like(a, np.nan if np.issubdtype(a.dtype, np.floating) else 0)  # noqa: E731
    empty = jax.tree.map(fill, like)
    status = np.full_like(like.last.status, Status.NOT_RUN)
    return replace(empty, last=eqx.tree_at(lambda lane: lane.status, empty.last, status))


def _run_chunk(chunk: tuple[Scene, State, np.ndarray], plan: Plan, tick: Tick) -> Runs:
    scenes, states, arrived = chunk
    lanes = begin_lanes(scenes, states, plan.method)
    if plan.lead_in is not None and not arrived.all():
        led, _ = run_block(scenes, lanes, plan.lead_in, jnp.int32(1), plan.method, BLOCK, best())
        lanes = chosen(arrived, lanes, led)
    lanes, _ = _blocks(scenes, lanes, plan.transient, plan, tick, keep=False)
    lanes = eqx.tree_at(_times, lanes, jax.tree.map(jnp.zeros_like, _times(lanes)))  # late in float32, sums lose digits
    before = lanes.tally
    lanes, samples = _blocks(scenes, lanes, plan.kept, plan, tick, keep=True)
    return jax.tree.map(np.asarray, Runs(samples, before, lanes))


def chosen(which: np.ndarray, a: Tree, b: Tree) -> Tree:
    """Trees of arrays with a leading axis: `a` where `which`, else `b`."""
    return jax.tree.map(lambda a, b: np.where(which.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), a, b)


def _times(lanes: Any) -> tuple[Any, Any, Any]:
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
            kept.append(jax.tree.map(lambda a, n=n: in_full(a)[:n].T, sample))
        tick(n)
    return lanes, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *kept) if kept else None


def told_chatter(scenes: Scene, runs: Runs, plan: Plan) -> str | None:
    """What alternated in the first of the lanes (leading axis) that stopped with TOO_MANY_EVENTS."""
    if scenes.parts.contact == "none":
        return None
    whole = np.isfinite(runs.samples.power[0]).sum(axis=-1)
    period = np.where((whole > 0) | (plan.transient == 0), plan.transient + whole + 1, 0)
    return chatter(scenes, runs.last, period, plan.clock, plan.method)


def in_full(a) -> np.ndarray:
    """An array with its real numbers in float64."""
    return np.asarray(a, float) if np.issubdtype(np.asarray(a).dtype, np.floating) else np.asarray(a)
