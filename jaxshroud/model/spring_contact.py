"""The article's law of contact: a normal spring and the friction element of Eq. (2), parts of it, and a smooth law.

The slider `u_s` is an explicit state. `BilinearContact` has both; `SpringContact` has the spring alone and `NoContact`
neither, so that the compiled program does not contain what is left out.

`SmoothContact` has hyperbolas of a given width in place of the corners of the law, and no events:
N = k (v + sqrt(v^2 + width^2)) / 2, and a friction spring whose elastic stretch bends over at mu N / k_d. The slider
follows the excess, at a rate inverse to the width; it is integrated with the motion. Between the four cases there is a
mixture, and there are no modes.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where
from jaxshroud.model.contact import Load, sprung_load
from jaxshroud.model.contact_law import (
    ContactLaw,
    ContactLoads,
    ContactPoint,
    FrictionGuard,
    GuardCrossing,
    LawForces,
    LinearLaw,
    Modes,
    Slider,
    starts_in_overlap,
)
from jaxshroud.model.geometry import AtPoint, CaseBlend, Corners, Kinematics, Pose, Rates, RatesAtPoint, blended_case
from jaxshroud.model.modes import Mode
from jaxshroud.model.series import Series


class NoContact(LinearLaw):
    """Blocks that pass through each other."""

    called: ClassVar[str] = "no contact"
    is_examined: ClassVar[bool] = True
    has_events: ClassVar[bool] = False

    @property
    def normal_stiffness(self) -> Scalar:
        """Zero."""
        return ZERO

    def normal_force(self, v: Scalar, mode: Modes) -> Scalar:
        """Zero."""
        del v, mode
        return ZERO

    def forces(self, point: ContactPoint) -> LawForces:
        """All absent."""
        del point
        return LawForces(ZERO, ZERO, ZERO)

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """Zero [J]."""
        del w, mode
        return jnp.zeros_like(v)


class SpringContact(LinearLaw):
    """The normal spring N = k v without friction."""

    called: ClassVar[str] = "located contact"
    is_examined: ClassVar[bool] = True

    k: Scalar  # [N/m]

    @property
    def normal_stiffness(self) -> Scalar:
        """The stiffness k [N/m]."""
        return self.k

    @property
    def stiffnesses(self) -> tuple[Any, ...]:
        """The stiffness of the spring."""
        return (self.k,)

    def normal_force(self, v: Scalar, mode: Modes) -> Scalar:
        """The normal force N = k v in contact [N]."""
        return where(mode == Mode.APART, ZERO, self.k * v)

    def forces(self, point: ContactPoint) -> LawForces:
        """The normal force."""
        return LawForces(self.normal_force(point.at.v, point.mode), ZERO, ZERO)

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy k v^2 / 2 of the spring [J]."""
        del w
        return where(mode == Mode.APART, 0.0, self.k * v * v / 2)

    def load(self, point: ContactPoint, forces: LawForces, block: Corners) -> Load:
        """The load of its forces, for series with fewer products where N = k v allows it."""
        if not isinstance(point.at.turn, Series) or point.reading:
            return super().load(point, forces, block)
        return sprung_load(point.at, self._engaged_stiffness(point.mode), forces.N, forces.F, point.case, block)

    def shift_torque(self, at: Kinematics, forces: LawForces, mode: Modes) -> Scalar:
        """F v - N u, for series with one product."""
        if not isinstance(at.v, Series):
            return super().shift_torque(at, forces, mode)
        return (forces.F - self._engaged_stiffness(mode) * at.u) * at.v

    def _engaged_stiffness(self, mode: Modes) -> Scalar:
        """The stiffness k; absent when apart."""
        return where(mode == Mode.APART, ZERO, self.k)

    def largest_normal_force(self, deepest: Scalar, mode: Modes, at_ends: tuple[Scalar, Scalar]) -> Scalar:
        """The normal force at the largest penetration [N]."""
        del at_ends
        return self.normal_force(deepest, mode)


class BilinearContact(SpringContact):
    """The normal spring and a spring k_d in series with a slider that slips at mu N.

    `mu` and `lag` are 0 where there is no friction for want of a stiffness or a coefficient.
    """

    has_stick: ClassVar[bool] = True

    k_d: Scalar  # [N/m]
    mu: Scalar
    lag: Scalar  # mu k / k_d: stretch of the friction spring in slip, per unit penetration

    @property
    def tangential_stiffness(self) -> Scalar:
        """The stiffness k_d [N/m]."""
        return jnp.where(self.mu > 0, self.k_d, 0.0)

    @property
    def stiffnesses(self) -> tuple[Any, ...]:
        """Those of both springs."""
        return self.k, self.k_d

    def friction_force(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Scalar:
        """The friction force F = k_d (u - u_s) in stick, sigma mu N in slip [N]."""
        slipping = self.mu * (slip_sign(mode, v.dtype) * self.k * v)
        return where(mode == Mode.STICK, self.k_d * (u - u_s), slipping)

    def forces(self, point: ContactPoint) -> LawForces:
        """The normal and the friction force."""
        v, u = point.at.v, point.at.u
        N = self.normal_force(v, point.mode)
        return LawForces(N, self.friction_force(v, u, point.u_s, point.mode), ZERO)

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        """The stretch w of the friction spring [m]: u - u_s in stick, sigma mu N / k_d in slip, 0 apart."""
        return where(mode == Mode.STICK, u - u_s, slip_sign(mode, v.dtype) * self.lag * v)

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy k v^2 / 2 + k_d w^2 / 2 of both springs [J]."""
        return where(mode == Mode.APART, 0.0, (self.k * v * v + self.k_d * w * w) / 2)

    def slider_speed(self, v_rate: Scalar, u_rate: Scalar, mode: Modes) -> Scalar:
        """The rate d(u_s)/dt in slip [m/s]: u' - sigma mu k v' / k_d; zero otherwise."""
        sigma = slip_sign(mode, v_rate.dtype)
        return where(sigma == 0, ZERO, u_rate - sigma * (self.lag * v_rate))

    def dissipated_power(self, point: ContactPoint, forces: LawForces) -> Scalar:
        """F times the speed of the slider [W]."""
        rate = point.rates()
        return forces.F * self.slider_speed(rate.v, rate.u, point.mode)

    def load_rates(self, point: ContactPoint, forces: LawForces) -> ContactLoads:
        """The rates of the loads."""
        slips = is_slipping(point.mode)
        rate = point.rates()
        speed = self.slider_speed(rate.v, rate.u, point.mode)
        return ContactLoads(forces.N, where(slips, forces.N, 0.0), where(slips, 1.0, 0.0), abs(speed))

    def carried_slider(self, u_s: Slider, mode: Modes) -> Slider:
        """The slider."""
        del mode
        return u_s

    def friction_guard(self, at: AtPoint, rate: RatesAtPoint, u_s: Slider, mode: Modes) -> FrictionGuard:
        """The guard in stick, abs(w) - mu k v / k_d, or in slip, the speed of the slider against its direction."""
        apart, stick = mode == Mode.APART, mode == Mode.STICK
        w = at.u - u_s
        sigma = slip_sign(mode, at.v.dtype)
        rubs = self.mu > 0
        # stick may begin at its limit, where a rounding error must not count as slip
        in_stick = jnp.abs(w) - self.lag * at.v - 2 * at.rounding, jnp.sign(w) * rate.u - self.lag * rate.v
        in_slip = -sigma * self.slider_speed(rate.v, rate.u, mode)
        return FrictionGuard(
            where(stick, in_stick[0], where(rubs & ~apart, in_slip, -1.0)),
            where(stick, in_stick[1], 0.0),
            where(stick | apart | ~rubs, 0.0, -sigma * (at.u - sigma * self.lag * at.v)),
        )

    def friction_series(self, at: Kinematics, rate: Rates, u_s: Slider, mode: Modes) -> tuple[Scalar, Scalar]:
        """The guards of the friction element by series: one for each direction in stick; slip needs the first only."""
        apart, stick = mode == Mode.APART, mode == Mode.STICK
        w = at.u - u_s
        limit = self.lag * at.v + 2 * at.rounding  # stick may begin at its limit
        slipping = -slip_sign(mode, at.v.dtype) * self.slider_speed(rate.v, rate.u, mode)
        other = where(apart | (self.mu <= 0), -1.0, slipping)
        return where(stick, w - limit, other), where(stick, -w - limit, -1.0)

    def onset_mode(self, crossing: GuardCrossing) -> Modes:
        """The mode as contact begins: by the rates where v = 0, and stick where the blocks start in overlap.

        In overlap the element is unstretched under a normal force: k_d abs(w) = 0 is less than mu N at any rates.
        """
        at, rate = crossing.at, crossing.rate
        slips = ((jnp.abs(rate.u) > self.lag * rate.v) & ~starts_in_overlap(at, crossing.delay)) | (self.mu == 0)
        return where(slips, slip_mode(rate.u < 0), jnp.int32(Mode.STICK))

    def mode_after_rub(self, crossing: GuardCrossing) -> Modes:
        """Slip away from the slider after stick; stick after slip."""
        return after_friction(crossing)

    def slider_after(self, crossing: GuardCrossing, w: Slider, mode: Modes, u: Scalar) -> Slider:
        """The slide at an onset; else the stretch stays."""
        del mode
        return where(crossing.mode == Mode.APART, slide_at_onset(crossing), u - w)

    def friction_rate(self, rate: RatesAtPoint, mode: Modes) -> Scalar:
        """The rate of the friction force [N/s]."""
        slipping = self.mu * (slip_sign(mode, rate.v.dtype) * self.k * rate.v)
        return where(mode == Mode.STICK, self.k_d * rate.u, slipping)


def slip_sign(mode: Modes, dtype: Any) -> Scalar:
    """sigma: +1 in slip+, -1 in slip-, 0 otherwise."""
    return (mode == Mode.SLIP_PLUS).astype(dtype) - (mode == Mode.SLIP_MINUS).astype(dtype)


def slip_mode(is_negative: Any) -> Modes:
    """The mode of slip by its direction: slip- where that `is_negative`, else slip+."""
    return where(is_negative, jnp.int32(Mode.SLIP_MINUS), jnp.int32(Mode.SLIP_PLUS))


def after_friction(crossing: GuardCrossing) -> Modes:
    """The mode after the guard of a friction element: slip away from the slider after stick; stick after slip."""
    sliding = slip_mode(crossing.at.u < crossing.u_s)
    return where(crossing.mode == Mode.STICK, sliding, jnp.int32(Mode.STICK))


def is_slipping(mode: Modes) -> Any:
    """Whether the slider moves."""
    return (mode == Mode.SLIP_PLUS) | (mode == Mode.SLIP_MINUS)


def slide_at_onset(crossing: GuardCrossing) -> Scalar:
    """The slide u where v = 0, extrapolated back from the located time by the remaining penetration."""
    at, rate, delay = crossing.at, crossing.rate, crossing.delay
    closing = rate.v > 0
    return at.u - rate.u * where(closing, jnp.minimum(at.v / where(closing, rate.v, 1.0), delay), 0.0)


class SmoothContact(ContactLaw):
    """The smooth spring and the smooth friction element; without friction all of `k_d`, `mu` and `lag` are absent."""

    called: ClassVar[str] = "smooth contact"
    has_events: ClassVar[bool] = False
    flows: ClassVar[bool] = True

    k: Scalar  # [N/m]
    k_d: Scalar  # [N/m]
    mu: Scalar
    lag: Scalar  # mu k / k_d: stretch of the friction spring in slip, per unit penetration
    width: Scalar  # [m]
    haste: Scalar  # rate of the slider: the speed of the blades over the width [1/s]

    @property
    def normal_stiffness(self) -> Scalar:
        """The stiffness k far in contact [N/m]."""
        return self.k

    @property
    def tangential_stiffness(self) -> Scalar:
        """The stiffness k_d of small slides [N/m]."""
        return self.k_d if is_zero(self.mu) else jnp.where(self.mu > 0, self.k_d, 0.0)

    @property
    def slider_haste(self) -> Scalar:
        """The rate at which the slider follows [1/s]."""
        return self.haste

    def normal_force(self, v: Scalar) -> Scalar:
        """The normal force [N]."""
        return self.k * _smooth_positive_part(v, self.width)

    def friction_force(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Scalar:
        """The friction force [N]."""
        return self.k_d * self.stretch(v, u, u_s, mode)

    def forces(self, point: ContactPoint) -> LawForces:
        """The normal and the friction force, and the rate of the slider [m/s]."""
        v, u, u_s, mode = point.at.v, point.at.u, point.u_s, point.mode
        N = self.normal_force(v)
        F = self.friction_force(v, u, u_s, mode)
        rate = ZERO if is_zero(self.lag) else self.haste * (u - u_s - self.stretch(v, u, u_s, mode))
        return LawForces(N, F, rate)

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        """The stretch w of the friction spring [m]."""
        del mode
        if is_zero(self.lag):
            return ZERO
        limit = self.lag * _smooth_positive_part(v, self.width)
        return (_smooth_abs(u - u_s + limit, self.width) - _smooth_abs(u - u_s - limit, self.width)) / 2

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy of both springs [J], of which that of the normal force is its integral."""
        del mode
        root = _smooth_abs(v, self.width)
        pressed = v * (v + root) + self.width**2 * jnp.log((v + root) / self.width)
        return (self.k * pressed / 2 + self.k_d * w * w) / 2

    def dissipated_power(self, point: ContactPoint, forces: LawForces) -> Scalar:
        """F times the speed of the slider [W]."""
        del point
        return forces.F * forces.u_s

    def load_rates(self, point: ContactPoint, forces: LawForces) -> ContactLoads:
        """The rates of the loads; nothing separates slip from stick."""
        if is_zero(self.lag):
            return super().load_rates(point, forces)
        return ContactLoads(forces.N, ZERO, ZERO, abs(forces.u_s))

    def case_blend(self, q: Pose, block: Corners) -> CaseBlend:
        """The mixture of the cases over the width."""
        return blended_case(q, block, self.width)

    def carried_mode(self, mode: Modes) -> Modes:
        """There are no modes."""
        return jnp.full_like(mode, Mode.SMOOTH)

    def carried_slider(self, u_s: Slider, mode: Modes) -> Slider:
        """The slider; absent without friction."""
        del mode
        return ZERO if is_zero(self.lag) else u_s

    def largest_normal_force(self, deepest: Scalar, mode: Modes, at_ends: tuple[Scalar, Scalar]) -> Scalar:
        """The normal force at the largest penetration [N]."""
        del mode, at_ends
        return self.normal_force(deepest)


def _smooth_abs(x: Scalar, width: Scalar) -> Scalar:
    return jnp.sqrt(x * x + width * width)


def _smooth_positive_part(v: Scalar, width: Scalar) -> Scalar:
    return (v + _smooth_abs(v, width)) / 2
