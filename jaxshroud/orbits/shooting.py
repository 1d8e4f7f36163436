"""Periodic orbits by shooting: Newton's method on the map of some drive periods."""

from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import DTypeLike

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import coordinate_sizes, final_states, from_vector, motion_rows, shroud_rows, to_vector
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.stepped_runs import select_lanes
from jaxshroud.batch.tangents import TangentProblem, Tangents, run_flow, without_direction
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives, Periods
from jaxshroud.orbits.orbit import (
    MAX_DERIVATIVE_ERROR,
    PeriodicOrbit,
    ShootingState,
    conditioning_of,
    derivative_error_of,
    describe_orbit,
    determined,
    free_sliders,
    no_orbit,
)
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree
from jaxshroud.signals.averages import half_diagonal, period_maxima
from jaxshroud.signals.period import repetition

PERIODS_BETWEEN_CHECKS = 8  # between checks whether the motion repeats
RETURN_WINDOW = 48  # latest periods that are checked, at most
RETURN_TOLERANCE = 1e-2  # closing error, relative to each displacement's size, at which Newton's method starts
MAX_NEWTON_UPDATES = 12
# Relative closing errors. Rounding in the march leaves some 1e-13 in float64 and 1e-6 to 2e-5 in float32, where
# Newton's method ends as soon as it stalls; an orbit counts as closed up to a thousand times the tolerance.
CLOSING_TOLERANCE = {"float64": 1e-11, "float32": 1e-7}
FOLLOWED_TOLERANCE = {"float64": 1e-9, "float32": 1e-4}  # of orbits of nearby scenes
SAME_STATE_TOLERANCE = {"float64": 1e-8, "float32": 1e-4}  # distance of equal states of an orbit


class ShootingOptions(NamedTuple):
    """The options of a search for an orbit."""

    steps: int  # Runge-Kutta steps in one period
    tolerance: float  # closing error at which Newton's method ends
    method: Choices


def settled_orbit(scene: Scene, state: State, max_periods: int, aim: ShootingOptions) -> Algorithm[PeriodicOrbit]:
    """The orbit on which a scene settles from a state within `max_periods` periods.

    The scene is run until its samples nearly repeat; then Newton's method closes the orbit. If the orbit is not stable,
    the motion was only passing by, and the run goes on.
    """
    steps, method = aim.steps, aim.method
    blades = scene.layout.blades
    simulated = 0
    samples = np.empty((0, 6 * blades))
    largest = np.empty((0, 3 * blades))
    orbit = None
    lever = float(half_diagonal(scene.shroud))
    for periods in range(PERIODS_BETWEEN_CHECKS, max_periods + PERIODS_BETWEEN_CHECKS, PERIODS_BETWEEN_CHECKS):
        runs = yield Periods(scene, state, Plan(0, PERIODS_BETWEEN_CHECKS, steps, 0.0, method))
        simulated = simulated + PERIODS_BETWEEN_CHECKS
        state = _first_lane(final_states(runs.last.state))
        status = int(runs.last.status[0])
        if status != Status.OK:
            return no_orbit(scene, state, "stopped", simulated, steps, method, status)
        new = motion_rows(runs.samples.motion)[0]
        latest = slice(-max(min(RETURN_WINDOW, periods // 2), PERIODS_BETWEEN_CHECKS), None)
        samples = np.concatenate([samples, new])[latest]
        largest = np.concatenate([largest, period_maxima(runs.samples)[0]])[latest]
        q = _approximate_period(samples, largest.max(axis=0), lever, scene.drive.omega.dtype)
        if q == 0:
            continue
        orbit = yield from nearby_orbit(scene, state, q, samples, aim, simulated)
        if orbit.sound:
            return orbit
        simulated = orbit.periods
    return no_orbit(scene, state, "aperiodic", simulated, steps, method) if orbit is None else orbit


def nearby_orbit(
    scene: Scene, state: State, q: int, samples: np.ndarray, aim: ShootingOptions, simulated: int = 0
) -> Algorithm[PeriodicOrbit]:
    """The orbit of period number `q`, or of a part of it, near a state whose samples (n, 6 blades) nearly repeat.

    `simulated` is the number of periods simulated before.
    """
    sizes = _scales(scene, samples)
    shot = yield from _shoot(scene, state, q, sizes, aim)
    simulated += (shot.updates + 1) * q
    orbit = describe_orbit(scene, shot, q, aim.tolerance, simulated, aim.steps, aim.method)
    return (yield from shortest_orbit(orbit, sizes, aim)) if orbit.sound else orbit


def closed_orbit(
    scene: Scene, state: State, q: int, aim: ShootingOptions, max_updates: int = MAX_NEWTON_UPDATES
) -> Algorithm[PeriodicOrbit]:
    """The orbit of period number `q` near a state by at most `max_updates` updates, stable or not."""
    shot = yield from _shoot(scene, state, q, state_scales(scene, state), aim, max_updates)
    return describe_orbit(scene, shot, q, aim.tolerance, (shot.updates + 1) * q, aim.steps, aim.method)


def shortest_orbit(orbit: PeriodicOrbit, sizes: np.ndarray, aim: ShootingOptions) -> Algorithm[PeriodicOrbit]:
    """The orbit with its smallest period number: a converging motion may have seemed to have a multiple of it."""
    for q in range(1, orbit.q):
        if orbit.q % q == 0:
            shot = yield from _shoot(orbit.scene, orbit.start, q, sizes, aim, max_updates=0)
            if shot.residual <= SAME_STATE_TOLERANCE[orbit.method.precision]:
                simulated = orbit.periods + q
                return describe_orbit(
                    orbit.scene, shot, q, aim.tolerance, simulated, orbit.steps_per_period, orbit.method
                )
    return orbit


def _approximate_period(samples: np.ndarray, sizes: np.ndarray, lever: float, precision: DTypeLike) -> int:
    """The approximate period number of samples (n, 6 blades), if it occurs three times; else 0."""
    q = int(repetition(samples[:, : len(sizes)], sizes, np.asarray(lever), RETURN_TOLERANCE, precision).number)
    return q if 3 * q <= len(samples) else 0


def state_scales(scene: Scene, state: State) -> np.ndarray:
    """The sizes that the numbers of a state at drive phase 0 must reach on its motion, as units."""
    return _scales(scene, shroud_rows(to_vector(state)[None], scene))


def _scales(scene: Scene, samples: np.ndarray) -> np.ndarray:
    """The largest value of each quantity over samples (n, 6 blades) and all blades; for the sliders that of x.

    A quantity that is small at drive phase 0 gets the size that it must reach: no motion is slower than the drive, nor
    faster than its stiffest spring.
    """
    omega_max, period = stiffest(scene, 0)
    blades = scene.layout.blades
    place, rate = np.abs(samples).reshape(-1, 2, 3, blades).max(axis=(0, 3))
    place = np.maximum(place, rate / omega_max)
    rate = np.maximum(rate, 2 * np.pi / period * place)
    sizes = [np.repeat(np.where(size > 0, size, 1.0), blades) for size in (place, rate)]
    sliders = np.full(scene.sliders, place[0] or 1.0)
    return np.concatenate([*(coordinate_sizes(size, scene) for size in sizes), sliders])


def _shoot(
    scene: Scene, state: State, q: int, sizes: np.ndarray, aim: ShootingOptions, max_updates: int = MAX_NEWTON_UPDATES
) -> Algorithm[ShootingState]:
    """Newton's method on the map of `q` periods, in quantities scaled by their `sizes`."""
    best = None
    unchanged = 0
    updates = 0
    for updates in range(max_updates + 1):
        tangents = yield Derivatives(TangentProblem(scene, state), q, aim.steps, aim.method)
        z = with_determined_sliders(to_vector(state), tangents)
        miss = (tangents.vector - z) / sizes
        residual = float(np.max(np.abs(miss)))
        shot = ShootingState(state, tangents, residual, updates)
        if best is None or residual < best.residual:
            best = shot
            unchanged = 0
        else:
            unchanged += 1
        if tangents.status != Status.OK or unchanged == 2 or not np.isfinite(residual):
            break
        free = free_sliders(scene, tangents)
        doubt = derivative_error_of(conditioning_of(scene, tangents, free), shot)
        if residual <= aim.tolerance and doubt <= MAX_DERIVATIVE_ERROR[aim.method.precision]:
            break
        step = _shooting_step(tangents.by_state * sizes / sizes[:, None], miss, free)
        z = (z + sizes * step).astype(z.dtype)
        state = from_vector(z, tangents.end.mode, tangents.end.case, scene)
    assert best is not None
    return best._replace(updates=updates)


def with_determined_sliders(z: np.ndarray, tangents: Tangents, units: np.ndarray | float = 1.0) -> np.ndarray:
    """A start (numbers,) in `units` whose sliders are those at the end of its map, except for sticking ones."""
    z = np.copy(z)
    sticks = np.ravel(tangents.end.mode) == Mode.STICK
    count = len(sticks)
    z[-count:] = np.where(sticks, z[-count:], (tangents.vector / units)[-count:])
    return z


def _shooting_step(M: np.ndarray, miss: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The solution of (I - M) step = miss; free sliders are not moved."""
    moves = determined(len(M), free)
    step = np.zeros(len(M))
    step[moves] = np.linalg.lstsq(np.eye(len(moves)) - M[np.ix_(moves, moves)], miss[moves], rcond=None)[0]
    return step


def moved_start(M: np.ndarray, shift: np.ndarray, free: np.ndarray | bool) -> np.ndarray:
    """The shift of the start of an orbit, (numbers, n), where its map has a `shift`; free sliders are held fixed."""
    moves = determined(len(M), free)
    shifted = np.zeros_like(shift)
    shifted[moves] = np.linalg.solve(np.eye(len(moves)) - M[np.ix_(moves, moves)], shift[moves])
    return shifted


class NearbyOrbits(NamedTuple):
    """The orbits of scenes very near that of another; the averages are NaN where one does not close."""

    starts: State
    power: np.ndarray  # mean square displacements (lanes, blades) [m^2]
    means: np.ndarray | None  # as of `Tangents`, (lanes, 4, blades); None unless they are wanted


def nearby_orbits(orbit: PeriodicOrbit, scenes: Scene, *, vibration: bool = False) -> NearbyOrbits:
    """The orbits of scenes very near that of `orbit`, with their mean positions if `vibration`.

    All orbits are closed at once, by Newton's method with the Jacobian of the given orbit.
    """
    assert orbit.jacobian is not None  # there is an orbit
    lanes = len(scenes.drive.omega)
    sizes = state_scales(orbit.scene, orbit.start)
    states = starts = repeat_lane(orbit.start, lanes)
    no_change = jax.tree.map(np.zeros_like, scenes)
    method = as_differentiable(orbit.method)
    method = method._replace(vibration=vibration)
    power, smallest = np.full((lanes, len(orbit.P)), np.nan), np.full(lanes, np.inf)
    means = np.full((lanes, 4, scenes.layout.counted), np.nan) if vibration else None
    for _ in range(MAX_NEWTON_UPDATES):
        flows = run_flow(
            Dual(scenes, no_change), without_direction(states), orbit.q, orbit.steps_per_period, method
        ).value
        z, end = to_vector(states), to_vector(flows.own)
        miss = np.max(np.abs(end - z) / sizes, axis=1)
        improved = miss < smallest
        power[improved], smallest[improved] = flows.power[improved], miss[improved]
        if means is not None:
            means[improved] = np.stack(flows.means, axis=1)[improved]
        starts = select_lanes(improved, states, starts)
        if not improved.any():
            break
        step = moved_start(orbit.jacobian.by_state, (end - z).T, orbit.free_sliders).T
        states = from_vector(z + step, flows.state.mode, flows.state.case, scenes)
    closed = smallest <= FOLLOWED_TOLERANCE[orbit.method.precision]
    return NearbyOrbits(starts, np.where(closed[:, None], power, np.nan), means)


def _first_lane(tree: Tree) -> Tree:
    """The first lane of a tree of arrays."""
    return jax.tree.map(lambda a: a[0], tree)
