"""How lanes ended, in words that say what to do."""

import warnings
from collections.abc import Iterator

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.scene.errors import NumericalError

MESSAGES = {
    Status.OK: "came to its end",
    Status.TOO_MANY_EVENTS: "contact changed more often in one step than can be followed; "
    "take twice the steps_per_period, another tableau, or the consistent reading",
    Status.NOT_FINITE: "the state or its energy overflowed; look at the drive, the damping and the units of the scene",
    Status.ANGLE_OUT_OF_RANGE: "a block turned beyond pi/4, where the model ends; look at drive.M_0 and blades.k_T",
    Status.NOT_RUN: "interrupted before it had come to its end; run it again",
    Status.OUT_OF_TRIALS: "more trial steps than `most_trials` were needed; give a larger bound, see `js.most_trials`",
}
STORED = [s for s in Status if s != Status.OUT_OF_TRIALS]  # that of pure functions, which store nothing
FLAGS = {"flag_values": [int(s) for s in STORED], "flag_meanings": " ".join(s.name for s in STORED)}


class LaneWarning(UserWarning):
    """Some lanes of a result stopped before their end; their numbers are NaN."""


def named(code: int) -> str:
    """Name of a status, of an unknown one too."""
    return Status(code).name if code in set(Status) else f"status {code}"


def counted(status: np.ndarray | int) -> dict[str, int]:
    """How many lanes ended how, by the names of the statuses that occur."""
    codes, counts = np.unique(status, return_counts=True)
    return {named(int(code)): int(n) for code, n in zip(codes, counts, strict=True)}


def messages(status: np.ndarray | int, chatter: str | None = None) -> Iterator[str]:
    """One line for each status but OK: how many lanes ended so, why, and what to do."""
    for code in np.unique(status):
        if code != Status.OK:
            about = MESSAGES.get(code, "")
            about = chatter if code == Status.TOO_MANY_EVENTS and chatter else about
            yield f"{np.sum(status == code)} of {np.size(status)} lanes ended with {named(int(code))}: {about}"


def tell_failures(status: np.ndarray | int, chatter: str | None = None, *, throw: bool = False, depth: int = 3) -> None:
    """Warn of lanes that are not OK; with `throw` raise instead.

    Args:
        status: Of each lane, or of the only one.
        chatter: What alternated where one had too many events.
        throw: Raise.
        depth: Frames from here to the user's call.

    Raises:
        NumericalError: A lane is not OK, and `throw` is asked for.
    """
    told = "; ".join(messages(status, chatter))
    if told and throw:
        raise NumericalError(told)
    if told:
        warnings.warn(told, LaneWarning, stacklevel=depth)
