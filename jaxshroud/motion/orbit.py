"""Periodic orbits by shooting, with their Floquet multipliers and exact derivatives.

The section is drive phase 0. An orbit of period number q is a fixed point of the map of q drive periods on the state
(motion and slider); Newton's method on it needs the map's Jacobian M, which comes with the march.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.batch.states import STATE, as_precise, final_states, from_vector, rows, to_vector
from jaxshroud.batch.tangents import Dual, Tangents, differentiable, resting, run_flow, tangents
from jaxshroud.batch.xla import alone, repeated
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for, stiffest
from jaxshroud.model.absent import filled
from jaxshroud.model.linear import area, free_power
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import half_diagonal, sizes_of
from jaxshroud.motion.period import repetition
from jaxshroud.scene.checks import count_argument, positive_argument
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene

BLOCK = 8  # periods between two looks whether the motion repeats
WINDOW = 48  # of the latest periods is looked at, at most
NEAR = 1e-2  # how nearly it must, relative to each displacement's size, for Newton's method to take over
MOST_UPDATES = 12
# Relative errors of derivatives that are promised; where they cannot be kept, conditions are ill.
EXACT = {"float64": 1e-6, "float32": 1e-2}
ROUNDINGS = 1e3  # units of rounding that a slider's row of the Jacobian may differ by from that of a slider at rest
# Relative closing errors. The march's rounding leaves some 1e-13 in float64 and 1e-6 to 2e-5 in float32, where Newton's
# method ends as soon as it no longer gains; an orbit counts as closed up to a thousand times the tolerance.
TOLERANCE = {"float64": 1e-11, "float32": 1e-7}
CLOSED = {"float64": 1e-9, "float32": 1e-4}  # of orbits that are only followed
TOGETHER = {"float64": 1e-8, "float32": 1e-4}  # states of an orbit so close are one and the same
UNSOUND = {"unstable", "not converged", "stopped"}  # flags of what is not a motion that lasts


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit, or what was found in place of one.

    `flags` is empty for an orbit that can be relied upon. Else it holds any of "aperiodic" (the motion never nearly
    repeated), "not converged" (Newton's method did not close it), "unstable" (a multiplier outside the unit circle),
    "not unique" (permanent stick: the slider stays wherever it starts, one orbit for each of its places; derivatives
    are those with the slider held in its place), "ill conditioned" (`doubt` exceeds 1e-6) and "stopped" (the march
    ended with a status other than OK).
    """

    scene: Scene
    start: State  # at drive phase 0
    q: int  # period number; 0: no orbit
    P: np.ndarray  # (2,) Eq. (23) [m^4]; NaN without an orbit
    P_0: np.ndarray  # (2,) [m^4]
    P_d: float  # of the left blade, Eq. (24) [%]
    residual: float  # of closing, relative to the largest value of each quantity
    multipliers: np.ndarray  # (13,) Floquet multipliers, largest first; the slider's own is among them
    conditioning: float  # norm of (I - M)^-1 in the units of `_lengths`: how far a push of the map moves the orbit
    doubt: float  # relative error that derivatives may have from how well the orbit is closed, or from rounding
    flags: tuple[str, ...]
    updates: int  # of Newton's method
    periods: int  # drive periods simulated in all, each Jacobian counted as one run
    steps_per_period: int
    method: Choices
    jacobian: Tangents | None = field(repr=False)  # of the map at the orbit

    def __repr__(self) -> str:
        motion = f"period {self.q}, P_d {self.P_d:.6g} %" if self.found else "none found"
        closed = (
            f"closed to {self.residual:.1e}, largest multiplier {abs(self.multipliers[0]):.3g}; " if self.found else ""
        )
        return (
            f"Orbit: {motion}; {closed}flags: {', '.join(self.flags) or 'none'}; {self.periods} periods simulated; "
            f"{self.method}, {self.steps_per_period} steps a period"
        )

    @property
    def found(self) -> bool:
        """Whether there is a periodic orbit, stable or not."""
        return self.q > 0

    @property
    def slider_is_free(self) -> bool:
        """Whether the slider stays wherever it starts (permanent stick)."""
        return "not unique" in self.flags

    @property
    def others(self) -> np.ndarray:
        """The multipliers without that of a slider that stays wherever it starts, if it does."""
        return _without_slider(self.multipliers, self.slider_is_free)

    @property
    def bifurcation(self) -> tuple[str, float]:
        """The bifurcation that the leading multiplier is on its way to, and its distance 1 - abs(multiplier)."""
        lead = self.others[0]
        real = "fold" if lead.real > 0 else "flip"
        return "Neimark-Sacker" if abs(lead.imag) > 1e-6 * abs(lead) else real, float(1 - abs(lead))


class Shot(NamedTuple):
    """A state on its way to becoming an orbit."""

    state: State
    at: Tangents
    residual: float
    updates: int


def orbit(
    scene: Scene,
    *,
    state: State | None = None,
    q: int | None = None,
    most_periods: int = 1024,
    steps_per_period: Steps = 400,
    tolerance: float | None = None,
    method: Method | Choices = FAST,
) -> Orbit:
    """The periodic orbit that a scene settles on.

    The scene is run until its samples nearly repeat; then Newton's method closes the orbit. If what it finds is not
    stable, the motion was only passing by, and the run goes on.

    Args:
        scene: The scene.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        q: The period number where it is known. The given state is then closed at once, without a run, whether or not
            the orbit is stable: so an orbit can be followed from scene to scene.
        most_periods: Give up when the motion has not repeated by then.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        tolerance: Closing error at which Newton's method ends, relative to the largest value of each quantity; by
            default 1e-11 in float64 and 1e-7 in float32.
        method: Static choices of the march.

    Returns:
        The orbit. See its `flags` before using it.

    Raises:
        ValueError: A count is too small, the tolerance is not positive, or `q` is given without a state.
    """
    method = choices(method)
    count_argument("most_periods", most_periods, 1)
    tolerance = TOLERANCE[method.precision] if tolerance is None else tolerance
    positive_argument("tolerance", tolerance)
    steps_per_period = steps_for(scene, 0, steps_per_period, method.tableau)
    if q is not None:
        count_argument("q", q, 1)
        if state is None:
            raise ValueError("Argument `q` needs a `state` close to the orbit.")
    scene = in_precision(scene, method.precision)
    state = state and as_precise(state, scene)
    if q is not None and state is not None:
        shot = _closed(scene, state, q, _sizes(scene, to_vector(state)[None]), steps_per_period, tolerance, method)
        return described(scene, shot, q, tolerance, (shot.updates + 1) * q, steps_per_period, method)
    return _settled(scene, state, most_periods, steps_per_period, tolerance, method)


def _settled(scene: Scene, state: State | None, most: int, steps: int, tolerance: float, method: Choices) -> Orbit:
    lane = alone(scene)
    states = starts(lane) if state is None else alone(state)
    spent, samples, largest, latest = 0, np.empty((0, STATE - 1)), np.empty((0, 6)), None
    lever = float(half_diagonal(scene.shroud))
    here = jax.tree.map(lambda a: a[0], states)
    for done in range(BLOCK, most + BLOCK, BLOCK):
        runs = run_lanes(lane, states, Plan(0, BLOCK, steps, 0.0, method), lambda _: None)
        spent, states = spent + BLOCK, final_states(runs.last.state)
        here = jax.tree.map(lambda a: a[0], states)
        if int(runs.last.status[0]) != Status.OK:
            return _none(scene, here, ("stopped",), spent, steps, method)
        new = rows(runs.samples.motion)[0]
        latest_ones = slice(-max(min(WINDOW, done // 2), BLOCK), None)
        samples = np.concatenate([samples, new])[latest_ones]
        largest = np.concatenate([largest, sizes_of(runs.samples)[0]])[latest_ones]
        q = _nearly(samples, largest.max(axis=0), lever, scene.drive.omega.dtype)
        if q == 0:
            continue
        shot = _closed(scene, here, q, _sizes(scene, samples), steps, tolerance, method)
        spent += (shot.updates + 1) * q
        latest = described(scene, shot, q, tolerance, spent, steps, method)
        if not UNSOUND & set(latest.flags):
            return _shortest(latest, _sizes(scene, samples), tolerance)
    return _none(scene, here, ("aperiodic",), spent, steps, method) if latest is None else latest


def _shortest(long: Orbit, sizes: np.ndarray, tolerance: float) -> Orbit:
    """The orbit with the smallest period number: one that still converged may have looked like a multiple of it."""
    for q in range(1, long.q):
        if long.q % q == 0:
            shot = _closed(long.scene, long.start, q, sizes, long.steps_per_period, tolerance, long.method, most=0)
            if shot.residual <= TOGETHER[long.method.precision]:
                spent = long.periods + q
                return described(long.scene, shot, q, tolerance, spent, long.steps_per_period, long.method)
    return long


def _nearly(samples: np.ndarray, sizes: np.ndarray, lever: float, precision: Any) -> int:
    """The period number that samples (n, 12) nearly have, if they show it three times; else 0."""
    q = int(repetition(samples[:, :6], sizes, np.asarray(lever), NEAR, precision).number)
    return q if 3 * q <= len(samples) else 0


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
    scene: Scene,
    state: State,
    q: int,
    sizes: np.ndarray,
    steps: int,
    tolerance: float,
    method: Choices,
    most: int = MOST_UPDATES,
) -> Shot:
    """Newton's method on the map of `q` periods, in quantities scaled by their `sizes`."""
    best, unchanged, updates = None, 0, 0
    for updates in range(most + 1):
        at = tangents(scene, state, [], n=q, steps=steps, method=differentiable(method))
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
        free = _slider_is_free(scene, at)
        if residual <= tolerance and _doubt(_conditioning(scene, at, free), shot) <= EXACT[method.precision]:
            break
        step = _newton_step(at.by_state * sizes / sizes[:, None], miss, free)
        state = from_vector((z + sizes * step).astype(z.dtype), at.end.mode, at.end.case)
    assert best is not None
    return best._replace(updates=updates)


def _newton_step(M: np.ndarray, miss: np.ndarray, slider_is_free: bool) -> np.ndarray:
    """Solution of (I - M) step = miss; a slider that stays where it starts is left there."""
    size = STATE - slider_is_free
    step = np.zeros(STATE)
    step[:size] = np.linalg.lstsq(np.eye(size) - M[:size, :size], miss[:size], rcond=None)[0]
    return step


def moved_start(M: np.ndarray, by: np.ndarray, slider_is_free: bool) -> np.ndarray:
    """How the orbit's start moves, (13, n), where its map moves `by` (13, n); a slider that stays is held."""
    size = STATE - slider_is_free
    moved = np.zeros_like(by)
    moved[:size] = np.linalg.solve(np.eye(size) - M[:size, :size], by[:size])
    return moved


def followed(found: Orbit, scenes: Scene) -> np.ndarray:
    """Mean square displacements (lanes, 2) on the orbits of scenes (leading axis) very near that of `found`.

    All are closed at once, by Newton's method with the Jacobian of the known orbit. NaN where that does not close.
    """
    assert found.jacobian is not None  # there is an orbit
    lanes, sizes = len(scenes.drive.omega), _sizes(found.scene, to_vector(found.start)[None])
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


def _lengths(scene: Scene) -> np.ndarray:
    """What a state's numbers (13,) are counted in to compare them: lengths at a block's corner, and these per radian.

    A norm in these units does not depend on how large the motion is.
    """
    lever = np.hypot(float(scene.shroud.l_oa), float(scene.shroud.l_ab)) / 2
    place = np.repeat([1.0, 1.0, 1 / lever], 2)
    return np.concatenate([place, float(scene.drive.omega) * place, [1.0]])


def _in_lengths(scene: Scene, M: np.ndarray) -> np.ndarray:
    units = _lengths(scene)
    return M * units / units[:, None]


def _slider_is_free(scene: Scene, at: Tangents) -> bool:
    """Permanent stick: but for rounding, where the slider ends is where it started, and nothing else moves it."""
    M = _in_lengths(scene, at.by_state)
    most = ROUNDINGS * np.finfo(at.by_state.dtype).eps * max(1.0, float(np.abs(M).max()))
    return bool(at.end.mode == Mode.STICK and np.all(np.abs(M[-1] - np.eye(STATE)[-1]) <= most))


def _conditioning(scene: Scene, at: Tangents, slider_is_free: bool) -> float:
    """Norm of (I - M)^-1 in the units of `_lengths`, without a slider that stays where it starts; NaN if unknown."""
    if not np.all(np.isfinite(at.by_state)):
        return float("nan")
    size = STATE - slider_is_free
    with np.errstate(divide="ignore"):
        rest = np.eye(size) - _in_lengths(scene, at.by_state)[:size, :size]
        return float(1 / np.linalg.svd(rest, compute_uv=False)[-1])


def _doubt(conditioning: float, shot: Shot) -> float:
    """Relative error that derivatives may have from closing no better than this, or from rounding.

    An error of the map moves the orbit by `conditioning` times as much, and the derivatives by that once more.
    """
    return conditioning**2 * max(shot.residual, float(np.finfo(shot.at.by_state.dtype).eps))


def _without_slider(multipliers: np.ndarray, slider_is_free: bool) -> np.ndarray:
    return np.delete(multipliers, np.argmin(np.abs(multipliers - 1))) if slider_is_free else multipliers


def described(scene: Scene, shot: Shot, q: int, tolerance: float, spent: int, steps: int, method: Choices) -> Orbit:
    """The orbit through a closed shot, with its multipliers and flags."""
    at = shot.at
    multipliers = np.linalg.eigvals(at.by_state) if np.all(np.isfinite(at.by_state)) else np.full(STATE, np.nan + 0j)
    free = _slider_is_free(scene, at)
    multipliers = multipliers[np.argsort(-np.abs(multipliers))]
    others = _without_slider(multipliers, free)
    conditioning = _conditioning(scene, at, free)
    doubt = _doubt(conditioning, shot)
    flags = {
        "stopped": at.status != Status.OK,
        "not converged": not shot.residual <= max(1e3 * tolerance, 1e-9),
        "unstable": bool(np.any(np.abs(others) > 1)),
        "not unique": free,
        "ill conditioned": doubt > EXACT[method.precision],
    }
    P = float(area(scene.shroud)) * at.power
    P_0 = np.asarray(free_power(scene), float)
    return Orbit(
        scene=scene,
        start=shot.state,
        q=q,
        P=P,
        P_0=P_0,
        P_d=float(100 * (1 - P[0] / P_0[0])) if P_0[0] > 0 else float("nan"),
        residual=shot.residual,
        multipliers=multipliers,
        conditioning=conditioning,
        doubt=doubt,
        flags=tuple(name for name, raised in flags.items() if raised),
        updates=shot.updates,
        periods=spent,
        steps_per_period=steps,
        method=method,
        jacobian=at,
    )


def _none(scene: Scene, state: State, flags: tuple[str, ...], spent: int, steps: int, method: Choices) -> Orbit:
    nothing = np.full(2, np.nan)
    return Orbit(
        scene=scene,
        start=state,
        q=0,
        P=nothing,
        P_0=np.asarray(free_power(scene), float),
        P_d=float("nan"),
        residual=float("nan"),
        multipliers=np.full(STATE, np.nan + 0j),
        conditioning=float("nan"),
        doubt=float("nan"),
        flags=flags,
        updates=0,
        periods=spent,
        steps_per_period=steps,
        method=method,
        jacobian=None,
    )


class Margins(NamedTuple):
    """How far an orbit is from grazing, where its derivatives would be infinite."""

    counters: dict[str, int]  # events on the orbit
    slowest_onset: float  # closing speed at the gentlest onset, over the largest on the orbit; NaN without contact
    nearest_miss: float  # least distance that the corners come to without touching [m]; NaN where there is none


def contact_margins(found: Orbit) -> Margins:
    """Grazing margins of an orbit, from its onsets and from between the ends of its steps."""
    method = found.method._replace(ledger=False, within=True)
    plan = Plan(0, found.q, found.steps_per_period, 0.0, method)
    log = run_lanes(alone(found.scene), alone(found.start), plan, lambda _: None).last.tally.log
    counters = {name: int(n[0]) for name, n in vars(filled(log.counters, log.time_apart)).items()}
    fastest, gentlest, miss = (float(a[0]) for a in log.within[1:])
    slowest = gentlest / fastest if np.isfinite(gentlest) else np.nan
    return Margins(counters, slowest, miss if np.isfinite(miss) else np.nan)
