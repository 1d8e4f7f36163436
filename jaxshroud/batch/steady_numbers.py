"""Numbers of a steady motion, each a mean and harmonics: their courses, extremes and least values over a period."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

EXTREME_UPDATES = 6  # of Newton's method from the sample at which a number is largest


class SteadyNumbers(NamedTuple):
    """A number over the period: its mean, and its complex amplitudes by order, Im[a exp(i n omega t)]."""

    mean: Any
    waves: dict[int, Any]


def steady_course(swing: SteadyNumbers, tau: Any) -> tuple[Any, Any, Any]:
    """The value and its first two derivatives by the phase, at phases `tau` that broadcast against the numbers."""
    q, rate, bend = swing.mean + 0.0 * tau, 0.0 * tau, 0.0 * tau
    for n, a in swing.waves.items():
        s, c = jnp.sin(n * tau), jnp.cos(n * tau)
        wave, quarter = a.real * s + a.imag * c, a.real * c - a.imag * s
        q, rate, bend = q + wave, rate + n * quarter, bend - n**2 * wave
    return q, rate, bend


def steady_extremes(swing: SteadyNumbers, tau: Any, q: Any) -> tuple[Any, Any]:
    """The largest and the smallest values (3 blades,)."""
    if len(swing.waves) == 1:
        (size,) = (magnitude(a) for a in swing.waves.values())
        return swing.mean + size, swing.mean - size
    return _turning_value(swing, tau, jnp.argmax(q, axis=0)), _turning_value(swing, tau, jnp.argmin(q, axis=0))


def magnitude(a: Any) -> Any:
    """The magnitude of complex numbers, whose derivative at 0 is 0."""
    square = a.real**2 + a.imag**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _turning_value(swing: SteadyNumbers, tau: Any, node: Any) -> Any:
    """Each number where its rate vanishes beside the sample `node`."""
    frozen = jax.tree.map(lax.stop_gradient, swing)
    at = tau[node]

    step = tau[1]
    low, high = at - step, at + step
    for _ in range(EXTREME_UPDATES):
        _, rate, bend = steady_course(frozen, at)
        at = jnp.clip(at - rate / jnp.where(bend != 0, bend, jnp.inf), low, high)
    return steady_course(swing, at)[0]


def negative(a: SteadyNumbers) -> SteadyNumbers:
    """The numbers with the other sign."""
    return SteadyNumbers(-a.mean, {n: -wave for n, wave in a.waves.items()})


def least_value(a: SteadyNumbers, count: int) -> Any:
    """The least value over the period: exact for one harmonic, else a bound from below."""
    if not a.waves:
        return a.mean
    if len(a.waves) == 1:
        (wave,) = a.waves.values()
        return a.mean - magnitude(wave)
    tau = jnp.linspace(0, 2 * jnp.pi, count, endpoint=False, dtype=a.mean.dtype)
    phases = {n: (jnp.sin(n * tau), jnp.cos(n * tau)) for n in a.waves}
    shape = (-1, *[1] * a.mean.ndim)
    course = sum(
        w.real * phases[n][0].reshape(shape) + w.imag * phases[n][1].reshape(shape) for n, w in a.waves.items()
    )
    bend = sum(n**2 * magnitude(w) for n, w in a.waves.items())
    return a.mean + jnp.min(course, axis=0) - bend * (jnp.pi / count) ** 2 / 2
