"""The moments and the range of the displacements of free blades within a period, in closed form."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.march.tally import DisplacementRange
from jaxshroud.model.arithmetic import Scalar, sine_versine, summed
from jaxshroud.model.linear import free_components, free_oscillations, free_propagators
from jaxshroud.model.rhs import Displacements, Means, Moments
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene

NEWTON_STEPS = 4  # from the node at which a displacement is largest to where its speed vanishes: to rounding


class FreeCourse(NamedTuple):
    """The displacements of free blades and their rates at some times, (times, 2, 3) each: blades; x, y and theta."""

    displacement: Float[Array, "n 2 3"]
    speed: Float[Array, "n 2 3"]
    acceleration: Float[Array, "n 2 3"]


def free_course(scene: Scene, first: Motion, turns: Scalar, t: Float[Array, " n"]) -> FreeCourse:
    """The course of the free blades at times `t` after the motion `first` at a drive phase [turns]."""
    start, swing = free_components(scene, first, turns), free_oscillations(scene)
    place, rate = free_propagators(scene, t)
    q, w = (jnp.einsum("nbik,bik->nbi", a, start) for a in (place, rate))
    columns = {n: slice(2 * k + 2, 2 * k + 4) for k, n in enumerate(swing.steady)}
    harmonics = lambda a: {n: jnp.einsum("nbik,bik->nbi", a[..., own], start[..., own]) for n, own in columns.items()}
    by_order, rates_by_order = harmonics(place), harmonics(rate)
    steady, steady_rate = summed(by_order.values()), summed(rates_by_order.values())
    stiffness = swing.square + swing.damping**2
    decaying = -2 * swing.damping * (w - steady_rate) - stiffness * (q - steady)
    return FreeCourse(q, w, decaying - summed(scene.drive.frequency(n) ** 2 * q for n, q in by_order.items()))


def free_extent(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> tuple[Moments, DisplacementRange]:
    """The moments and the range over the drive period that begins with the motion `first`.

    Args:
        scene: The scene.
        first: The motion at the start, fields (2,).
        turns: The drive phase there.
        nodes: Of the Gauss-Legendre rule over a period.
    """
    period, dtype = scene.drive.period, scene.drive.omega.dtype
    place, weights = np.polynomial.legendre.leggauss(nodes)
    t = jnp.asarray(np.concatenate([[0.0], (place + 1) / 2, [1.0]]), dtype) * period
    weights = jnp.asarray(weights / 2, dtype) * period
    q = free_course(scene, first, turns, t).displacement
    inner = q[1:-1]
    moments = Moments(*(_in_pairs(jnp.einsum("n,nbi->bi", weights, a)) for a in (inner, inner**2)))
    highest = _at_turn(scene, first, turns, t, q, jnp.argmax(q, axis=0))
    lowest = _at_turn(scene, first, turns, t, q, jnp.argmin(q, axis=0))
    highest, lowest = jnp.maximum(highest, jnp.max(q, axis=0)), jnp.minimum(lowest, jnp.min(q, axis=0))
    return moments, DisplacementRange(_in_pairs(highest), _in_pairs(lowest))


def free_means(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> Means:
    """The mean position of the left block over the drive period that begins with the motion `first`."""
    place, weights = np.polynomial.legendre.leggauss(nodes)
    dtype = scene.drive.omega.dtype
    t = jnp.asarray((place + 1) / 2, dtype) * scene.drive.period
    x, y, theta = free_course(scene, first, turns, t).displacement[:, 0].T
    return Means(*(jnp.asarray(weights / 2, dtype) @ a for a in (x, y, *sine_versine(theta))))


def _at_turn(
    scene: Scene,
    first: Motion,
    turns: Scalar,
    t: Float[Array, " n"],
    q: Float[Array, "n 2 3"],
    node: Int[Array, "2 3"],
) -> Float[Array, "2 3"]:
    """Each displacement where its speed vanishes beside its `node`."""
    low, high = t[jnp.maximum(node - 1, 0)], t[jnp.minimum(node + 1, len(t) - 1)]
    at, value = t[node], jnp.take_along_axis(q, node[None], axis=0)[0]
    own = jnp.arange(6), *np.unravel_index(np.arange(6), (2, 3))
    for _ in range(NEWTON_STEPS + 1):
        course = free_course(scene, first, turns, at.ravel())
        value, speed, bend = (a[own].reshape(2, 3) for a in course)
        at = jnp.clip(at - speed / jnp.where(bend != 0, bend, jnp.inf), low, high)
    return value


def _in_pairs(values: Float[Array, "2 3"]) -> Displacements:
    """Displacements (2, 3) as a pair for each of x, y and theta."""
    x, y, theta = ((values[0, i], values[1, i]) for i in range(3))
    return x, y, theta
