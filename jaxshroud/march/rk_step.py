"""One explicit Runge-Kutta step in a fixed mode."""

import math
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.march.carry import Lane, PerLane, TimeGrid
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import Pair, Scalar, plus, sincos_turns, sine_versine, times, where
from jaxshroud.model.blade import rate_of_motion
from jaxshroud.model.drive import Waves, drive_wave_rates, drive_waves
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Integrals, StateDerivative, rhs_once


class TrialInterval(NamedTuple):
    """The time interval of a trial step."""

    turns: PerLane  # drive phase at its start [turns]
    dturns: PerLane  # advance of the drive phase [turns]
    h: PerLane  # its length [s]


def interval_in_step(step: Int[Array, "..."], done: PerLane, length: PerLane, grid: TimeGrid) -> TrialInterval:
    """The time interval of so much of a `step` after the part that is `done`."""
    at = step.astype(done.dtype) + done
    return TrialInterval(grid.start + at * grid.turn, length * grid.turn, length * grid.h)


def trial_interval(lane: Lane, grid: TimeGrid) -> TrialInterval:
    """The time interval of the next trial step of a lane, or of a row."""
    return interval_in_step(lane.step, lane.search.done, lane.search.length, grid)


class Stages(NamedTuple):
    """The results of the stages of a Runge-Kutta step so far."""

    slopes: tuple[StateDerivative, ...]
    gain: Integrals | None  # sum of the integrals' rates times the weights b


NO_STAGES = Stages((), None)


def rk_stages(partial: Stages, stage_count: int, interval: TrialInterval, start: State, model: Model, method: Choices):
    """The first `stage_count` stages, and the slopes dz/dt in all of them; the mode stays fixed."""
    tableau, (stage_slopes, gain) = method.rk, partial
    slopes: list[State] = []
    waves = _drive_waves(interval, set(tableau.c[len(stage_slopes) : stage_count]), model)
    for i in range(stage_count):
        stage = stage_state(start, interval.h, tableau.a[i][: len(slopes)], slopes, model.law.flows)
        if i == len(stage_slopes):
            slope, rates = rhs_once(waves[tableau.c[i]], stage, model, method.recorded)
            stage_slopes = (*stage_slopes, slope)
            gain = weighted_sum(gain, tableau.b[i], rates)
        slopes.append(_rates(stage, stage_slopes[i]))
    return Stages(stage_slopes, gain), slopes


def _rates(stage: State, slope: StateDerivative) -> State:
    """The time derivative of a state."""
    return State(rate_of_motion(stage.motion, slope.acceleration), slope.u_s, None, None)


def weighted_sum(total: Integrals | None, weight: float, rates: Integrals) -> Integrals | None:
    """The sum of the integrals' rates times weights so far, with one more; None without any."""
    weighted = jax.tree.map(lambda a: weight * a, rates) if weight else None
    return weighted if total is None else total if weighted is None else jax.tree.map(jnp.add, total, weighted)


class StepEnd(NamedTuple):
    """The end of a trial step."""

    state: State  # in the mode and case of the step
    Q: Waves  # of the drive
    gain: Integrals  # of the step
    slope: tuple[State, Waves, Integrals] | None  # d/dt of all three; None without derivatives

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent."""
        return self.state, self.Q, self.gain


def rk_step(partial: Stages, interval: TrialInterval, start: State, model: Model, method: Choices) -> StepEnd:
    """One explicit Runge-Kutta step in a fixed mode."""
    b = method.rk.b
    (_, gain), slopes = rk_stages(partial, len(b), interval, start, model, method)
    stage = stage_state(start, interval.h, b, slopes, model.law.flows)
    Q, slope = _drive_waves(interval, {1.0}, model)[1.0], None
    if method.derivative:
        rates, of_integrals = rhs_once(Q, stage, model, method.recorded)
        slope = _rates(stage, rates), _wave_rates(interval, model), of_integrals
    return StepEnd(stage, Q, jax.tree.map(lambda a: interval.h * a, gain), slope)


def _wave_rates(interval: TrialInterval, model: Model) -> Waves:
    """The time derivative of the drive's waves at the end of the step."""
    quarter_later = waves_at_nodes(interval._replace(turns=interval.turns + 0.25), {1.0})[1.0]
    per_radian = drive_wave_rates(*quarter_later, model.drive)
    omega = 2 * math.pi * interval.dturns / where(interval.h > 0, interval.h, 1.0)
    return jax.tree.map(lambda rate: omega * rate, per_radian)


def _drive_waves(interval: TrialInterval, nodes: set[float], model: Model) -> dict[float, Waves]:
    """The drive's waves at some nodes of the tableau."""
    return {c: drive_waves(*wave, model.drive) for c, wave in waves_at_nodes(interval, nodes).items()}


def waves_at_nodes(interval: TrialInterval, nodes: set[float]) -> dict[float, Pair]:
    """(sin, cos) of the drive's phase at some nodes of the tableau, by angle addition from the start of the step."""
    s_0, c_0 = sincos_turns(interval.turns)

    def advanced(s, v):
        return (s_0 - s_0 * v + c_0 * s, c_0 - c_0 * v - s_0 * s)

    return {c: advanced(*by) if c else (s_0, c_0) for c, by in _node_angles(interval.dturns, nodes).items()}


def _node_angles(dturns: Scalar, nodes: set[float]) -> dict[float, Pair]:
    """The sine and versine of the drive's phase advance up to the nodes, by double angles where possible."""
    angles: dict[float, Pair] = {}
    for c in sorted(nodes):
        if c / 2 in angles and c:
            s, v = angles[c / 2]
            angles[c] = 2 * (s - s * v), 2 * s * s
        else:
            angles[c] = sine_versine(2 * math.pi * c * dturns)
    return angles


def stage_state(start: State, h: Scalar, weights, slopes: Any, flows: bool) -> State:
    """The start + h sum(weights * slopes), number by number."""
    used = [(w, k) for w, k in zip(weights, slopes, strict=True) if w]
    if not used:
        return start
    weights, slopes = zip(*used, strict=True)

    def add(z, *k):
        return plus(z, times(h, reduce(plus, map(times, weights, k), 0)))

    motion = jax.tree.map(add, start.motion, *(k.motion for k in slopes))
    u_s = jax.tree.map(add, start.u_s, *(k.u_s for k in slopes)) if flows else start.u_s
    return State(motion, u_s, start.mode, start.case)
