"""The check that user laws of contact and friction are passive."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.scene.checks import InputError, require_pair
from jaxshroud.scene.laws import Laws
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed

CYCLE_POINTS = 4000  # of the cycle through which the laws are taken
POWER_ROUNDING = 1e-9  # of the largest power, or energy, in the cycle
CycleSamples = Float[Array, " points"]


class LoadingCycle(NamedTuple):
    """The forces, energies and powers of laws while a contact is pressed and released, and slides to and fro."""

    N: CycleSamples
    F: CycleSamples
    energy: CycleSamples  # stored
    spare: CycleSamples  # its spurious dependence on v_t, u_t or N
    normal_power: CycleSamples  # given to the normal law [W]
    friction_power: CycleSamples
    normal_loss: CycleSamples  # power dissipated [W]
    friction_loss: CycleSamples


@typed
def check_laws(scene: Scene) -> None:
    """Take the user laws of a scene through a cycle of loading and sliding, and refuse laws that are not passive.

    The penetration rises to the gap's size and falls back, while the blocks slide to and fro by as much, within a
    period of the drive and within a hundredth of one.

    Args:
        scene: A scene `with_laws`.

    Raises:
        InputError: The scene has no user laws; or one of them is not finite, stores energy where nothing is pressed,
            stores energy that depends on more than v and z, or returns more work than it has received.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1").scene
        >>> js.check_laws(js.with_laws(scene, js.Hertz(4e7)))
        >>> js.check_laws(js.with_laws(scene, lambda v, v_t: (1e6 * v - 10 * v_t, 5e5 * v**2)))
        Traceback (most recent call last):
        ...
        jaxshroud.scene.checks.InputError: The normal law gives out more work than it was given.
    """
    require_pair("`check_laws`", scene.row)
    if scene.laws is None:
        raise InputError("This scene has no own laws; see js.with_laws.")
    size, omega = jnp.abs(scene.shroud.gap) + 1e-9, scene.drive.omega
    for speed in (omega, 100 * omega):
        _check_passive(scene.laws, jax.tree.map(np.asarray, _loading_cycle(scene.laws, size, speed)))


def _check_passive(laws: Laws, values: LoadingCycle) -> None:
    """Raise InputError unless the laws are finite and passive."""
    energies = max(np.max(np.abs(values.energy)), 1e-30)
    losses = (
        ("normal", values.normal_power, values.normal_loss),
        ("friction", values.friction_power, values.friction_loss),
    )
    for law, power, loss in losses:
        if not np.all(np.isfinite([values.N, values.F, values.energy, loss])):
            raise InputError(f"The {law} law is not finite; mind quotients by N, which is 0 where contact begins.")
        if np.any(loss < -POWER_ROUNDING * np.max(np.abs(power))):
            raise InputError(f"The {law} law gives out more work than it was given.")
    if abs(float(laws.energy(jnp.zeros(()), laws.z))) > POWER_ROUNDING * energies:
        raise InputError("The laws store energy where nothing is pressed yet: that of v = 0 and the first z must be 0.")
    if np.any(np.abs(values.spare) > POWER_ROUNDING * energies):
        raise InputError("The energy of a law must depend on nothing but v, or z.")


@jax.jit
def _loading_cycle(laws: Laws, size: Float[Array, ""], omega: Float[Array, ""]) -> LoadingCycle:
    """The laws along a cycle of angular frequency `omega`; z follows by the classical Runge-Kutta method."""
    h = 2 * math.pi / CYCLE_POINTS

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

    taus = jnp.arange(CYCLE_POINTS, dtype=omega.dtype) * h
    _, states = jax.lax.scan(step, laws.z, taus)
    return jax.vmap(lambda tau, z: _law_values(laws, *motion(tau), z))(taus, states)


def _law_values(laws: Laws, v, v_t, u_t, z) -> LoadingCycle:
    N, zero = jnp.maximum(laws.push(v, v_t), 0.0), jnp.zeros_like(v)
    energy, F, loss = laws.energy(v, z), zero, zero
    spare = laws.normal(v, v_t)[1] - laws.normal(v, zero)[1]
    if laws.friction is not None:
        F, z_t = laws.rub(z, u_t, N)
        loss = F * u_t - laws.stored_power(v, z, zero, z_t)
        spare = jnp.abs(spare) + jnp.abs(laws.friction(z, u_t, N)[2] - laws.friction(z, zero, zero)[2])
    stored = laws.stored_power(v, z, v_t, jnp.zeros_like(z))
    return LoadingCycle(N, F, energy, spare, N * v_t, F * u_t, N * v_t - stored, loss)
