"""Ready-made laws of contact and friction, which are also examples of user laws."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.key import FROM_0, POSITIVE, Range
from jaxshroud.scene.laws import Number
from jaxshroud.scene.scene import scalar
from jaxshroud.scene.typed import are_numbers, short_repr


class _Law(eqx.Module):
    """The base of laws whose fields are numbers in ranges, which numbers that are being traced are not held to."""

    ranges: ClassVar[dict[str, Range]]

    def __check_init__(self):
        for name, value in vars(self).items():
            what = f"Argument `{name}` of {type(self).__name__}"
            if not are_numbers(value):
                raise InputError(f"{what} must be a number, but is {short_repr(value)}.")
            if is_traced(value):
                continue
            numbers = np.ravel(value)
            wrong = numbers[~self.ranges[name].holds(numbers)]
            if len(wrong):
                raise InputError(f"{what} {self.ranges[name].fault(float(wrong[0]))}, but is {wrong[0]:g}.")


class Hertz(_Law):
    """The law N = k v^(3/2) between round surfaces.

    Source:
        Hertz's contact of an ellipsoid with a plane, to first order in v over the radii.
    """

    ranges = {"k": POSITIVE}  # noqa: RUF012  a class variable, see the base
    k: Number = eqx.field(converter=scalar)  # [N/m^1.5]

    def __call__(self, v, v_t):
        """The normal force and the energy."""
        root = jnp.sqrt(jnp.where(v > 0, v, 1.0))
        pressed = jnp.where(v > 0, v * root, 0.0)
        return self.k * pressed, 0.4 * self.k * pressed * v


class DampedSpring(_Law):
    """A spring that stiffens beyond a depth, parallel to a dashpot: N jumps at the onset of contact."""

    ranges = {"k": POSITIVE, "k_deep": FROM_0, "depth": FROM_0, "c": FROM_0}  # noqa: RUF012
    k: Number = eqx.field(converter=scalar)  # [N/m]
    k_deep: Number = eqx.field(converter=scalar)  # beyond the depth [N/m]
    depth: Number = eqx.field(converter=scalar)  # [m]
    c: Number = eqx.field(converter=scalar)  # [N s/m]

    def __call__(self, v, v_t):
        """The normal force and the energy."""
        deep, more = jnp.maximum(v - self.depth, 0.0), self.k_deep - self.k
        return self.k * v + more * deep + self.c * v_t, (self.k * v * v + more * deep * deep) / 2


class RegularisedCoulomb(_Law):
    """The law F = mu N tanh(u_t / speed): Coulomb's law, regularised over a sliding speed and without stick."""

    ranges = {"mu": FROM_0, "speed": POSITIVE}  # noqa: RUF012
    mu: Number = eqx.field(converter=scalar)
    speed: Number = eqx.field(converter=scalar)  # [m/s]

    def __call__(self, z, u_t, N):
        """The friction force; the internal state is constant, and no energy is stored."""
        return self.mu * N * jnp.tanh(u_t / self.speed), jnp.zeros_like(z), jnp.zeros_like(N)


class LuGre(_Law):
    """Bristles with the deflection z: z_t = u_t - k_d abs(u_t) z / (mu (N + N_0)), F = k_d z + c z_t.

    Without the force N_0, which is small against N, bristles would bend infinitely fast where contact ends. Where N
    falls faster than k_d N_0 / c, the damping of bristles that cannot follow gives out work; see `check_laws`.

    Source:
        The law of Canudas de Wit, Olsson, Astrom and Lischinsky without its Stribeck and viscous terms.
    """

    ranges = {"k_d": POSITIVE, "c": FROM_0, "mu": POSITIVE, "N_0": POSITIVE}  # noqa: RUF012
    k_d: Number = eqx.field(converter=scalar)  # [N/m]
    c: Number = eqx.field(converter=scalar)  # [N s/m]
    mu: Number = eqx.field(converter=scalar)
    N_0: Number = eqx.field(converter=scalar)  # [N]

    def __call__(self, z, u_t, N):
        """The friction force, the rate of the deflection and the energy of the bristles."""
        z_t = u_t - self.k_d * jnp.abs(u_t) * z / (self.mu * (N + self.N_0))
        return self.k_d * z + self.c * z_t, z_t, self.k_d * z * z / 2
