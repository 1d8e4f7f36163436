"""The normal spring and the bilinear friction element of Eq. (2), with the slider `u_s` as explicit state."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxshroud.scene import Scalar, Scene
from jaxshroud.state import Mode


class Springs(NamedTuple):
    """Contact stiffnesses of one scene. No stiffness or no friction coefficient: no friction, `mu` and `lag` are 0."""

    k: Scalar  # [N/m]
    k_d: Scalar  # [N/m]
    mu: Scalar
    lag: Scalar  # mu k / k_d: stretch of the friction spring in slip, per unit penetration


def springs(scene: Scene) -> Springs:
    """The scene's contact springs, guarded against 0/0."""
    k, k_d, mu = scene.k, scene.friction.k_d, scene.friction.mu
    rubs = (k > 0) & (k_d > 0) & (mu > 0)
    lag = mu * k / jnp.where(rubs, k_d, 1.0)
    return Springs(k, k_d, jnp.where(rubs, mu, 0.0), jnp.where(rubs, lag, 0.0))


def slip_sign(mode: Int[Array, ""], dtype) -> Scalar:
    """sigma: +1 in slip+, -1 in slip-, 0 otherwise."""
    return (mode == Mode.SLIP_PLUS).astype(dtype) - (mode == Mode.SLIP_MINUS).astype(dtype)


def stretch(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """Stretch w of the friction spring [m]: `u - u_s` in stick, `sigma mu N / k_d` in slip, 0 apart."""
    return jnp.where(mode == Mode.STICK, u - u_s, slip_sign(mode, v.dtype) * spring.lag * v)


def normal_force(v: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """N = k v in contact [N]."""
    return jnp.where(mode == Mode.APART, 0.0, spring.k * v)


def friction_force(v: Scalar, u: Scalar, u_s: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """F = k_d (u - u_s) in stick, sigma mu N in slip [N]; positive against sliding to larger u."""
    slipping = slip_sign(mode, v.dtype) * spring.mu * spring.k * v
    return jnp.where(mode == Mode.STICK, spring.k_d * (u - u_s), slipping)


def slider_speed(v_rate: Scalar, u_rate: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """d(u_s)/dt in slip [m/s]: u' - sigma mu k v' / k_d. Zero otherwise."""
    sigma = slip_sign(mode, v_rate.dtype)
    return jnp.where(sigma == 0, 0.0, u_rate - sigma * spring.lag * v_rate)


def contact_energy(v: Scalar, w: Scalar, mode: Int[Array, ""], spring: Springs) -> Scalar:
    """Energy stored in both contact springs, k v^2/2 + k_d w^2/2 [J]."""
    return jnp.where(mode == Mode.APART, 0.0, (spring.k * v * v + spring.k_d * w * w) / 2)
