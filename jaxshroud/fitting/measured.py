"""Measured motions, and the same quantities of the model with their exact derivatives.

Amplitudes on periodic orbits with their exact derivatives: the model of a measured frequency response.

An orbit starts where the map of its periods returns to; by the implicit function theorem the start moves by
(I - M)^-1 times what a number of the scene moves its image. Every sample moves with the start and with the number.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.pure_functions import Schedule
from jaxshroud.batch.stretches import cubic_mean, hermite_largest
from jaxshroud.batch.tangents import SampledMotions, TangentProblem, direction, motions_with_tangents, start_duals
from jaxshroud.cache.programs import kept
from jaxshroud.fitting.least_squares import Data
from jaxshroud.march.method import Choices
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import moved_start
from jaxshroud.scene.measurements import MEASURES, Channel, Kind, Measurements
from jaxshroud.scene.scene import Scene, without_given

# Largest omega h between samples of responses and of histories: the error of the cubic, (omega h)^4 / 384, is then 4e-6
# of the fastest oscillation, and 2e-4 where it is compared with noisy samples.
INTERPOLATION_ANGLES = {"response": 0.2, "history": 0.5}


class Predicted(NamedTuple):
    """What the model says of measurements at several points; NaN where it says nothing."""

    values: np.ndarray  # (points, n, channels)
    slopes: np.ndarray  # (points, n, channels, keys) derivatives by the numbers of a point


def along_each(scenes: Scene, keys: tuple[str, ...]) -> Dual:
    """Scenes (leading axis), each repeated once for each key, with the derivative by that number."""
    count = len(scenes.drive.omega)
    first = jax.tree.map(lambda a: np.asarray(a)[0], scenes)
    directions = jax.tree.map(lambda *a: np.stack(a), *(direction(first, key) for key in keys))
    repeated = jax.tree.map(lambda a: np.repeat(np.asarray(a), len(keys), axis=0), without_given(scenes))
    return Dual(repeated, jax.tree.map(lambda a: np.concatenate([a] * count), directions))


def predicted_history(
    scenes: Scene, keys: tuple[str, ...], data: Measurements, schedule: Schedule, rows: int
) -> Predicted:
    """The displacements of scenes (leading axis) from their initial motion at the measured times, with derivatives.

    Between samples the motion is the cubic through the displacements and their rates.

    Args:
        scenes: One scene for each point.
        keys: The numbers by which to differentiate.
        data: The measured times and channels.
        schedule: A sample in every step; up to the last measured time.
        rows: The first of the measured times, so many of them; the others are NaN.
    """
    duals = along_each(scenes, keys)
    shortest = math.tau / float(np.max(duals.value.drive.omega))
    wanted = min(history_samples(float(data.at[rows - 1]), shortest, schedule), schedule.samples)
    motions = motions_with_tangents(duals, start_duals(duals), schedule, wanted)
    values, slopes = np.full((2, len(motions.place), len(data.at), motions.place.shape[-1]), np.nan)
    omega, omega_by = (np.asarray(part.drive.omega) for part in (duals.value, duals.tangent))
    values[:, :rows], slopes[:, :rows] = _at_times(motions, omega, omega_by, data.at[:rows], schedule)
    return _predicted(values, slopes, data, len(keys))


def _predicted(values: np.ndarray, slopes: np.ndarray, data: Measurements, keys: int) -> Predicted:
    """Values and slopes (points * keys, n, 3 blades) by points and channels."""
    columns = [channel.column(values.shape[-1] // 3) for channel in data.channels]

    def by_point(a):
        return a[..., columns].reshape(-1, keys, *a.shape[1:-1], len(columns))

    return Predicted(by_point(values)[:, 0], np.moveaxis(by_point(slopes), 1, -1))


def _at_times(
    motions: SampledMotions, omega: np.ndarray, omega_by: np.ndarray, t: np.ndarray, schedule: Schedule
) -> tuple[np.ndarray, np.ndarray]:
    """The displacements of lanes at times (n,), and their derivatives: (lanes, n, 3 blades) each."""
    per_period = schedule.steps / schedule.every
    turns = t * omega[:, None] / math.tau * per_period
    before = np.clip(np.floor(turns), 0, motions.place.shape[1] - 2).astype(int)
    h = (math.tau / omega / per_period)[:, None, None]
    h_by = -h * (omega_by / omega)[:, None, None]
    share = (turns - before)[..., None]
    share_by = (turns * (omega_by / omega)[:, None])[..., None]

    def ends(a):
        return (np.take_along_axis(a, before[..., None] + i, axis=1) for i in (0, 1))

    (q_0, q_1), (v_0, v_1) = ends(motions.place), ends(motions.rate)
    (q_0_by, q_1_by), (v_0_by, v_1_by) = ends(motions.place_by), ends(motions.rate_by)
    values, by_share = _between_samples(q_0, q_1, h * v_0, h * v_1, share)
    slopes, _ = _between_samples(q_0_by, q_1_by, h * v_0_by + h_by * v_0, h * v_1_by + h_by * v_1, share)
    return values, slopes + by_share * share_by


def _between_samples(q_0, q_1, m_0, m_1, s):
    """The cubic with values `q` and slopes `m` at its ends, at the share `s` of the interval, and its derivative."""
    rise = q_1 - q_0
    second, third = 3 * rise - 2 * m_0 - m_1, m_0 + m_1 - 2 * rise
    return q_0 + s * (m_0 + s * (second + s * third)), m_0 + s * (2 * second + 3 * s * third)


def steps_between_samples(omega_max: float, period: float, march_steps: int, kind: Kind) -> int:
    """The samples in a period: the steps of the march, or more where the cubic between them would be inaccurate."""
    return max(march_steps, math.ceil(omega_max * period / INTERPOLATION_ANGLES[kind]))


def history_schedule(last: float, shortest_period: float, steps: int, method: Choices) -> Schedule:
    """The schedule that reaches a time in every scene, whose drive periods are not shorter than the shortest.

    Its samples are a power of two, of which later ones rest, so that records of all lengths share some programs.
    """
    exact = Schedule(0, 1, steps, method)
    return exact._replace(samples=1 << (history_samples(last, shortest_period, exact) - 1).bit_length())


def history_samples(last: float, shortest_period: float, schedule: Schedule) -> int:
    """The samples of a schedule that reach a time in every scene."""
    return math.ceil(last / shortest_period * schedule.steps / schedule.every) + 1


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
    measures = [MEASURES.index(channel.measure) for channel in channels]
    for group in alike.values():
        numbers, sound = (list(part) for part in zip(*group, strict=True))
        places = measures, [channel.column(sound[0].scene.layout.blades) for channel in channels]
        of_all, by_all = _amplitudes_of_alike(sound, keys)
        values[numbers] = of_all[:, *places]
        slopes[numbers] = np.moveaxis(by_all[:, :, *places], 1, -1)
    return values, slopes


def _amplitudes_of_alike(orbits: Sequence[PeriodicOrbit], keys: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes (orbits, measures, 3 blades) of orbits of one period number, and derivatives (orbits, keys, ...)."""
    first = orbits[0]
    steps = first.steps_per_period
    schedule = Schedule(first.q * steps, 1, steps, as_differentiable(first.method))
    directions = [direction(first.scene, key) for key in keys]
    problems = [TangentProblem(orbit.scene, orbit.start, directions) for orbit in orbits]
    scenes, states = jax.tree.map(lambda *a: np.concatenate(a), *(problem.duals for problem in problems))
    motions = motions_with_tangents(scenes, states, schedule)
    by_orbit = jax.tree.map(lambda a: a.reshape(len(orbits), -1, *a.shape[1:]), motions)
    moved = [_moved_along(orbit, jax.tree.map(lambda a, i=i: a[i], by_orbit)) for i, orbit in enumerate(orbits)]
    interval = [math.tau / float(orbit.scene.drive.omega) / steps for orbit in orbits]
    values, slopes = _amplitudes_and_slopes(*(np.stack(a) for a in zip(*moved, strict=True)), np.array(interval))
    return np.asarray(values), np.asarray(slopes)


def _moved_along(orbit: PeriodicOrbit, motions: SampledMotions) -> tuple[np.ndarray, ...]:
    """The samples of an orbit (place and rate), and derivatives (keys, samples, 3 blades) where it stays closed."""
    size = orbit.scene.state_size
    by_start, by_number = np.split(motions.end_by, [size])
    shift = moved_start(by_start.T, by_number.T, orbit.slider_is_free)

    def along(by):
        return by[size:] + np.einsum("zk,znc->knc", shift, by[:size])

    return motions.place[0], motions.rate[0], along(motions.place_by), along(motions.rate_by)


@kept()
def _amplitudes_and_slopes(place, rate, place_by, rate_by, interval):
    """Amplitudes of orbits (leading axis) over whole periods, and their derivatives along each number."""

    def one_orbit(place, rate, place_by, rate_by, h):
        def of(place, rate):
            return _amplitudes(place[None], rate[None], h[None, None, None])

        def slope(place_by, rate_by):
            return jax.jvp(of, (place, rate), (place_by, rate_by))[1]

        return of(place, rate), jax.vmap(slope)(place_by, rate_by)

    return jax.vmap(one_orbit)(place, rate, place_by, rate_by, interval)


def _amplitudes(q, rate, h):
    """RMS and peak about the mean, (measures, 3 blades), of one orbit (leading axis)."""
    mean = cubic_mean(q, rate, h)
    square = cubic_mean((q - mean) ** 2, 2 * (q - mean) * rate, h)
    rms = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)  # what stands still has no slope
    high = hermite_largest(q, h * rate)
    low = -hermite_largest(-q, -h * rate)
    return jnp.stack([rms[0], jnp.maximum(high - mean, mean - low)[0]])


def weighted_data(data: Measurements) -> Data:
    """The data with their noise, or with the size of each channel where that is unknown."""
    if data.sigma is not None:
        return Data(data.values, data.sigma, True)
    return Data(data.values, np.broadcast_to(data.sizes, data.values.shape), False)
