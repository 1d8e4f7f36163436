"""Smooth contact: the article's law with hyperbolas of a given width in place of its corners, and without events.

N = k (v + sqrt(v^2 + width^2)) / 2, and a friction spring whose elastic stretch bends over at mu N / k_d. The slider
follows the excess, at a rate inverse to the width; it is integrated with the motion. Between the four cases there is a
mixture, and there are no modes.
"""

from typing import ClassVar

import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero
from jaxshroud.model.contact_law import ContactLaw, ContactLoads, ContactPoint, LawForces, Modes, Slider
from jaxshroud.model.geometry import CaseBlend, Corners, Pose, blended_case
from jaxshroud.model.modes import Mode


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
