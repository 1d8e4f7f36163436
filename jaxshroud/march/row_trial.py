"""The trials of a row of blades: every trial ends at the earliest event over all interfaces, or where its step ends.

All interfaces whose guards are violated there are crossed, and every guard is looked at again: symmetry makes events
exactly simultaneous. Arrays have the axis of blades or interfaces first, then the lanes; see `model.row`.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import MAX_EVENTS_PER_STEP, NEGLIGIBLE_REST, TimeGrid, change_at
from jaxshroud.march.events import (
    EventKind,
    GuardEvaluation,
    Guards,
    any_of,
    event_kinds,
    first_kind,
    forces_jump,
    guards_at,
    place_contact,
)
from jaxshroud.march.locate import (
    CUBIC_TRIALS,
    Target,
    at_least_two,
    event_tolerance,
    first_crossed,
    first_interior_maximum,
    next_trial_end,
    select,
    select_guard,
)
from jaxshroud.march.method import Choices
from jaxshroud.march.method_names import Locate
from jaxshroud.march.observables import ContactForces, contact_forces_at, updated_range
from jaxshroud.march.row_step import OfLanes, RowStepEnd, row_interval, row_step
from jaxshroud.march.tally import Counters, DisplacementRange, count_event, displacements_of, no_events
from jaxshroud.model.arithmetic import ABSENT, ANGLE_RANGE, Absent, Scalar, is_absent, where, zeros_for
from jaxshroud.model.geometry import ContactKinematics
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import EndTorques, Integrals, Recorded, law_forces, torques_along_face
from jaxshroud.model.row import (
    Cluster,
    Each,
    OfInterfaces,
    RowModel,
    blade_energies,
    blade_forces,
    clusters,
    interface_effects,
    joint_inertia,
    over,
    pair_states,
    rates_of_blades,
    relative_torques,
)
from jaxshroud.scene.keys import Motion

ONLY_FORCES = Recorded()


class RowTarget(NamedTuple):
    """The guard that a search closes in on: its interface, and its values at the upper end of the bracket."""

    place: Int[Array, " lanes"]
    guard: Target


class RowSearch(NamedTuple):
    """The search of a row inside its current step, as `locate.Search`; every field (lanes,)."""

    done: OfLanes
    length: OfLanes
    low: OfLanes
    high: OfLanes
    bracketing: Bool[Array, " lanes"]
    probing: Bool[Array, " lanes"]
    inside: Bool[Array, " lanes"]
    recheck: Bool[Array, " lanes"]
    events: Int[Array, " lanes"]
    target: RowTarget | None  # None unless events are located by cubics


class RowLog(NamedTuple):
    """What has happened so far: at each interface, and the largest displacement of each blade."""

    time_apart: OfInterfaces  # [s]
    time_stick: OfInterfaces  # [s]
    time_slip: OfInterfaces  # [s]
    v_max: OfInterfaces  # largest penetration at ends of trials [m]
    largest: tuple[Any, Any, Any]  # magnitudes of x, y [m] and theta [rad] at ends of trials, (N, lanes) each
    counters: Counters
    extent: DisplacementRange | None  # of each blade; None unless it was requested


class RowTally(NamedTuple):
    """The integrals and the log of a row so far."""

    integrals: Integrals  # of each blade, those of contact of each interface
    springs: OfInterfaces  # energy gained by the contact springs at events [J]
    dropped: OfLanes  # energy lost where flat contact ended a rocking motion [J]
    log: RowLog


class RowLane(eqx.Module):
    """The loop state of a row."""

    state: State  # motion (N, lanes); slider, mode and case (E, lanes)
    step: Int[Array, " lanes"]
    search: RowSearch
    guards: Guards | None  # of each interface at the start of the trial; None where there are no events
    tally: RowTally
    status: Int[Array, " lanes"]


class RowFixed(NamedTuple):
    """The constants of rows during a march."""

    model: RowModel
    grid: TimeGrid
    stop: Int[Array, " lanes"]  # the march ends at the start of this step


def row_running(lane: RowLane, stop: Int[Array, " lanes"]) -> Bool[Array, " lanes"]:
    """Which rows have not arrived at the start of step `stop` and have not failed."""
    return (lane.step < stop) & (lane.status == Status.OK)


def begin_row(state: State, model: RowModel, method: Choices, each: Each) -> RowLane:
    """A row at step 0. The first trial has length zero: it sets the guards, and a start in overlap is an onset."""
    lanes, shape = jnp.zeros_like(state.motion.x[0]), jnp.shape(state.mode)
    count, no, at = jnp.zeros(lanes.shape, jnp.int32), jnp.zeros(lanes.shape, bool), jnp.zeros(shape, lanes.dtype)
    target = RowTarget(count, Target(count, lanes, lanes, lanes, count)) if method.locate == "cubic" else None
    search = RowSearch(lanes, lanes, lanes, lanes, no, no, no, ~no, count, target)
    zero_step = row_interval(count, lanes, lanes, TimeGrid(lanes, lanes, lanes))
    nothing = zeros_for(lambda: row_step(zero_step, state, _clusters_of(state, model), model, method, each).gain)
    guards = None
    if model.interfaces.spring.modal:
        guards = zeros_for(lambda: _guards_of(state, (lanes, lanes), model, each))
    counters = jax.tree.map(lambda a: jnp.zeros(shape, a.dtype), no_events(model.interfaces))
    largest = jax.tree.map(jnp.zeros_like, displacements_of(state.motion))
    extent = (
        DisplacementRange(displacements_of(state.motion), displacements_of(state.motion)) if method.amplitudes else None
    )
    tally = RowTally(nothing, at, lanes, RowLog(at, at, at, at, largest, counters, extent))
    return RowLane(state, count, search, guards, tally, count)


def tally_of_new_period(tally: RowTally, z: Motion) -> RowTally:
    """The tally with what is told of each period reset, at the motion `z`."""
    zeros, log = jax.tree.map(jnp.zeros_like, tally), tally.log
    extent = None if log.extent is None else DisplacementRange(displacements_of(z), displacements_of(z))
    return zeros._replace(log=log._replace(largest=zeros.log.largest, extent=extent))


def _clusters_of(state: State, model: RowModel) -> Cluster | None:
    """The blocks that are flat on each other; None where no blocks can be."""
    return clusters(state.case, model) if model.turns_by_events else None


def _torques(
    state: State, wave: Any, model: RowModel, each: Each
) -> tuple[OfInterfaces | Absent, OfInterfaces | Absent]:
    """The relative torque of each interface with contact at the corner of its case, and the inertia against it."""
    if not model.turns_by_events:
        return ABSENT, ABSENT
    cluster = clusters(state.case, model)
    effects = over(
        each, partial(interface_effects, recorded=ONLY_FORCES), pair_states(state, model.closed), model.interfaces
    )
    own = rates_of_blades(state.motion, wave, blade_forces(effects, model), model, False, each).theta
    return relative_torques(own, state.case, cluster, model), joint_inertia(cluster, model)


def _interface_view(torque: Scalar, state: State, model: Model) -> GuardEvaluation:
    """The kinematics and the guards of one interface under the relative torque of its corner."""
    placed = place_contact(state.motion, state, model)
    return guards_at(placed, state.motion, _end_torques(torque, placed[2], state, model), state, model)


def _end_torques(torque: Scalar, at: ContactKinematics, state: State, model: Model) -> EndTorques:
    """The torques at both ends of the faces' overlap from the relative torque of the corner."""
    if is_absent(torque):
        return EndTorques(ABSENT, ABSENT)
    forces = law_forces(at, state.motion, state, state.case, model)
    return torques_along_face(torque, forces, at, state, model)


def row_contact_forces(state: State, wave: Any, model: RowModel, each: Each) -> ContactForces:
    """The contact forces at each interface in a state, at (sin, cos) of omega t."""
    torque, _ = _torques(state, wave, model, each)

    def at_interface(torque: Scalar, state: State, model: Model) -> ContactForces:
        placed = place_contact(state.motion, state, model)
        return contact_forces_at(placed, _end_torques(torque, placed[2], state, model), state, model)

    return over(each, at_interface, torque, pair_states(state, model.closed), model.interfaces)


def _guards_of(state: State, wave: Any, model: RowModel, each: Each) -> Guards:
    """The guards of each interface in a state."""
    torque, _ = _torques(state, wave, model, each)
    guards = lambda torque, state, model: _interface_view(torque, state, model).guards
    return over(each, guards, torque, pair_states(state, model.closed), model.interfaces)


class InterfaceOutcome(NamedTuple):
    """What a trial has shown at one interface."""

    guards: Guards  # at its end
    hit: Bool[Array, ""]  # a guard is violated
    kind: Int[Array, ""]  # the violated guard that takes precedence
    several: Bool[Array, ""]  # several are violated
    jumps: Bool[Array, ""]  # the forces jump there
    exact: Bool[Array, ""]  # the guard is zero to rounding
    top: Scalar  # the fraction of the trial at which a guard seems to be above zero; 1 if there is none
    share: Scalar  # of the width above zero, of the guard that was crossed first
    crossed: Target


def interface_outcome(
    torque: Scalar, state: State, low: Guards, counts: Bool[Array, ""], length: Scalar, model: Model
) -> InterfaceOutcome:
    """The outcome at one interface of a trial of so many seconds that ended in `state`.

    Args:
        torque: The relative torque of its corner.
        state: Its end, in the mode and case of the trial.
        low: The guards at the lower end of the bracket, or at the start of the trial.
        counts: Whether a violated guard counts.
        length: The length of the trial [s].
        model: The constants of the pair.
    """
    view = _interface_view(torque, state, model)
    guards = view.guards
    violated = {kind: (guards.value[kind] > 0) & counts for kind in event_kinds(guards.value)}
    kind, hit, several = first_kind(violated), any_of(violated.values()), at_least_two(tuple(violated.values()))
    jumps = forces_jump(kind, state, model)
    rounding = where(kind == EventKind.TURN, view.at.turn_rounding, view.at.rounding)
    exact = jumps & ~several & (select_guard(guards.value, kind) <= rounding)
    zero, none = jnp.zeros_like(length), jnp.zeros_like(kind)
    share, crossed = first_crossed(low, guards, violated, Target(none, zero, zero, zero, none))
    top = first_interior_maximum(low, guards, length)
    return InterfaceOutcome(guards, hit, kind, several, jumps & hit, exact, top, share[0] / share[1], crossed)


class RowOutcome(NamedTuple):
    """What a trial has shown of a row."""

    hits: Int[Array, ""]  # number of interfaces where a guard is violated
    jumps: Bool[Array, ""]  # the forces jump at one of them
    exact: Bool[Array, ""]  # all of their guards are zero to rounding
    top: Scalar
    crossed: RowTarget  # the guard that was crossed first
    low: Guards  # of the interface of the target, at the lower end of the bracket


def _row_outcome(search: RowSearch, outcome: InterfaceOutcome, low: Guards) -> RowOutcome:
    """The outcome of each lane, from those of its interfaces."""
    hit = outcome.hit
    hits, any_hit = jnp.sum(hit, axis=0, dtype=jnp.int32), jnp.any(hit, axis=0)
    first = jnp.argmax(jnp.where(hit, outcome.share, -1.0), axis=0).astype(jnp.int32)
    place = first if search.target is None else jnp.where(any_hit, first, search.target.place)
    here = jnp.arange(len(hit), dtype=jnp.int32)[:, None] == place
    at_place = lambda a: jnp.sum(jnp.where(here, a, jnp.zeros_like(a)), axis=0, dtype=a.dtype)
    now = select(any_hit | ~search.bracketing, low, outcome.guards)
    return RowOutcome(
        hits,
        jnp.any(outcome.jumps, axis=0),
        jnp.all(outcome.exact | ~hit, axis=0),
        jnp.min(outcome.top, axis=0),
        RowTarget(place, jax.tree.map(at_place, outcome.crossed)),
        jax.tree.map(at_place, now),
    )


class RowDecision(NamedTuple):
    """The decision on a trial step of a row."""

    accept: Bool[Array, ""]
    fire: Bool[Array, ""]  # accept, and cross the violated guards
    move_low: Bool[Array, ""]  # the trial's end is the new lower end of the bracket
    delay: Scalar  # upper bound of the time since the event [s]
    search: RowSearch  # if the trial is not accepted


def judge_row(
    search: RowSearch, outcome: RowOutcome, active: Bool[Array, ""], h: Scalar, locate: Locate, order: int
) -> RowDecision:
    """Decide on a trial of one lane, as `judge_trial` does for a pair; `h` is the length of a whole step [s]."""
    hit = outcome.hits > 0
    if locate == "none":
        return RowDecision(active, hit & active, jnp.zeros_like(hit), search.length * h, search)
    bracketing = search.bracketing | hit
    high = where(hit, search.length, search.high)
    below = where(search.bracketing & ~hit, search.length, search.low)
    probes = ~bracketing & ~search.probing & (outcome.top < 1)
    finest = event_tolerance(jnp.ones_like(hit), locate, order, False, high.dtype)
    tolerance = event_tolerance(outcome.jumps, locate, order, False, high.dtype)
    target, delay, next_end = search.target, high - below, (below + high) / 2
    if target is not None:
        chosen = select(hit, outcome.crossed.guard._replace(tries=target.guard.tries), target.guard)
        chosen = chosen._replace(tries=where(hit | search.bracketing, target.guard.tries + 1, 0))
        target = RowTarget(outcome.crossed.place, chosen)
        by_cubic, delay = next_trial_end(chosen, outcome.low, below, high, h, tolerance)
        halve = (chosen.tries > CUBIC_TRIALS) & (chosen.tries % 2 == 0)
        next_end = where(halve, next_end, by_cubic)
    exact = outcome.exact & (outcome.hits == 1)
    fire = hit & ((delay <= tolerance) | exact)
    after = search._replace(
        length=where(probes, outcome.top * search.length, where(high - below <= finest, high, next_end)),
        low=below,
        high=high,
        bracketing=bracketing,
        probing=probes,
        inside=search.inside | (search.probing & hit),
        target=target,
    )
    return RowDecision(
        ((~bracketing & ~probes) | fire) & active,
        fire & active,
        active & search.bracketing & ~hit,
        delay * h,
        select(active, after, search),
    )


class InterfaceChange(NamedTuple):
    """The change of one interface at an event."""

    u_s: Any
    mode: Int[Array, ""]
    case: Int[Array, ""]
    becomes_flat: Bool[Array, ""]
    jumped: Bool[Array, ""]  # guards may have jumped
    springs: Scalar  # energy gained by the contact springs [J]
    counters: Counters
    v: Scalar  # penetration before it [m]


def interface_change(
    torque: Scalar,
    joint: Scalar,
    start: State,
    fire: Bool[Array, ""],
    kind: Int[Array, ""],
    several: Bool[Array, ""],
    inside: Bool[Array, ""],
    delay: Scalar,
    h: Scalar,
    counters: Counters,
    model: Model,
) -> InterfaceChange:
    """The change of one interface whose trial ended in `start`, and at an event there if `fire` is true."""
    if not is_absent(joint):
        model = eqx.tree_at(lambda m: m.mobility.joint, model, joint)
    view = _interface_view(torque, start, model)
    change = change_at(view, start.motion, start, fire, kind, delay, h, model)
    now = change.transition.after
    u_s, mode, case = select(fire, (now.u_s, now.mode, now.case), (start.u_s, start.mode, start.case))
    becomes_flat = fire & (case == FLAT) & (start.case != FLAT)
    turned = (kind == EventKind.TURN) | (kind == EventKind.HEIGHT)
    return InterfaceChange(
        u_s,
        mode,
        case,
        becomes_flat,
        fire & (several | turned | (case == FLAT)),
        change.jumps.springs,
        count_event(counters, change.transition, fire, inside),
        view.at.v,
    )


def row_trial(lane: RowLane, fixed: RowFixed, method: Choices, each: Each) -> RowLane:
    """One trial step of every lane that has neither arrived nor failed, and what follows from its end."""
    model, grid, stop = fixed
    cluster = _clusters_of(lane.state, model)
    interval = row_interval(lane.step, lane.search.done, lane.search.length, grid)
    end = row_step(interval, lane.state, cluster, model, method, each)
    active = row_running(lane, stop)
    if not model.interfaces.spring.modal:
        return _without_events(lane, end, active, interval.h, model, method, each)
    assert lane.guards is not None
    search, start = lane.search, lane.state
    torque, joint = _torques(end.state, end.wave, model, each)
    pairs = pair_states(end.state, model.closed)
    counts = (search.length > 0) | search.recheck
    outcome = over(each, interface_outcome, torque, pairs, lane.guards, counts, interval.h, model.interfaces)
    judge = partial(judge_row, locate=method.locate, order=method.rk.order)
    decision = each(judge, search, _row_outcome(search, outcome, lane.guards), active, grid.h)
    not_finite = ~_is_finite(end.state)
    accept, fire = decision.accept | (not_finite & active), decision.fire
    fires = fire[None] & outcome.hit
    change = over(
        each,
        interface_change,
        torque,
        joint,
        pairs,
        fires,
        outcome.kind,
        outcome.several,
        search.inside,
        decision.delay,
        grid.h,
        lane.tally.log.counters,
        model.interfaces,
    )
    after = State(end.state.motion, change.u_s, change.mode, change.case)
    after, dropped = _as_flat(after, change.becomes_flat, model, each)
    guards = select(fire, _guards_of(after, end.wave, model, each), outcome.guards)
    violated = any_of([jnp.any(guards.value[kind] > 0, axis=0) for kind in event_kinds(guards.value)])
    jumped = jnp.any(change.jumped, axis=0) | (jnp.sum(fires, axis=0) > 1)
    next_search, step = _next_row_search(search, lane.step, fire, fire & jumped & violated)
    tally = _updated_tally(lane.tally, end.gain, interval.h, start, after, change, dropped, each)
    limit = MAX_EVENTS_PER_STEP * len(outcome.hit)
    status = jnp.where(accept, _status(after, not_finite, next_search.events > limit), Status.OK).astype(jnp.int32)
    return RowLane(
        select(accept, after, start),
        jnp.where(accept, step, lane.step),
        select(accept, next_search, decision.search),
        select(accept | decision.move_low, guards, lane.guards),
        select(accept, tally, lane.tally),
        jnp.where(active, status, lane.status),
    )


def _as_flat(
    state: State, becomes_flat: Bool[Array, "interfaces lanes"], model: RowModel, each: Each
) -> tuple[State, OfLanes]:
    """The state once the blocks of new flat faces turn as one with their clusters, and the energy that is lost [J].

    The angular momentum of each cluster is kept.
    """
    if not model.turns_by_events:
        return state, jnp.zeros_like(state.motion.x[0])
    z, cluster, now = state.motion, clusters(state.case, model), jnp.any(becomes_flat, axis=0)
    as_one = lambda a: jnp.where(now, cluster.mean(a), a)
    parallel = z._replace(theta=as_one(z.theta), v_theta=as_one(z.v_theta))
    lost = jnp.sum(blade_energies(z, model, each) - blade_energies(parallel, model, each), axis=0)
    return State(parallel, state.u_s, state.mode, state.case), jnp.where(now, lost, 0.0)


def _is_finite(state: State) -> Bool[Array, " lanes"]:
    return jnp.isfinite(sum(jnp.sum(a, axis=0) for a in jax.tree.leaves(state.motion)))


def _status(state: State, not_finite: Any, too_many: Any) -> Int[Array, " lanes"]:
    """The status at the end of an accepted trial."""
    turned = not_finite
    if not is_absent(state.motion.theta):
        turned = turned | jnp.any(jnp.abs(state.motion.theta) > ANGLE_RANGE, axis=0)
    status = jnp.where(too_many, Status.TOO_MANY_EVENTS, Status.OK)
    status = jnp.where(turned, Status.ANGLE_OUT_OF_RANGE, status)
    return jnp.where(not_finite, Status.NOT_FINITE, status)


def _next_row_search(search: RowSearch, step: Any, fire: Any, recheck: Any) -> tuple[RowSearch, Any]:
    """The search of the next trial, and the clock, after an accepted trial."""
    done = search.done + search.length
    complete = done >= 1 - NEGLIGIBLE_REST[done.dtype.itemsize]
    done = jnp.where(complete, 0.0, done)
    events = jnp.where(complete, 0, search.events + fire.astype(jnp.int32))
    zero, no = jnp.zeros_like(done), jnp.zeros_like(fire)
    length = jnp.where(recheck, 0.0, 1 - done)
    probing = search.probing & ~fire & ~complete
    target = None if search.target is None else jax.tree.map(jnp.zeros_like, search.target)
    after = RowSearch(done, length, zero, zero, no, probing, no, recheck, events, target)
    return after, step + complete.astype(jnp.int32)


def _updated_tally(
    tally: RowTally,
    gain: Integrals,
    h: OfLanes,
    start: State,
    after: State,
    change: InterfaceChange,
    dropped: OfLanes,
    each: Each,
) -> RowTally:
    """The tally after an accepted trial of `h` seconds from `start`."""
    extent = tally.log.extent
    if extent is not None:
        extent = over(each, updated_range, extent, start.motion, after.motion, h)
    log, apart, stick = tally.log, start.mode == Mode.APART, start.mode == Mode.STICK
    spent = lambda before, during: before + jnp.where(during, h, 0.0)
    now = RowLog(
        spent(log.time_apart, apart),
        spent(log.time_stick, stick),
        spent(log.time_slip, ~apart & ~stick),
        jnp.maximum(log.v_max, jnp.where(apart, 0.0, change.v)),
        jax.tree.map(lambda most, q: jnp.maximum(most, jnp.abs(q)), log.largest, displacements_of(after.motion)),
        change.counters,
        extent,
    )
    integrals = jax.tree.map(jnp.add, tally.integrals, gain)
    return RowTally(integrals, tally.springs + change.springs, tally.dropped + dropped, now)


def _without_events(
    lane: RowLane, end: RowStepEnd, active: Any, h: OfLanes, model: RowModel, method: Choices, each: Each
) -> RowLane:
    """The rows after a trial of smooth contact, which is accepted in any case."""
    no = jnp.zeros_like(active)
    v = over(
        each, lambda s, m: place_contact(s.motion, s, m)[2].v, pair_states(end.state, model.closed), model.interfaces
    )
    touches = jnp.where(v < 0, jnp.int32(Mode.APART), jnp.int32(Mode.SLIP_PLUS))
    counters = lane.tally.log.counters
    change = InterfaceChange(ABSENT, touches, touches, no, no, jnp.zeros_like(v), counters, v)
    seen = State(lane.state.motion, lane.state.u_s, touches, lane.state.case)
    tally = _updated_tally(lane.tally, end.gain, h, seen, end.state, change, jnp.zeros_like(h), each)
    status = _status(end.state, ~_is_finite(end.state), no).astype(jnp.int32)
    next_search, step = _next_row_search(lane.search, lane.step, no, no)
    return RowLane(
        select(active, end.state, lane.state),
        jnp.where(active, step, lane.step),
        select(active, next_search, lane.search),
        None,
        select(active, tally, lane.tally),
        jnp.where(active, status, lane.status),
    )
