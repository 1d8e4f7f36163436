"""The points of a branch of periodic orbits: shooting with pseudo-arclength continuation in one parameter.

A point of a branch is a fixed point of the map of q drive periods together with the value of the parameter, a number of
the scene. The next point is predicted along the tangent and corrected, by Newton's method, on the hyperplane normal to
it, so that a branch may turn back in the parameter at a fold. The derivatives by the state and by the parameter come
from one run with tangents, compiled once for all points.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import coordinate_sizes, from_vector, to_vector
from jaxshroud.batch.plan import Plan, Runs
from jaxshroud.batch.tangents import TangentProblem, Tangents, direction
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives, Periods
from jaxshroud.orbits.orbit import PeriodicOrbit, ShootingState, describe_orbit, determined, free_sliders
from jaxshroud.orbits.shooting import FOLLOWED_TOLERANCE, ShootingOptions, with_determined_sliders
from jaxshroud.orbits.travelling_wave import TravellingWave, travelling_wave
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.averages import period_maxima

MAX_CORRECTOR_UPDATES = 8
SLIDER_SCALE = 1e3  # the unit of sliders in sizes of x: they start anew at every onset, wherever that is


class ContinuationProblem(NamedTuple):
    """The continuation of a scene in one of its numbers, the parameter."""

    scene: Scene  # written such that the parameter is one of its own numbers
    key: str
    low: float
    high: float
    aim: ShootingOptions
    units: np.ndarray  # (numbers,) of the state

    @property
    def width(self) -> float:
        """The range of the parameter, which is its unit."""
        return self.high - self.low

    @property
    def size(self) -> float:
        """The size of x [m]."""
        return float(self.units[-1] / SLIDER_SCALE)

    @property
    def along_parameter(self) -> np.ndarray:
        """The axis of the parameter, (numbers + 1,)."""
        return np.eye(len(self.units) + 1)[-1]

    @property
    def weights(self) -> np.ndarray:
        """The weights (numbers,) that undo the unit of sliders in closing errors."""
        place = np.arange(len(self.units)) < len(self.units) - self.scene.sliders
        return np.where(place, 1.0, SLIDER_SCALE)

    def at(self, value: float) -> Scene:
        """The scene at a value of the parameter."""
        return jax.tree.map(lambda a: a[0], scenes_at(self.scene, [self.key], np.array([[value]])))


class BranchPoint(NamedTuple):
    """A periodic orbit on a branch."""

    y: np.ndarray  # (numbers + 1,) state and parameter, in their units
    value: float  # of the parameter
    cycle: PeriodicOrbit
    free: tuple[bool, ...]  # which sliders are free: they stay where they start
    tangent: np.ndarray  # (numbers + 1,) of the branch, of length 1
    updates: int  # of Newton's method
    kind: str = ""  # of the special points: "fold", "flip", ...
    error: float = np.nan  # of the value of a special point, by a finer march
    wave: TravellingWave | None = None  # the reduced map, in a ring of alike blades

    @property
    def is_wave(self) -> bool:
        """Whether the orbit is a travelling wave."""
        return self.wave is not None and self.wave.holds

    @property
    def multipliers(self) -> np.ndarray:
        """The multipliers without those of free sliders: of a travelling wave those of the reduced map."""
        return self.wave.others if self.wave is not None and self.wave.holds else self.cycle.others

    @property
    def of_period(self) -> "BranchPoint":
        """The point with the multipliers of the whole period."""
        return self._replace(wave=None)


def continuation_problem(
    orbit: PeriodicOrbit, key: str, low: float, high: float, aim: ShootingOptions
) -> Algorithm[ContinuationProblem]:
    """The continuation from an orbit, in units of the largest values on it."""
    runs: Runs = yield Periods(orbit.scene, orbit.start, Plan(0, orbit.q, aim.steps, 0.0, aim.method))
    place = period_maxima(runs.samples)[0].max(axis=0).reshape(3, len(orbit.P)).max(axis=1)
    place = np.where(place > 0, place, 1.0)
    sliders = np.full(orbit.scene.sliders, SLIDER_SCALE * place[0])
    sizes = coordinate_sizes(np.repeat(place, len(orbit.P)), orbit.scene)
    units = np.concatenate([sizes, sizes * float(orbit.scene.drive.omega), sliders])
    return ContinuationProblem(orbit.scene, key, low, high, aim, units)


def first_point(problem: ContinuationProblem, state: State, value: float, q: int) -> Algorithm[BranchPoint | None]:
    """The orbit of period number q at a value of the parameter, near a state."""
    y = np.append(to_vector(state) / problem.units, value / problem.width)
    return (yield from corrected_point(problem, y, problem.along_parameter, state, q))


def corrected_point(
    problem: ContinuationProblem, y: np.ndarray, normal: np.ndarray, start: State, q: int
) -> Algorithm[BranchPoint | None]:
    """The point of a branch on the hyperplane through `y`; None where Newton's method does not converge.

    Args:
        problem: The continuation problem.
        y: The first guess (numbers + 1,).
        normal: The normal of the hyperplane (numbers + 1,): the tangent of the branch, or the axis of the parameter.
        start: A state with the contact mode and the case of the first guess.
        q: The period number.
    """
    point = yield from _closed_point(problem, y, normal, start, q)
    return None if point is None else point._replace(wave=(yield from travelling_wave(point.cycle)))


def _closed_point(
    problem: ContinuationProblem, y: np.ndarray, normal: np.ndarray, start: State, q: int
) -> Algorithm[BranchPoint | None]:
    """The orbit of `corrected_point`, without its reduced map."""
    base = y
    best = None
    last = np.inf
    for updates in range(MAX_CORRECTOR_UPDATES + 1):
        scene = problem.at(float(y[-1] * problem.width))
        state = _state_at(problem, y, start)
        course = TangentProblem(scene, state, [direction(scene, problem.key)])
        tangents: Tangents = yield Derivatives(course, q, problem.aim.steps, problem.aim.method)
        if tangents.status != Status.OK or not np.all(np.isfinite(tangents.by_state)):
            return best
        y = np.append(with_determined_sliders(y[:-1], tangents, problem.units), y[-1])
        miss = tangents.vector / problem.units - y[:-1]
        residual = float(np.abs(miss * problem.weights).max())
        free = free_sliders(scene, tangents)
        jacobian = _jacobian(problem, tangents)
        if residual <= FOLLOWED_TOLERANCE[problem.aim.method.precision] and (
            best is None or residual < best.cycle.residual
        ):
            state = _state_at(problem, y, start)
            shot = ShootingState(state, tangents._replace(by_parameter=tangents.by_parameter), residual, updates)
            best = _branch_point(problem, y, shot, q, free, jacobian, normal)
        done = residual <= problem.aim.tolerance or (best is not None and residual > 0.5 * last)
        if done or residual > 1e3 * max(last, 1e-3):
            return best
        start = tangents.end
        last = residual
        y = y + _corrector_step(jacobian, miss, normal, float(normal @ (base - y)), free)
    return best


def _state_at(problem: ContinuationProblem, y: np.ndarray, like: State) -> State:
    """The state of a point, with the contact modes and cases of another."""
    numbers = (y[:-1] * problem.units).astype(problem.scene.drive.omega.dtype)
    return from_vector(numbers, like.mode, like.case, problem.scene)


def _jacobian(problem: ContinuationProblem, tangents: Tangents) -> np.ndarray:
    """The Jacobian (numbers, numbers + 1) of the closing error, in the units of the problem."""
    by_state = tangents.by_state * problem.units / problem.units[:, None] - np.eye(len(problem.units))
    return np.column_stack([by_state, tangents.by_parameter[:, 0] * problem.width / problem.units])


def _free_unknowns(size: int, free: np.ndarray) -> np.ndarray:
    """The indices of the state's and the parameter's unknowns without free sliders, which are held fixed."""
    return np.append(determined(size, free), size)


def _corrector_step(
    jacobian: np.ndarray, miss: np.ndarray, normal: np.ndarray, distance: float, free: np.ndarray
) -> np.ndarray:
    """The Newton step to where the map closes, on the hyperplane."""
    unknowns = _free_unknowns(len(miss), free)
    system = np.vstack([jacobian[unknowns[:-1]][:, unknowns], normal[unknowns]])
    step = np.zeros(len(normal))
    step[unknowns] = np.linalg.lstsq(system, np.append(-miss[unknowns[:-1]], distance), rcond=None)[0]
    return step


def _tangent(jacobian: np.ndarray, free: np.ndarray, side: np.ndarray) -> np.ndarray:
    """The unit tangent of the branch, on that side of the point."""
    moves = _free_unknowns(len(jacobian), free)
    tangent = np.zeros(len(side))
    tangent[moves] = np.linalg.svd(jacobian[moves[:-1]][:, moves])[2][-1]
    return tangent if tangent @ side >= 0 else -tangent


def _branch_point(
    problem: ContinuationProblem,
    y,
    shot: ShootingState,
    q: int,
    free: np.ndarray,
    jacobian: np.ndarray,
    side: np.ndarray,
) -> BranchPoint:
    value = float(y[-1] * problem.width)
    tangent = _tangent(jacobian, free, side)
    scene = problem.at(value)
    cycle = describe_orbit(scene, shot, q, problem.aim.tolerance, 0, problem.aim.steps, problem.aim.method)
    return BranchPoint(y, value, cycle, tuple(free.tolist()), tangent, shot.updates)
