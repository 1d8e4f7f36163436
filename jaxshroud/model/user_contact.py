"""Contact by user laws, the functions that a scene holds as `scene.laws`.

Their internal state z is integrated with the motion in place of the slider. Contact lasts while they push.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where
from jaxshroud.model.contact_law import ContactLaw, ContactPoint, GuardCrossing, LawForces, Modes, Slider
from jaxshroud.model.geometry import AtPoint, RatesAtPoint
from jaxshroud.model.modes import Mode
from jaxshroud.scene.laws import Laws


class UserContact(ContactLaw):
    """User laws of contact and friction, and the largest stiffnesses that their user states for them."""

    marches_in_rows: ClassVar[bool] = False
    flows: ClassVar[bool] = True
    relaxes: ClassVar[bool] = True
    jumps_at_onset: ClassVar[bool] = True
    may_create_energy: ClassVar[bool] = True

    k: Scalar  # [N/m]
    k_d: Scalar  # [N/m]
    laws: Laws

    @property
    def normal_stiffness(self) -> Scalar:
        """The stated stiffness of the normal law [N/m]."""
        return self.k

    @property
    def tangential_stiffness(self) -> Scalar:
        """The stated stiffness of the friction law [N/m]."""
        return self.k_d

    def relaxation(self, speed: Scalar) -> Scalar:
        """The fastest relaxation rate of z in unloaded faces [1/s]."""
        if self.laws.friction is None:
            return jnp.zeros_like(speed)
        z = jnp.asarray(self.laws.z, speed.dtype)

        def rate(u_t: Scalar) -> Scalar:
            by_z = jax.jacfwd(lambda z: jnp.ravel(self.laws.rub(z, u_t, jnp.zeros_like(u_t))[1]))(z)
            return jnp.max(jnp.sum(jnp.abs(by_z.reshape(z.size, z.size)), axis=-1))

        return jnp.maximum(rate(speed), rate(-speed))

    def forces(self, point: ContactPoint) -> LawForces:
        """The forces of the laws and the rate of z; a normal force cannot pull."""
        rate, touches = point.rates(), point.mode != Mode.APART
        N = where(touches, jnp.maximum(self.laws.push(jnp.maximum(point.at.v, 0.0), rate.v), 0.0), 0.0)
        if is_zero(point.u_s):
            return LawForces(N, ZERO, ZERO)
        F, z_t = self.laws.rub(point.u_s, rate.u, N)
        return LawForces(N, where(touches, F, 0.0), where(touches, z_t, jnp.zeros_like(z_t)))

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        """The state z."""
        del v, u, mode
        return u_s

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy stored in the laws [J]."""
        return where(mode == Mode.APART, 0.0, self.laws.energy(jnp.maximum(v, 0.0), w))

    def dissipated_power(self, point: ContactPoint, forces: LawForces) -> Scalar:
        """What the laws do not store of the power that they get [W]."""
        rate = point.rates()
        v, v_t = jnp.maximum(point.at.v, 0.0), where(point.at.v > 0, rate.v, 0.0)
        stored = self.laws.stored_power(v, point.u_s, v_t, forces.u_s)
        return where(point.mode == Mode.APART, 0.0, forces.N * rate.v + forces.F * rate.u - stored)

    def carried_slider(self, u_s: Slider, mode: Modes) -> Slider:
        """The state z, by default the first one; absent without a friction law."""
        if self.laws.friction is None:
            return ZERO
        z = self.laws.z
        fits = jnp.shape(u_s) == z.shape
        return jnp.where(mode == Mode.APART, z, u_s) if fits else z

    def lift_guard(self, at: AtPoint, rate: RatesAtPoint, apart: Bool[Array, ""]) -> tuple[Scalar, Scalar]:
        """That of `ContactLaw`; in contact the normal law must push as well."""
        push = self.laws.push(jnp.maximum(at.v, 0.0), rate.v) / self.k  # a length, as v is
        sign = where((at.v > 0) & (push <= 0), -1.0, 1.0)  # apart although the corners overlap
        in_contact = -jnp.minimum(at.v, push), where(push < at.v, 0.0, -rate.v)
        return where(apart, sign * at.v, in_contact[0]), where(apart, sign * rate.v, in_contact[1])

    def slider_after(self, crossing: GuardCrossing, w: Slider, mode: Modes, u: Scalar) -> Slider:
        """The state z goes on while contact lasts, and is the first one at an onset."""
        del w, u
        if is_zero(crossing.u_s):
            return ZERO
        in_contact = (crossing.mode != Mode.APART) & (mode != Mode.APART)
        return where(in_contact, crossing.u_s, self.laws.z)
