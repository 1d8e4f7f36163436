"""The ranges of the numbers of a scene."""

import math
from typing import NamedTuple


class Range(NamedTuple):
    """The range of a number."""

    words: str
    minimum: float = -math.inf
    open: bool = False  # whether the minimum itself is excluded
    maximum: float = math.inf
    whole: bool = False  # whether only whole numbers are in the range

    def holds(self, value):
        """Whether a number, or each of an array, is in the range."""
        above = value > self.minimum if self.open else value >= self.minimum
        inside = (abs(value) < math.inf) & above & (value <= self.maximum)
        return inside & _is_whole(value) if self.whole else inside

    def fault(self, value: float) -> str:
        """The message for a number outside the range."""
        if not abs(value) < math.inf:
            return "must be a finite number"
        if self.whole and not _is_whole(value):
            return "must be a whole number"
        if value > self.maximum:
            return f"must be less than or equal to {self.maximum}"
        return f"must be greater than {'' if self.open else 'or equal to '}{self.minimum:g}"


def _is_whole(value):
    """Whether a number, or each of an array, is whole."""
    return value.round() == value if hasattr(value, "round") else float(value).is_integer()


ANY, POSITIVE, FROM_0 = Range("any"), Range("> 0", 0.0, open=True), Range(">= 0", 0.0)
ANY_WHOLE = Range("whole", whole=True)
FACE = Range("> 0, <= pi/2", 0.0, open=True, maximum=math.pi / 2)
