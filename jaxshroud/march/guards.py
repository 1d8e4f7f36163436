"""The guards of events: numbers that are negative until their event happens, and what they are functions of."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where
from jaxshroud.model.geometry import Case, Kinematics, Pose, Rates, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import EndTorques


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
    """The contact at an instant, of which guards are functions."""

    at: Kinematics
    rate: Rates
    torques: EndTorques
    state: State
    case: Int[Array, ""]  # the current case; when apart, the case of the position
    apart: Bool[Array, ""]
    flat: Bool[Array, ""]
    model: Model

    @cached_property
    def of_corners(self) -> tuple[Guard, Guard]:
        """The guards of the two switches of the case, TURN and HEIGHT. Their rates in flat contact are not known."""
        turn_value, height_value = map(self._in_contact, switch_guards(self.at, self.torques, self.case))
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


def switch_guards(at: Kinematics, torques: EndTorques, case: Case) -> tuple[Scalar, Scalar]:
    """The values of the guards TURN and HEIGHT in contact."""
    (turn, height), flat = switch_signs(case), case == FLAT
    return (
        where(flat, -torques.lower, turn * at.turn - at.turn_rounding),
        where(flat, torques.upper, height * at.height),
    )


def present(numbers: tuple[Any, ...]) -> list[int]:
    """The numbers of the events for which there is a value."""
    return [i for i, value in enumerate(numbers) if not is_zero(value)]


def any_of(flags: Iterable[Bool[Array, "..."]]) -> Bool[Array, "..."]:
    """Whether any of the flags is true."""
    return reduce(jnp.logical_or, flags)
