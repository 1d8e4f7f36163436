"""Measured motions, and the same quantities of the model with their exact derivatives."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.differentiable_samples import Schedule
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.sampled_tangents import motions_with_tangents, start_duals
from jaxshroud.batch.tangents import direction
from jaxshroud.march.method import Choices
from jaxshroud.programs.kept import kept
from jaxshroud.scene.measurements import Kind, Measurements
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
    wanted = min(history_samples(float(data.at[rows - 1]), shortest, schedule.steps), schedule.samples)
    motions = motions_with_tangents(duals, start_duals(duals), schedule, wanted)
    sampled = [_with_rest(a, schedule.samples) for a in motions[:4]]
    omega = duals.value.drive.omega, duals.tangent.drive.omega
    values, slopes = _at_times(sampled, *omega, data.at.astype(motions.place.dtype), float(schedule.steps))
    return _predicted(np.asarray(values), np.asarray(slopes), data, len(keys))


def _with_rest(samples: np.ndarray, count: int) -> np.ndarray:
    """Samples (lanes, 1 + wanted, ...) with NaN for the rest of so many, so that one program serves any part."""
    rest = np.full((len(samples), 1 + count - samples.shape[1], *samples.shape[2:]), np.nan, samples.dtype)
    return np.concatenate([samples, rest], axis=1)


def _predicted(values: np.ndarray, slopes: np.ndarray, data: Measurements, keys: int) -> Predicted:
    """Values and slopes (points * keys, n, 6) by points and channels."""
    columns = [channel.column for channel in data.channels]
    by_point = lambda a: a[..., columns].reshape(-1, keys, *a.shape[1:-1], len(columns))
    return Predicted(by_point(values)[:, 0], np.moveaxis(by_point(slopes), 1, -1))


@kept()
def _at_times(sampled: list[Any], omega, omega_by, t, per_period):
    """The displacements of lanes at times (n,), and their derivatives: (lanes, n, 6) each."""

    def one_lane(place, rate, omega):
        turns = t * omega / math.tau * per_period
        before = jnp.clip(jnp.floor(turns), 0.0, len(place) - 2.0)
        i = before.astype(jnp.int32)
        h = math.tau / omega / per_period
        return _between_samples(place[i], place[i + 1], h * rate[i], h * rate[i + 1], (turns - before)[:, None])

    def with_tangent(place, rate, place_by, rate_by, omega, omega_by):
        return jax.jvp(one_lane, (place, rate, omega), (place_by, rate_by, omega_by))

    return jax.vmap(with_tangent)(*sampled, omega, omega_by)  # pyright: ignore[reportCallIssue]


def _between_samples(q_0, q_1, m_0, m_1, s):
    """The cubic with values `q` and slopes `m` at its ends, at the share `s` of the interval."""
    rise = q_1 - q_0
    return q_0 + s * (m_0 + s * (3 * rise - 2 * m_0 - m_1 + s * (m_0 + m_1 - 2 * rise)))


def steps_between_samples(omega_max: float, period: float, march_steps: int, kind: Kind) -> int:
    """The samples in a period: the steps of the march, or more where the cubic between them would be inaccurate."""
    return max(march_steps, math.ceil(omega_max * period / INTERPOLATION_ANGLES[kind]))


def history_schedule(last: float, shortest_period: float, steps: int, method: Choices) -> Schedule:
    """The schedule that reaches a time in every scene, whose drive periods are not shorter than the shortest."""
    return Schedule(history_samples(last, shortest_period, steps), 1, steps, method)


def history_samples(last: float, shortest_period: float, steps: int) -> int:
    """The samples, one in each step, that reach a time in every scene."""
    return math.ceil(last / shortest_period * steps) + 1
