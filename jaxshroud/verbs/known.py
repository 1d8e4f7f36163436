"""What a report rests on."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.results.attractors import Attractors
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.scatter import Scatter
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.tuned import Judged, Tuned
from jaxshroud.verbs.check import Sheet


class Limits(NamedTuple):
    """What a design is to keep."""

    at_least: float | None = None  # P_d [percent]
    most_force: float = np.inf  # [N]
    most_penetration: float = np.inf  # [m]


class Known(NamedTuple):
    """All that a report rests on."""

    sheet: Sheet
    limits: Limits
    conditions: Mapping[str, Sequence[float]]
    rows: np.ndarray  # (conditions, keys) values
    judged: Judged  # of the design in all conditions
    checks: dict[str, Judged]
    run: SweepResult
    over_gap: SweepResult
    spread: Scatter | None
    slopes: Gradient
    motions: Attractors
    tuned: Tuned | None = None  # where the design comes from
