"""The built-in observables: all that is logged along a march beside the integrals, in the order of a `Log`."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxshroud.march.accumulator import (
    ContactPeaks,
    ContactTimes,
    DisplacementRange,
    Impacts,
    Log,
    StepExtrema,
    count_event,
    half_position,
    no_events,
    watched_of,
)
from jaxshroud.march.carry import PerLane
from jaxshroud.march.event import Event
from jaxshroud.march.events import BUILT_IN_EVENTS
from jaxshroud.march.extremes import (
    closing_speed,
    final_closing_speed,
    merged_extrema,
    merged_peaks,
    merged_range,
    midpoint_magnitudes,
    taylor_extrema,
    taylor_peaks,
    taylor_range,
    trial_extrema,
    trial_peaks,
    trial_range,
)
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Beginning, BladeTrial, Ending, InterfaceTrial, Observable, from_zero, lasting
from jaxshroud.model.arithmetic import Scalar, where
from jaxshroud.model.modes import Mode
from jaxshroud.model.rhs import Means, position_of
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion


def _updated_times(before: ContactTimes, trial: InterfaceTrial) -> ContactTimes:
    apart = trial.apart
    stick = trial.mode == Mode.STICK
    return ContactTimes(
        before.apart + where(apart, trial.h, 0.0),
        before.stick + where(stick, trial.h, 0.0),
        before.slip + where(apart | stick, 0.0, trial.h),
    )


TIMES = Observable(
    name="times",
    label="time in each contact state",
    unit="s",
    per="interface",
    start=lambda at: ContactTimes(at.zero, at.zero, at.zero),
    update=_updated_times,
    reset=from_zero,
    takes="all",
)


def _deepest(at: Beginning) -> PerLane:
    return jnp.maximum(at.v, 0.0)


V_MAX = Observable(
    name="v_max",
    label="largest penetration at the start, at the end of a trial or at an event",
    unit="m",
    per="interface",
    start=_deepest,
    update=lambda before, trial: jnp.maximum(before, where(trial.apart, 0.0, trial.v)),
    reset=lasting,
    takes="all",
)


def _updated_sizes(before: tuple[Any, Any, Any], trial: BladeTrial) -> tuple[Any, Any, Any]:
    sizes = trial.after[:3]
    if trial.by_series is not None:
        sizes = jax.tree.map(lambda a, b: jnp.maximum(a, jnp.abs(b)), trial.by_series, sizes)
    return jax.tree.map(lambda most, now: jnp.maximum(most, jnp.abs(now)), before, sizes)


LARGEST_SIZES = Observable(
    name="largest",
    label="largest magnitudes of x, y and theta at ends of trials and at events",
    unit="m, rad",
    per="blade",
    start=lambda at: jax.tree.map(jnp.zeros_like, at.motion[:3]),
    update=_updated_sizes,
    reset=from_zero,
    of_series=midpoint_magnitudes,
    takes="all",
)


COUNTERS = Observable(
    name="counters",
    label="number of events of each sort",
    unit="1",
    per="interface",
    start=lambda at: no_events(at.model, jnp.zeros_like(at.zero, jnp.int32)),
    update=count_event,
    reset=lasting,
    takes="event",
)


def _merging(merge: Callable[[Any, Any], Any], of_trial: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """An update by what a trial shows: by its power series, or else `of_trial`."""

    def update(before: Any, trial: Any) -> Any:
        return merge(before, of_trial(trial) if trial.by_series is None else trial.by_series)

    return update


def _initial_extrema(at: Beginning) -> StepExtrema:
    return StepExtrema(_deepest(at), at.zero, at.zero + jnp.inf, at.zero + jnp.inf)


WITHIN = Observable(
    name="within",
    label="extremes of the penetration and of its rate inside trials",
    unit="m, m/s",
    per="interface",
    start=_initial_extrema,
    update=_merging(merged_extrema, trial_extrema),
    reset=lasting,
    of_series=taylor_extrema,
    recorded=lambda method: method.within,
)


FORCES = Observable(
    name="forces",
    label="largest normal and friction force inside trials",
    unit="N",
    per="interface",
    start=lambda at: ContactPeaks(at.zero, at.zero),
    update=_merging(merged_peaks, trial_peaks),
    reset=from_zero,
    of_series=taylor_peaks,
    recorded=lambda method: method.forces,
)


def _updated_impacts(before: Impacts, trial: InterfaceTrial) -> Impacts:
    if not trial.model.law.has_events:
        return before  # without events contact neither begins nor ends at an instant
    loads, (_, impact, separation) = trial.loads, trial.lift
    assert loads is not None  # they are integrated with the forces
    speed = closing_speed(trial) if trial.by_series is None else trial.by_series
    now = before.now + loads.N
    return Impacts(
        before.number + where(impact, 1.0, 0.0),
        where(impact, jnp.maximum(before.approach, speed), before.approach),
        before.approach_sum + where(impact, speed, 0.0),
        before.ended + where(separation, 1.0, 0.0),
        before.impulse_sum + where(separation, now, 0.0),
        where(separation, jnp.maximum(before.impulse, now), before.impulse),
        where(separation, 0.0, now),
    )


IMPACTS = Observable(
    name="impacts",
    label="impacts, with their closing speeds and impulses",
    unit="1, m/s, N s",
    per="interface",
    start=lambda at: Impacts._make([at.zero] * 7),
    update=_updated_impacts,
    reset=lambda before, z: from_zero(before, z)._replace(now=before.now),  # the current contact goes on
    of_series=final_closing_speed,
    recorded=lambda method: method.forces,
)


def _range_at(z: Motion) -> DisplacementRange:
    return DisplacementRange(watched_of(z), watched_of(z))


EXTENT = Observable(
    name="extent",
    label="range of x, y and theta inside trials",
    unit="m, rad",
    per="blade",
    start=lambda at: _range_at(at.motion),
    update=_merging(merged_range, trial_range),
    reset=lambda _, z: _range_at(z),
    of_series=taylor_range,
    recorded=lambda method: method.amplitudes,
)


def _updated_positions(before: Means, trial: BladeTrial) -> Means:
    complete = trial.complete

    def add(total, a):
        return total + where(complete, a, 0.0)

    return jax.tree.map(add, before, position_of(trial.after))


POSITIONS = Observable(
    name="positions",
    label="position, summed over the ends of steps by the trapezoidal rule",
    unit="m, 1",
    per="left blade",
    start=lambda at: half_position(position_of(at.motion)),
    update=_updated_positions,
    reset=lambda _, z: half_position(position_of(z)),
    takes="all",
    recorded=lambda method: method.sums_positions,
)

BUILT_IN = (TIMES, V_MAX, LARGEST_SIZES, COUNTERS, WITHIN, FORCES, IMPACTS, EXTENT, POSITIONS)


def number_of_times(event: Event, kind: int) -> Observable:
    """How often an event of a user's own, of number `kind`, has happened."""

    def counted(before: Scalar, ending: Ending) -> Scalar:
        return before + where(ending.fire & (ending.transition.kind == kind), 1.0, 0.0)

    return Observable(
        name=event.name,
        label=event.label,
        unit="1",
        per="interface",
        start=lambda at: at.zero,
        update=counted,
        reset=lasting,
        takes="event",
    )


def observables_of(method: Choices) -> tuple[Observable, ...]:
    """The observables that are logged with a method, its own ones and the counts of its own events last.

    Raises:
        InputError: Two of them have one name.
    """
    taken = {*Log._fields}
    counts = [number_of_times(event, kind) for kind, event in enumerate(method.events, start=len(BUILT_IN_EVENTS))]
    for own in (*method.observables, *counts):
        if own.name in taken:
            raise InputError(f"There is another observable or event with the name {own.name!r}.")
        taken.add(own.name)
    return *(one for one in BUILT_IN if one.recorded(method)), *method.observables, *counts
