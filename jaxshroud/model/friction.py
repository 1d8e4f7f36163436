"""The normal spring and the bilinear friction element of Eq. (2), with the slider `u_s` as explicit state.

**Smooth contact** replaces the corners of both laws by hyperbolas of a given width: N = k (v + sqrt(v^2 + width^2)) / 2
and a friction spring whose elastic stretch bends over at mu N / k_d. The slider follows the excess, at a rate
inverse to the width; it is integrated with the motion, and there are no events to locate.

**User laws** (`scene.laws`) replace both: their internal state z is integrated with the motion in place of the slider,
and contact lasts while they push.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.model.arithmetic import ABSENT, Scalar, is_absent, where
from jaxshroud.model.modes import Mode

Slider = Any  # a scalar, or the state z of own laws, of any shape


class Springs(NamedTuple):
    """The contact stiffnesses of one scene.

    Without a stiffness or a friction coefficient there is no friction: `mu` and `lag` are 0. In a model without
    friction all but `k` are absent, and in one without contact `k` as well.
    """

    k: Scalar  # [N/m]
    k_d: Scalar  # [N/m]
    mu: Scalar
    lag: Scalar  # mu k / k_d: stretch of the friction spring in slip, per unit penetration
    width: Scalar = ABSENT  # of smooth contact [m]; absent for other contact
    haste: Scalar = ABSENT  # rate of its slider: the speed of the blades over the width [1/s]
    laws: Any = ABSENT  # user laws, which replace all but k; absent without them

    @property
    def smooth(self) -> bool:
        """Whether contact is smooth."""
        return not is_absent(self.width)

    @property
    def flows(self) -> bool:
        """Whether the slider, or the state of a user law, is integrated with the motion."""
        return self.smooth or not is_absent(self.laws)

    @property
    def modal(self) -> bool:
        """Whether contact has modes with events between them."""
        return is_absent(self.width) and not is_absent(self.k)


def slip_sign(mode: Int[Array, ""], dtype) -> Scalar:
    """sigma: +1 in slip+, -1 in slip-, 0 otherwise."""
    return (mode == Mode.SLIP_PLUS).astype(dtype) - (mode == Mode.SLIP_MINUS).astype(dtype)


def stretch(v: Scalar, u: Scalar, u_s: Slider, mode: Int[Array, ""], spring: Springs) -> Slider:
    """The stretch w of the friction spring [m]: u - u_s in stick, sigma mu N / k_d in slip, 0 apart; user laws: z."""
    if not is_absent(spring.laws):
        return u_s
    if is_absent(spring.lag):
        return ABSENT
    if spring.smooth:
        limit = spring.lag * _smooth_positive_part(v, spring.width)
        return (_smooth_abs(u - u_s + limit, spring.width) - _smooth_abs(u - u_s - limit, spring.width)) / 2
    return where(mode == Mode.STICK, u - u_s, slip_sign(mode, v.dtype) * spring.lag * v)


def normal_force(v: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """The normal force N = k v in contact [N]."""
    if spring.smooth:
        return spring.k * _smooth_positive_part(v, spring.width)
    return where(mode == Mode.APART, ABSENT, spring.k * v)


def friction_force(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """The friction force F = k_d (u - u_s) in stick, sigma mu N in slip [N]; positive against sliding to larger u."""
    if spring.smooth:
        return spring.k_d * stretch(v, u, u_s, mode, spring)
    slipping = spring.mu * (slip_sign(mode, v.dtype) * spring.k * v)
    return where(mode == Mode.STICK, spring.k_d * (u - u_s), slipping)


def slider_speed(v_rate: Scalar, u_rate: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """The rate d(u_s)/dt in slip [m/s]: u' - sigma mu k v' / k_d; zero otherwise."""
    sigma = slip_sign(mode, v_rate.dtype)
    return where(sigma == 0, ABSENT, u_rate - sigma * (spring.lag * v_rate))


def smooth_slider_rate(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """The rate d(u_s)/dt of smooth contact [m/s]; absent where the slider moves by events, or there is none."""
    if not spring.smooth or is_absent(spring.lag):
        return ABSENT
    return spring.haste * (u - u_s - stretch(v, u, u_s, mode, spring))


def _smooth_abs(x: Scalar, width: Scalar) -> Scalar:
    return jnp.sqrt(x * x + width * width)


def _smooth_positive_part(v: Scalar, width: Scalar) -> Scalar:
    return (v + _smooth_abs(v, width)) / 2


def contact_energy(v: Scalar, w: Slider, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """The energy stored in both contact springs, k v^2/2 + k_d w^2/2 [J], or in user laws."""
    if not is_absent(spring.laws):
        return where(mode == Mode.APART, 0.0, spring.laws.energy(jnp.maximum(v, 0.0), w))
    if spring.smooth:
        root = _smooth_abs(v, spring.width)
        pressed = v * (v + root) + spring.width**2 * jnp.log((v + root) / spring.width)
        return (spring.k * pressed / 2 + spring.k_d * w * w) / 2
    if is_absent(spring.k):
        return jnp.zeros_like(v)
    return where(mode == Mode.APART, 0.0, (spring.k * v * v + spring.k_d * w * w) / 2)
