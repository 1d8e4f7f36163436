"""One explicit Runge-Kutta step in a fixed mode."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.march.lane import Grid, Lane
from jaxshroud.march.method import Choices
from jaxshroud.model.absent import Pair, Scalar
from jaxshroud.model.ready import Model
from jaxshroud.model.rhs import Integrals, Slope, rhs_once, wave
from jaxshroud.model.state import State
from jaxshroud.model.trig import sincos_turns, sine_versine
from jaxshroud.scene.motion import Motion


class Place(NamedTuple):
    """A trial step of one lane in time."""

    turns: Scalar  # phase of the drive at its start [turns]
    dturns: Scalar  # and what it gains [turns]
    h: Scalar  # its length [s]


def place_of(lane: Lane, grid: Grid) -> Place:
    """Where the lane's next trial step is."""
    done = lane.step.astype(lane.search.done.dtype) + lane.search.done
    length = lane.search.length
    return Place(grid.start + done * grid.turn, length * grid.turn, length * grid.h)


class Stages(NamedTuple):
    """What the stages of a Runge-Kutta step so far have found."""

    slopes: tuple[Slope, ...]
    gain: Integrals | None  # sum of the integrals' rates times the weights b


NO_STAGES = Stages((), None)


def rk_stages(known: Stages, upto: int, place: Place, held: State, model: Model, method: Choices):
    """The stages before number `upto`, and the slopes dz/dt in all of them; the mode stays fixed."""
    tableau, (found, gain) = method.rk, known
    slopes: list[State] = []
    waves = _waves(place, set(tableau.c[len(found) : upto]), model)
    for i in range(upto):
        now = _combined(held, place.h, tableau.a[i][: len(slopes)], slopes, model)
        if i == len(found):
            slope, rates = rhs_once(waves[tableau.c[i]], now, model, method.ledger)
            found = (*found, slope)
            gain = _added(gain, tableau.b[i], rates)
        slopes.append(_rates(now, found[i]))
    return Stages(found, gain), slopes


def _rates(now: State, slope: Slope) -> State:
    """d/dt of a state's numbers."""
    z = now.motion
    return State(Motion(z.v_x, z.v_y, z.v_theta, *slope.acceleration), slope.u_s, None, None)


def _added(total: Integrals | None, weight: float, rates: Integrals) -> Integrals | None:
    weighted = jax.tree.map(lambda a: weight * a, rates) if weight else None
    return weighted if total is None else total if weighted is None else jax.tree.map(jnp.add, total, weighted)


class End(NamedTuple):
    """Where a trial step ends."""

    state: State  # in the mode and case of the step
    Q: Pair  # the drive's wave
    gain: Integrals  # of the step
    slope: tuple[State, Pair, Integrals] | None  # d/dt of all three; None where nothing is differentiated


def rk_step(known: Stages, place: Place, held: State, model: Model, method: Choices) -> End:
    """One explicit Runge-Kutta step in a fixed mode."""
    b = method.rk.b
    (_, gain), slopes = rk_stages(known, len(b), place, held, model, method)
    now = _combined(held, place.h, b, slopes, model)
    Q, slope = _waves(place, {1.0}, model)[1.0], None
    if method.derivative:
        rates, of_integrals = rhs_once(Q, now, model, method.ledger)
        slope = _rates(now, rates), _wave_rates(place, model), of_integrals
    return End(now, Q, jax.tree.map(lambda a: place.h * a, gain), slope)


def _wave_rates(place: Place, model: Model) -> Pair:
    """d/dt of the drive's wave at the end of the step."""
    ahead = _waves(place._replace(turns=place.turns + 0.25), {1.0}, model)[1.0]
    omega = 2 * math.pi * place.dturns / jnp.where(place.h > 0, place.h, 1.0)
    return omega * ahead[0], omega * ahead[1]


def _waves(place: Place, nodes: set[float], model: Model) -> dict[float, Pair]:
    """The drive at some of the tableau's nodes, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(place.turns)
    waves = {}
    for c, (s, v) in _angles(place.dturns, nodes).items():
        now = (s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s) if c else (s_0, c_0)
        waves[c] = wave(*now, model.drive)
    return waves


def _angles(dturns: Scalar, nodes: set[float]) -> dict[float, Pair]:
    """Sine and versine of what the drive's phase gains up to the nodes, by that of half the angle where it is known."""
    known: dict[float, Pair] = {}
    for c in sorted(nodes):
        if c / 2 in known and c:
            s, v = known[c / 2]
            known[c] = 2 * (s - s * v), 2 * s * s
        else:
            known[c] = sine_versine(2 * math.pi * c * dturns)
    return known


def _combined(held: State, h: Scalar, weights, slopes: Any, model: Model) -> State:
    """The held state + h sum(weights * slopes), number by number."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return held
    weights, slopes = zip(*used, strict=True)
    add = lambda z, *k: z + h * sum(w * k for w, k in zip(weights, k, strict=True))  # noqa: E731
    motion = jax.tree.map(add, held.motion, *(k.motion for k in slopes))
    u_s = jax.tree.map(add, held.u_s, *(k.u_s for k in slopes)) if model.spring.flows else held.u_s
    return State(motion, u_s, held.mode, held.case)
