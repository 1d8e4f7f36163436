"""Contact of faces at several points, each with a law, a mode and a slider of its own.

The points press along the mean normal of both faces, by their shares of the stiffnesses; their forces act at the
middles between partners. Modes and sliders of such an interface are tuples, one entry for each point.
"""

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, summed, where
from jaxshroud.model.contact import Load, middle_load
from jaxshroud.model.contact_law import (
    ContactLaw,
    ContactLoads,
    ContactPoint,
    GuardCrossing,
    Modes,
    Slider,
    SummedForces,
)
from jaxshroud.model.geometry import Corners
from jaxshroud.model.modes import Mode


class PointsContact(ContactLaw):
    """Several points with a law each."""

    called: ClassVar[str] = "contact points"
    is_examined: ClassVar[bool] = True  # as far as rows are: an accuracy chooses a method that is not tried
    has_points: ClassVar[bool] = True
    by_series: ClassVar[bool] = True

    laws: tuple[ContactLaw, ...]
    shares: tuple[Scalar, ...]

    @property
    def normal_stiffness(self) -> Scalar:
        """That of all points [N/m]."""
        return summed(law.normal_stiffness for law in self.laws)

    @property
    def tangential_stiffness(self) -> Scalar:
        """That of all points [N/m]."""
        return summed(law.tangential_stiffness for law in self.laws)

    @property
    def has_friction(self) -> bool:
        """Whether the points stick and slip."""
        return self.laws[0].has_stick

    @property
    def of_points(self) -> tuple[ContactLaw, ...]:
        """The law of each point."""
        return self.laws

    def points_of(self, point: ContactPoint) -> list[ContactPoint]:
        """The points of an interface."""
        rates = [None] * len(self.laws) if point.own_rates is None else point.own_rates.points
        sliders = [ZERO] * len(self.laws) if is_zero(point.u_s) else point.u_s
        return [
            point._replace(at=at, u_s=u_s, mode=mode, own_rates=rate)
            for at, u_s, mode, rate in zip(point.at.points, sliders, point.mode, rates, strict=True)
        ]

    def forces(self, point: ContactPoint) -> SummedForces:
        """The sums of the forces of the points, and these."""
        of_each = tuple(law.forces(own) for law, own in zip(self.laws, self.points_of(point), strict=True))
        return SummedForces(summed(own.N for own in of_each), summed(own.F for own in of_each), ZERO, of_each)

    def load(self, point: ContactPoint, forces: SummedForces, block: Corners) -> Load:
        """The load of all points."""
        del block
        pairs = zip(forces.points, point.at.points, strict=True)
        return middle_load(point.at, forces.N, forces.F, summed(own.N * at.reach for own, at in pairs))

    def stored_energy(self, v: Any, w: Any, mode: Any) -> Scalar:
        """The sum of the energies of the points [J], from their penetrations, stretches and modes."""
        stretches = [ZERO] * len(self.laws) if is_zero(w) else w
        return summed(law.stored_energy(*own) for law, *own in zip(self.laws, v, stretches, mode, strict=True))

    def energy_at(self, at: Any, w: Any, mode: Any) -> Scalar:
        """The sum of the energies of the points [J]."""
        return self.stored_energy([own.v for own in at.points], w, mode)

    def stretch_at(self, at: Any, u_s: Any, mode: Any) -> Any:
        """The stretch of each point [m]; absent without friction."""
        if is_zero(u_s):
            return ZERO
        numbers = zip(self.laws, at.points, u_s, mode, strict=True)
        return tuple(law.stretch(own.v, own.u, slider, own_mode) for law, own, slider, own_mode in numbers)

    def dissipated_power(self, point: ContactPoint, forces: SummedForces) -> Scalar:
        """The sum of the powers of the points [W]."""
        return summed(self._of_each(lambda law, *own: law.dissipated_power(*own), point, forces))

    def load_rates(self, point: ContactPoint, forces: SummedForces) -> ContactLoads:
        """The rates of the loads of all points."""
        return self.loads_of_interface(self._of_each(lambda law, *own: law.load_rates(*own), point, forces))

    def loads_of_interface(self, of_points: list[ContactLoads]) -> ContactLoads:
        """The sums of the loads; the time is that in which any point slips, the path its mean by the shares."""
        times: list[Any] = [own.time_slip for own in of_points]
        return ContactLoads(
            N=summed(own.N for own in of_points),
            N_slip=summed(own.N_slip for own in of_points),
            time_slip=times[0] if is_zero(times[0]) else reduce(jnp.maximum, times),
            slip=summed(share * own.slip for share, own in zip(self.shares, of_points, strict=True)),
        )

    def _of_each(self, f: Callable[..., Any], point: ContactPoint, forces: SummedForces) -> list[Any]:
        """`f` of the law, the point and the forces of each."""
        return [f(*own) for own in zip(self.laws, self.points_of(point), forces.points, strict=True)]

    def carried_mode(self, mode: Any) -> Any:
        """One for each point."""
        return _by_point(mode)

    def carried_slider(self, u_s: Any, mode: Any) -> Any:
        """One for each point; absent without friction."""
        del mode
        return _by_point(u_s) if self.has_friction else ZERO

    def crossing_at(self, m: int, crossing: GuardCrossing) -> GuardCrossing:
        """The crossing at point `m`."""
        u_s = crossing.u_s if is_zero(crossing.u_s) else crossing.u_s[m]
        return GuardCrossing(crossing.at.points[m], crossing.rate.points[m], u_s, crossing.mode[m], crossing.delay)

    def with_mode_at(self, m: int, modes: Any, mode: Modes) -> Any:
        """The modes of all points."""
        return *modes[:m], mode, *modes[m + 1 :]

    def slider_after(self, crossing: GuardCrossing, w: Any, mode: Any, u: Scalar) -> Any:
        """The slider of each point; that of a point whose mode stays is as it was."""
        if is_zero(crossing.u_s):
            return ZERO

        def after(m: int, law: ContactLaw) -> Slider:
            new = law.slider_after(self.crossing_at(m, crossing), w[m], mode[m], u)
            return where(mode[m] == crossing.mode[m], crossing.u_s[m], new)

        return tuple(after(m, law) for m, law in enumerate(self.laws))


def _by_point(a: Any) -> Any:
    """Numbers (points, ...) as a tuple of them."""
    return a if isinstance(a, tuple) else tuple(a[m] for m in range(a.shape[0]))


def interface_mode(mode: Any) -> Any:
    """The mode of an interface: apart if all of its points are, slip if one of them slips, else stick."""
    if not isinstance(mode, tuple):
        return mode
    sticks, forward, backward = (
        reduce(operator.or_, (one == wanted for one in mode))
        for wanted in (Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS)
    )
    slips = where(forward, jnp.int32(Mode.SLIP_PLUS), jnp.int32(Mode.SLIP_MINUS))
    in_contact = where(forward | backward, slips, jnp.int32(Mode.STICK))
    return where(sticks | forward | backward, in_contact, jnp.int32(Mode.APART))


def by_point(a: Any, like: Any) -> Any:
    """An array (..., points) as the tuple of the numbers of each point, if it has an axis more than `like`."""
    return tuple(a[..., m] for m in range(a.shape[-1])) if a.ndim > like.ndim else a


def points_last(a: Any) -> Any:
    """Numbers of each point, a tuple, as an array with a last axis of points, (..., points); others as they are."""
    return jnp.stack(a, axis=-1) if isinstance(a, tuple) else a
