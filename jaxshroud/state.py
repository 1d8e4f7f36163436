"""What moves: the state of one lane, its contact mode and how its run ended."""

from enum import IntEnum

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.scene import Motion, Scalar


class Mode(IntEnum):
    """State of the contact (physics: bilinear element of Fig. 3)."""

    APART = 0
    STICK = 1
    SLIP_PLUS = 2
    SLIP_MINUS = 3


class Status(IntEnum):
    """How a lane's run ended. A lane that is not OK stops there; the others go on."""

    OK = 0
    TOO_MANY_EVENTS = 1  # more contact changes in one step than allowed: chatter, or face-to-face contact
    NOT_FINITE = 2  # the state overflowed
    ANGLE_OUT_OF_RANGE = 3  # a block turned further than the model's angle range


class State(eqx.Module):
    """Motion and contact of one lane.

    `u_s` is the slider of Eq. (2) [m], meaningful in contact only. `case` is 1-4 (Sec. 2.3), 0 when apart.
    """

    motion: Motion
    u_s: Scalar
    mode: Int[Array, ""]
    case: Int[Array, ""]


def start(motion: Motion) -> State:
    """The state at t = 0: apart. A start with the blocks already overlapping becomes an onset at once."""
    zero = jnp.zeros((), jnp.int32)
    return State(motion, jnp.zeros((), motion.x.dtype), zero, zero)
