"""The march of `scalar_c` without event location: what a step's end violates changes there."""

from collections.abc import Callable

import numpy as np
from problem import Problem

from peers import scalar_c

NAME = "scalar C, RK4, events not located"
SETTINGS = (500, 4000)  # steps per period

missing = scalar_c.missing


def prepare(problem: Problem) -> Callable[[int], np.ndarray]:
    """Integrate all lanes with so many steps per period."""
    return scalar_c.prepare(problem, bisections=0)
