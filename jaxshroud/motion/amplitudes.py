"""The amplitudes of motions and the loads of contact over the kept periods, from the samples of their march."""

import math

import jax
import numpy as np

from jaxshroud.batch.cubics import SampledAmplitudes
from jaxshroud.batch.periods import LANES_PER_CALL, Sample
from jaxshroud.batch.threads import in_chunks
from jaxshroud.model.linear import free_reach, steady_amplitudes
from jaxshroud.programs.kept import kept
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.scene.scene import Scene


def amplitude_values(scenes: Scene, samples: Sample, number: np.ndarray) -> dict[str, np.ndarray]:
    """The values of `WithAmplitudes` by their names, (lanes, blades) each; nothing unless they were kept.

    Args:
        scenes: The scenes (leading axis).
        samples: The kept periods, (lanes, periods).
        number: The period number of each lane, 0 if aperiodic: whole orbits are averaged, the latest ones.
    """
    if samples.moments is None or samples.extent is None:
        return {}
    counted, time = counted_periods(samples, number), math.tau / np.asarray(scenes.drive.omega, float)
    shares = (counted / counted.sum(axis=-1, keepdims=True) / time[:, None])[:, None]
    by_period = lambda a: np.stack(np.moveaxis(a, -1, 0), axis=1)  # periods side by side: sums are pairwise
    mean, square = ([np.sum(shares * by_period(a), axis=-1) for a in moment] for moment in samples.moments)
    highest = [_largest_of(a, counted) for a in samples.extent.highest]
    lowest = [-_largest_of(-a, counted) for a in samples.extent.lowest]
    values = {}
    for i, (name, free) in enumerate(zip(DISPLACEMENTS, free_amplitudes(scenes), strict=True)):
        values[f"{name}_mean"] = mean[i]
        values[f"{name}_rms"] = np.sqrt(np.maximum(square[i] - mean[i] ** 2, 0.0))
        values[f"{name}_peak"] = np.maximum(highest[i] - mean[i], mean[i] - lowest[i])
        values[f"{name}_free"] = free
    return values


def counted_periods(samples: Sample, number: np.ndarray) -> np.ndarray:
    """Which periods count, (lanes, periods): the latest whole orbits."""
    n, q = np.shape(samples.power)[1], np.maximum(number, 1)
    return np.arange(n) >= (n - n // q * q)[:, None]


def _largest_of(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """The largest of values (lanes, periods, ...) over the periods that count, (lanes, ...)."""
    return np.where(_like(counted, values), values, -np.inf).max(axis=1)


def _like(counted: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Which periods count, with as many axes as the values (lanes, periods, ...)."""
    return counted.reshape(*counted.shape, *[1] * (values.ndim - 2))


def free_amplitudes(scenes: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The amplitudes of x, y and theta without contact, (lanes, blades) each, see `free_reach`."""
    count = len(scenes.drive.omega)
    chunk = lambda _, lanes: _free_amplitudes(jax.tree.map(lambda a: np.asarray(a)[lanes], scenes))
    x, y, theta = in_chunks(chunk, count, 1 if count == 1 else LANES_PER_CALL)
    return np.asarray(x, float), np.asarray(y, float), np.asarray(theta, float)


@kept()
def _free_amplitudes(scenes: Scene):
    def one(scene: Scene):
        free = steady_amplitudes(scene)
        return tuple(free_reach(free, name) for name in DISPLACEMENTS)

    return jax.vmap(one)(scenes)


def counted_mean(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """The mean of values (lanes, periods, ...) over the periods that count, (lanes, ...)."""
    number = counted.sum(axis=-1).reshape(-1, *[1] * (values.ndim - 2))
    return np.sum(np.where(_like(counted, values), values, 0.0), axis=1) / number


def load_values(scenes: Scene, samples: Sample, number: np.ndarray) -> dict[str, np.ndarray]:
    """The values of `WithLoads` by their names, of each lane and interface; nothing unless they were kept.

    Args:
        scenes: The scenes (leading axis).
        samples: The kept periods, (lanes, periods).
        number: The period number of each lane, as of `amplitude_values`.
    """
    if samples.forces is None:
        return {}
    period, counted = math.tau / np.asarray(scenes.drive.omega, float)[:, None], counted_periods(samples, number)
    mean = lambda a: counted_mean(a, counted)
    largest = lambda a: _largest_of(a, counted)
    N, N_slip, time_slip, slip = map(mean, samples.loads)
    impacts = mean(samples.impacts.number)
    own, mu = scenes.parts.contact == "own", np.asarray(scenes.friction.mu, float).reshape(len(period), -1)
    work = mean(samples.friction)
    N_max, F_max = map(largest, samples.forces)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = {
            "N_max": N_max,
            "F_max": F_max,
            "N_mean": N / period,
            "N_slip": N_slip / time_slip,
            "friction_work": work,
            "slip": np.full_like(slip, np.nan) if own else slip,
            "archard": np.full_like(work, np.nan) if own else work / mu,
            "impacts": impacts,
            "approach_max": largest(samples.impacts.approach),
            "approach_mean": mean(samples.impacts.approach_sum) / impacts,
            "impulse_max": largest(samples.impacts.impulse),
            "impulse_mean": mean(samples.impacts.impulse_sum) / mean(samples.impacts.ended),
        }
    return {name: scenes.layout.at_interfaces(a) for name, a in values.items()}


def sampled_amplitude_values(scenes: Scene, amplitudes: SampledAmplitudes | None) -> dict[str, np.ndarray]:
    """The values of `WithAmplitudes` of runs (leading axis) by their names; nothing where no steps count."""
    if amplitudes is None:
        return {}
    columns = {**amplitudes._asdict(), "free": np.stack(free_amplitudes(scenes), axis=-1)}
    return {f"{name}_{of}": a[..., i] for i, name in enumerate(DISPLACEMENTS) for of, a in columns.items()}
