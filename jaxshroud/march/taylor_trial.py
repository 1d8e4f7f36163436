"""One trial of the march by power series: as far as the series are accurate, or to the first event.

The motion of the lane is expanded once. The last coefficients bound the length of the trial, and the series give the
guard that rises first and the motion there: no trial is repeated to locate an event.
"""

from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.accumulator import EnergyJumps, displacements_of
from jaxshroud.march.carry import (
    NEGLIGIBLE_REST,
    EachLane,
    Fixed,
    Lane,
    LaneTree,
    event_change,
    is_finite,
    most_events,
    running,
    status_of,
    turned_too_far,
    updated_lanes,
    updated_margins,
)
from jaxshroud.march.event import any_of, case_switches
from jaxshroud.march.events import EVENTS, LIFT, happens, number_of
from jaxshroud.march.extremes import ContactSeries, MotionSeries, deepest_penetration
from jaxshroud.march.locate import at_event, select
from jaxshroud.march.log import AcceptedTrial, found_by_series, takers_of_events, updated_accumulator, value_in
from jaxshroud.march.method import Choices
from jaxshroud.march.observable import Ending
from jaxshroud.march.row_trial import new_accumulator, no_time
from jaxshroud.march.taylor_events import (
    TaylorSearch,
    TrialEvent,
    first_event,
    return_length,
    select_polynomial,
    trimmed,
)
from jaxshroud.march.taylor_expansion import (
    RADIANS_PER_TURN,
    TaylorExpansion,
    integrated_loads,
    integrated_means,
    integrated_moments,
    integrated_squares,
    integrated_works,
    taylor_expansion,
    without_derivatives,
)
from jaxshroud.model.arithmetic import ZERO, Scalar, filled, is_zero, of_blade, sincos_turns, where, zeros_for
from jaxshroud.model.contact_law import linear_law
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, touches_at_corners
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import (
    RowModel,
    alone,
    along_blades,
    at_interface,
    at_only_interface,
    row_rhs,
    state_of_row,
)
from jaxshroud.model.series import polynomial_value_and_rate
from jaxshroud.scene.keys import Motion

MAX_TRIAL_ANGLE = 0.5  # [rad] of a trial, so that guards are evaluated often enough
NEGLIGIBLE_SPEED = 1e-30  # a speed that does not matter [m/rad]


class TaylorTrial(NamedTuple):
    """A trial by power series."""

    motion: Motion
    gain: Integrals
    length: Scalar  # in steps
    kind: Int[Array, ""]  # of the event, or of the guard that ended the trial
    event: TrialEvent  # its `end` in radians
    deepest: Scalar | None  # largest penetration [m]; None with derivatives
    by_series: dict[str, Any] | None  # what each observable reads off the polynomials; None with derivatives

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent."""
        return self.motion, self.gain, self.length


DisplacementSeries = tuple[Any, Any, Any]  # coefficients of x, y and theta, of both blades


def begin_series(state: State, model: RowModel, method: Choices, each: EachLane) -> Lane:
    """`Stepper.begin`. The first trial rechecks the guards."""
    zero = no_time(state)
    count = jnp.zeros(zero.shape, jnp.int32)
    yes = jnp.ones(zero.shape, bool)
    waves = zero, zero
    nothing = zeros_for(lambda: row_rhs(waves, state, None, model, method.recorded, each)[1])
    search = TaylorSearch(
        done=zero,
        cap=zero,
        recheck=yes,
        crossed=count - 1,
        probing=~yes,
        events=count,
        tries=count,
        tolerance=zero + method.taylor.tolerance,
    )
    return Lane(state, count, search, None, new_accumulator(nothing, state, model, method, each), count)


def taylor_trials(lanes: LaneTree, fixed: LaneTree, method: Choices, each: EachLane) -> LaneTree:
    """`Stepper.trial`: the trials in one kernel, and what follows from them in another."""
    trials = each(lambda lane, fixed: trial_and_series(lane, fixed, method)[0], lanes, fixed)
    return update_after_taylor(lanes, trials, fixed, method, each)


def _of_pair(lane: Lane, fixed: Fixed[RowModel]) -> tuple[Lane, Fixed[Model]]:
    """A lane and its constants as those of a pair, without the accumulator."""
    motion, model = lane.state.motion, fixed.model.pair
    motion = Motion._make((ZERO, ZERO) if is_zero(a) else tuple(a) for a in motion)
    u_s, mode, case = at_only_interface((lane.state.u_s, lane.state.mode, lane.state.case))
    state = State(motion, u_s, mode, case)
    return eqx.tree_at(lambda lane: lane.state, lane, state), Fixed(model, fixed.grid, fixed.stop)


def update_after_taylor(
    lanes: LaneTree, trials: LaneTree, fixed: LaneTree, method: Choices, each: EachLane
) -> LaneTree:
    """The lanes after their trials."""

    def update(lane, trial, fixed):
        return lane_after_trial(lane, trial, fixed, method)

    return updated_lanes(update, method, each, lanes, trials, fixed)


def trial_and_series(row: Lane, constants: Fixed[RowModel], method: Choices) -> tuple[TaylorTrial, DisplacementSeries]:
    """The next trial of a lane, and its displacements as polynomials in radians from the start."""
    order = method.taylor.order
    lane, fixed = _of_pair(row, constants)
    expansion = taylor_expansion(lane, fixed, order, method.ledger)
    step = RADIANS_PER_TURN * fixed.grid.turn
    if method.derivative:
        event, kind = _trial_event(without_derivatives(expansion), *lax.stop_gradient((lane, fixed)), order)
    else:
        event, kind = _trial_event(expansion, lane, fixed, order)
    s = where(event.reject, 0.0, event.end)
    if method.derivative:
        s = _differentiable_end(expansion, order, event, s, _remaining_angle(lane, fixed))
    displacements = jax.tree.map(lambda a: a.coefficients(order), displacements_of(expansion.motion))
    deepest, by_series = (None, None)
    if not method.derivative:
        deepest, by_series = _found_in_trial(expansion, s, lane, event, kind, fixed, method)

    def loads():
        return integrated_loads(expansion, order, s, lane.state, linear_law(fixed.model.law))

    gain = Integrals(
        power=along_blades(integrated_squares(expansion, order, s, fixed.model)),
        ledger=integrated_works(expansion, order, s),
        moments=along_blades(integrated_moments(expansion, order, s)) if method.amplitudes else None,
        loads=at_interface(loads()) if method.forces else None,
        means=at_interface(integrated_means(expansion, order, s)) if method.vibration else None,
    )
    trial = TaylorTrial(
        motion=motion_after(displacements, expansion.unit, s),
        gain=gain,
        length=s / step,
        kind=kind,
        event=event,
        deepest=deepest,
        by_series=by_series,
    )
    return trial, displacements


def _trial_event(
    expansion: TaylorExpansion, lane: Lane, fixed: Fixed[Model], order: int
) -> tuple[TrialEvent, Int[Array, ""]]:
    """The event that ends the trial, and its kind."""
    search, grid = lane.search, fixed.grid
    h = jnp.minimum(
        _accurate_length(expansion, order, search.tolerance, fixed), jnp.maximum(_remaining_angle(lane, fixed), 0.0)
    )
    rocking = [g.coefficients(2) for kind, g in expansion.guards if EVENTS[kind].switches_case]
    shortest = grid.flat * RADIANS_PER_TURN * grid.turn  # what returns sooner counts as flat contact
    resolved = jnp.maximum(return_length(rocking, h), shortest)
    h = jnp.minimum(h, resolved)
    h = where(search.tries > 0, jnp.minimum(h, search.cap), h)
    return _first_event_of_kind(expansion, order, h, search)


def _remaining_angle(lane: Lane, fixed: Fixed[Model]) -> Scalar:
    """The angle until the march stops [rad]."""
    turn = fixed.grid.turn
    return ((fixed.stop - lane.step).astype(turn.dtype) - lane.search.done) * (RADIANS_PER_TURN * turn)


def _differentiable_end(expansion: TaylorExpansion, order: int, event: TrialEvent, s: Scalar, rest: Scalar) -> Scalar:
    """The end of a trial with its derivative: that of the guard's root or of the remaining angle, else none."""
    guard = select_polynomial(trimmed([g.coefficients(order) for _, g in expansion.guards], s), event.which)
    size, rate = polynomial_value_and_rate(guard, s)
    rate = where(event.fire & (s > 0) & (rate > 0), lax.stop_gradient(rate), jnp.inf)
    root = at_event(s, jnp.ones_like(s), size, rate)
    return where(event.fire | event.probe | (s < rest), root, rest)


def _found_in_trial(
    expansion: TaylorExpansion,
    s: Scalar,
    lane: Lane,
    event: TrialEvent,
    kind: Int[Array, ""],
    fixed: Fixed[Model],
    method: Choices,
) -> tuple[Scalar, dict[str, Any]]:
    """The largest penetration within `s` radians, and what each observable reads off the polynomials."""
    order = method.taylor.order
    start = lane.state
    (motion, v, u, *_) = expansion
    onset = (start.mode == Mode.APART) & event.fire & happens(kind, LIFT)
    contact = ContactSeries(v, u, expansion.unit, order, s, start, onset, linear_law(fixed.model.law))
    blades = [MotionSeries(own, order, s) for own in (of_blade(i, motion)[0] for i in (0, 1))]
    return deepest_penetration(contact), found_by_series(contact, blades, method)


def _accurate_length(expansion: TaylorExpansion, order: int, tolerance: Scalar, fixed: Fixed[Model]) -> Scalar:
    """The length at which the last terms of the speeds are `tolerance` times the largest speed [rad]."""

    def largest(n):
        return reduce(jnp.maximum, (jnp.abs(c) for c in _displacement_coefficients(expansion, n, fixed)))

    speed = reduce(jnp.maximum, map(largest, (1, 2, 3)))
    allowed = tolerance * speed + NEGLIGIBLE_SPEED
    lengths = [_power(allowed / (n * largest(n) + NEGLIGIBLE_SPEED), 1 / (n - 1)) for n in (order - 1, order)]
    return jnp.minimum(jnp.minimum(*lengths), MAX_TRIAL_ANGLE)


def _displacement_coefficients(expansion: TaylorExpansion, n: int, fixed: Fixed[Model]) -> list[Scalar]:
    """The coefficients `n` of the displacements [m]; theta counts as the displacement of a corner."""
    x, y, theta = displacements_of(expansion.motion)
    lever = fixed.model.block.a_x
    return [a[n] for a in (*x, *y) if not is_zero(a)] + [lever * a[n] for a in theta if not is_zero(a)]


def _power(x: Scalar, exponent: float) -> Scalar:
    """The power `x ** exponent` of a positive number to a few percent, from the bits of its fourth root in float32."""
    bits = lax.bitcast_convert_type(jnp.sqrt(jnp.sqrt(x)).astype(jnp.float32), jnp.int32)
    log = bits.astype(jnp.float32) * (1 / 2**23) - 127.0
    power = ((log * (4 * exponent) + (127.0 - 0.043)) * 2**23).astype(jnp.int32)
    return lax.bitcast_convert_type(power, jnp.float32).astype(x.dtype)


def _first_event_of_kind(
    expansion: TaylorExpansion, order: int, h: Scalar, search: TaylorSearch
) -> tuple[TrialEvent, Int[Array, ""]]:
    """The first event within `h` radians, and its kind."""
    kinds = [k for k, _ in expansion.guards]
    at_start = [(g[0] > 0) & search.recheck & (search.crossed != k) for k, g in expansion.guards]
    event = first_event([g.coefficients(order) for _, g in expansion.guards], h, search.probing, search.tries)
    immediately = any_of(at_start)
    which = event.which
    for i in reversed(range(len(kinds))):
        which = where(at_start[i], jnp.int32(i), which)
    immediate = TrialEvent(jnp.zeros_like(h), which, immediately, ~immediately, ~immediately, ~immediately)
    event = select(immediately, immediate, event._replace(which=which))
    kind = jnp.int32(kinds[-1])
    for i, k in enumerate(kinds[:-1]):
        kind = where(which == i, jnp.int32(k), kind)
    return event, kind


def motion_in_trial(
    displacements: DisplacementSeries, period: Scalar, steps_per_period: Scalar, steps: Scalar
) -> Motion:
    """The motion so many `steps` after the start of a trial, by its series."""
    return motion_after(displacements, period / RADIANS_PER_TURN, steps * (RADIANS_PER_TURN / steps_per_period))


def motion_after(displacements: DisplacementSeries, unit: Scalar, s: Scalar) -> Motion:
    """The motion after `s` radians of `unit` seconds each."""
    ends = [[a if is_zero(a) else polynomial_value_and_rate(a, s) for a in pair] for pair in displacements]
    x, y, theta = (tuple(a if is_zero(a) else a[0] for a in pair) for pair in ends)
    v_x, v_y, v_theta = (tuple(a if is_zero(a) else a[1] / unit for a in pair) for pair in ends)
    return Motion(x=x, y=y, theta=theta, v_x=v_x, v_y=v_y, v_theta=v_theta)


def lane_after_trial(lane: Lane, trial: TaylorTrial, fixed: Fixed[RowModel], method: Choices) -> Lane:
    """The lane after its `trial`; unchanged if it has arrived or failed."""
    row, event, search = fixed.model, trial.event, lane.search
    own, fixed_pair = _of_pair(lane, fixed)
    model, grid, start = fixed_pair.model, fixed.grid, own.state
    assert isinstance(search, TaylorSearch)
    active = running(lane, fixed.stop)
    z = trial.motion
    apart = start.mode == Mode.APART
    # when apart, a change of the case has no effect
    fire = event.fire & ~(apart & (trial.kind != number_of(LIFT))) & active
    next_search, step = _next_taylor_search(lane, trial, fire)
    done = step.astype(grid.turn.dtype) + next_search.done
    Q = drive_waves(*sincos_turns(grid.start + done * grid.turn), model.drive)
    h = trial.length * grid.h
    change = event_change(z, Q, start, fire, trial.kind, h, fixed_pair)
    transition = change.transition
    ending = Ending(transition, fire, event.inside)
    log = lane.accumulator.log
    counted = {} if log is None else {one: value_in(log, one.name) for one in takers_of_events(method)}
    accepted = AcceptedTrial(
        start=lane.state,
        mode=lane.state.mode,
        h=h,
        end=along_blades(z),
        after=along_blades(z),
        v=at_interface(trial.deepest),
        lift=at_interface(change.lift),
        gain=trial.gain,
        jumps=EnergyJumps(at_interface(change.jumps.springs), filled(change.jumps.dropped, h)),
        step=lane.step,
        next_step=step,
        events={one.name: at_interface(one.update(at_only_interface(a), ending)) for one, a in counted.items()},
        by_series=trial.by_series,
    )
    accumulator = updated_accumulator(lane.accumulator, accepted, row, method, alone)
    margins = updated_margins(at_only_interface(accumulator.margins), change, fire, model)
    accumulator = accumulator._replace(margins=at_interface(margins))
    lost = ~is_finite(z)
    tries = jnp.maximum(next_search.events, next_search.tries)
    too_many = tries > most_events(grid, touches_at_corners(model))
    status = status_of(turned_too_far(z, lost), lost, too_many)
    state = select(fire, transition.after, State(z, start.u_s, start.mode, start.case))
    # contact may begin flat although one end of the overlap already pulls
    next_search = next_search._replace(recheck=next_search.recheck | (fire & (transition.after.case == FLAT)))
    return select(active, Lane(state_of_row(state), step, next_search, None, accumulator, status), lane)


def _next_taylor_search(lane: Lane, trial: TaylorTrial, fire: Bool[Array, ""]) -> tuple[TaylorSearch, Int[Array, ""]]:
    """The search of the next trial, and the clock."""
    search, event = lane.search, trial.event
    done = search.done + trial.length
    negligible = NEGLIGIBLE_REST[done.dtype.itemsize]
    completed = jnp.floor(done + negligible)
    done = jnp.maximum(done - completed, 0.0)
    completed = completed.astype(jnp.int32)
    done = where(done < negligible, 0.0, done)
    events = where(completed > 0, 0, search.events) + event.fire.astype(jnp.int32)
    moved = (trial.length > 0) | fire
    next_search = TaylorSearch(
        done=done,
        cap=event.end,
        recheck=fire & any_of(case_switches(trial.kind, EVENTS)),
        crossed=trial.kind,
        probing=event.probe,
        events=events,
        tries=where(moved, 0, search.tries + 1),
        tolerance=search.tolerance,
    )
    return next_search, lane.step + completed
