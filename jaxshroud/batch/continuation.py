"""Lanes of a grid: all at once, or along its first axis one after the other."""

from dataclasses import dataclass

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Runs, Ticker, chosen, completed, run_lanes, starts
from jaxshroud.batch.states import final_states
from jaxshroud.batch.threads import Interrupted
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.scene import Scene


@dataclass
class Relay:
    """How far lanes have come that are continued from value to value: handed from one stretch of values to the next."""

    state: State | None = None  # at the end of the value before; None at the first
    arrived: np.ndarray | None = None  # which lanes came there; the others start afresh


def independent(scenes: Scene, shape: tuple[int, ...], plan: Plan, ticker: Ticker, states: State | None = None) -> Runs:
    """All lanes at once, each from its scene's start or from `states` of the same leading axes.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    flat, begin = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), (scenes, states))
    shaped = lambda runs: jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), runs)  # noqa: E731
    try:
        return shaped(run_lanes(flat, starts(flat) if begin is None else begin, plan, ticker))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and shaped(stopped.done)) from None


def continued(
    scenes: Scene,
    shape: tuple[int, ...],
    plan: Plan,
    ticker: Ticker,
    states: State | None = None,
    *,
    direction: Direction,
    relay: Relay | None = None,
) -> Runs:
    """Lanes along the first axis one after the other, each from the final state of the one before.

    Args:
        scenes: The scenes, with leading axes of that `shape`.
        shape: Of the lanes.
        plan: How long to run.
        ticker: Told how much is done.
        states: Where to start; by default from the scenes' own starts.
        direction: From the first value to the last, or "backward".
        relay: Where the values before these have ended; afterwards where these have.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    order = range(shape[0]) if direction == "forward" else range(shape[0] - 1, -1, -1)
    joined = lambda runs: jax.tree.map(lambda *a: np.stack(a).reshape(*shape, *a[0].shape[1:]), *runs)  # noqa: E731
    runs: list[Runs | None] = [None] * shape[0]
    relay = relay or Relay()
    for i in order:
        here, begin = jax.tree.map(lambda a, i=i: a[i].reshape(-1, *a.shape[len(shape) :]), (scenes, states))
        fresh = starts(here) if begin is None else begin
        try:
            runs[i] = run = run_lanes(here, fresh if relay.state is None else relay.state, plan, ticker, relay.arrived)
        except Interrupted as stopped:
            runs[i] = stopped.done
            raise Interrupted(completed(runs, joined)) from None
        arrived = run.last.status == Status.OK  # a lane that had stopped starts afresh
        relay.state, relay.arrived = chosen(arrived, final_states(run.last.state), fresh), arrived
    return joined(runs)
