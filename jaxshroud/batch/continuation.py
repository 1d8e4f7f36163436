"""The lanes of a grid, run all at once, or value by value along its first axis."""

from dataclasses import dataclass

import jax
import numpy as np

from jaxshroud.batch.plan import Plan, Runs, Ticker, completed_runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import final_states, initial_states
from jaxshroud.batch.stepped_runs import select_lanes
from jaxshroud.batch.threads import Interrupted
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.scene import Scene


@dataclass
class SweepHandover:
    """The states of lanes that are continued from value to value, handed from one block of values to the next."""

    state: State | None = None  # at the end of the previous value; None at the first
    arrived: np.ndarray | None = None  # which lanes reached it; the others start afresh


def independent_runs(
    scenes: Scene, shape: tuple[int, ...], plan: Plan, ticker: Ticker, states: State | None = None
) -> Runs:
    """Run all lanes at once, each from the start of its scene or from `states` with the same leading axes.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    flat, begin = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), (scenes, states))
    shaped = lambda runs: jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), runs)
    try:
        return shaped(run_lanes(flat, initial_states(flat) if begin is None else begin, plan, ticker))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and shaped(stopped.done)) from None


def continued_runs(
    scenes: Scene,
    shape: tuple[int, ...],
    plan: Plan,
    ticker: Ticker,
    states: State | None = None,
    *,
    direction: Direction,
    relay: SweepHandover | None = None,
) -> Runs:
    """Run the lanes along the first axis one after the other, each from the final state of the previous one.

    Args:
        scenes: The scenes, with leading axes of that `shape`.
        shape: The shape of the grid.
        plan: How long to run.
        ticker: Called with the number of lane-periods done.
        states: The initial states; by default those of the scenes.
        direction: "forward", from the first value to the last, or "backward".
        relay: Where the previous values have ended; updated to where these end.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    order = range(shape[0]) if direction == "forward" else range(shape[0] - 1, -1, -1)
    concatenate = lambda runs: jax.tree.map(lambda *a: np.stack(a).reshape(*shape, *a[0].shape[1:]), *runs)
    runs: list[Runs | None] = [None] * shape[0]
    relay = relay or SweepHandover()
    for i in order:
        here, begin = jax.tree.map(lambda a, i=i: a[i].reshape(-1, *a.shape[len(shape) :]), (scenes, states))
        fresh = initial_states(here) if begin is None else begin
        try:
            runs[i] = run = run_lanes(here, fresh if relay.state is None else relay.state, plan, ticker, relay.arrived)
        except Interrupted as stopped:
            runs[i] = stopped.done
            raise Interrupted(completed_runs(runs, concatenate)) from None
        arrived = run.last.status == Status.OK  # a lane that has stopped starts afresh
        relay.state, relay.arrived = select_lanes(arrived, final_states(run.last.state), fresh), arrived
    return concatenate(runs)
