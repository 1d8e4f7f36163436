"""Periodic orbits by shooting: Newton's method on the map of some drive periods."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan
from jaxshroud.batch.states import STATE, final_states, from_vector, rows, to_vector
from jaxshroud.batch.tangents import Course, Dual, differentiable, resting, run_flow
from jaxshroud.batch.xla import repeated
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import half_diagonal, sizes_of
from jaxshroud.motion.orbit import (
    EXACT,
    Cycle,
    Shot,
    conditioning_of,
    described,
    doubt_of,
    none_found,
    slider_is_free,
)
from jaxshroud.motion.period import repetition
from jaxshroud.motion.together import Algorithm, Derivatives, Periods
from jaxshroud.scene.scene import Scene

BLOCK = 8  # periods between two looks whether the motion repeats
WINDOW = 48  # of the latest periods is looked at, at most
NEAR = 1e-2  # how nearly it must, relative to each displacement's size, for Newton's method to take over
MOST_UPDATES = 12
# Relative closing errors. The march's rounding leaves some 1e-13 in float64 and 1e-6 to 2e-5 in float32, where Newton's
# method ends as soon as it no longer gains; an orbit counts as closed up to a thousand times the tolerance.
TOLERANCE = {"float64": 1e-11, "float32": 1e-7}
CLOSED = {"float64": 1e-9, "float32": 1e-4}  # of orbits that are only followed
TOGETHER = {"float64": 1e-8, "float32": 1e-4}  # states of an orbit so close are one and the same


class Aim(NamedTuple):
    """How an orbit is looked for."""

    steps: int  # Runge-Kutta steps in one period
    tolerance: float  # closing error at which Newton's method ends
    method: Choices


def settled_orbit(scene: Scene, state: State, most: int, aim: Aim) -> Algorithm[Cycle]:
    """The orbit that a scene settles on from a state within `most` periods.

    The scene is run until its samples nearly repeat; then Newton's method closes the orbit. If what it finds is not
    stable, the motion was only passing by, and the run goes on.
    """
    steps, method = aim.steps, aim.method
    spent, samples, largest, latest = 0, np.empty((0, STATE - 1)), np.empty((0, 6)), None
    lever = float(half_diagonal(scene.shroud))
    for done in range(BLOCK, most + BLOCK, BLOCK):
        runs = yield Periods(scene, state, Plan(0, BLOCK, steps, 0.0, method))
        spent, state = spent + BLOCK, _first(final_states(runs.last.state))
        status = int(runs.last.status[0])
        if status != Status.OK:
            return none_found(scene, state, "stopped", spent, steps, method, status)
        new = rows(runs.samples.motion)[0]
        latest_ones = slice(-max(min(WINDOW, done // 2), BLOCK), None)
        samples = np.concatenate([samples, new])[latest_ones]
        largest = np.concatenate([largest, sizes_of(runs.samples)[0]])[latest_ones]
        q = _nearly(samples, largest.max(axis=0), lever, scene.drive.omega.dtype)
        if q == 0:
            continue
        latest = yield from nearby_orbit(scene, state, q, samples, aim, spent)
        if latest.sound:
            return latest
        spent = latest.periods
    return none_found(scene, state, "aperiodic", spent, steps, method) if latest is None else latest


def nearby_orbit(scene: Scene, state: State, q: int, samples: np.ndarray, aim: Aim, spent: int = 0) -> Algorithm[Cycle]:
    """The orbit of period number `q`, or of a part of it, near a state whose samples (n, 12) nearly repeat.

    `spent` periods were simulated before.
    """
    sizes = _sizes(scene, samples)
    shot = yield from _closed(scene, state, q, sizes, aim)
    spent += (shot.updates + 1) * q
    found = described(scene, shot, q, aim.tolerance, spent, aim.steps, aim.method)
    return (yield from shortest_orbit(found, sizes, aim)) if found.sound else found


def closed_orbit(scene: Scene, state: State, q: int, aim: Aim, most: int = MOST_UPDATES) -> Algorithm[Cycle]:
    """The orbit of period number `q` near a state by `most` updates, without a run, whether or not it is stable."""
    shot = yield from _closed(scene, state, q, state_sizes(scene, state), aim, most)
    return described(scene, shot, q, aim.tolerance, (shot.updates + 1) * q, aim.steps, aim.method)


def shortest_orbit(long: Cycle, sizes: np.ndarray, aim: Aim) -> Algorithm[Cycle]:
    """The orbit with the smallest period number: one that still converged may have looked like a multiple of it."""
    for q in range(1, long.q):
        if long.q % q == 0:
            shot = yield from _closed(long.scene, long.start, q, sizes, aim, most=0)
            if shot.residual <= TOGETHER[long.method.precision]:
                spent = long.periods + q
                return described(long.scene, shot, q, aim.tolerance, spent, long.steps_per_period, long.method)
    return long


def _nearly(samples: np.ndarray, sizes: np.ndarray, lever: float, precision: Any) -> int:
    """The period number that samples (n, 12) nearly have, if they show it three times; else 0."""
    q = int(repetition(samples[:, :6], sizes, np.asarray(lever), NEAR, precision).number)
    return q if 3 * q <= len(samples) else 0


def state_sizes(scene: Scene, state: State) -> np.ndarray:
    """What the numbers of a state at drive phase 0 must come to on its motion, (13,): units to compare them in."""
    return _sizes(scene, to_vector(state)[None])


def _sizes(scene: Scene, samples: np.ndarray) -> np.ndarray:
    """Largest value of each quantity over samples (n, 12 or 13) and both blades, (13,); the slider's is that of x.

    What happens to be small at drive phase 0 counts as what it must come to: no motion is slower than the drive, nor
    faster than the stiffest of its springs.
    """
    omega_max, period = stiffest(scene, 0)
    place, rate = np.abs(samples[:, :12]).reshape(-1, 2, 3, 2).max(axis=(0, 3))
    place = np.maximum(place, rate / omega_max)
    rate = np.maximum(rate, 2 * np.pi / period * place)
    size = np.concatenate([place, rate])
    return np.append(np.repeat(np.where(size > 0, size, 1.0), 2), place[0] or 1.0)


def _closed(
    scene: Scene, state: State, q: int, sizes: np.ndarray, aim: Aim, most: int = MOST_UPDATES
) -> Algorithm[Shot]:
    """Newton's method on the map of `q` periods, in quantities scaled by their `sizes`."""
    best, unchanged, updates = None, 0, 0
    for updates in range(most + 1):
        at = yield Derivatives(Course(scene, state), q, aim.steps, aim.method)
        z = to_vector(state)
        z[STATE - 1] = z[STATE - 1] if at.end.mode == Mode.STICK else at.vector[STATE - 1]
        miss = (at.vector - z) / sizes
        residual = float(np.max(np.abs(miss)))
        shot = Shot(state, at, residual, updates)
        if best is None or residual < best.residual:
            best, unchanged = shot, 0
        else:
            unchanged += 1
        if at.status != Status.OK or unchanged == 2 or not np.isfinite(residual):
            break
        free = slider_is_free(scene, at)
        doubt = doubt_of(conditioning_of(scene, at, free), shot)
        if residual <= aim.tolerance and doubt <= EXACT[aim.method.precision]:
            break
        step = _newton_step(at.by_state * sizes / sizes[:, None], miss, free)
        state = from_vector((z + sizes * step).astype(z.dtype), at.end.mode, at.end.case)
    assert best is not None
    return best._replace(updates=updates)


def _newton_step(M: np.ndarray, miss: np.ndarray, free: bool) -> np.ndarray:
    """Solution of (I - M) step = miss; a slider that stays where it starts is left there."""
    size = STATE - free
    step = np.zeros(STATE)
    step[:size] = np.linalg.lstsq(np.eye(size) - M[:size, :size], miss[:size], rcond=None)[0]
    return step


def moved_start(M: np.ndarray, by: np.ndarray, free: bool) -> np.ndarray:
    """How the orbit's start moves, (13, n), where its map moves `by` (13, n); a slider that stays is held."""
    size = STATE - free
    moved = np.zeros_like(by)
    moved[:size] = np.linalg.solve(np.eye(size) - M[:size, :size], by[:size])
    return moved


def followed(found: Cycle, scenes: Scene) -> np.ndarray:
    """Mean square displacements (lanes, 2) on the orbits of scenes (leading axis) very near that of `found`.

    All are closed at once, by Newton's method with the Jacobian of the known orbit. NaN where that does not close.
    """
    assert found.jacobian is not None  # there is an orbit
    lanes, sizes = len(scenes.drive.omega), state_sizes(found.scene, found.start)
    states = repeated(found.start, lanes)
    still, method = jax.tree.map(np.zeros_like, scenes), differentiable(found.method)
    power, least = np.full((lanes, 2), np.nan), np.full(lanes, np.inf)
    for _ in range(MOST_UPDATES):
        came = run_flow(Dual(scenes, still), resting(states), found.q, found.steps_per_period, method).value
        z, end = to_vector(states), to_vector(came.state)
        miss = np.max(np.abs(end - z) / sizes, axis=1)
        better = miss < least
        power[better], least[better] = np.stack(came.power, axis=-1)[better], miss[better]
        if not better.any():
            break
        step = moved_start(found.jacobian.by_state, (end - z).T, found.slider_is_free).T
        states = from_vector(z + step, came.state.mode, came.state.case)
    return np.where((least <= CLOSED[found.method.precision])[:, None], power, np.nan)


def _first(tree: Any) -> Any:
    """The first lane of a tree of arrays."""
    return jax.tree.map(lambda a: a[0], tree)
