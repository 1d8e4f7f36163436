"""The events of faces that touch at several points: contact begins and ends, sticks and slips, at each of them.

Points that touch at an instant are crossed one after another, in trials of length zero, after each of which all guards
of the interface are evaluated again. Contact at a point ends only beyond the rounding of its penetration, as slip
begins only beyond that of its stretch: points that switch together would else switch without an end.
"""

from functools import partial
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.event import ContactNow, Event, EventInstant, Guard
from jaxshroud.model.arithmetic import is_zero, where
from jaxshroud.model.contact_law import ContactLaw, GuardCrossing, Modes, Slider
from jaxshroud.model.geometry import FaceKinematics, FaceRates, PointKinematics, PointRates
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import PointsContact
from jaxshroud.model.prepared import Model
from jaxshroud.scene.point_numbers import MAX_POINTS


class _PointNow(NamedTuple):
    """One of several points at an instant."""

    law: ContactLaw
    at: PointKinematics
    rate: PointRates
    u_s: Slider
    mode: Modes
    apart: Bool[Array, ""]


def _point(m: int, now: ContactNow) -> _PointNow:
    law = _law_of_points(now.model)
    u_s = now.state.u_s
    mode = now.state.mode[m]
    at, rate = cast(FaceKinematics, now.at), cast(FaceRates, now.rate)
    slider = u_s if is_zero(u_s) else u_s[m]
    return _PointNow(law.laws[m], at.points[m], rate.points[m], slider, mode, mode == Mode.APART)


def _law_of_points(model: Model) -> PointsContact:
    assert isinstance(model.law, PointsContact)  # else the event does not exist
    return model.law


def _guard_of_lift_at(m: int, now: ContactNow) -> Guard:
    point = _point(m, now)
    value, rate = point.law.lift_guard(point.at, point.rate, point.apart)
    return Guard(where(point.apart, value, value - point.at.rounding), rate)


def _guard_of_rub_at(m: int, now: ContactNow) -> Guard:
    point = _point(m, now)
    return Guard._make(point.law.friction_guard(point.at, point.rate, point.u_s, point.mode))


def _with_mode(m: int, instant: EventInstant, mode: Any) -> tuple[Any, ...]:
    """The modes of all points, that of point `m` anew."""
    modes = instant.state.mode
    return *modes[:m], mode, *modes[m + 1 :]


def _crossing_at(m: int, instant: EventInstant) -> tuple[ContactLaw, GuardCrossing]:
    law = _law_of_points(instant.model)
    return law.laws[m], law.crossing_at(m, instant.crossing)


def _modes_after_lift_at(m: int, instant: EventInstant) -> tuple[Any, ...]:
    law, crossing = _crossing_at(m, instant)
    onset = law.onset_mode(crossing)
    return _with_mode(m, instant, where(crossing.mode == Mode.APART, onset, jnp.int32(Mode.APART)))


def _modes_after_rub_at(m: int, instant: EventInstant) -> tuple[Any, ...]:
    law, crossing = _crossing_at(m, instant)
    return _with_mode(m, instant, law.mode_after_rub(crossing))


def _has_point(m: int, model: Model) -> bool:
    return isinstance(model.law, PointsContact) and m < len(model.law.laws)


def _rubs_at(m: int, model: Model) -> bool:
    return _has_point(m, model) and _law_of_points(model).has_friction


def _lift_at(m: int) -> Event:
    return Event(
        name=f"lift at point {m}",
        label=f"contact at point {m}",
        guard=partial(_guard_of_lift_at, m),
        transition=partial(_modes_after_lift_at, m),
        exists=partial(_has_point, m),
        counters=("onset_slip", "separation", "grazing"),
    )


def _rub_at(m: int) -> Event:
    return Event(
        name=f"rub at point {m}",
        label=f"friction at point {m}",
        guard=partial(_guard_of_rub_at, m),
        transition=partial(_modes_after_rub_at, m),
        exists=partial(_rubs_at, m),
        counters=("onset_stick", "stick_slip", "slip_stick"),
    )


LIFT_AT = tuple(map(_lift_at, range(MAX_POINTS)))
RUB_AT = tuple(map(_rub_at, range(MAX_POINTS)))
POINT_EVENTS = (*LIFT_AT, *RUB_AT)
