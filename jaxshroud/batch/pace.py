"""How long a call to the device may take: Ctrl-C is heard between calls, and progress is told there."""

from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

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

        `cut_short` tells of them whether the passes were used up; of a call with less to do only a long time counts.
        """
        began = perf_counter()
        result = call(np.int32(self.passes))
        factor = self.seconds / max(perf_counter() - began, 1e-9)
        if factor < 1 or cut_short(result):
            change = min(max(factor, 1 / LARGEST_CHANGE), LARGEST_CHANGE)
            self.passes = int(min(max(self.passes * change, 1), np.iinfo(np.int32).max))
        return result
