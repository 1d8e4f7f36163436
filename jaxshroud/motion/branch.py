"""Branches of periodic orbits over one number of the scene: shooting and pseudo-arclength continuation.

A point of a branch is a fixed point of the map of q drive periods together with the number's value. The next point is
predicted along the tangent and corrected, by Newton's method, on the hyperplane at right angles to it: a branch may so
turn back in the number, where its orbits cease to be stable. Derivatives by the state and by the number come from one
run with tangents, compiled once for all points.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Runs
from jaxshroud.batch.states import STATE, from_vector, to_vector
from jaxshroud.batch.tangents import Course, Tangents, direction
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import sizes_of
from jaxshroud.motion.orbit import Cycle, Shot, described, slider_is_free
from jaxshroud.motion.shooting import CLOSED, Aim
from jaxshroud.motion.together import Algorithm, Derivatives, Periods
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene

MOST_UPDATES = 8
HARDLY = 1e3  # times its size is what a slider is measured in: it starts anew at every onset, wherever that is
WEIGHTS = np.append(np.ones(STATE - 1), HARDLY)  # which closing errors are measured without


class Line(NamedTuple):
    """What is followed: a scene along one of its numbers."""

    scene: Scene  # such that the number is one of its own
    key: str
    low: float
    high: float
    aim: Aim
    units: np.ndarray  # (13,) of the state, in which points are measured

    @property
    def width(self) -> float:
        """The range of the number: its unit."""
        return self.high - self.low

    def at(self, value: float) -> Scene:
        """The scene with the number replaced."""
        return jax.tree.map(lambda a: a[0], scenes_at(self.scene, [self.key], np.array([[value]])))


class Point(NamedTuple):
    """A periodic orbit on a branch."""

    y: np.ndarray  # (14,) state and number, in their units
    value: float  # of the number
    cycle: Cycle
    free: bool  # the slider stays wherever it starts
    tangent: np.ndarray  # (14,) of the branch, of length 1
    updates: int  # of Newton's method
    kind: str = ""  # of the special points: "fold", "flip", ...

    @property
    def multipliers(self) -> np.ndarray:
        """Those of the motion, without that of a free slider."""
        return self.cycle.others


def line_through(found: Cycle, key: str, low: float, high: float, aim: Aim) -> Algorithm[Line]:
    """What is followed from an orbit on, measured in the largest values on it."""
    runs: Runs = yield Periods(found.scene, found.start, Plan(0, found.q, aim.steps, 0.0, aim.method))
    place = sizes_of(runs.samples)[0].max(axis=0).reshape(3, 2).max(axis=1)
    place = np.repeat(np.where(place > 0, place, 1.0), 2)
    units = np.concatenate([place, place * float(found.scene.drive.omega), [HARDLY * place[0]]])
    return Line(found.scene, key, low, high, aim, units)


def first_point(line: Line, state: State, value: float, q: int) -> Algorithm[Point | None]:
    """The orbit of period number q at a value of the number, near a state."""
    y = np.append(to_vector(state) / line.units, value / line.width)
    return (yield from corrected(line, y, np.eye(STATE + 1)[-1], state, q))


def corrected(line: Line, y: np.ndarray, normal: np.ndarray, held: State, q: int) -> Algorithm[Point | None]:
    """The point of a branch nearest to `y` on the hyperplane through it; None where Newton's method finds none.

    Args:
        line: What is followed.
        y: Where to begin (14,).
        normal: Of the hyperplane (14,); the branch's tangent, or the number alone.
        held: Contact mode and case to begin with.
        q: Period number.
    """
    base, best, last = y, None, np.inf
    for updates in range(MOST_UPDATES + 1):
        scene = line.at(float(y[-1] * line.width))
        state = from_vector((y[:-1] * line.units).astype(scene.drive.omega.dtype), held.mode, held.case)
        course = Course(scene, state, [direction(scene, line.key)])
        at: Tangents = yield Derivatives(course, q, line.aim.steps, line.aim.method)
        if at.status != Status.OK or not np.all(np.isfinite(at.by_state)):
            return best
        if at.end.mode != Mode.STICK:  # the motion determines it
            y = np.append(y[: STATE - 1], [at.vector[-1] / line.units[-1], y[-1]])
        miss = at.vector / line.units - y[:-1]
        residual = float(np.abs(miss * WEIGHTS).max())
        free, jacobian = slider_is_free(scene, at), _jacobian(line, at)
        if residual <= CLOSED[line.aim.method.precision] and (best is None or residual < best.cycle.residual):
            state = from_vector((y[:-1] * line.units).astype(scene.drive.omega.dtype), held.mode, held.case)
            shot = Shot(state, at._replace(by_parameter=at.by_parameter), residual, updates)
            best = _point(line, y, shot, q, free, jacobian, normal)
        done = residual <= line.aim.tolerance or (best is not None and residual > 0.5 * last)
        if done or residual > 1e3 * max(last, 1e-3):
            return best
        held, last = at.end, residual
        y = y + _newton_step(jacobian, miss, normal, float(normal @ (base - y)), free)
    return best


def _jacobian(line: Line, at: Tangents) -> np.ndarray:
    """Derivatives (13, 14) of how far the map misses, in the line's units."""
    by_state = at.by_state * line.units / line.units[:, None] - np.eye(STATE)
    return np.column_stack([by_state, at.by_parameter[:, 0] * line.width / line.units])


def _without(free: bool) -> np.ndarray:
    """Which of the 14 numbers may change: a slider that stays where it starts is held there."""
    return np.delete(np.arange(STATE + 1), STATE - 1) if free else np.arange(STATE + 1)


def _newton_step(jacobian: np.ndarray, miss: np.ndarray, normal: np.ndarray, off: float, free: bool) -> np.ndarray:
    """By how much to move: to where the map closes, and onto the hyperplane."""
    moves = _without(free)
    system = np.vstack([jacobian[moves[:-1]][:, moves], normal[moves]])
    step = np.zeros(STATE + 1)
    step[moves] = np.linalg.lstsq(system, np.append(-miss[moves[:-1]], off), rcond=None)[0]
    return step


def _tangent(jacobian: np.ndarray, free: bool, along: np.ndarray) -> np.ndarray:
    """The direction in which orbits stay orbits, to the same side as `along`."""
    moves = _without(free)
    tangent = np.zeros(STATE + 1)
    tangent[moves] = np.linalg.svd(jacobian[moves[:-1]][:, moves])[2][-1]
    return tangent if tangent @ along >= 0 else -tangent


def _point(line: Line, y, shot: Shot, q: int, free: bool, jacobian: np.ndarray, along: np.ndarray) -> Point:
    scene = line.at(float(y[-1] * line.width))
    cycle = described(scene, shot, q, line.aim.tolerance, 0, line.aim.steps, line.aim.method)
    return Point(y, float(y[-1] * line.width), cycle, free, _tangent(jacobian, free, along), shot.updates)
