"""What moves: the state of one lane, its contact mode and how its run ended."""

from enum import IntEnum
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxshroud.scene import Motion


class Mode(IntEnum):
    """State of the contact (physics: bilinear element of Fig. 3)."""

    APART = 0
    STICK = 1
    SLIP_PLUS = 2
    SLIP_MINUS = 3
    SMOOTH = 4  # smooth contact, which has no modes


class Status(IntEnum):
    """How a lane's run ended. A lane that is not OK stops there; the others go on."""

    OK = 0
    TOO_MANY_EVENTS = 1  # more contact changes in one step than allowed: chatter
    NOT_FINITE = 2  # the state, or its energy, overflowed
    ANGLE_OUT_OF_RANGE = 3  # a block turned further than the model's angle range
    NOT_RUN = 4  # interrupted before it had come to its end


class State(eqx.Module):
    """Motion and contact of one lane.

    Scalars in compiled code, arrays of lanes outside.
    """

    motion: Motion
    u_s: Any  # slider of Eq. (2), meaningful in contact only [m]
    mode: Any  # see `Mode`
    case: Any  # 1-4 (Sec. 2.3), 5 in flat contact, 0 when apart


def start(motion: Motion) -> State:
    """The state at t = 0: apart. A start with the blocks already overlapping becomes an onset at once."""
    zero = jnp.zeros((), jnp.int32)
    return State(motion, jnp.zeros((), motion.x.dtype), zero, zero)
