"""Which steep steps of a sweep in both directions are jumps: those that halving the step does not make smaller.

The change of a motion along a curve of orbits shrinks with the step, however steep the curve is. A jump to another
motion stays. Where a scene has one motion at both ends of a step, the motion from rest among them, nothing has jumped.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.runs import SweepHandover
from jaxshroud.results.sweep import DIRECTION, SweepResult, lane_motions, motion_sizes
from jaxshroud.scene.layout import SINGLE_DIRECTIONS
from jaxshroud.signals.orbit_distance import LEAST_STEEP, SweptMotion, are_one_motion, motions_differ, step_distance

MOST_HALVINGS = 5
# Of the change over the whole step that is left in its last part: the root of a flip leaves 0.18, a straight line 0.03.
JUMP_SHARE = 0.25
MOST_RUNS = 4  # of the sweep's own length, after which a lane beside a fold counts as it is

MotionAt = Callable[[float, SweepHandover], SweptMotion]  # at a value, from a handover, which it updates


class SweptLane(NamedTuple):
    """A lane of a sweep in one direction: where it is, how it moves, and where it ended."""

    value: float
    motion: SweptMotion
    end: SweepHandover

    def settled(self, motion_at: MotionAt) -> "SweptLane":
        """The lane with its transient over: beside a fold lanes leave slowly what is an orbit before it."""
        lane = self
        for _ in range(MOST_RUNS):
            if lane.motion.settled:
                break
            lane = lane_from(lane, lane.value, motion_at)
        return lane


def lane_from(start: SweptLane, value: float, motion_at: MotionAt) -> SweptLane:
    """The lane at a value that is run from where another one ended."""
    relay = SweepHandover(start.end.state, start.end.arrived)
    motion = motion_at(value, relay)
    return SweptLane(value=value, motion=motion, end=relay)


def with_jumps(
    result: SweepResult,
    ends: Mapping[str, Sequence[SweepHandover]],
    run_at: Callable[[float, SweepHandover], SweepResult],
) -> SweepResult:
    """A sweep in all directions along one number, with its `jump`s.

    Args:
        result: The sweep, with its steep steps.
        ends: Of the directions that were marched from value to value: where the lane at each value ended, in the order
            in which they were run.
        run_at: Runs one lane at a value, from a handover, which it updates.
    """
    ((_, values),) = result.axes.items()
    sizes = motion_sizes(result.data)
    motions = {way: lane_motions(result.data.sel({DIRECTION: way}), sizes) for way in SINGLE_DIRECTIONS}
    apart = {way: result.data["time_apart"].sel({DIRECTION: way}).to_numpy() == 1 for way in SINGLE_DIRECTIONS}
    alike = [all(are_one_motion(*pair) for pair in combinations(at, 2)) for at in zip(*motions.values(), strict=True)]

    def motion_at(value: float, relay: SweepHandover) -> SweptMotion:
        return lane_motions(run_at(value, relay).data, sizes)[0]

    jump = np.zeros(result.steep.shape, bool)
    for way in ends:
        row = SINGLE_DIRECTIONS.index(way)
        order = list(range(len(values)))[:: -1 if way == "backward" else 1]
        for place in np.flatnonzero(result.steep[row][order]).tolist():
            start, stop = order[place - 1], order[place]
            is_free = apart[way][start] and apart[way][stop]  # of which there is one motion alone
            if is_free or (alike[start] and alike[stop]):
                continue
            lanes = [
                SweptLane(value=values[i], motion=motions[way][i], end=end).settled(motion_at)
                for i, end in ((start, ends[way][place - 1]), (stop, ends[way][place]))
            ]
            jump[row, stop] = _jumps(lanes[0], lanes[1], motion_at)
    variable = SweepResult.variables["jump"]
    return SweepResult(result.data.assign(dict(variable.entries(jump, result.dims))))


def _jumps(start: SweptLane, stop: SweptLane, motion_at: MotionAt) -> bool:
    """Whether the motion jumps between two neighbouring lanes."""
    whole = left = _motion_distance(start, stop)
    if whole <= LEAST_STEEP:
        return False
    for _ in range(MOST_HALVINGS):
        if not left > JUMP_SHARE * whole:
            return False
        middle = lane_from(start, (start.value + stop.value) / 2, motion_at).settled(motion_at)
        before = _motion_distance(start, middle)
        left = max(before, _motion_distance(middle, stop))
        if left == before:
            stop = middle
        else:
            start = middle
    return left > JUMP_SHARE * whole


def _motion_distance(a: SweptLane, b: SweptLane) -> float:
    """The distance of two motions; 0 of aperiodic ones that are not known to differ, NaN where one has stopped."""
    if not (a.motion.number or b.motion.number or motions_differ(a.motion, b.motion)):
        return 0.0
    return step_distance(a.motion, b.motion)
