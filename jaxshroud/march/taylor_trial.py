"""One trial of the march by power series: as far as the series are accurate, or to the first event.

The motion of the lane is expanded once. The last coefficients bound the length of the trial, and the series give the
guard that rises first and the motion there: no trial is repeated to locate an event.
"""

import math
import operator
from collections.abc import Iterable
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import (
    NEGLIGIBLE_REST,
    EachLane,
    Fixed,
    Lane,
    LaneTree,
    TimeGrid,
    most_events,
    no_time,
    running,
)
from jaxshroud.march.event import any_of
from jaxshroud.march.events import HEIGHT, TURN, events_at_points, happens, number_of
from jaxshroud.march.locate import at_event, one_after_the_other, select
from jaxshroud.march.log import AcceptedTrial, new_accumulator
from jaxshroud.march.method import Choices
from jaxshroud.march.row_events import InterfaceEnding, change_of_row, is_finite_row, lane_after, row_torques
from jaxshroud.march.row_step import OfLanes, whole
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
    Coefficients,
    FaceSeries,
    TaylorExpansion,
    blades_of,
    faces_of,
    seconds_per_radian,
    taylor_expansion,
    wave_at,
    whole_row,
)
from jaxshroud.march.taylor_integrals import TrialSpan, motion_after, read_off, sliding_points
from jaxshroud.model.arithmetic import (
    ZERO,
    Scalar,
    any_along,
    at_place,
    greatest,
    is_unrolled,
    is_zero,
    least,
    place_of_largest,
    summed,
    where,
    zeros_for,
)
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Integrals
from jaxshroud.model.row import Each, RowModel, alone, over, row_rhs
from jaxshroud.model.row_program import of_row
from jaxshroud.model.series import coefficients, polynomial_value_and_rate

MAX_TRIAL_ANGLE = 0.5  # [rad] of a trial, so that guards are evaluated often enough
NEGLIGIBLE_SPEED = 1e-30  # a speed that does not matter [m/rad]
# Share of a trial within which events are at one instant, by the bytes of a number: symmetry makes them so, up to the
# rounding of their roots. In a tuned wheel that rounding is larger; it is allowed where no force jumps at an event, and
# without derivatives, which depend on the order of events.
SIMULTANEOUS = {8: 2.0**-44, 4: 2.0**-16}
SYMMETRIC = {8: 2.0**-36, 4: 2.0**-14}


class SeriesOutcome(NamedTuple):
    """Where a trial ends, and in what."""

    end: OfLanes  # [rad]; of a rejected one the bound of the next
    reject: Bool[Array, "..."]
    fires: Any  # of each interface: whether it ends in an event there, and so on for the next
    kind: Any  # of the event, or of the guard that ended the trial
    which: Any  # index of that guard
    probe: Any  # see `TrialEvent`
    inside: Any
    several: Any  # more than one guard was above zero at the start
    is_root: Any  # it ends where the guard that fires vanishes, rather than at a prescribed instant
    pending: Any  # see `TaylorSearch`


class TaylorTrial(NamedTuple):
    """A trial by power series."""

    motion: Any
    gain: Integrals
    length: OfLanes  # in steps
    outcome: SeriesOutcome
    deepest: Any  # largest penetration at each interface [m]; None with derivatives
    by_series: dict[str, Any] | None  # what each observable reads off the polynomials; None with derivatives

    @property
    def differentiable(self) -> tuple[Any, ...]:
        """The fields that may have a tangent."""
        return self.motion, self.gain, self.length


DisplacementSeries = tuple[Coefficients, ...]  # of each coordinate, along the blades


def begin_series(state: State, model: RowModel, method: Choices, each: EachLane) -> Lane:
    """`Stepper.begin`. The first trial rechecks the guards."""
    zero = no_time(state)
    count = jnp.zeros(zero.shape, jnp.int32)
    yes = jnp.ones(zero.shape, bool)
    waves = zero, zero
    nothing = zeros_for(lambda: row_rhs(waves, state, None, model, method.recorded, each)[1])
    at = jax.tree.map(jnp.zeros_like, state.case)
    search = TaylorSearch(
        done=zero,
        cap=zero,
        recheck=yes,
        crossed=at - 1,
        probing=at != 0,
        events=count,
        tries=count,
        tolerance=zero + method.taylor.tolerance,
        turns=at if model.turns_by_events and len(at) > 1 else None,
        pending=at != 0 if method.derivative and len(at) > 1 else None,
    )
    return Lane(state, count, search, None, new_accumulator(nothing, state, model, method, each), count)


def taylor_trials(lanes: LaneTree, fixed: LaneTree, method: Choices, each: EachLane) -> LaneTree:
    """`Stepper.trial`: the trials of pairs in one kernel, and what follows from them in another."""
    trials, _ = trials_and_series(lanes, fixed, method, each)
    return update_after_taylor(lanes, trials, fixed, method, each)


def trials_and_series(
    lanes: LaneTree, fixed: LaneTree, method: Choices, each: EachLane
) -> tuple[LaneTree, DisplacementSeries]:
    """The next trials of lanes, and their displacements as polynomials in radians from the start."""
    return whole(each, partial(_trial_and_series, method=method), lanes, fixed)


def update_after_taylor(
    lanes: LaneTree, trials: LaneTree, fixed: LaneTree, method: Choices, each: EachLane
) -> LaneTree:
    """The lanes after their trials; of pairs the sums and extremes of a long accumulator in a kernel of their own.

    A kernel with all of them would have more arguments than vector registers serve.
    """
    update = partial(_lane_after_trial, method=method)
    if not method.has_long_accumulator or not is_unrolled(lanes.state.case):
        return whole(each, update, lanes, trials, fixed)

    def sums(lane: Lane) -> tuple[Any, ...]:
        log: Any = lane.accumulator.log
        return lane.accumulator.integrals, log.impacts, log.extent

    def with_sums(lane: Lane, values: tuple[Any, ...]) -> Lane:
        return eqx.tree_at(sums, lane, values, is_leaf=lambda a: a is None)

    update = partial(update, each=alone)
    trees = lanes, trials, fixed
    others = each(lambda *trees: with_sums(update(*trees), (None,) * 3), *trees)
    return with_sums(others, each(lambda *trees: sums(update(*trees)), *trees))


def _trial_and_series(
    lane: Lane, fixed: Fixed[RowModel], method: Choices, each: Each
) -> tuple[TaylorTrial, DisplacementSeries]:
    order = method.taylor.order
    expansion = taylor_expansion(lane, fixed, order, each)
    step = RADIANS_PER_TURN * fixed.grid.turn
    seen = (expansion, lane, fixed)
    outcome = trial_outcome(*(lax.stop_gradient(seen) if method.derivative else seen), order, each)
    s = where(outcome.reject, 0.0, outcome.end)
    if method.derivative:
        s = _differentiable_end(expansion.faces, lane, fixed, outcome, s, each)
    state, model = lane.state, fixed.model
    contact = _contact_of(state)
    events = outcome.fires, outcome.kind

    def read(span, of_blades, of_faces):
        (own, blades), (faces, contact, events, constants) = of_blades, of_faces
        return read_off(span, own, faces, contact, events, whole_row(blades, constants), method)

    wave = wave_at(lane.step, lane.search.done, fixed.grid, each)
    span = TrialSpan(s, seconds_per_radian(fixed), wave)
    of_faces = expansion.faces, contact, events, faces_of(model)
    reading = of_row(each, read, span, (expansion.blades, blades_of(model)), of_faces)
    trial = TaylorTrial(
        motion=reading.motion,
        gain=reading.gain,
        length=s / step,
        outcome=outcome,
        deepest=reading.deepest,
        by_series=reading.by_series,
    )
    return trial, expansion.blades.own


def _contact_of(state: State) -> State:
    """The contact alone, whose parts are all numbers of interfaces."""
    return State(None, state.u_s, state.mode, state.case)


def trial_outcome(
    expansion: TaylorExpansion, lane: Lane, fixed: Fixed[RowModel], order: int, each: Each
) -> SeriesOutcome:
    """Where the next trial ends, and in what: at the first event over all interfaces, if there is one.

    No guard of any interface rises unseen before that place, as none does before the first event of its own interface.
    """
    search, faces = lane.search, expansion.faces
    contact = _contact_of(lane.state)
    model = fixed.model.interfaces
    terms = _largest_terms(expansion, fixed, order, each)
    stiffest = greatest(over(each, _square_by_contact, contact.mode, faces_of(fixed.model)))
    returns = _shortest_return(faces, each)
    times = lane.step, fixed.stop, fixed.grid
    length_of = partial(_trial_length, order=order, neighbours=min(len(lane.state.case), 2))
    h = each(length_of, terms, stiffest, returns, search.done, search.tolerance, search.tries, search.cap, *times)
    before = search.crossed, search.probing, search.recheck, search.tries
    event, kind, several = over(each, _first_event_of_face, faces, contact, before, h, model)
    first = least(event.end)
    pending = search.pending
    together = SIMULTANEOUS if pending is not None or fixed.model.turns_by_events else SYMMETRIC
    here = event.end <= first + together[h.dtype.itemsize] * h
    reject = any_along(event.reject) & ~any_along(event.fire & (event.end == 0))  # nothing comes before the start
    end = greatest(where(here, event.end, 0.0))
    fires = here & event.fire & ~reject
    at_root = end > 0
    if pending is not None:
        fires, at_root, pending = one_after_the_other(fires, place_of_largest(fires), pending, at_root)
    return SeriesOutcome(
        end=end,
        reject=reject,
        fires=fires,
        kind=kind,
        which=event.which,
        probe=here & event.probe & ~reject,
        inside=event.inside,
        several=several,
        is_root=at_root & _has_effect(kind, contact.mode),
        pending=pending,
    )


def _has_effect(kind: Any, mode: Any) -> Any:
    """Whether an event changes the contact: a switch of the case of blocks that are apart does not."""
    return ~((interface_mode(mode) == Mode.APART) & happens(kind, TURN, HEIGHT))


class LargestTerms(NamedTuple):
    """The largest coefficients of the coordinates of blades, as they are `in_one_unit`."""

    speed: Any  # the largest of orders 1 to 3
    last: Any
    before: Any  # the last but one
    square: Any  # of the fastest motion of a blade by itself, see `squared_rates` [1/s^2]


def _largest_terms(expansion: TaylorExpansion, fixed: Fixed[RowModel], order: int, each: Each) -> LargestTerms:
    """The largest coefficients over all blades."""
    blades = fixed.model.blades

    def of_blade(own: tuple[Coefficients, ...], lever: Scalar, blade: Any, inverse: Any) -> LargestTerms:
        def largest(n: int) -> Scalar:
            numbers = [ZERO if is_zero(a[0]) else a[n] for a in own]
            sizes = [jnp.abs(a) for a in blades.in_one_unit(numbers, lever) if not is_zero(a)]
            return reduce(jnp.maximum, sizes) if sizes else jnp.zeros_like(lever)  # of a rigid neighbour

        return LargestTerms(
            speed=reduce(jnp.maximum, map(largest, (1, 2, 3))),
            last=largest(order),
            before=largest(order - 1),
            square=_largest_present(blade.squared_rates(inverse), lever),
        )

    lever = fixed.model.interfaces.block.a_x[0]
    terms = over(each, of_blade, expansion.blades.own, lever, blades, fixed.model.inverse)
    return LargestTerms._make(map(greatest, terms))


def _largest_present(numbers: Iterable[Any], like: Scalar) -> Scalar:
    """The largest of the numbers that are not absent, none of which is negative; zero if all are."""
    return reduce(jnp.maximum, (a for a in numbers if not is_zero(a)), jnp.zeros_like(like))


def _square_by_contact(mode: Any, faces: dict[str, Any]) -> Scalar:
    """A bound of what one interface adds to the square of the fastest motion of its blades [1/s^2].

    The larger stiffness of contact resists a displacement of the corner that is furthest from the centre, in any
    direction; of springs between neighbours each coordinate is by itself.
    """
    model = faces["interfaces"]
    law, block = model.law, model.block
    lever = jnp.maximum(block.a_x**2, block.b_x**2) + block.h_y**2
    k = _largest_present([law.normal_stiffness, law.tangential_stiffness], lever)
    mobility = [sum(pair) for pair in model.mobility.inverse]
    held = k * (_largest_present(mobility[:2], lever) + lever * mobility[2])
    square = where(interface_mode(mode) == Mode.APART, 0.0, held)
    springs = [4 * kappa for kappa in faces["kappa"]]
    if faces["coupling"] is not None:
        springs += map(operator.mul, faces["coupling"].k, mobility)
    return square + _largest_present(springs, lever)


def _shortest_return(faces: FaceSeries, each: Each) -> OfLanes | None:
    """The shortest `return_length` of the guards of the case over all interfaces; None where blocks do not turn."""
    rocking = [a[:3] for a in (faces.turn, faces.height) if not is_zero(a[0])]
    if not rocking:
        return None

    def of_face(guards: list[Coefficients]) -> Scalar:
        return return_length(guards, jnp.full_like(guards[0][0], MAX_TRIAL_ANGLE))

    return least(over(each, of_face, rocking))


def _trial_length(
    terms: LargestTerms,
    stiffest: Scalar,
    returns: Scalar | None,
    done: Scalar,
    tolerance: Scalar,
    tries: Int[Array, ""],
    cap: Scalar,
    step: Int[Array, ""],
    stop: Int[Array, ""],
    grid: TimeGrid,
    order: int,
    neighbours: int,
) -> Scalar:
    """The longest trial that is accurate, follows the fastest motion, and within which rocking is seen [rad].

    `stiffest` is the largest `_square_by_contact`; a blade has so many `neighbours`.
    """
    rest = jnp.maximum(_remaining_angle(done, step, stop, grid.turn), 0.0)
    h = jnp.minimum(_accurate_length(terms, order, tolerance), rest)
    per_radian = jnp.sqrt(terms.square + neighbours * stiffest) * (grid.h / (RADIANS_PER_TURN * grid.turn))
    h = jnp.minimum(h, _followed_angle(order, tolerance) / (per_radian + NEGLIGIBLE_SPEED))
    if returns is not None:
        shortest = grid.flat * RADIANS_PER_TURN * grid.turn  # what returns sooner counts as flat contact
        h = jnp.minimum(h, jnp.maximum(returns, shortest))
    return where(tries > 0, jnp.minimum(h, cap), h)


def _accurate_length(terms: LargestTerms, order: int, tolerance: Scalar) -> Scalar:
    """The length at which the last terms of the speeds are `tolerance` times the largest speed [rad]."""
    allowed = tolerance * terms.speed + NEGLIGIBLE_SPEED
    last = (order - 1, terms.before), (order, terms.last)
    lengths = [_power(allowed / (n * size + NEGLIGIBLE_SPEED), 1 / (n - 1)) for n, size in last]
    return jnp.minimum(jnp.minimum(*lengths), MAX_TRIAL_ANGLE)


def _followed_angle(order: int, tolerance: Scalar) -> Scalar:
    """The angle of an oscillation over which a series errs by the tolerance [rad].

    A motion that is not excited bounds no trial by its coefficients, and is excited by rounding, or by a direction of
    derivatives. A decay of twice the rate is stable.
    """
    error = float(math.factorial(order + 1)) * tolerance  # too large for an integer of 32 bits
    return jnp.minimum(_power(error, 1 / (order + 1)), 0.65 + 0.187 * order)


def _remaining_angle(done: Any, step: Any, stop: Any, turn: Any) -> Any:
    """The angle until the march stops [rad]."""
    return ((stop - step).astype(turn.dtype) - done) * (RADIANS_PER_TURN * turn)


def _power(x: Scalar, exponent: float) -> Scalar:
    """The power `x ** exponent` of a positive number to a few percent, from the bits of its fourth root in float32."""
    bits = lax.bitcast_convert_type(jnp.sqrt(jnp.sqrt(x)).astype(jnp.float32), jnp.int32)
    log = bits.astype(jnp.float32) * (1 / 2**23) - 127.0
    power = ((log * (4 * exponent) + (127.0 - 0.043)) * 2**23).astype(jnp.int32)
    return lax.bitcast_convert_type(power, jnp.float32).astype(x.dtype)


def face_guards(faces: FaceSeries, contact: State, model: Model) -> list[tuple[int, Coefficients]]:
    """The guards of one interface as polynomials by the numbers of their events; negative while the mode lasts."""
    switches = [(number_of(event), a) for event, a in ((TURN, faces.turn), (HEIGHT, faces.height)) if not is_zero(a[0])]
    lifts, rubs = [], []
    points = sliding_points(faces, contact, model)
    for (lift, rub), (law, point), own in zip(events_at_points(model.law), points, faces.points, strict=True):
        apart = point.mode == Mode.APART
        gap, *rates = (where(apart, 1.0, -1.0) * a for a in own.v)
        if model.law.has_points:  # see `events`
            gap = where(apart, gap, gap - own.rounding)
        lifts.append((number_of(lift), (gap, *rates)))
        friction = law.friction_series(point.at, point.rates(), point.u_s, point.mode)
        rubs += [(number_of(rub), coefficients(guard, len(own.v) - 1)) for guard in friction]
    return [*lifts, *switches, *rubs]


def _first_event_of_face(
    faces: FaceSeries,
    contact: State,
    before: tuple[Any, Any, Any, Any],
    h: Scalar,
    model: Model,
) -> tuple[TrialEvent, Int[Array, ""], Bool[Array, ""]]:
    """The first event of one interface within `h` radians, its kind, and whether several were due at the start.

    `before` are `crossed`, `probing`, `recheck` and `tries` of the search.
    """
    crossed, probing, recheck, tries = before
    kinds, guards = zip(*face_guards(faces, contact, model), strict=True)
    at_start = [(g[0] > 0) & recheck & (crossed != k) for k, g in zip(kinds, guards, strict=True)]
    event = first_event(list(guards), h, probing, tries)
    immediately = any_of(at_start)
    which = event.which
    for i in reversed(range(len(kinds))):
        which = where(at_start[i], jnp.int32(i), which)
    immediate = TrialEvent(jnp.zeros_like(h), which, immediately, ~immediately, ~immediately, ~immediately)
    event = select(immediately, immediate, event._replace(which=which))
    kind = jnp.int32(kinds[-1])
    for i, k in enumerate(kinds[:-1]):
        kind = where(which == i, jnp.int32(k), kind)
    several = summed(due.astype(jnp.int32) for due in at_start) > 1
    return event, kind, several


def _differentiable_end(
    faces: FaceSeries, lane: Lane, fixed: Fixed[RowModel], outcome: SeriesOutcome, s: OfLanes, each: Each
) -> OfLanes:
    """The end of a trial with its derivative: that of a guard's root or of the remaining angle, else none."""

    def root(
        faces: FaceSeries, contact: State, fires: Scalar, which: Scalar, is_root: Scalar, s: Scalar, model: Model
    ) -> Scalar:
        guards = [guard for _, guard in face_guards(faces, contact, model)]
        size, rate = polynomial_value_and_rate(select_polynomial(trimmed(guards, s), which), s)
        rate = where(fires & is_root & (rate > 0), lax.stop_gradient(rate), jnp.inf)
        return at_event(s, jnp.ones_like(s), size, rate)

    contact = _contact_of(lane.state)
    fires = outcome.fires
    at_faces = over(each, root, faces, contact, fires, outcome.which, outcome.is_root, s, fixed.model.interfaces)
    at_root = where(any_along(fires), at_place(fires, at_faces), s)
    rest = _remaining_angle(lane.search.done, lane.step, fixed.stop, fixed.grid.turn)
    ends = any_along(fires) | any_along(outcome.probe)
    return where(ends | (s < rest), at_root, rest)


def motion_in_trial(
    own: DisplacementSeries, model: RowModel, period: Scalar, steps_per_period: Scalar, steps: Scalar
) -> Any:
    """The motion so many `steps` after the start of a trial, by its series."""
    unit = period / RADIANS_PER_TURN
    s = steps * (RADIANS_PER_TURN / steps_per_period)
    return motion_after(own, model.blades, unit, s)


def _lane_after_trial(lane: Lane, trial: TaylorTrial, fixed: Fixed[RowModel], method: Choices, each: Each) -> Lane:
    """The lane after its `trial`; unchanged if it has arrived or failed."""
    model, grid, start, search = fixed.model, fixed.grid, lane.state, lane.search
    assert isinstance(search, TaylorSearch)
    outcome = trial.outcome
    active = running(lane, fixed.stop)
    fires = outcome.fires & _has_effect(outcome.kind, start.mode) & active
    next_search, step = _next_taylor_search(lane, trial, fires)
    end = State(trial.motion, start.u_s, start.mode, start.case)
    wave = wave_at(step, next_search.done, grid, each)
    h = trial.length * grid.h
    delay = where(outcome.is_root, jnp.maximum(h, SIMULTANEOUS[h.dtype.itemsize] * grid.h), h)
    ending = InterfaceEnding(
        fires=fires, kind=outcome.kind, several=outcome.several, inside=outcome.inside, delay=delay
    )
    change = change_of_row(lane, end, row_torques(end, wave, model, each), ending, fixed, method, each)
    accepted = AcceptedTrial(
        start=start,
        mode=interface_mode(start.mode),
        h=h,
        end=trial.motion,
        change=change,
        v=trial.deepest,
        gain=trial.gain,
        step=lane.step,
        next_step=step,
        by_series=trial.by_series,
    )
    tries = jnp.maximum(next_search.events, next_search.tries)
    too_many = tries > most_events(grid, model.turns_by_events) * len(outcome.fires)
    # contact may begin flat although one end of the overlap already pulls
    turns = None if change.at.turns is None else where(step > lane.step, 0, change.at.turns)
    recheck = any_along(change.at.jumped)
    if outcome.pending is not None:
        recheck = recheck | any_along(outcome.pending)
    next_search = next_search._replace(recheck=recheck, turns=turns, pending=outcome.pending)
    after = lane_after(lane, accepted, next_search, None, ~is_finite_row(end), too_many, model, method, each)
    return select(active, after, lane)


def _next_taylor_search(lane: Lane, trial: TaylorTrial, fires: Any) -> tuple[TaylorSearch, Int[Array, "..."]]:
    """The search of the next trial before the events change it, and the clock."""
    search, outcome = lane.search, trial.outcome
    done = search.done + trial.length
    negligible = NEGLIGIBLE_REST[done.dtype.itemsize]
    completed = jnp.floor(done + negligible)
    done = jnp.maximum(done - completed, 0.0)
    completed = completed.astype(jnp.int32)
    done = where(done < negligible, 0.0, done)
    fire = any_along(outcome.fires)
    moved = trial.length > 0
    next_search = search._replace(
        done=done,
        cap=outcome.end,
        crossed=where(fires, outcome.kind, where(moved, jnp.int32(-1), search.crossed)),
        probing=outcome.probe,
        events=where(completed > 0, 0, search.events) + fire.astype(jnp.int32),
        tries=where(moved | any_along(fires), 0, search.tries + 1),
    )
    return next_search, lane.step + completed
