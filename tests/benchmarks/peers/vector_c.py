"""Vectorised C, several lanes at a time and no event location: the limit of what the machine can do."""

from collections.abc import Callable

import numpy as np
from problem import PERIODS, Problem

from peers import scalar_c
from peers.scalar_c import library, parameters, pointer, waves

NAME = "vectorised C, RK4, events not located"
SETTINGS = (200, 500)  # steps per period

TUNING = ("-mprefer-vector-width=512", "-fschedule-insns", "-fsched-pressure")

missing = scalar_c.missing


def prepare(problem: Problem) -> Callable[[int], np.ndarray]:
    """Integrate all lanes with so many steps per period."""
    run = library("vector.c", *TUNING).run
    scene, springs = parameters(problem), np.array(problem.gamma * problem.k_x, float)

    def integrate(steps: int) -> np.ndarray:
        drive, ends = waves(steps), np.empty((len(springs), 12))
        run(pointer(scene), pointer(springs), len(springs), steps, PERIODS, pointer(drive), pointer(ends))
        return ends

    return integrate
