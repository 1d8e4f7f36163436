"""Rows of blades inside JAX's transformations: samples and whole periods, whose derivatives raise a TypeError."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.blocks import period_function
from jaxshroud.batch.differentiable_samples import Schedule, batching_by_lanes, skip_samples
from jaxshroud.batch.input_status import Admitted
from jaxshroud.batch.periods import Clock
from jaxshroud.batch.pure_march import LaneOutcomes, Moment, PureMarch, SampledMoments, SweepPlan, sample_times
from jaxshroud.batch.row_samples import RowSamples, next_row_sample
from jaxshroud.batch.rows import ROW_KERNELS, lanes_first, row_models, rows_at_start
from jaxshroud.batch.xla import best_mapping, compiled, one_lane
from jaxshroud.march.derivative_limits import values_only
from jaxshroud.march.method import Choices
from jaxshroud.march.row_log import tally_of_new_period
from jaxshroud.march.tally import EventMargins
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.capabilities import require_capability
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


class RowFlow(NamedTuple):
    """Samples (leading axis) of a row; NaN once it has stopped."""

    at: RowSamples
    power: Float[Array, "..."]  # mean square displacement of each block since the previous sample, (samples, N) [m^2]
    status: Int[Array, "..."]  # (samples,)
    margins: EventMargins  # so far, at all interfaces


def _row_flow(scene: Scene, state: State, schedule: Schedule) -> RowFlow:
    """The samples of one row by a `schedule` without a bound of trials; a TypeError where it is differentiated."""
    flows = _sampled_rows(*one_lane(values_only((scene, state))), schedule)
    return jax.tree.map(lambda a: a[0], flows)


@compiled("schedule")
def _sampled_rows(scenes: Scene, states: State, schedule: Schedule) -> RowFlow:
    return batching_by_lanes(lambda scenes, states: _row_samples_in_lanes(scenes, states, schedule))(scenes, states)


def _row_samples_in_lanes(scenes: Scene, states: State, schedule: Schedule) -> RowFlow:
    """The samples of rows (leading axis): a `RowFlow` with axes (lane, sample)."""
    (model, period), each, steps = row_models(scenes), best_mapping(), schedule.steps
    clock = Clock.from_phase_0(steps)
    begin = rows_at_start(states, model, schedule.method, each)
    time = period * (schedule.every / steps)

    def one(lanes, _):
        empty = tally_of_new_period(lanes.tally, model.blades.shroud(lanes.state.motion), schedule.method)
        lanes = eqx.tree_at(lambda lane: lane.tally, lanes, empty)
        lanes, sample = next_row_sample(lanes, jnp.int32(schedule.every), model, period, clock, schedule.method, each)
        gain: Any = lanes.tally.integrals.power
        power = gain / time[None]
        overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(jnp.sum(power, axis=0))
        status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
        lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
        return lanes, lanes_first(
            RowFlow(sample, jnp.where(status == Status.OK, power, jnp.nan), status, _of_all(lanes.tally.margins))
        )

    _, flows = lax.scan(one, begin, length=schedule.samples)
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), flows)


def _of_all(margins: EventMargins | None) -> EventMargins:
    """The margins of rows, lanes last, from those of their interfaces."""
    assert margins is not None
    least = lambda speeds: jnp.min(speeds, axis=0)
    return EventMargins(jnp.sum(margins.events, axis=0), least(margins.slowest_onset), least(margins.slowest_switch))


class RowStrobe(NamedTuple):
    """Rows (leading axis) over whole periods; NaN where a row has stopped."""

    motion: Motion  # at the end of each kept period, (lanes, periods, N)
    power: Float[Array, "..."]  # mean square displacement of each block over these, (lanes, N) [m^2]
    means: Any  # `Means` of each block over these, fields (lanes, N); None unless the method has `vibration`
    status: Int[Array, "..."]  # (lanes,)


def row_strobe(scenes: Scene, states: State, transient: int, kept: int, steps: int, method: Choices) -> RowStrobe:
    """Rows (leading axis) run for `transient` and `kept` periods; a TypeError where it is differentiated."""

    def run(scenes: Scene, states: State) -> RowStrobe:
        each = best_mapping()
        period = period_function(scenes, Clock.from_phase_0(steps), method, each, ROW_KERNELS)

        def one(lanes: Any, _: Any) -> Any:
            lanes, sample = period(lanes, True)
            return lanes, lanes_first((sample.motion, sample.power, sample.means))

        begin = rows_at_start(states, row_models(scenes)[0], method, each)
        last, (motion, power, means) = lax.scan(skip_samples(one, transient), begin, jnp.arange(kept))
        motion = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), motion)
        power, means = jax.tree.map(lambda a: jnp.mean(a, axis=0), (power, means))
        return RowStrobe(motion, power, means, last.status)

    return batching_by_lanes(run)(*values_only((scenes, states)))


def _check_row_start(scene: Scene, state: State) -> None:
    """Raise InputError if the state is not one of such a row."""
    sizes = scene.layout.blades, scene.layout.interfaces
    if (jnp.shape(state.motion.x), jnp.shape(state.u_s)) != ((sizes[0],), (sizes[1],)):
        raise InputError("Argument `state` must have the motion of {} blades and contact at {}.".format(*sizes))


def _moments_of_row(begin: Admitted, schedule: Schedule) -> SampledMoments:
    """The samples of a row, whose derivatives raise a TypeError."""
    if schedule.most_trials is not None:
        require_capability("Argument `most_trials`", begin.scene.layout)
    _check_row_start(begin.scene, begin.start)
    schedule = schedule._replace(method=schedule.method._replace(margins=True))
    flow = _row_flow(begin.scene, begin.start, schedule)
    f = flow.at.forces
    moments = Moment(sample_times(begin, schedule)[0], flow.at.state, f.N, f.F, f.v, f.u)
    return SampledMoments(moments, flow.power, flow.status, flow.margins)


def _chunk_of_rows(rows: Scene, states: State, plan: SweepPlan) -> LaneOutcomes:
    """The results of a chunk of rows, by the kernels of the verb `sweep`."""
    strobe = row_strobe(rows, states, *plan)
    told = strobe.motion, strobe.power, strobe.means
    motion, power, means = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), told)
    return LaneOutcomes(motion, power, means, strobe.status)


PURE_ROWS = PureMarch(
    moments=_moments_of_row,
    outcomes=_chunk_of_rows,
    within_bounds=lambda _, scenes: scenes,
    counted=lambda a: a.sum(axis=-1),
    told=lambda P_0: P_0,
)
