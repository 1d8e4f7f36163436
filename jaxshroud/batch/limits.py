"""The limits of the size of a run, and of a call to the device, between which Ctrl-C is heard."""

from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
import psutil

from jaxshroud.scene.checks import InputError

SECONDS_PER_CALL = 0.3  # aimed at
LARGEST_CHANGE = 16.0  # from call to call: the first one may compile, and others may be held up by other work

Called = TypeVar("Called")


class CallPace:
    """The passes of a loop over trials that a call to the device may make, found from the time of earlier calls.

    A period of a large row may take minutes, one of a pair microseconds. Results do not depend on the passes of a call.
    """

    def __init__(self, passes: int, seconds: float = SECONDS_PER_CALL):
        """`passes` of the first call."""
        self.passes, self.seconds = passes, seconds

    def timed(self, call: Callable[[np.int32], Called], cut_short: Callable[[Called], Any]) -> Called:
        """The results of a `call` with so many passes, which waits for the device.

        `cut_short` says of them whether the passes were used up; of a call with less to do only a long time counts.
        """
        began = perf_counter()
        result = call(np.int32(self.passes))
        factor = self.seconds / max(perf_counter() - began, 1e-9)
        if factor < 1 or cut_short(result):
            change = min(max(factor, 1 / LARGEST_CHANGE), LARGEST_CHANGE)
            self.passes = int(min(max(self.passes * change, 1), np.iinfo(np.int32).max))
        return result


MAX_LANE_PERIODS = 10**10  # months on a few cores
# bytes that a sweep takes at its peak for each lane, and for each of its kept periods; those of a pair of blades
LANE_BYTES, SAMPLE_BYTES = 4096, 512
STORED_LANE_BYTES, STORED_SAMPLE_BYTES = 400, 96  # bytes that its results take
STEP_BYTES = 400  # bytes that `simulate` takes at its peak for each step it stores


def check_size(lanes: int, transient: int, kept: int, lanes_held: int | None = None, blades: int = 2) -> None:
    """Raise ValueError if a run of so many lanes and drive periods would be too long or too large.

    The samples of `lanes_held` lanes are in memory at once, by default those of all.
    """
    periods = lanes * (transient + kept)
    if periods > MAX_LANE_PERIODS:
        raise InputError(
            f"{periods:.3g} lane-periods (lanes x periods) are more than the {MAX_LANE_PERIODS:.0e} that a run may "
            "have; give fewer periods or values"
        )
    check_memory("this run", sweep_memory(lanes, kept, lanes_held, blades))


def sweep_memory(lanes: int, kept: int, lanes_held: int | None = None, blades: int = 2) -> int:
    """The peak memory of a sweep [bytes], with the samples of `lanes_held` lanes at once, by default of all."""
    samples = (lanes if lanes_held is None else lanes_held) * kept
    return (lanes * LANE_BYTES + samples * SAMPLE_BYTES) * blades // 2


def results_size(lanes: int, kept: int, *, samples: bool, blades: int = 2) -> int:
    """The size of the results of a sweep [bytes], with samples or without."""
    return lanes * (STORED_LANE_BYTES + (kept * STORED_SAMPLE_BYTES if samples else 0)) * blades // 2


def check_memory(what: str, size: int) -> None:
    """Raise ValueError unless `size` bytes for `what` are free."""
    free = psutil.virtual_memory().available
    if size > free:
        raise InputError(
            f"{what} would take some {size / 2**30:.3g} GiB of memory, but {free / 2**30:.3g} GiB are free; "
            "keep fewer periods, steps or values"
        )
