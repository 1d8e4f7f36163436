"""Laws of the normal force and of friction, of which `js.Laws` makes a law of contact: their interface, and examples.

| law | is called with | returns |
|---|---|---|
| normal | penetration v >= 0 [m] and its rate v_t [m/s] | normal force N [N], energy stored [J] |
| friction | internal state z, sliding speed u_t [m/s], N | friction force F [N], rate of z, energy stored [J] |

The energies depend on v or on z only, and are 0 at v = 0 and at the first z; all other work is dissipated. Contact
begins where v and N are positive and ends where either no longer is: a normal force cannot pull. Both laws are JAX
functions that are finite where N = 0; the arrays of a law that is an `eqx.Module` are numbers of the scene, over which
one can batch and by which one can differentiate. Laws with scalars only, z included, are compiled into the same kernel
as everything else.
"""

from abc import abstractmethod
from typing import ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.fields import scalar
from jaxshroud.scene.key import FROM_0, POSITIVE, Range
from jaxshroud.scene.typed import are_numbers, short_repr

Number = Float[Array, "..."]  # of one scene, or with the leading axes of many


@runtime_checkable
class NormalLaw(Protocol):
    """The interface of a law of the normal force."""

    def __call__(self, v: Number, v_t: Number, /) -> tuple[ArrayLike, ArrayLike]:
        """The normal force [N] and the energy [J] at a penetration v [m] and its rate [m/s]."""
        ...


@runtime_checkable
class FrictionLaw(Protocol):
    """The interface of a law of friction."""

    def __call__(self, z: Number, u_t: Number, N: Number, /) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """The friction force [N], the rate of z and the energy [J] at an internal state z, a speed u_t [m/s] and N."""
        ...


class SceneLaw(eqx.Module):
    """A law of contact that a scene can hold: a `ContactLaw` of `model.contact_law`."""

    @property
    @abstractmethod
    def has_friction(self) -> bool:
        """Whether the faces rub."""


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
        deep = jnp.maximum(v - self.depth, 0.0)
        more = self.k_deep - self.k
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
