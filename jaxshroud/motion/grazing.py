"""Where a branch grazes: contact begins, or ends, to touch at some instant with zero closing speed."""

from typing import NamedTuple

import numpy as np

from jaxshroud.batch.runs import Plan, Runs
from jaxshroud.batch.states import rows
from jaxshroud.model.absent import filled
from jaxshroud.motion.bifurcation import located
from jaxshroud.motion.branch import Line, Point
from jaxshroud.motion.together import Algorithm, Periods

GRAZED = 1e-6  # share of the motion's size by which a touch misses or goes in, at a grazing


class Contacts(NamedTuple):
    """How an orbit touches."""

    onsets: int
    slowest: float  # closing speed at the gentlest onset [m/s]; infinite without contact
    miss: float  # least distance that the corners come to without touching [m]; infinite where there is none
    samples: np.ndarray  # (q, 12) motion at the end of each of its periods


def contacts(point: Point) -> Algorithm[Contacts]:
    """How the orbit of a point touches."""
    cycle = point.cycle
    method = cycle.method._replace(ledger=False, within=True)
    plan = Plan(0, cycle.q, cycle.steps_per_period, 0.0, method)
    runs: Runs = yield Periods(cycle.scene, cycle.start, plan)
    log = runs.last.tally.log
    counters = filled(log.counters, log.time_apart)
    onsets = int(counters.onset_slip[0] + counters.onset_stick[0])
    slowest, miss = (float(a[0]) for a in log.within[2:])
    return Contacts(onsets, slowest, miss, rows(runs.samples.motion)[0])


def grazing(line: Line, here: Point, there: Point) -> Algorithm[Point | None]:
    """The grazing point between two neighbouring points of a branch that touch differently often.

    The test is the distance by which the nearest miss misses, or, where there is one more contact, how far the gentlest
    onset goes in, which is as the square of its closing speed. None where an onset comes or goes at a finite speed.
    """
    fewer = min((yield from contacts(here)).onsets, (yield from contacts(there)).onsets)
    size, omega = line.units[0], float(line.scene.drive.omega)

    def depth(point: Point) -> Algorithm[float]:
        touches = yield from contacts(point)
        if touches.onsets > fewer:
            return float(-((touches.slowest / (omega * size)) ** 2))
        return min(touches.miss / size, 1.0)

    point, miss = yield from located(line, here, there, depth)
    return point._replace(kind="grazing") if abs(miss) <= GRAZED else None
