"""Some laws of contact and friction, as examples of own ones and for use."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshroud.scene.scene import scalar

Number = Float[Array, "..."]


class Hertz(eqx.Module):
    """N = k v^(3/2) between round surfaces.

    Source:
        Hertz's contact of an ellipsoid with a plane, to first order in v over the radii.
    """

    k: Number = eqx.field(converter=scalar)  # [N/m^1.5]

    def __call__(self, v, v_t):
        """Normal force and energy."""
        root = jnp.sqrt(jnp.where(v > 0, v, 1.0))
        pressed = jnp.where(v > 0, v * root, 0.0)
        return self.k * pressed, 0.4 * self.k * pressed * v


class DampedSpring(eqx.Module):
    """A spring that is stiffer beyond a depth, with a dashpot beside it: N jumps where contact sets in."""

    k: Number = eqx.field(converter=scalar)  # [N/m]
    k_deep: Number = eqx.field(converter=scalar)  # beyond the depth [N/m]
    depth: Number = eqx.field(converter=scalar)  # [m]
    c: Number = eqx.field(converter=scalar)  # [N s/m]

    def __call__(self, v, v_t):
        """Normal force and energy."""
        deep, more = jnp.maximum(v - self.depth, 0.0), self.k_deep - self.k
        return self.k * v + more * deep + self.c * v_t, (self.k * v * v + more * deep * deep) / 2


class RegularisedCoulomb(eqx.Module):
    """F = mu N tanh(u_t / speed): Coulomb's law with its jump spread over a sliding speed; there is no stick."""

    mu: Number = eqx.field(converter=scalar)
    speed: Number = eqx.field(converter=scalar)  # [m/s]

    def __call__(self, z, u_t, N):
        """Friction force; the internal state rests, and nothing is stored."""
        return self.mu * N * jnp.tanh(u_t / self.speed), jnp.zeros_like(z), jnp.zeros_like(N)


class LuGre(eqx.Module):
    """Bristles of deflection z: z_t = u_t - k_d abs(u_t) z / (mu (N + N_0)), F = k_d z + c z_t.

    Without the force N_0, small against N, bristles would bend infinitely fast where contact ends.

    Source:
        The law of Canudas de Wit, Olsson, Astrom and Lischinsky without its Stribeck and viscous terms.
    """

    k_d: Number = eqx.field(converter=scalar)  # [N/m]
    c: Number = eqx.field(converter=scalar)  # [N s/m]
    mu: Number = eqx.field(converter=scalar)
    N_0: Number = eqx.field(converter=scalar)  # [N]

    def __call__(self, z, u_t, N):
        """Friction force, rate of the deflection and energy of the bristles."""
        z_t = u_t - self.k_d * jnp.abs(u_t) * z / (self.mu * (N + self.N_0))
        return self.k_d * z + self.c * z_t, z_t, self.k_d * z * z / 2
