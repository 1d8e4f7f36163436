"""Own laws of contact and friction: what a user's functions must say, and where a scene keeps them.

| law | is called with | returns |
|---|---|---|
| normal | penetration v >= 0 [m] and its rate v_t [m/s] | normal force N [N], energy stored [J] |
| friction | internal state z, sliding speed u_t [m/s], N | friction force F [N], rate of z, energy stored [J] |

The energies are functions of v and of z alone, 0 at v = 0 and at the first z; what else the forces work is dissipated.
Contact begins where v and N are positive and ends where either no longer is: a normal force that would pull is none.
Both laws are functions of JAX, finite where N = 0; as `eqx.Module`s their arrays are numbers of the scene, that one can
batch over and differentiate by. Laws of scalars alone, z too, are compiled with all else into one kernel.
"""

from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxshroud.scene.errors import InputError

Number = Float[Array, ""]


@runtime_checkable
class NormalLaw(Protocol):
    """A law of the normal force."""

    def __call__(self, v: Any, v_t: Any, /) -> tuple[Any, Any]:
        """Normal force [N] and energy [J] at a penetration v [m] and its rate [m/s]."""
        ...


@runtime_checkable
class FrictionLaw(Protocol):
    """A law of friction."""

    def __call__(self, z: Any, u_t: Any, N: Any, /) -> tuple[Any, Any, Any]:
        """Friction force [N], rate of z and energy [J] at an internal state, a sliding speed [m/s] and N."""
        ...


class _Held(eqx.Module):
    """A function of which the arrays are leaves, and all else is static."""

    arrays: Any
    rest: Any = eqx.field(static=True)

    def __init__(self, function: Any):
        self.arrays, self.rest = eqx.partition(function, eqx.is_array)

    def __call__(self, *args: Any) -> Any:
        return eqx.combine(self.arrays, self.rest)(*args)


class Laws(eqx.Module):
    """Own laws of a scene."""

    normal: _Held
    friction: _Held | None
    z: Array  # at every first touch

    def __init__(self, normal: NormalLaw, friction: FrictionLaw | None = None, z: ArrayLike = 0.0):
        self.normal, self.friction = _Held(normal), None if friction is None else _Held(friction)
        self.z = jnp.asarray(z, float)

    def push(self, v: Any, v_t: Any) -> Any:
        """Normal force at a penetration of at least 0; negative where it would pull [N]."""
        return self.normal(v, v_t)[0]

    def rub(self, z: Any, u_t: Any, N: Any) -> tuple[Any, Any]:
        """Friction force [N] and rate of the internal state."""
        assert self.friction is not None
        return self.friction(z, u_t, N)[:2]

    def energy(self, v: Any, z: Any) -> Any:
        """Energy stored at a penetration of at least 0 and an internal state [J]."""
        still = jnp.zeros_like(v)
        stored = self.normal(v, still)[1]
        return stored if self.friction is None else stored + self.friction(z, still, still)[2]

    def stored_power(self, v: Any, z: Any, v_t: Any, z_t: Any) -> Any:
        """Rate of that energy [W]."""
        if self.friction is None:
            return jax.jvp(lambda v: self.energy(v, z), (v,), (v_t,))[1]
        return jax.jvp(self.energy, (v, z), (v_t, z_t))[1]


def shaped(laws: Laws) -> Laws:
    """The laws, once they are known to return numbers of the right shapes.

    Raises:
        InputError: They do not.
    """
    one, z = jax.ShapeDtypeStruct((), laws.z.dtype), jax.ShapeDtypeStruct(laws.z.shape, laws.z.dtype)
    _returns("normal", laws.normal, (one, one), "(N, energy)", [()] * 2)
    if laws.friction is not None:
        _returns("friction", laws.friction, (z, one, one), "(F, z_t, energy)", [(), z.shape, ()])
    return laws


def _returns(name: str, law: _Held, args: tuple, words: str, shapes: list) -> None:
    found = jax.eval_shape(law, *args)
    got = [getattr(a, "shape", None) for a in found] if isinstance(found, tuple) else found
    if got != shapes:
        raise InputError(f"The {name} law must return {words}, of shapes {shapes}, but returns {got}.")
