"""Closed-form response of the blades while they do not touch: Eq. (1) with the contact forces absent."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float

from jaxshroud.geometry import gyration
from jaxshroud.scene import PerBlade, Scene, Shroud

QUADRATURE = 128  # points over one drive period: exact to rounding while the torsion amplitude is below 50 rad


class Amplitudes(NamedTuple):
    """Complex amplitudes: the displacement is the imaginary part of `amplitude * exp(i omega t)`."""

    x: Complex[Array, "2"]  # [m]
    y: Complex[Array, "2"]  # [m]
    theta: Complex[Array, "2"]  # [rad]


def steady_amplitudes(scene: Scene) -> Amplitudes:
    """Steady response of the free blades to the drive (Sec. 3.1)."""
    b, d, omega = scene.blades, scene.drive, scene.drive.omega

    def response(load, m, c, k):
        force = lax.complex(load * jnp.cos(d.phase), load * jnp.sin(d.phase))
        return force / lax.complex(k - m * omega**2, c * omega)

    return Amplitudes(
        response(d.F_0 * jnp.cos(d.beta), b.m, b.c_x, b.k_x),
        response(d.F_0 * jnp.sin(d.beta), b.inertia_y, b.c_y, b.k_y),
        response(d.M_0, b.I, b.c_T, b.k_T),
    )


def area(shroud: Shroud) -> Float[Array, ""]:
    """Area A of one block [m^2]."""
    return shroud.l_oa * shroud.l_ab * jnp.sin(shroud.alpha)


def free_power(scene: Scene) -> PerBlade:
    """P_0 of Eq. (23), in closed form [m^4].

    Source:
        Over a centrally symmetric block P_0 = A <x^2 + y^2> + 4 J_A <sin^2(theta/2)>; the mean of
        sin^2(Theta sin(tau) / 2) is (1 - J_0(Theta)) / 2, here by the trapezoidal rule, which is exact to rounding.
    """
    free, s = steady_amplitudes(scene), scene.shroud
    tau = jnp.linspace(0, 2 * jnp.pi, QUADRATURE, endpoint=False, dtype=s.gap.dtype)
    swing = jnp.sin(jnp.abs(free.theta)[:, None] * jnp.sin(tau) / 2) ** 2
    translation = (jnp.abs(free.x) ** 2 + jnp.abs(free.y) ** 2) / 2
    return area(s) * (translation + 4 * gyration(s) * jnp.mean(swing, axis=1))
