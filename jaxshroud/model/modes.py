"""What contact may be in, and how a lane's run may end."""

from enum import IntEnum

FLAT = 5  # the case of face-to-face contact


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
    OUT_OF_TRIALS = 5  # more trial steps than the bound given to a pure function
