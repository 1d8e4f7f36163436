"""What contact does at one instant: its two forces, how deep and how far along it is, and where on the face it acts."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxshroud.march.events import seat
from jaxshroud.model.absent import ABSENT, Pair, Scalar, mixed, where
from jaxshroud.model.geometry import Case, Touch, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.ready import Model, turns
from jaxshroud.model.rhs import forces, lean
from jaxshroud.model.state import State


class Resultant(NamedTuple):
    """The force on the left block is -N n - F t, with the face's normal n and tangent t; the right one feels it back.

    Apart, the forces are 0 and v < 0 is what is left of the gap, along the normal.
    """

    N: Any  # normal force [N]
    F: Any  # friction force; positive against sliding to larger u [N]
    v: Any  # penetration [m]
    u: Any  # slide of the left block against the right one [m]
    contact_point: Any  # up the left block's face from its middle [m]; NaN when apart, absent where blocks do not turn


def resultant(Q: Pair, held: State, model: Model) -> Resultant:
    """What contact does in a state, with `Q` the drive's wave, which flat contact needs to know where it acts."""
    _, case, at = seat(held.motion, held, model)
    N, F, _ = forces(at, held.motion, held, case, model)
    F = where(held.mode == Mode.APART, ABSENT, F)  # no negative zero
    point = ABSENT
    if turns(model):
        place = _at_the_tip(at, case, model.block.l_ab)
        if model.spring.modal:
            place = jnp.where(case == FLAT, _between(Q, at, held, model), place)
        point = jnp.where(held.mode == Mode.APART, jnp.nan, place)
    return Resultant(N, F, at.v, at.u, point)


def _at_the_tip(at: Touch, case: Case, l_ab: Scalar) -> Scalar:
    """Where the penetrating corner is along the left block's face: its own, or one of the right block's."""
    return mixed(is_upper(case), l_ab, -l_ab) / 2 - mixed(tip_is_left(case), 0.0, _along(at))


def _along(at: Touch) -> Scalar:
    """How far up the face the left block's corner is from the right one's; the consistent reading's slide."""
    return at.offset[0] * at.tangent[0] + at.offset[1] * at.tangent[1]


def _between(Q: Pair, at: Touch, held: State, model: Model) -> Scalar:
    """Where the resultant of flat contact keeps the blocks parallel: on the line between the ends of the overlap.

    The torque on theta_1 - theta_2 is linear along that line. Its ends are d and a, or b and c.
    """
    l_ab, torque, along = model.block.l_ab, lean(held.motion, Q, at, held, model), _along(at)
    low = -l_ab / 2 - jnp.where(at.height > 0, 0.0, along)
    high = l_ab / 2 - jnp.where(at.height > 0, along, 0.0)
    apart = torque.lower - torque.upper
    return low + (high - low) * (torque.lower / jnp.where(apart == 0, 1.0, apart))
