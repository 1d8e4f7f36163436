"""User laws of contact and friction: the interface of the functions, and how a scene holds them.

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

from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from jaxshroud.scene.checks import InputError

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


class _PartitionedFunction(eqx.Module):
    """A function whose arrays are leaves while everything else is static."""

    arrays: PyTree
    static: PyTree = eqx.field(static=True)

    def __init__(self, function: NormalLaw | FrictionLaw):
        self.arrays, self.static = eqx.partition(function, eqx.is_array)

    def __call__(self, *args: Any) -> Any:
        return eqx.combine(self.arrays, self.static)(*args)


class SceneLaw(eqx.Module):
    """A law of contact that a scene can hold: user laws, or a `ContactLaw` of `model.contact_law`."""

    marches_in_rows: ClassVar[bool] = True


class Laws(SceneLaw):
    """The user laws of a scene."""

    marches_in_rows: ClassVar[bool] = False

    normal: _PartitionedFunction
    friction: _PartitionedFunction | None
    z: Array  # internal state at every onset

    def __init__(self, normal: NormalLaw, friction: FrictionLaw | None = None, z: ArrayLike = 0.0):
        self.normal, self.friction = (
            _PartitionedFunction(normal),
            None if friction is None else _PartitionedFunction(friction),
        )
        self.z = jnp.asarray(z, float)

    def push(self, v: Number, v_t: Number) -> Number:
        """The normal force [N] at a penetration of at least 0; negative where it would pull."""
        return self.normal(v, v_t)[0]

    def rub(self, z: Number, u_t: Number, N: Number) -> tuple[Number, Number]:
        """The friction force [N] and the rate of the internal state."""
        assert self.friction is not None
        return self.friction(z, u_t, N)[:2]

    def energy(self, v: Number, z: PyTree) -> Number:
        """The energy [J] stored at a penetration of at least 0 and an internal state."""
        zero = jnp.zeros_like(v)
        stored = self.normal(v, zero)[1]
        return stored if self.friction is None else stored + self.friction(z, zero, zero)[2]

    def stored_power(self, v: Number, z: PyTree, v_t: Number, z_t: PyTree) -> Number:
        """The rate of the stored energy [W]."""
        if self.friction is None:
            return jax.jvp(lambda v: self.energy(v, z), (v,), (v_t,))[1]
        return jax.jvp(self.energy, (v, z), (v_t, z_t))[1]


def with_checked_shapes(laws: Laws) -> Laws:
    """The laws, after a check of the shapes that they return.

    Raises:
        InputError: The shapes are wrong.
    """
    scalar, z = jax.ShapeDtypeStruct((), laws.z.dtype), jax.ShapeDtypeStruct(laws.z.shape, laws.z.dtype)
    _check_shapes("normal", laws.normal, (scalar, scalar), "(N, energy)", [()] * 2)
    if laws.friction is not None:
        _check_shapes("friction", laws.friction, (z, scalar, scalar), "(F, z_t, energy)", [(), z.shape, ()])
    return laws


def _check_shapes(name: str, law: _PartitionedFunction, args: tuple, names: str, shapes: list) -> None:
    results = jax.eval_shape(law, *args)
    returned = [getattr(a, "shape", None) for a in results] if isinstance(results, tuple) else results
    if returned != shapes:
        raise InputError(f"The {name} law must return {names}, of shapes {shapes}, but returns {returned}.")
