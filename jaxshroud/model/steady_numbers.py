"""Numbers of a steady motion, each a mean and harmonics: their courses, amplitudes and least values over a period.

The amplitude of such a number is its largest distance from its mean, at a root of its rate: harmonics that peak at
different times do not add up.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxshroud.model.arithmetic import summed

START_PHASES = 16  # of the period of the highest harmonic, from each of which a turning point is looked for
NEWTON_UPDATES = 6  # to each: from 16 phases they leave 3e-10 of the largest value where it is flattest, else rounding


class SteadyNumbers(NamedTuple):
    """A number over the period: its mean, and its complex amplitudes by order, Im[a exp(i n omega t)]."""

    mean: Any
    waves: dict[int, Any]


def steady_course(swing: SteadyNumbers, tau: Any) -> tuple[Any, Any, Any]:
    """The value and its first two derivatives by the phase, at phases `tau` that broadcast against the numbers."""
    q = swing.mean + 0.0 * tau
    rate = 0.0 * tau
    bend = 0.0 * tau
    for n, a in swing.waves.items():
        s = jnp.sin(n * tau)
        c = jnp.cos(n * tau)
        wave = a.real * s + a.imag * c
        quarter = a.real * c - a.imag * s
        q = q + wave
        rate = rate + n * quarter
        bend = bend - n**2 * wave
    return q, rate, bend


def steady_extremes(swing: SteadyNumbers) -> tuple[Any, Any]:
    """The largest and the smallest values of numbers."""
    if len(swing.waves) == 1:
        (size,) = (magnitude(a) for a in swing.waves.values())
        return swing.mean + size, swing.mean - size
    q = steady_course(swing, turning_phases(swing.waves))[0]
    return _of_one(q, jnp.argmax(q, axis=0)), _of_one(q, jnp.argmin(q, axis=0))


def steady_peak(waves: dict[int, Any]) -> Any:
    """The largest distance of numbers from their mean, of their complex amplitudes by order; inf where one is."""
    if len(waves) == 1:
        (wave,) = waves.values()
        return jnp.abs(wave)
    bound = summed(jnp.abs(a) for a in waves.values())
    finite = {n: jnp.where(jnp.isfinite(bound), a, 0.0) for n, a in waves.items()}
    away = jnp.abs(steady_course(SteadyNumbers(0.0, finite), turning_phases(finite))[0])
    return jnp.where(jnp.isfinite(bound), _of_one(away, jnp.argmax(away, axis=0)), bound)


def steady_rms(waves: dict[int, Any]) -> Any:
    """The root mean square of numbers about their mean, of their complex amplitudes by order."""
    return jnp.sqrt(summed(jnp.abs(a) ** 2 for a in waves.values()) / 2)


def turning_phases(waves: dict[int, Any]) -> Any:
    """Phases (samples, ...) at which numbers turn, among them those of their largest and smallest values.

    From each of some samples Newton's method goes to a root of the rate, and no farther than the next sample. For
    derivatives the phases are held: at a turning point a value moves as it does at that time.
    """
    frozen = SteadyNumbers(0.0, jax.tree.map(lax.stop_gradient, waves))
    wave = next(iter(frozen.waves.values()))
    count = START_PHASES * max(waves)
    tau = jnp.linspace(0, 2 * jnp.pi, count, endpoint=False, dtype=wave.real.dtype).reshape(-1, *[1] * wave.ndim)
    at = tau + 0.0 * wave.real
    apart = 2 * jnp.pi / count
    for _ in range(NEWTON_UPDATES):
        _, rate, bend = steady_course(frozen, at)
        at = jnp.clip(at - rate / jnp.where(bend != 0, bend, jnp.inf), tau - apart, tau + apart)
    return at


def _of_one(values: Any, place: Any) -> Any:
    """One of the values (samples, ...) of each number."""
    return jnp.take_along_axis(values, place[None], axis=0)[0]


def magnitude(a: Any) -> Any:
    """The magnitude of complex numbers, whose derivative at 0 is 0."""
    square = a.real**2 + a.imag**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


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
