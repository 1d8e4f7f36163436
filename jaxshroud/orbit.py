"""Periodic orbits by shooting, with their Floquet multipliers and exact derivatives.

The section is drive phase 0. An orbit of period number q is a fixed point of the map of q drive periods on the state
(motion and slider); Newton's method on it needs the map's Jacobian M, which comes with the march.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.analysis.period import periodicity
from jaxshroud.checks import count_argument, in_precision
from jaxshroud.events import seat
from jaxshroud.geometry import touch_rates
from jaxshroud.integrate import FAST, Method
from jaxshroud.lanes import alone, repeated
from jaxshroud.linear import area, free_power
from jaxshroud.rhs import as_pairs, model
from jaxshroud.scene import Scene
from jaxshroud.stability import Steps, steps_for
from jaxshroud.state import Mode, State, Status
from jaxshroud.sweep import Plan, final_states, run_lanes, starts
from jaxshroud.tangents import (
    STATE,
    Dual,
    Tangents,
    as_precise,
    differentiable,
    from_vector,
    resting,
    run_flow,
    tangents,
    to_vector,
)
from jaxshroud.trajectory import simulate

BLOCK = 8  # periods between two looks whether the motion repeats
WINDOW = 48  # of the latest periods is looked at, at most
NEAR = 1e-2  # how nearly it must, relative to the largest displacement, for Newton's method to take over
MOST_UPDATES = 12
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
    "not unique" (permanent stick: the slider stays wherever it starts, one orbit for each of its places) and
    "stopped" (the march ended with a status other than OK).
    """

    scene: Scene
    start: State  # at drive phase 0
    q: int  # period number; 0: no orbit
    P: np.ndarray  # (2,) Eq. (23) [m^4]; NaN without an orbit
    P_0: np.ndarray  # (2,) [m^4]
    P_d: float  # of the left blade, Eq. (24) [%]
    residual: float  # of closing, relative to the largest value of each quantity
    multipliers: np.ndarray  # (13,) Floquet multipliers, largest first; the slider's own is among them
    flags: tuple[str, ...]
    updates: int  # of Newton's method
    periods: int  # drive periods simulated in all, each Jacobian counted as one run
    steps_per_period: int
    method: Method
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
        lead = self.multipliers[0]
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
    method: Method = FAST,
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
        ValueError: A count is too small, or `q` is given without a state.
    """
    count_argument("most_periods", most_periods, 1)
    steps_per_period = steps_for(scene, 0, steps_per_period, method.tableau)
    if q is not None:
        count_argument("q", q, 1)
        if state is None:
            raise ValueError("Argument `q` needs a `state` close to the orbit.")
    scene = in_precision(scene, method.precision)
    state = state and as_precise(state, scene)
    tolerance = tolerance or TOLERANCE[method.precision]
    if q is not None and state is not None:
        shot = _closed(scene, state, q, _sizes(to_vector(state)[None]), steps_per_period, tolerance, method)
        return described(scene, shot, q, tolerance, (shot.updates + 1) * q, steps_per_period, method)
    return _settled(scene, state, most_periods, steps_per_period, tolerance, method)


def _settled(scene: Scene, state: State | None, most: int, steps: int, tolerance: float, method: Method) -> Orbit:
    lane = alone(scene)
    states = starts(lane) if state is None else alone(state)
    spent, samples, latest = 0, np.empty((0, STATE - 1)), None
    here = jax.tree.map(lambda a: a[0], states)
    for done in range(BLOCK, most + BLOCK, BLOCK):
        runs = run_lanes(lane, states, Plan(0, BLOCK, steps, 0.0, method), lambda _: None)
        spent, states = spent + BLOCK, final_states(runs.last)
        here = jax.tree.map(lambda a: a[0], states)
        if int(runs.last.status[0]) != Status.OK:
            return _none(scene, here, ("stopped",), spent, steps, method)
        new = np.concatenate([np.stack(pair, axis=-1)[0] for pair in runs.samples.motion], axis=-1)
        samples = np.concatenate([samples, new])[-max(min(WINDOW, done // 2), BLOCK) :]
        q = _nearly(samples)
        if q == 0:
            continue
        shot = _closed(scene, here, q, _sizes(samples), steps, tolerance, method)
        spent += (shot.updates + 1) * q
        latest = described(scene, shot, q, tolerance, spent, steps, method)
        if not UNSOUND & set(latest.flags):
            return _shortest(latest, _sizes(samples), tolerance)
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


def _nearly(samples: np.ndarray) -> int:
    """The period number that samples (n, 12) nearly have, if they show it three times; else 0."""
    q = int(periodicity(samples[:, 0], NEAR).number)
    return q if 3 * q <= len(samples) else 0


def _sizes(samples: np.ndarray) -> np.ndarray:
    """Largest value of each quantity over samples (n, 12 or 13) and both blades, (13,); the slider's is that of x."""
    pairs = np.abs(samples[:, :12]).reshape(-1, 6, 2).max(axis=(0, 2))
    sizes = np.repeat(np.where(pairs > 0, pairs, 1.0), 2)
    return np.append(sizes, sizes[0])


def _closed(
    scene: Scene,
    state: State,
    q: int,
    sizes: np.ndarray,
    steps: int,
    tolerance: float,
    method: Method,
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
        if at.status != Status.OK or residual <= tolerance or unchanged == 2 or not np.isfinite(residual):
            break
        step = _newton_step(at.by_state * sizes / sizes[:, None], miss, _slider_is_free(at))
        state = from_vector(z + sizes * step, at.end.mode, at.end.case)
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
    lanes, sizes = len(scenes.drive.omega), _sizes(to_vector(found.start)[None])
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


def _slider_is_free(at: Tangents) -> bool:
    """Permanent stick: where the slider ends is where it started, and nothing else moves it."""
    return bool(at.end.mode == Mode.STICK and np.array_equal(at.by_state[-1], np.eye(STATE)[-1]))


def _without_slider(multipliers: np.ndarray, slider_is_free: bool) -> np.ndarray:
    return np.delete(multipliers, np.argmin(np.abs(multipliers - 1))) if slider_is_free else multipliers


def described(scene: Scene, shot: Shot, q: int, tolerance: float, spent: int, steps: int, method: Method) -> Orbit:
    """The orbit through a closed shot, with its multipliers and flags."""
    at = shot.at
    multipliers = np.linalg.eigvals(at.by_state) if np.all(np.isfinite(at.by_state)) else np.full(STATE, np.nan + 0j)
    free = _slider_is_free(at)
    multipliers = multipliers[np.argsort(-np.abs(multipliers))]
    others = _without_slider(multipliers, free)
    flags = {
        "stopped": at.status != Status.OK,
        "not converged": not shot.residual <= max(1e3 * tolerance, 1e-9),
        "unstable": bool(np.any(np.abs(others) > 1)),
        "not unique": free,
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
        flags=tuple(name for name, raised in flags.items() if raised),
        updates=shot.updates,
        periods=spent,
        steps_per_period=steps,
        method=method,
        jacobian=at,
    )


def _none(scene: Scene, state: State, flags: tuple[str, ...], spent: int, steps: int, method: Method) -> Orbit:
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
    """Grazing margins of an orbit, from its samples at every step."""
    run = simulate(
        found.scene,
        found.start,
        n_periods=found.q,
        steps_per_period=found.steps_per_period,
        method=found.method._replace(ledger=False),
    )
    states = State(run.motion, np.nan_to_num(run.u_s), run.mode, run.case)
    v, closing = (np.asarray(a) for a in _penetrations(found.scene, states))
    apart = run.mode == Mode.APART
    onset = np.flatnonzero(apart[:-1] & ~apart[1:])
    gentlest = closing[onset].min() / np.abs(closing).max() if len(onset) else np.nan
    inner = apart[:-2] & apart[1:-1] & apart[2:]
    tops = inner & (v[1:-1] >= v[:-2]) & (v[1:-1] > v[2:]) & (v[1:-1] < 0)
    miss = -v[1:-1][tops].max() if tops.any() else np.nan
    return Margins(run.counters, float(gentlest), float(miss))


@jax.jit
def _penetrations(scene: Scene, states: State):
    whole = model(scene)

    def one(state: State):
        _, case, at = seat(state.motion, state, whole)
        return at.v, touch_rates(at, state.motion, case, whole.reading).v

    return jax.vmap(lambda state: one(as_pairs(state)))(states)
