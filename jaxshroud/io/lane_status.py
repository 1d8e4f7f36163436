"""Messages about the statuses of lanes, which say why a lane stopped and what to do."""

import warnings
from collections.abc import Iterator

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import NumericalError

MESSAGES = {
    Status.OK: "came to its end",
    Status.TOO_MANY_EVENTS: "contact changed more often in one step than can be followed; "
    "take twice the steps_per_period, another tableau, or the consistent reading",
    Status.NOT_FINITE: "the state or its energy overflowed; look at the drive, the damping and the units of the scene, "
    "or take more steps_per_period; a static start that was not found ends so too, see `check`",
    Status.ANGLE_OUT_OF_RANGE: "a block turned beyond pi/4, where the model ends; look at drive.M_0 and blades.k_T",
    Status.NOT_RUN: "interrupted before it had come to its end; run it again",
    Status.OUT_OF_TRIALS: "more trial steps than `most_trials` were needed; give a larger bound, see `js.most_trials`",
    Status.UNBALANCED: "the energy of a drive period does not balance: the step is too long for what contact does; "
    'take more steps_per_period, or "auto"',
    Status.NOT_LINEAR: "contact leaves the state that was requested; see the margins in `check`, or march it",
    Status.BAD_INPUT: "a number of the scene is out of its range, or one of the start is not finite; see docs/keys.md",
}
OF_PURE_FUNCTIONS = (Status.OUT_OF_TRIALS, Status.BAD_INPUT)  # which write no files
STORED_STATUSES = [s for s in Status if s not in OF_PURE_FUNCTIONS]
FLAGS = {"flag_values": [int(s) for s in STORED_STATUSES], "flag_meanings": " ".join(s.name for s in STORED_STATUSES)}


class LaneWarning(UserWarning):
    """Some lanes of a result stopped before their end; their numbers are NaN."""


class AccuracyWarning(UserWarning):
    """Some lanes of a result are estimated to miss the accuracy that was requested."""


def status_name(code: int) -> str:
    """The name of a status; an unknown code has a name too."""
    return Status(code).name if code in set(Status) else f"status {code}"


def count_by_status(status: np.ndarray | int) -> dict[str, int]:
    """The number of lanes with each status, by the names of the statuses that occur."""
    codes, counts = np.unique(status, return_counts=True)
    return {status_name(int(code)): int(n) for code, n in zip(codes, counts, strict=True)}


def status_messages(status: np.ndarray | int, chatter: str | None = None) -> Iterator[str]:
    """One line for each status other than OK: how many lanes have it, why, and what to do."""
    for code in np.unique(status):
        if code != Status.OK:
            reason = chatter if code == Status.TOO_MANY_EVENTS and chatter else MESSAGES.get(code, "")
            yield f"{np.sum(status == code)} of {np.size(status)} lanes ended with {status_name(int(code))}: {reason}"


def warn_failures(status: np.ndarray | int, chatter: str | None = None, *, throw: bool = False, depth: int = 4) -> None:
    """Warn of lanes that are not OK, or raise an error.

    Args:
        status: The status of each lane, or of the only one.
        chatter: The contact changes that alternate in the first lane with too many events.
        throw: Raise instead of warning.
        depth: The number of stack frames from here to the user's call.

    Raises:
        NumericalError: A lane is not OK, and `throw` is true.
    """
    message = "; ".join(status_messages(status, chatter))
    if message and throw:
        raise NumericalError(message)
    if message:
        warnings.warn(message, LaneWarning, stacklevel=depth)
