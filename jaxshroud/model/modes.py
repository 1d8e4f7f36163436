"""The codes that results and files hold: contact modes, lane statuses and kinds of points on a branch."""

from enum import IntEnum

FLAT = 5  # the case of face-to-face contact
BIFURCATION_KINDS = (
    "regular",
    "fold",
    "flip",
    "Neimark-Sacker",
    "branch point",
    "corner",
    "jump",
    "grazing",
    "localisation",
)
WAVE_RESIDUAL = 1e-6  # of the reduced map: an orbit that misses it by less is a travelling wave; see `locate_point`
MULTIPLIER_KINDS = ("fold", "flip", "Neimark-Sacker", "branch point", "localisation")  # a multiplier passes the circle


class Mode(IntEnum):
    """The mode of the contact (Fig. 3)."""

    APART = 0
    STICK = 1
    SLIP_PLUS = 2
    SLIP_MINUS = 3
    SMOOTH = 4  # smooth contact, which has no modes


class Status(IntEnum):
    """How the run of a lane ended. A lane that is not OK stops there; the others go on."""

    OK = 0
    TOO_MANY_EVENTS = 1  # more contact changes in one step than allowed: Zeno behaviour
    NOT_FINITE = 2  # the state or its energy has overflowed
    ANGLE_OUT_OF_RANGE = 3  # a block has turned beyond the angle range of the model
    NOT_RUN = 4  # interrupted before its end
    OUT_OF_TRIALS = 5  # more trial steps than the bound that a pure function was given
    BAD_INPUT = 6  # of a pure function: numbers out of their ranges, found while it ran
    NOT_LINEAR = 8  # asked to stay in one state of contact, which the motion leaves
    UNBALANCED = 7  # with user laws: the energy residual of a drive period exceeds half of the energy involved
