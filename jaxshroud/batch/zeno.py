"""Events that follow each other without an end: what is said of a lane that has stopped because of them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.periods import Clock, lanes_per_call
from jaxshroud.batch.plan import Plan, Runs, run_log
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import run_periods, with_loads_of_rows
from jaxshroud.batch.stretches import Trajectories
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.scene.scene import Scene


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
