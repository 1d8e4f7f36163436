"""The normal spring and the bilinear friction element of Eq. (2), with the slider `u_s` as explicit state.

**Smooth contact** replaces the corners of both laws by hyperbolas of a given width: N = k (v + sqrt(v^2 + width^2)) / 2
and a friction spring whose elastic stretch bends over at mu N / k_d. The slider follows what is beyond that, the faster
the smaller the width; it is integrated with the motion, and there is nothing to locate.

**Own laws** (`scene.laws`) take the place of both: their internal state z is integrated with the motion in the slider's
place, and contact lasts while they push.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.model.absent import ABSENT, Scalar, is_absent, where
from jaxshroud.model.modes import Mode

Slider = Any  # a scalar, or the state z of own laws, of any shape


class Springs(NamedTuple):
    """Contact stiffnesses of one scene.

    No stiffness or no friction coefficient: no friction, `mu` and `lag` are 0. A scene whose model has no friction
    lacks all but the first of them, one without contact that as well.
    """

    k: Scalar  # [N/m]
    k_d: Scalar  # [N/m]
    mu: Scalar
    lag: Scalar  # mu k / k_d: stretch of the friction spring in slip, per unit penetration
    width: Scalar = ABSENT  # of smooth contact [m]; absent where contact sets in at once
    haste: Scalar = ABSENT  # at which its slider follows: the blades' speed over the width [1/s]
    laws: Any = ABSENT  # the user's own, which take the place of all but k; absent where there are none

    @property
    def smooth(self) -> bool:
        """Whether contact is smooth."""
        return not is_absent(self.width)

    @property
    def flows(self) -> bool:
        """Whether the slider, or what takes its place, is integrated with the motion."""
        return self.smooth or not is_absent(self.laws)

    @property
    def modal(self) -> bool:
        """Whether contact has modes, and events between them."""
        return is_absent(self.width) and not is_absent(self.k)


def slip_sign(mode: Int[Array, ""], dtype) -> Scalar:
    """sigma: +1 in slip+, -1 in slip-, 0 otherwise."""
    return (mode == Mode.SLIP_PLUS).astype(dtype) - (mode == Mode.SLIP_MINUS).astype(dtype)


def stretch(v: Scalar, u: Scalar, u_s: Slider, mode: Int[Array, ""], spring: Springs) -> Slider:
    """Stretch w of the friction spring [m]: `u - u_s` in stick, `sigma mu N / k_d` in slip, 0 apart; of own laws z."""
    if not is_absent(spring.laws):
        return u_s
    if is_absent(spring.lag):
        return ABSENT
    if spring.smooth:
        limit = spring.lag * _softened(v, spring.width)
        return (_root(u - u_s + limit, spring.width) - _root(u - u_s - limit, spring.width)) / 2
    return where(mode == Mode.STICK, u - u_s, slip_sign(mode, v.dtype) * spring.lag * v)


def normal_force(v: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """N = k v in contact [N]."""
    if spring.smooth:
        return spring.k * _softened(v, spring.width)
    return where(mode == Mode.APART, ABSENT, spring.k * v)


def friction_force(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """F = k_d (u - u_s) in stick, sigma mu N in slip [N]; positive against sliding to larger u."""
    if spring.smooth:
        return spring.k_d * stretch(v, u, u_s, mode, spring)
    slipping = spring.mu * (slip_sign(mode, v.dtype) * spring.k * v)
    return where(mode == Mode.STICK, spring.k_d * (u - u_s), slipping)


def slider_speed(v_rate: Scalar, u_rate: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """d(u_s)/dt in slip [m/s]: u' - sigma mu k v' / k_d. Zero otherwise."""
    sigma = slip_sign(mode, v_rate.dtype)
    return where(sigma == 0, ABSENT, u_rate - sigma * (spring.lag * v_rate))


def following(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """d(u_s)/dt of smooth contact [m/s]; absent where the slider moves by events, or there is none."""
    if not spring.smooth or is_absent(spring.lag):
        return ABSENT
    return spring.haste * (u - u_s - stretch(v, u, u_s, mode, spring))


def _root(x: Scalar, width: Scalar) -> Scalar:
    return jnp.sqrt(x * x + width * width)


def _softened(v: Scalar, width: Scalar) -> Scalar:
    return (v + _root(v, width)) / 2


def contact_energy(v: Scalar, w: Slider, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """Energy stored in both contact springs, k v^2/2 + k_d w^2/2 [J]; by own laws that of v and z."""
    if not is_absent(spring.laws):
        return jnp.where(mode == Mode.APART, 0.0, spring.laws.energy(jnp.maximum(v, 0.0), w))
    if spring.smooth:
        root = _root(v, spring.width)
        pressed = v * (v + root) + spring.width**2 * jnp.log((v + root) / spring.width)
        return (spring.k * pressed / 2 + spring.k_d * w * w) / 2
    return jnp.where(mode == Mode.APART, 0.0, (spring.k * v * v + spring.k_d * w * w) / 2)
