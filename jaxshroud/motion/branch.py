"""The points of a branch of periodic orbits: shooting with pseudo-arclength continuation in one parameter.

A point of a branch is a fixed point of the map of q drive periods together with the value of the parameter, a number of
the scene. The next point is predicted along the tangent and corrected, by Newton's method, on the hyperplane normal to
it, so that a branch may turn back in the parameter at a fold. The derivatives by the state and by the parameter come
from one run with tangents, compiled once for all points.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Runs
from jaxshroud.batch.states import STATE_SIZE, from_vector, to_vector
from jaxshroud.batch.tangents import TangentProblem, Tangents, direction
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.averages import period_maxima
from jaxshroud.motion.batched_algorithms import Algorithm, Derivatives, Periods
from jaxshroud.motion.orbit import PeriodicOrbit, ShootingState, describe_orbit, slider_is_free
from jaxshroud.motion.shooting import FOLLOWED_TOLERANCE, ShootingOptions
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene

MAX_CORRECTOR_UPDATES = 8
SLIDER_SCALE = 1e3  # the unit of the slider in sizes of x: it starts anew at every onset, wherever that is
RESIDUAL_WEIGHTS = np.append(np.ones(STATE_SIZE - 1), SLIDER_SCALE)  # undoes this unit in closing errors


class ContinuationProblem(NamedTuple):
    """The continuation of a scene in one of its numbers, the parameter."""

    scene: Scene  # written such that the parameter is one of its own numbers
    key: str
    low: float
    high: float
    aim: ShootingOptions
    units: np.ndarray  # (13,) of the state

    @property
    def width(self) -> float:
        """The range of the parameter, which is its unit."""
        return self.high - self.low

    def at(self, value: float) -> Scene:
        """The scene at a value of the parameter."""
        return jax.tree.map(lambda a: a[0], scenes_at(self.scene, [self.key], np.array([[value]])))


class BranchPoint(NamedTuple):
    """A periodic orbit on a branch."""

    y: np.ndarray  # (14,) state and parameter, in their units
    value: float  # of the parameter
    cycle: PeriodicOrbit
    free: bool  # the slider is free: it stays where it starts
    tangent: np.ndarray  # (14,) of the branch, of length 1
    updates: int  # of Newton's method
    kind: str = ""  # of the special points: "fold", "flip", ...
    error: float = np.nan  # of the value of a special point, by a finer march

    @property
    def multipliers(self) -> np.ndarray:
        """The multipliers without that of a free slider."""
        return self.cycle.others


def continuation_problem(
    orbit: PeriodicOrbit, key: str, low: float, high: float, aim: ShootingOptions
) -> Algorithm[ContinuationProblem]:
    """The continuation from an orbit, in units of the largest values on it."""
    runs: Runs = yield Periods(orbit.scene, orbit.start, Plan(0, orbit.q, aim.steps, 0.0, aim.method))
    place = period_maxima(runs.samples)[0].max(axis=0).reshape(3, 2).max(axis=1)
    place = np.repeat(np.where(place > 0, place, 1.0), 2)
    units = np.concatenate([place, place * float(orbit.scene.drive.omega), [SLIDER_SCALE * place[0]]])
    return ContinuationProblem(orbit.scene, key, low, high, aim, units)


def first_point(problem: ContinuationProblem, state: State, value: float, q: int) -> Algorithm[BranchPoint | None]:
    """The orbit of period number q at a value of the parameter, near a state."""
    y = np.append(to_vector(state) / problem.units, value / problem.width)
    return (yield from corrected_point(problem, y, np.eye(STATE_SIZE + 1)[-1], state, q))


def corrected_point(
    problem: ContinuationProblem, y: np.ndarray, normal: np.ndarray, start: State, q: int
) -> Algorithm[BranchPoint | None]:
    """The point of a branch on the hyperplane through `y`; None where Newton's method does not converge.

    Args:
        problem: The continuation problem.
        y: The first guess (14,).
        normal: The normal of the hyperplane (14,): the tangent of the branch, or the axis of the parameter.
        start: A state with the contact mode and the case of the first guess.
        q: The period number.
    """
    base, best, last = y, None, np.inf
    for updates in range(MAX_CORRECTOR_UPDATES + 1):
        scene = problem.at(float(y[-1] * problem.width))
        state = from_vector((y[:-1] * problem.units).astype(scene.drive.omega.dtype), start.mode, start.case)
        course = TangentProblem(scene, state, [direction(scene, problem.key)])
        tangents: Tangents = yield Derivatives(course, q, problem.aim.steps, problem.aim.method)
        if tangents.status != Status.OK or not np.all(np.isfinite(tangents.by_state)):
            return best
        if tangents.end.mode != Mode.STICK:  # the motion determines the slider
            y = np.append(y[: STATE_SIZE - 1], [tangents.vector[-1] / problem.units[-1], y[-1]])
        miss = tangents.vector / problem.units - y[:-1]
        residual = float(np.abs(miss * RESIDUAL_WEIGHTS).max())
        free, jacobian = slider_is_free(scene, tangents), _jacobian(problem, tangents)
        if residual <= FOLLOWED_TOLERANCE[problem.aim.method.precision] and (
            best is None or residual < best.cycle.residual
        ):
            state = from_vector((y[:-1] * problem.units).astype(scene.drive.omega.dtype), start.mode, start.case)
            shot = ShootingState(state, tangents._replace(by_parameter=tangents.by_parameter), residual, updates)
            best = _branch_point(problem, y, shot, q, free, jacobian, normal)
        done = residual <= problem.aim.tolerance or (best is not None and residual > 0.5 * last)
        if done or residual > 1e3 * max(last, 1e-3):
            return best
        start, last = tangents.end, residual
        y = y + _corrector_step(jacobian, miss, normal, float(normal @ (base - y)), free)
    return best


def _jacobian(problem: ContinuationProblem, tangents: Tangents) -> np.ndarray:
    """The Jacobian (13, 14) of the closing error, in the units of the problem."""
    by_state = tangents.by_state * problem.units / problem.units[:, None] - np.eye(STATE_SIZE)
    return np.column_stack([by_state, tangents.by_parameter[:, 0] * problem.width / problem.units])


def _free_unknowns(free: bool) -> np.ndarray:
    """The indices of the 14 unknowns without a free slider, which is held fixed."""
    return np.delete(np.arange(STATE_SIZE + 1), STATE_SIZE - 1) if free else np.arange(STATE_SIZE + 1)


def _corrector_step(
    jacobian: np.ndarray, miss: np.ndarray, normal: np.ndarray, distance: float, free: bool
) -> np.ndarray:
    """The Newton step to where the map closes, on the hyperplane."""
    unknowns = _free_unknowns(free)
    system = np.vstack([jacobian[unknowns[:-1]][:, unknowns], normal[unknowns]])
    step = np.zeros(STATE_SIZE + 1)
    step[unknowns] = np.linalg.lstsq(system, np.append(-miss[unknowns[:-1]], distance), rcond=None)[0]
    return step


def _tangent(jacobian: np.ndarray, free: bool, side: np.ndarray) -> np.ndarray:
    """The unit tangent of the branch, on that side of the point."""
    moves = _free_unknowns(free)
    tangent = np.zeros(STATE_SIZE + 1)
    tangent[moves] = np.linalg.svd(jacobian[moves[:-1]][:, moves])[2][-1]
    return tangent if tangent @ side >= 0 else -tangent


def _branch_point(
    problem: ContinuationProblem, y, shot: ShootingState, q: int, free: bool, jacobian: np.ndarray, side: np.ndarray
) -> BranchPoint:
    scene = problem.at(float(y[-1] * problem.width))
    cycle = describe_orbit(scene, shot, q, problem.aim.tolerance, 0, problem.aim.steps, problem.aim.method)
    return BranchPoint(y, float(y[-1] * problem.width), cycle, free, _tangent(jacobian, free, side), shot.updates)
