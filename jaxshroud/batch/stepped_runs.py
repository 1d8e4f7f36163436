"""Periods and trajectories of many lanes step by step, in chunks on one thread per core and in short calls.

Of lanes that have stopped because events follow each other without an end it is said which these are.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.dense_samples import march_with_dense_output
from jaxshroud.batch.lanes import begin_lanes, energies_of_lanes, lanes_last, ledger_of, residual_of_energy
from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.periods import (
    LANES_PER_CALL,
    PERIODS_PER_CALL,
    CallLimits,
    Clock,
    Interim,
    Sample,
    at_start_of_period,
    first_passes,
    in_calls,
    lanes_per_call,
    part_done,
    run_block,
    sample_of_users,
)
from jaxshroud.batch.plan import Plan, Runs, Tick, completed_runs, run_log
from jaxshroud.batch.sampling import SampledMarch, SampleGrid, Stretch, first_sample, march_by_steps, march_by_trials
from jaxshroud.batch.stretches import SampledRun, Trajectories, march_in_stretches, values_by_name
from jaxshroud.batch.threads import Check, changing_what_is_done, concatenated_lanes, in_chunks
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march.accumulator import Accumulator
from jaxshroud.march.forces_and_energy import is_unbalanced
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State, law_type
from jaxshroud.model.rhs import Ledger
from jaxshroud.model.row import at_only_interface
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def stepped_runs(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray) -> Runs:
    """The runs of lanes (leading axis), in chunks that share one compiled function, one thread per core."""
    width = lanes_per_call(scenes.layout)
    pace = CallPace(first_passes(width, scenes.layout))

    def run(chunk, tick):
        return _run_chunk(chunk, plan, pace, tick)

    def joined(runs):
        return concatenated_lanes(runs, len(arrived))

    with changing_what_is_done(lambda runs: completed_runs(runs, joined)):
        return chunk_by_chunk(run, (scenes, states, arrived), ticker, width)


def chunk_by_chunk(run: Callable[[Any, Tick], Tree], lanes: Any, ticker: Tick, width: int = LANES_PER_CALL) -> Tree:
    """The results of `run(lanes, tick)` for one chunk of lanes after another, concatenated.

    Args:
        run: A function of a chunk and of a callback that reports progress; it is compiled for one lane alone, or for
            `width`.
        lanes: A tree of arrays with a leading axis.
        ticker: Called with the progress, summed over the lanes.
        width: Lanes of a chunk, see `lanes_per_call`.

    Raises:
        Interrupted: As in `in_chunks`.
    """
    count = len(jax.tree.leaves(lanes)[0])
    width = 1 if count == 1 else width

    def one(check: Check, at: np.ndarray) -> Tree:
        n = min(width, count - int(at[0]))

        def tick(done: int | float) -> None:
            ticker(done * n)
            check()

        return run(jax.tree.map(lambda a: np.asarray(a)[at], lanes), tick)

    return in_chunks(one, count, width)


def _run_chunk(chunk: tuple[Scene, State, np.ndarray], plan: Plan, pace: CallPace, tick: Tick) -> Runs:
    scenes, states, arrived = chunk
    lanes = begin_lanes(scenes, states, plan.method)
    if plan.lead_in is not None and not arrived.all():
        led_in, _ = run_periods(scenes, lanes, plan.lead_in, 1, plan.method, pace, lambda _: tick(0), keep=False)
        lanes = select_lanes(arrived, lanes, led_in)
    run = partial(run_periods, clock=plan.clock, method=plan.method, pace=pace, tick=tick)
    lanes, _ = run(scenes, lanes, n=plan.transient, keep=False)
    before = run_log(lanes)
    lanes, samples = run(scenes, lanes, n=plan.kept)
    return jax.tree.map(np.asarray, Runs(samples, before, run_log(lanes), lanes))


def select_lanes(which: np.ndarray, a: Tree, b: Tree) -> Tree:
    """Trees of arrays with a leading axis: `a` where `which`, else `b`."""
    return jax.tree.map(lambda a, b: np.where(which.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), a, b)


def run_periods(
    scenes: Scene,
    lanes: Any,
    clock: Clock,
    n: int,
    method: Choices,
    pace: CallPace,
    tick: Tick,
    keep: bool = True,
) -> tuple[Any, Sample | None]:
    """Run `n` periods of lanes (leading axis), in calls to the device that are short.

    Args:
        scenes: The scenes.
        lanes: The lanes at the start of a period.
        clock: The time grid.
        n: Periods.
        method: The options of the march.
        pace: How much a call does.
        tick: Called after every call with the number of periods that it made, parts of one included.
        keep: Whether samples are returned.

    Returns:
        The lanes at the end, and their samples, see `Runs`.
    """

    def call(interim: Interim, limits: CallLimits) -> tuple[Interim, Any, Any]:
        end, ended, samples = run_block(scenes, interim, clock, limits, method, PERIODS_PER_CALL, best_mapping())
        return end, ended, jax.tree.map(in_float64, sample_of_users(samples)) if keep else None

    def part(interim: Interim) -> float:
        return part_done(interim.lanes, clock.steps)

    interim, samples = in_calls(call, at_start_of_period(lanes), n, PERIODS_PER_CALL, pace, tick, part)
    return interim.lanes, samples


def in_float64(a) -> np.ndarray:
    """An array, in float64 if its numbers are real."""
    return np.asarray(a, float) if np.issubdtype(np.asarray(a).dtype, np.floating) else np.asarray(a)


def with_loads_of_rows(scenes: Scene, method: Choices) -> Choices:
    """The method by which lanes with samples are marched: what wears their faces is integrated in rows."""
    return method._replace(loads=scenes.layout != PAIR)


def _run_with_samples(
    scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick
) -> tuple[Any, SampledRun]:
    """The lanes (leading axis) at their start, and their march; `tick` gets the number of further steps."""
    lanes = begin_lanes(scenes, states, method)
    first = first_sample(scenes, lanes, grid.clock(scenes, method), grid.forces)
    march = partial(_march_stretch, scenes, grid=grid, method=method, tick=tick)
    return lanes, march_in_stretches(march, scenes, lanes, jax.tree.map(np.asarray, first), grid)


def sampled_motions_of(scenes: Scene, states: State, grid: SampleGrid, method: Choices, tick: Tick) -> Motion:
    """The motion of the samples of lanes (leading axis) alone."""
    return _run_with_samples(scenes, states, grid._replace(forces=False), method, tick)[1].samples.state.motion


def _march_stretch(
    scenes: Scene, lanes: Any, stretch: Stretch, *, grid: SampleGrid, method: Choices, tick: Tick
) -> SampledMarch:
    march = march_by_trials if grid.events else march_by_steps
    if stepper_for(method).dense_output is not None:
        march = march_with_dense_output
    return march(scenes, lanes, stretch, grid, method, tick)


def stepped_trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """The trajectories of lanes (leading axis), in chunks that share one compiled function."""
    method = with_loads_of_rows(scenes, method)

    def run(chunk: tuple[Scene, State], tick: Tick) -> Any:
        scenes = chunk[0]
        lanes, run = _run_with_samples(*chunk, grid, method, tick)
        energies = [np.asarray(energies_of_lanes(scenes, of, best_mapping())) for of in (lanes, run.lanes)]
        events = None
        if run.events is not None:
            # the first sample follows what happens at once
            after = np.where(run.events.steps == 0, -1, run.events.samples)
            events = values_by_name(run.events.states) | {"t": run.events.steps[None], "after": after[None]}
        return values_by_name(run.samples), run.amplitudes, jax.tree.map(np.asarray, run.lanes), energies, events

    marched = chunk_by_chunk(run, (scenes, states), ticker, lanes_per_call(scenes.layout))
    samples, amplitudes, last, (before, after), events = marched
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        balance = energy_balance(last.accumulator, after - before)
        integrals = jax.tree.leaves((last.accumulator.integrals, after - before))
        finite = np.isfinite(sum(np.asarray(a, float).reshape(len(before), -1).sum(axis=-1) for a in integrals))
    status = np.where((last.status == Status.OK) & ~finite, Status.NOT_FINITE, last.status)
    if balance is not None and law_type(scenes).may_create_energy:
        astray = is_unbalanced(*map(jnp.asarray, (balance.residual, balance.works.gross, before, after)))
        status = np.where((status == Status.OK) & np.asarray(astray), Status.UNBALANCED, status)
    log = at_only_interface(last.accumulator.log)
    counters = filled(log.counters, samples["mode"][:, 0])
    return Trajectories(
        samples=samples,
        amplitudes=amplitudes,
        status=status,
        counters={name: np.asarray(a) for name, a in vars(counters).items()},
        energy=_energy_values(balance, len(before)),
        loads=at_only_interface(last.accumulator.integrals.loads),
        times=log.times,
        last=last,
        events=events,
    )


class EnergyBalance(NamedTuple):
    """The energy balance of lanes (leading axis) over a run [J]."""

    works: Ledger  # of all blades; friction of each interface, where users see an axis of them
    of_blades: dict[str, np.ndarray]  # works on each blade of a row, (lanes, blades), by the names of results
    residual: np.ndarray
    dropped: np.ndarray  # by beginnings of flat contact


def energy_balance(accumulator: Accumulator, gained: np.ndarray) -> EnergyBalance | None:
    """The energy balance of lanes that have `gained` energies [J]; None without a ledger."""
    if accumulator.integrals.ledger is None:
        return None
    assert accumulator.jumps is not None  # they are kept with it
    works = at_only_interface(ledger_of(accumulator))
    of_blades = {}
    if np.ndim(works.drive) > 1:
        of_blades = {"blade_work_drive": np.asarray(works.drive), "blade_loss_viscous": np.asarray(works.viscous)}
        works = Ledger._make(np.asarray(a).sum(axis=-1) for a in works)._replace(friction=works.friction)
    residual = np.asarray(residual_of_energy(lanes_last(jax.tree.map(jnp.asarray, accumulator)), jnp.asarray(gained)))
    return EnergyBalance(works, of_blades, residual, np.asarray(accumulator.jumps.dropped, float))


def _energy_values(balance: EnergyBalance | None, lanes: int) -> dict[str, np.ndarray]:
    """The works [J] and the energy balance by the names of results, NaN without a ledger."""
    if balance is None:
        missing = np.full(lanes, np.nan)
        return {"energy_residual": missing, "energy_dropped": missing}
    gain = balance.works
    works = {"work_drive": gain.drive, "loss_viscous": gain.viscous, "loss_friction": gain.friction}
    return {
        "energy_residual": (balance.residual / np.where(gain.drive == 0, 1.0, np.abs(gain.drive))).astype(float),
        "energy_dropped": (balance.dropped / np.where(gain.gross > 0, gain.gross, 1.0)).astype(float),
        **{name: np.asarray(a, float) for name, a in {**works, **balance.of_blades}.items()},
    }


def zeno_warning(scenes: Scene, runs: Runs, plan: Plan) -> str | None:
    """The report on the first lane (leading axis) that stopped with TOO_MANY_EVENTS."""
    whole = np.isfinite(runs.samples.power[..., 0]).sum(axis=-1)
    period = np.where((whole > 0) | (plan.transient == 0), plan.transient + whole + 1, 0)
    return zeno_report(scenes, runs.last, period, plan.clock, plan.method)


def zeno_of_trajectories(scenes: Scene, marched: Trajectories, grid: SampleGrid, method: Choices) -> str | None:
    """The same of trajectories."""
    if not np.any(marched.status == Status.TOO_MANY_EVENTS):
        return None
    last, times = marched.last, marched.times
    assert times is not None  # without steps there are no events
    took = sum(np.asarray(a).reshape(len(last.status), -1)[:, 0] for a in times)  # the same at all interfaces
    steps = took / grid.step_lengths(scenes)
    whole = np.round((steps - last.step - last.search.done) / grid.steps).astype(int)
    return zeno_report(scenes, last, whole + 1, grid.clock(scenes, method), with_loads_of_rows(scenes, method))


def zeno_report(scenes: Scene, last: Any, period: np.ndarray, clock: Clock, method: Choices) -> str | None:
    """One line on the first lane that stopped with TOO_MANY_EVENTS: which events alternate; None if there is none.

    The lane continues from where it stopped until it stops again: the events of that time are those that alternate.

    Args:
        scenes: Scenes with a leading lane axis.
        last: The lanes at the end, with the same axis.
        period: The number of the period in which each lane stopped, (lanes,); 0 if it is unknown.
        clock: The time grid.
        method: The options of the march.
    """
    stopped = np.flatnonzero(np.asarray(last.status) == Status.TOO_MANY_EVENTS)
    if not len(stopped):
        return None
    # as many as the compiled program has
    copies = np.full(1 if len(period) == 1 else lanes_per_call(scenes.layout), stopped[0])
    scene, lane = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[copies]), (scenes, last))

    def places(lane):
        return (lane.status, lane.search.events)

    again = eqx.tree_at(places, lane, (jnp.zeros_like(lane.status), jnp.zeros_like(lane.search.events)))
    after: Any = run_periods(scene, again, clock, 1, method, CallPace(1024), lambda _: None, keep=False)[0]
    counts = [vars(run_log(of).counters) for of in (lane, after)]
    more = {n: int(np.sum(counts[1][n][0] - a[0])) for n, a in counts[0].items()}
    events = ", ".join(f"{n} {name}" for name, n in sorted(more.items(), key=lambda item: -item[1]) if n)
    done = (float(lane.step[0]) + float(lane.search.done[0])) / float(clock.per_period)
    when = f"period {period[stopped[0]]}" if period[stopped[0]] else "a period of the transient"
    cure = 'reading = "consistent", as misprinted forces contradict each other where cases meet'
    if not scene.contact.reading:
        cure = f"{2 * round(float(clock.per_period))} steps a period, or another tableau"
    return f"at {done:.6f} of {when} these events follow each other without an end: {events}; try {cure}"
