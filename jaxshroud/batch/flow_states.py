"""The result of a flow over drive periods, and the states at its ends in a unique form."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.march.events import place_contact
from jaxshroud.march.locate import select
from jaxshroud.march.tally import EventMargins
from jaxshroud.model.arithmetic import Pair, Scalar, is_absent
from jaxshroud.model.geometry import Kinematics
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.model.rhs import Means, Moments, parallel_mean


class Flow(NamedTuple):
    """The result of whole drive periods."""

    state: State  # with its slider updated; motion as pairs
    power: Pair  # mean square displacement over block and time [m^2]
    status: Int[Array, "..."]
    margins: EventMargins | None = None  # so far; None unless the method has `margins`
    coarseness: Scalar | None = None  # see `StepVerdict`; None within a march
    means: Means | None = None  # averaged over time; None unless a march has `vibration`


class FlowWithMoments(NamedTuple):
    """The result of some drive periods, of any length."""

    state: State  # as of a `Flow`, and so are the next two
    power: Pair
    status: Int[Array, "..."]
    moments: Moments | None  # averaged over time; None unless the method has `amplitudes`
    means: Means | None  # averaged over time; None unless the method has `vibration`


def canonical(state: State, scene_model: Model) -> State:
    """The state with the numbers that its mode determines: the slider in slip and when apart, and one angle if flat.

    Numbers on which no later motion depends are then unique, and have no tangent.
    """
    if touches_at_corners(scene_model) and scene_model.law.has_events:
        angles = lambda motion: (motion.theta, motion.v_theta)
        level = [select(state.case == FLAT, parallel_mean(pair, scene_model), pair) for pair in angles(state.motion)]
        state = eqx.tree_at(lambda s: angles(s.motion), state, tuple(level))
    at = place_contact(state.motion, state, scene_model)[2]
    if is_absent(state.u_s) or scene_model.law.flows:
        return state
    u_s = canonical_slider(at, state, scene_model)
    return eqx.tree_at(lambda s: s.u_s, state, u_s)


def canonical_slider(at: Kinematics, state: State, scene_model: Model) -> Scalar:
    """The slider that the mode determines in slip and when apart; else that of the state."""
    w = scene_model.law.stretch_at(at, state.u_s, state.mode)
    sliders = jax.tree.map(lambda w: at.u - w, w)
    return jax.tree.map(lambda u_s, mode: jnp.where(mode == Mode.APART, 0.0, u_s), sliders, state.mode)
