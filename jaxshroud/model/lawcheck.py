"""Whether own laws of contact and friction do what such laws must."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.scene.errors import InputError
from jaxshroud.scene.laws import Laws
from jaxshroud.scene.scene import Scene

POINTS = 4000  # of the cycle that the laws are taken through
ROUNDING = 1e-9  # of the largest power that a law is given, or of the energy, in it
Course = Float[Array, " points"]


class Cycle(NamedTuple):
    """What laws say while a contact is pressed and released, and rubs to and fro."""

    N: Course
    F: Course
    energy: Course  # stored
    spare: Course  # what of it changes with v_t, u_t or N alone
    normal_power: Course  # given to the normal law [W]
    friction_power: Course
    normal_loss: Course  # power dissipated [W]
    friction_loss: Course


def check_laws(scene: Scene) -> None:
    """Take the own laws of a scene through a cycle of loading and sliding, and refuse what no passive law does.

    The penetration rises to the gap's size and falls back, while the blocks slide to and fro by as much, within a
    period of the drive and within a hundredth of one.

    Args:
        scene: A scene `with_laws`.

    Raises:
        InputError: The scene has no own laws; or one of them is not finite, stores energy where nothing is pressed or
            by more than v and z, or gives out more work than it was given.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1").scene
        >>> js.check_laws(js.with_laws(scene, js.Hertz(4e7)))
        >>> js.check_laws(js.with_laws(scene, lambda v, v_t: (1e6 * v - 10 * v_t, 5e5 * v**2)))
        Traceback (most recent call last):
        ...
        jaxshroud.scene.errors.InputError: The normal law gives out more work than it was given.
    """
    if scene.laws is None:
        raise InputError("This scene has no own laws; see js.with_laws.")
    size, omega = jnp.abs(scene.shroud.gap) + 1e-9, scene.drive.omega
    for speed in (omega, 100 * omega):
        _refuse(scene.laws, jax.tree.map(np.asarray, _cycle(scene.laws, size, speed)))


def _refuse(laws: Laws, seen: Cycle) -> None:
    """Raise InputError for what is wrong with the laws."""
    energies = max(np.max(np.abs(seen.energy)), 1e-30)
    losses = ("normal", seen.normal_power, seen.normal_loss), ("friction", seen.friction_power, seen.friction_loss)
    for law, given, loss in losses:
        if not np.all(np.isfinite([seen.N, seen.F, seen.energy, loss])):
            raise InputError(f"The {law} law is not finite; mind quotients by N, which is 0 where contact begins.")
        if np.any(loss < -ROUNDING * np.max(np.abs(given))):
            raise InputError(f"The {law} law gives out more work than it was given.")
    if abs(float(laws.energy(jnp.zeros(()), laws.z))) > ROUNDING * energies:
        raise InputError("The laws store energy where nothing is pressed yet: that of v = 0 and the first z must be 0.")
    if np.any(np.abs(seen.spare) > ROUNDING * energies):
        raise InputError("The energy of a law must depend on nothing but v, or z.")


@jax.jit
def _cycle(laws: Laws, size: Float[Array, ""], omega: Float[Array, ""]) -> Cycle:
    """What the laws say at points of a cycle of an angular frequency; z by the classical Runge-Kutta method."""
    h = 2 * math.pi / POINTS

    def motion(tau):
        v, v_t = size * (1 - jnp.cos(tau)) / 2, size * omega * jnp.sin(tau) / 2
        return v, v_t, 2 * size * omega * jnp.cos(2 * tau)

    def rate(tau, z):
        v, v_t, u_t = motion(tau)
        return laws.rub(z, u_t, jnp.maximum(laws.push(v, v_t), 0.0))[1] / omega

    def step(z, tau):
        if laws.friction is None:
            return z, z
        a = rate(tau, z)
        b = rate(tau + h / 2, z + h / 2 * a)
        c = rate(tau + h / 2, z + h / 2 * b)
        return z + h / 6 * (a + 2 * b + 2 * c + rate(tau + h, z + h * c)), z

    taus = jnp.arange(POINTS, dtype=omega.dtype) * h
    _, states = jax.lax.scan(step, laws.z, taus)
    return jax.vmap(lambda tau, z: _seen(laws, *motion(tau), z))(taus, states)


def _seen(laws: Laws, v, v_t, u_t, z) -> Cycle:
    N, still = jnp.maximum(laws.push(v, v_t), 0.0), jnp.zeros_like(v)
    energy, F, loss = laws.energy(v, z), still, still
    spare = laws.normal(v, v_t)[1] - laws.normal(v, still)[1]
    if laws.friction is not None:
        F, z_t = laws.rub(z, u_t, N)
        loss = F * u_t - laws.stored_power(v, z, still, z_t)
        spare = jnp.abs(spare) + jnp.abs(laws.friction(z, u_t, N)[2] - laws.friction(z, still, still)[2])
    stored = laws.stored_power(v, z, v_t, jnp.zeros_like(z))
    return Cycle(N, F, energy, spare, N * v_t, F * u_t, N * v_t - stored, loss)
