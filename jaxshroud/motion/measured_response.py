"""Amplitudes on periodic orbits with their exact derivatives: the model of a measured frequency response.

An orbit starts where the map of its periods returns to; by the implicit function theorem the start moves by
(I - M)^-1 times what a number of the scene moves its image. Every sample moves with the start and with the number.
"""

import math
from collections import defaultdict
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.cubics import cubic_mean, hermite_largest
from jaxshroud.batch.differentiable_samples import Schedule
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.sampled_tangents import SampledMotions, motions_with_tangents
from jaxshroud.batch.tangents import TangentProblem, direction
from jaxshroud.motion.orbit import PeriodicOrbit
from jaxshroud.motion.shooting import moved_start
from jaxshroud.programs.kept import kept
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.measurements import MEASURES, Channel


def orbit_amplitudes_by(
    orbits: Sequence[PeriodicOrbit | None], keys: Sequence[str], channels: Sequence[Channel]
) -> tuple[np.ndarray, np.ndarray]:
    """The amplitudes on orbits, and their derivatives by numbers of the scene.

    Args:
        orbits: Orbits whose scenes have one structure; None, and one that is not sound, have NaN.
        keys: The numbers.
        channels: The amplitudes.

    Returns:
        Values (orbits, channels) and slopes (orbits, channels, keys).
    """
    values = np.full((len(orbits), len(channels)), np.nan)
    slopes = np.full((*values.shape, len(keys)), np.nan)
    alike: dict[int, list[tuple[int, PeriodicOrbit]]] = defaultdict(list)
    for i, orbit in enumerate(orbits):
        if orbit is not None and orbit.sound:
            alike[orbit.q].append((i, orbit))
    places = [MEASURES.index(channel.measure) for channel in channels], [channel.column for channel in channels]
    for group in alike.values():
        numbers, sound = (list(part) for part in zip(*group, strict=True))
        of_all, by_all = _amplitudes_of_alike(sound, keys)
        values[numbers], slopes[numbers] = of_all[:, *places], np.moveaxis(by_all[:, :, *places], 1, -1)
    return values, slopes


def _amplitudes_of_alike(orbits: Sequence[PeriodicOrbit], keys: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes (orbits, measures, 6) and derivatives (orbits, keys, measures, 6) of orbits of one period number."""
    first = orbits[0]
    steps = first.steps_per_period
    schedule = Schedule(first.q * steps, 1, steps, as_differentiable(first.method))
    directions = [direction(first.scene, key) for key in keys]
    problems = [TangentProblem(orbit.scene, orbit.start, directions) for orbit in orbits]
    scenes, states = jax.tree.map(lambda *a: np.concatenate(a), *(problem.duals for problem in problems))
    motions = motions_with_tangents(scenes, states, schedule)
    by_orbit = jax.tree.map(lambda a: a.reshape(len(orbits), PAIR.state_size + len(keys), *a.shape[1:]), motions)
    moved = [_moved_along(orbit, jax.tree.map(lambda a, i=i: a[i], by_orbit)) for i, orbit in enumerate(orbits)]
    interval = [math.tau / float(orbit.scene.drive.omega) / steps for orbit in orbits]
    values, slopes = _amplitudes_and_slopes(*(np.stack(a) for a in zip(*moved, strict=True)), np.array(interval))
    return np.asarray(values), np.asarray(slopes)


def _moved_along(orbit: PeriodicOrbit, motions: SampledMotions) -> tuple[np.ndarray, ...]:
    """The samples of an orbit (place and rate), and their derivatives (keys, samples, 6) where it stays closed."""
    by_start, by_number = np.split(motions.end_by, [PAIR.state_size])
    shift = moved_start(by_start.T, by_number.T, orbit.slider_is_free)
    along = lambda by: by[PAIR.state_size :] + np.einsum("zk,znc->knc", shift, by[: PAIR.state_size])
    return motions.place[0], motions.rate[0], along(motions.place_by), along(motions.rate_by)


@kept()
def _amplitudes_and_slopes(place, rate, place_by, rate_by, interval):
    """Amplitudes of orbits (leading axis) over whole periods, and their derivatives along each number."""

    def one_orbit(place, rate, place_by, rate_by, h):
        of = lambda place, rate: _amplitudes(place[None], rate[None], h[None, None, None])
        slope = lambda place_by, rate_by: jax.jvp(of, (place, rate), (place_by, rate_by))[1]
        return of(place, rate), jax.vmap(slope)(place_by, rate_by)

    return jax.vmap(one_orbit)(place, rate, place_by, rate_by, interval)


def _amplitudes(q, rate, h):
    """RMS and peak about the mean, (measures, 6), of one orbit (leading axis)."""
    mean = cubic_mean(q, rate, h)
    square = cubic_mean((q - mean) ** 2, 2 * (q - mean) * rate, h)
    rms = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)  # what stands still has no slope
    high, low = hermite_largest(q, h * rate), -hermite_largest(-q, -h * rate)
    return jnp.stack([rms[0], jnp.maximum(high - mean, mean - low)[0]])
