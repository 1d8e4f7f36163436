"""What an event is: a guard that rises through zero at some instant, and what changes there.

Guards are negative until their event happens: functions of the contact at an instant, see `ContactNow`. The built-in
events stand in `events`; `Choices.events` has a user's own.
"""

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where
from jaxshroud.model.contact_law import GuardCrossing
from jaxshroud.model.geometry import Case, Kinematics, Pose, Rates, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.points_contact import interface_mode
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import EndTorques
from jaxshroud.scene.checks import InputError

SLOW_TURN = 2000.0  # squared speed over acceleration and rounding: an arc of 1000 roundings at the most


class Guard(NamedTuple):
    """The guard of one event."""

    value: Scalar
    rate: Scalar  # d(value)/dt; 0 where it is not known
    integral: Scalar = ZERO  # of the value over time, where it is known and the rate may not be; else absent


class Guards(NamedTuple):
    """The guards of the current mode, in the order of the events; absent where the model lacks the event."""

    value: tuple[Scalar, ...]
    rate: tuple[Scalar, ...]
    integral: tuple[Scalar, ...]


class GuardEvaluation(NamedTuple):
    """The contact kinematics and the guards at the end of a trial step."""

    q: Pose
    at: Kinematics
    rate: Rates
    case: Int[Array, ""]  # the current case; when apart, the case of the position
    torques: EndTorques
    guards: Guards


@dataclass(frozen=True)
class ContactNow:
    """The contact at an instant, of which guards are functions, and what changes at events."""

    at: Kinematics
    rate: Rates
    torques: EndTorques
    state: State
    case: Int[Array, ""]  # the current case; when apart, the case of the position
    model: Model
    delay: Scalar = ZERO  # upper bound of the time since the event that happens [s]

    @property
    def crossing(self) -> GuardCrossing:
        """What the law of contact knows of it."""
        return GuardCrossing(self.at, self.rate, self.state.u_s, self.state.mode, self.delay)

    @cached_property
    def apart(self) -> Bool[Array, ""]:
        """Whether the blocks are apart."""
        return interface_mode(self.state.mode) == Mode.APART

    @cached_property
    def flat(self) -> Bool[Array, ""]:
        """Whether their faces are flat on each other."""
        return self.case == FLAT

    @cached_property
    def of_corners(self) -> tuple[Guard, Guard]:
        """The guards of the two switches of the case, TURN and HEIGHT. Their rates in flat contact are not known."""
        torque = where(is_upper(self.case), self.torques.upper, self.torques.lower)
        slack = turn_slack(self.rate.turn, torque / self.model.mobility.joint, self.at.turn_rounding)
        values = switch_guards(self.at, slack, self.torques, self.case)
        turn_value, height_value = map(self._in_contact, values)
        turn, height = switch_signs(self.case)
        turn_rate, height_rate = self._at_corner(turn * self.rate.turn), self._at_corner(height * self.rate.height)
        return Guard(turn_value, turn_rate), Guard(height_value, height_rate)

    def _in_contact(self, value: Scalar) -> Scalar:
        return where(self.apart, -1.0, value)

    def _at_corner(self, rate: Scalar) -> Scalar:
        return where(self.apart | self.flat, 0.0, rate)


def switch_signs(case: Case) -> tuple[Scalar, Scalar]:
    """The signs that theta_1 - theta_2 and the height take when they leave a case."""
    return where(is_upper(case), -1.0, 1.0), where(is_upper(case) == tip_is_left(case), 1.0, -1.0)


def turn_slack(rate: Scalar, acceleration: Scalar, rounding: Scalar) -> Scalar:
    """The rounding error of theta_1 - theta_2, beyond which a turn counts, where it is as slow as flat contact ends.

    It would delay each turn of faces that rock, and so drive their rocking.
    """
    return where(rate * rate > SLOW_TURN * jnp.abs(acceleration) * rounding, 0.0, rounding)


def switch_guards(at: Kinematics, slack: Scalar, torques: EndTorques, case: Case) -> tuple[Scalar, Scalar]:
    """The values of the guards TURN and HEIGHT in contact; `slack` is that of `turn_slack`."""
    turn, height = switch_signs(case)
    flat = case == FLAT
    return (
        where(flat, -torques.lower, turn * at.turn - slack),
        where(flat, torques.upper, height * at.height),
    )


def present(numbers: tuple[Any, ...]) -> list[int]:
    """The numbers of the events for which there is a value."""
    return [i for i, value in enumerate(numbers) if not is_zero(value)]


def any_of(flags: Iterable[Bool[Array, "..."]]) -> Bool[Array, "..."]:
    """Whether any of the flags is true."""
    return reduce(operator.or_, flags)


def always(_: Model) -> bool:
    """True of every model."""
    return True


def never(_: Model) -> bool:
    """True of no model."""
    return False


class Event(NamedTuple):
    """An event at one interface.

    Its functions are traced by JAX, except those of a model alone, whose answer is known while tracing. The events of a
    march are numbered in their order, built-in ones first; where several guards are crossed at an instant, the event
    with the lowest number takes precedence, and the others follow in trials of length zero.
    """

    name: str
    label: str
    """What it concerns, in words of results."""
    guard: Callable[[ContactNow], Guard]
    """The guard with its rate, or its integral where only that is known: each event is located by a cubic of these."""
    transition: Callable[[ContactNow], Any] | None = None
    """The mode of contact after it, of several points a tuple of modes; None: the mode stays."""
    switches_case: bool = False
    """Whether other corners meet after it, or flat contact ends; of the built-in TURN and HEIGHT, see `events`."""
    exists: Callable[[Model], bool] = always
    """Whether a model with modes of contact has it."""
    forces_jump: Callable[[Model], bool] = never
    """Whether the forces jump at it, so that its instant is located to rounding; at a switch of the case from a corner
    only."""
    rounding: Callable[[Kinematics], Scalar] | None = None
    """The guard's rounding error, below which it counts as zero; None: that of a corner's place [m]."""
    counters: tuple[str, ...] = ()
    """The fields of `Counters` that a model has because of it; none of a user's own, which is counted by its name."""

    @property
    def is_only_counted(self) -> bool:
        """Whether nothing changes at it. Its guard stays above zero, and it happens again once it has been below."""
        return self.transition is None and not self.switches_case


Events = tuple[Event, ...]  # of a march
Violated = dict[int, Bool[Array, ""]]  # whether the guard of each event that there is counts as crossed, by its number


def violated_guards(guards: Guards, low: Guards, counts: Bool[Array, ""], events: Events) -> Violated:
    """The guards that are above zero at the end of a trial, if they count.

    Those of events that are only counted must have been below: `low` are the guards where the trial began.
    """
    violated = {kind: (guards.value[kind] > 0) & counts for kind in present(guards.value)}
    return violated | {kind: violated[kind] & (low.value[kind] <= 0) for kind in only_counted(guards, events)}


def only_counted(guards: Guards, events: Events) -> list[int]:
    """The numbers of the events at which nothing changes, of those that there are."""
    return [kind for kind in present(guards.value) if events[kind].is_only_counted]


def above_zero(guards: Guards, events: Events) -> Iterator[Bool[Array, "..."]]:
    """Of every event at which something changes, whether its guard is above zero."""
    return (guards.value[kind] > 0 for kind in present(guards.value) if not events[kind].is_only_counted)


def first_kind(violated: Violated) -> Int[Array, ""]:
    """The number of the violated guard that takes precedence."""
    *others, last = violated
    kind = jnp.asarray(last, jnp.int32)
    for k in reversed(others):
        kind = where(violated[k], jnp.int32(k), kind)
    return kind


def case_switches(kind: Int[Array, ""], events: Events) -> Iterator[Bool[Array, ""]]:
    """Of every event that switches the case, whether it is that of number `kind`."""
    return (kind == number for number, event in enumerate(events) if event.switches_case)


def forces_jump(kind: Int[Array, ""], state: State, model: Model, events: Events) -> Bool[Array, ""]:
    """Whether the forces jump at the event of number `kind`."""
    jumping = {i: event for i, event in enumerate(events) if event.exists(model) and event.forces_jump(model)}
    switches = [kind == number for number, event in jumping.items() if event.switches_case]
    jumps = jnp.zeros_like(kind, bool)
    if switches:
        jumps = any_of(switches) & (state.case != FLAT)
    for number, event in jumping.items():
        jumps = jumps if event.switches_case else jumps | (kind == number)
    return jumps


def rounding_of(kind: Int[Array, ""], at: Kinematics, events: Events) -> Scalar:
    """The rounding error of the guard of the event of number `kind`."""
    rounding = at.rounding
    for number, event in enumerate(events):
        if event.rounding is not None:
            rounding = where(kind == number, event.rounding(at), rounding)
    return rounding


def next_mode(kind: Int[Array, ""], instant: ContactNow, events: Events) -> Any:
    """The mode after the event of number `kind`; of several points the mode of each."""
    modes = [
        (kind == i, event.transition(instant))
        for i, event in enumerate(events)
        if event.transition is not None and event.exists(instant.model)
    ]
    chosen = instant.state.mode
    for happened, mode in reversed(modes):
        chosen = jax.tree.map(partial(where, happened), mode, chosen)
    return chosen


def check_own_events(own: Events, has_modes: bool) -> None:
    """InputError if there are events of a user's own, but contact has no modes, and no instants at which they end."""
    if own and not has_modes:
        raise InputError(f"The event {own[0].name!r} needs contact with modes, which smooth contact and none lack.")


def guards_to_begin_with(guards: Guards, events: Events) -> Guards:
    """The guards before the first trial. An event that is only counted does not happen where it begins above zero."""
    value = list(guards.value)
    for kind in only_counted(guards, events):
        value[kind] = jax.tree.map(jnp.ones_like, value[kind])
    return guards._replace(value=tuple(value))


class GuardsAfterEvent(NamedTuple):
    """The guards with which a march goes on after an event."""

    guards: Guards
    waiting: list[Bool[Array, "..."]]  # of events that are only counted, whether they happen at this instant too


def guards_after_event(
    after: Guards, end: Guards, low: Guards, fire: Any, kind: Any, events: Events
) -> GuardsAfterEvent:
    """The guards after the event of number `kind`, if there was one.

    The guard of an event that is only counted waits at 0 if it has risen at the same instant, or jumped above zero.

    Args:
        after: The guards right after the event.
        end: Those right before it, where the trial ended.
        low: Those at the lower end of the bracket.
        fire: Whether there was an event, at each interface.
        kind: Its number.
        events: The events of the march.
    """
    value = list(after.value)
    waiting = []
    for counted in only_counted(after, events):
        was_below = (low.value[counted] <= 0) | (end.value[counted] <= 0)
        waits = ~(fire & (kind == counted)) & was_below & (after.value[counted] > 0)
        value[counted] = where(waits, 0.0, after.value[counted])
        waiting.append(waits)
    return GuardsAfterEvent(after._replace(value=tuple(value)), waiting)
