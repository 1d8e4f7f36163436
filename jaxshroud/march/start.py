"""What happens at the instant of a start: contact begins where blocks that are apart overlap.

A march crosses these events in its first trials, of length zero; here they are crossed without a march.
"""

import jax.numpy as jnp

from jaxshroud.march.event import GuardEvaluation, any_of, first_kind, present
from jaxshroud.march.events import transition
from jaxshroud.march.locate import select
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State


def events_at_start(model: Model) -> int:
    """How many events happen at most: an onset, and the transition from flat contact to a corner; or one a point."""
    return max(2, len(model.block.points))


def next_at_start(state: State, start: State, view: GuardEvaluation, model: Model) -> State:
    """The state after the next event at the instant of a `start` apart, if its guards show one; its motion is kept."""
    violated = {kind: view.guards.value[kind] > 0 for kind in present(view.guards.value)}
    zero = jnp.zeros_like(view.at.v)
    after = transition(state.motion, state, view, first_kind(violated), zero, zero, model).after
    fires = any_of(violated.values()) & (interface_mode(start.mode) == Mode.APART)
    u_s, mode, case = select(fires, (after.u_s, after.mode, after.case), (state.u_s, state.mode, state.case))
    return State(state.motion, u_s, mode, case)
