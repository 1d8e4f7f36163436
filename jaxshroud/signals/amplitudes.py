"""The amplitudes of motions, the loads of contact and the quantities of `Quantity` over the kept periods.

Which reduction counts where none is requested depends on whether blades are pressed or bent at rest.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import LANES_PER_CALL, Sample
from jaxshroud.batch.stretches import SampledAmplitudes
from jaxshroud.batch.threads import in_chunks
from jaxshroud.batch.xla import one_lane
from jaxshroud.cache.programs import kept
from jaxshroud.model.linear import area, free_power, power_reduction, steady_amplitudes, waves_of
from jaxshroud.model.linear_system import stress_response
from jaxshroud.model.steady_numbers import SteadyNumbers, steady_extremes, steady_peak, steady_rms
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import LIMIT_KEYS
from jaxshroud.scene.optional import MEAN_LOADS
from jaxshroud.scene.quantities import (
    DISPLACEMENTS,
    STRESSES,
    Amplitude,
    Quantity,
    RequiredReduction,
    amplitude_of,
    counted_amplitude,
    free_name,
    is_reduction,
)
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.vary import fields_of, named_number
from jaxshroud.signals.averages import POWER_ROUNDINGS, averages, closed_forms, half_diagonal
from jaxshroud.signals.statistics import confidence_interval, t_quantile

PEAK_STRETCHES = 6  # of the kept periods, whose largest distances are compared
UNDRIVEN = 1e-9  # of the displacement of a block: an amplitude below it is the rounding of a load that is 0


def amplitude_values(scenes: Scene, samples: Sample, number: np.ndarray) -> dict[str, np.ndarray]:
    """The values of `WithAmplitudes` by their names, (lanes, blades) each; nothing unless they were kept.

    Args:
        scenes: The scenes (leading axis).
        samples: The kept periods, (lanes, periods).
        number: The period number of each lane, 0 if aperiodic: whole orbits are averaged, the latest ones.
    """
    if samples.moments is None or samples.extent is None:
        return {}
    counted = counted_periods(samples, number)
    time = math.tau / np.asarray(scenes.drive.omega, float)
    shares = (counted / counted.sum(axis=-1, keepdims=True) / time[:, None])[:, None]

    mean, square = ([np.sum(shares * _by_period(a), axis=-1) for a in moment] for moment in samples.moments)
    highest = [_largest_of(a, counted) for a in samples.extent.highest]
    lowest = [-_largest_of(-a, counted) for a in samples.extent.lowest]
    values = {}
    for i, name in enumerate(DISPLACEMENTS):
        values[f"{name}_mean"] = mean[i]
        values[f"{name}_rms"] = np.sqrt(np.maximum(square[i] - mean[i] ** 2, 0.0))
        values[f"{name}_peak"] = np.maximum(highest[i] - mean[i], mean[i] - lowest[i])
    for high, low in zip(highest[3:], lowest[3:], strict=True):
        values |= _stress_values(scenes, high, low)
    return values | free_amplitudes(scenes)


def _stress_values(scenes: Scene, high: Any, low: Any) -> dict[str, Any]:
    """The values of a stress that goes from `low` to `high`, by their names."""
    values = {"sigma_a": (high - low) / 2, "sigma_m": (high + low) / 2}
    if "blades.sigma_e" not in fields_of(scenes):
        return values
    _, *used = stress_levels(high, low, *(named_number(scenes, key) for key in LIMIT_KEYS))
    return {**values, "goodman": high.__array_namespace__().maximum(*used)}


def stress_levels(high: Any, low: Any, sigma_e: Any, sigma_u: Any, sigma_0: Any) -> tuple[Any, Any, Any]:
    """Half the range of a stress, and how much of its limits that uses alone, and with the middle [Pa].

    The larger of these two is Goodman's utilisation, sigma_a / sigma_e + max(sigma_m + sigma_0, 0) / sigma_u.
    """
    half = (high - low) / 2
    return half, half / sigma_e, half / sigma_e + ((high + low) / 2 + sigma_0) / sigma_u


def amplitude_intervals(scenes: Scene, samples: Sample, number: np.ndarray) -> dict[str, np.ndarray]:
    """Half widths of the 95 % intervals of the root mean squares of `amplitude_values`, by the batches of P_d.

    They are NaN below two orbits. The arguments are those of `amplitude_values`.
    """
    if samples.moments is None:
        return {}
    period = math.tau / np.asarray(scenes.drive.omega, float)
    unit = float(np.finfo(scenes.drive.omega.dtype).eps)
    values = {}
    for name, mean, square in zip(DISPLACEMENTS, *samples.moments, strict=True):
        first, second = (_by_period(a) / period[:, None, None] for a in (mean, square))
        half = np.empty(first.shape[:2])
        for q in np.unique(number):
            lanes = np.flatnonzero(number == q)
            half[lanes] = _rms_half_width(first[lanes], second[lanes], max(int(q), 1), unit)
        values[f"{name}_rms_ci"] = half
    return values


def _rms_half_width(mean: np.ndarray, square: np.ndarray, q: int, unit: float) -> np.ndarray:
    """The half width of the interval of a root mean square about the mean, (lanes, blades).

    Args:
        mean: The mean of the number in each period, (lanes, blades, periods).
        square: That of its square.
        q: The periods of an orbit.
        unit: The rounding unit of the march, of which intervals are no narrower than that of the power is.
    """
    used = mean.shape[-1] // q * q
    mean, square = (a[..., a.shape[-1] - used :] for a in (mean, square))
    middle = mean.mean(axis=-1, keepdims=True)
    variance = square - middle * (2 * mean - middle)
    width = np.maximum(confidence_interval(variance, q), POWER_ROUNDINGS * unit * square.mean(axis=-1))
    rms = np.sqrt(np.maximum(variance.mean(axis=-1), 0.0))
    return np.where(rms > 0, width / (2 * np.where(rms > 0, rms, 1.0)), 0.0 * width)


def _by_period(values: np.ndarray) -> np.ndarray:
    """Values (lanes, periods, blades) with periods side by side, (lanes, blades, periods): sums are pairwise."""
    return np.stack([*np.moveaxis(values, -1, 0)], axis=1)


def counted_periods(samples: Sample, number: np.ndarray) -> np.ndarray:
    """Which periods count, (lanes, periods): the latest whole orbits."""
    n = np.shape(samples.power)[1]
    q = np.maximum(number, 1)
    return np.arange(n) >= (n - n // q * q)[:, None]


def _largest_of(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """The largest of values (lanes, periods, ...) over the periods that count, (lanes, ...)."""
    return np.where(_like(counted, values), values, -np.inf).max(axis=1)


def _like(counted: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Which periods count, with as many axes as the values (lanes, periods, ...)."""
    return counted.reshape(*counted.shape, *[1] * (values.ndim - 2))


def free_amplitudes(scenes: Scene, names: tuple[str, ...] = DISPLACEMENTS) -> dict[str, np.ndarray]:
    """The amplitudes of displacements without contact by their names, see `free_name`, (lanes, blades) each."""
    count = len(scenes.drive.omega)

    def chunk(_, lanes):
        return _free_amplitudes(jax.tree.map(lambda a: np.asarray(a)[lanes], scenes), names)

    found = in_chunks(chunk, count, 1 if count == 1 else LANES_PER_CALL)
    return {name: np.asarray(a, float) for name, a in found.items()}


@kept("names")
def _free_amplitudes(scenes: Scene, names: tuple[str, ...]):
    def one(scene: Scene):
        free = steady_amplitudes(scene)
        waves = {name: waves_of(free, name) for name in names}
        peaks = {free_name(f"{name}_peak"): steady_peak(a) for name, a in waves.items()}
        return peaks | {free_name(f"{name}_rms"): steady_rms(a) for name, a in waves.items()}

    return jax.vmap(one)(scenes)


@kept("name")
def _free_means(scenes: Scene, name: str) -> Any:
    """The displacements of scenes (leading axis) under the mean loads without contact, (lanes, blades)."""

    def one(scene: Scene):
        held = steady_amplitudes(scene).get(0)
        return jnp.zeros_like(scene.drive.phase) if held is None else getattr(held, name).imag

    return jax.vmap(one)(scenes)


@kept()
def _free_stress(scenes: Scene) -> Any:
    """The values of the stress of scenes (leading axis) without contact, by their names, (lanes, blades) each."""

    def one(scene: Scene):
        loads = scene.drive.harmonics()
        waves = {n: stress_response(scene, scene.drive.frequency(n), load) for n, load in loads.items()}
        mean = waves.pop(0).imag if 0 in waves else 0.0
        return _stress_values(scene, *steady_extremes(SteadyNumbers(mean, waves)))

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
    period = math.tau / np.asarray(scenes.drive.omega, float)[:, None]
    counted = counted_periods(samples, number)

    def mean(a):
        return counted_mean(a, counted)

    def largest(a):
        return _largest_of(a, counted)

    N, N_slip, time_slip, slip = map(mean, samples.loads)
    impacts = mean(samples.impacts.number)
    own = scenes.parts.contact == "own"
    mu = np.asarray(scenes.friction.mu, float).reshape(len(period), -1)
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
    columns = amplitudes._asdict()
    values = {f"{name}_{of}": a[..., i] for i, name in enumerate(DISPLACEMENTS) for of, a in columns.items()}
    return values | free_amplitudes(scenes)


class Levels(NamedTuple):
    """A quantity of many lanes."""

    value: np.ndarray  # (lanes,)
    ci: np.ndarray  # (lanes,) half width of its 95 % interval; NaN for "P_d_worst" and means
    number: np.ndarray  # (lanes,) period number, 0: aperiodic


def levels_of(of: Quantity, scenes: Scene, samples: Sample) -> Levels:
    """The quantity `of` of scenes (leading axis) from their samples, with moments and extent for an amplitude."""
    motion, power, P_0 = averages(scenes, samples)
    if of == "P_d":
        return Levels(power.P_d, power.ci, motion.number)
    if of == "P_d_vibration":
        return Levels(power.P_d_vibration, power.vibration_ci, motion.number)
    counts = scenes.layout.counting
    if of == "P":
        return Levels(power.P[:, counts].sum(axis=1), power.ci * P_0[:, counts].sum(axis=1) / 100, motion.number)
    amplitude = amplitude_of(of)
    if amplitude is None:
        value = power_reduction(power.P, P_0).min(axis=1)
        return Levels(value, np.full_like(value, np.nan), motion.number)
    of_blades = amplitude_values(scenes, samples, motion.number)[of][:, counts]
    value = of_blades.max(axis=1)
    blade = of_blades.argmax(axis=1)[:, None]
    ci = np.full_like(of_blades, np.nan)
    if amplitude.measure == "rms":
        ci = amplitude_intervals(scenes, samples, motion.number)[f"{of}_ci"][:, counts]
    elif amplitude.measure != "mean":
        per_unit = named_number(scenes, "blades.sigma_e") if of == "goodman" else 1.0
        ci = (_peak_half_width(amplitude.row, samples, motion.number) / per_unit)[:, counts]
    return Levels(value, np.take_along_axis(ci, blade, axis=1)[:, 0], motion.number)


def _peak_half_width(row: int, samples: Sample, number: np.ndarray) -> np.ndarray:
    """The half width within which the largest distance over as many other periods would be found, (lanes, blades).

    The largest of many values scatters as much as the largest of few of them: those of a few stretches of the kept
    periods say by how much. NaN below two orbits.
    """
    high, low = (np.moveaxis(np.asarray(part[row], float), 1, -1) for part in samples.extent)
    swing = (high - low) / 2
    n = swing.shape[-1]
    half = np.full(swing.shape[:-1], np.nan)
    for q in np.unique(number):
        orbit = max(int(q), 1)
        stretches = min(PEAK_STRETCHES, n // orbit)
        if stretches < 2:
            continue
        lanes = np.flatnonzero(number == q)
        length = n // stretches // orbit * orbit
        largest = swing[lanes][..., n - stretches * length :].reshape(len(lanes), -1, stretches, length).max(axis=-1)
        spread = largest.std(axis=-1, ddof=1) * np.sqrt(1 + 1 / stretches)
        half[lanes] = t_quantile(stretches - 1) * spread
    return half


def free_level(of: Quantity, scene: Scene) -> float:
    """What a quantity is compared with: what it is without contact; NaN for P_d.

    It is the sum of P_0 over the blades that count, or the largest of their amplitudes. A displacement on which no
    load works is compared with that of the block, see `block_level`.
    """
    if is_reduction(of):
        return np.nan
    amplitude = amplitude_of(of)
    if amplitude is None:
        return float(np.asarray(free_power(scene))[scene.layout.counting].sum())
    name = amplitude.displacement
    lane = one_lane(without_given(scene))
    if of in STRESSES:
        return float(counted_amplitude(np.asarray(_free_stress(lane)[of]), scene.layout)[0])
    of_blades = (
        _free_means(lane, name) if amplitude.measure == "mean" else free_amplitudes(lane, (name,))[free_name(of)]
    )
    own = float(counted_amplitude(np.abs(of_blades), scene.layout)[0])
    of_block = block_level(amplitude, scene)
    return own if own > UNDRIVEN * of_block else of_block


def block_level(amplitude: Amplitude, scene: Scene) -> float:
    """The largest RMS displacement of the blocks that count, without contact [m].

    Of angles it is that over half the longer diagonal of a block [rad].
    """
    P_0 = np.asarray(free_power(scene))[scene.layout.counting]
    lever = float(half_diagonal(scene.shroud)) if amplitude.displacement == "theta" else 1.0
    return float(np.sqrt(P_0.max() / area(scene.shroud))) / lever


def compared_powers(of: str, scenes: Scene) -> np.ndarray:
    """The powers without contact with which `of` of one scene or many is compared, (lanes, powers) [m^4]."""
    lanes = scenes if np.ndim(scenes.drive.omega) else one_lane(scenes)
    P_0 = closed_forms(without_given(lanes))[1].astype(float)[:, scenes.layout.counting]
    return P_0 if of == "P_d_worst" else P_0.sum(axis=1, keepdims=True)


def is_comparable(of: str, scene: Scene) -> bool:
    """Whether `of` of a single scene is compared with a power that is neither 0 nor infinite."""
    P_0 = compared_powers(of, scene)
    return bool(np.all((P_0 > 0) & np.isfinite(P_0)))


def is_preloaded(scene: Scene) -> bool:
    """Whether there is a mean load or interference in a scene, or in some of many."""
    numbers = fields_of(scene)
    loaded = any(np.any(np.asarray(numbers[key])) for key in MEAN_LOADS if key in numbers)
    return loaded or (scene.parts.contact != "none" and bool(np.any(np.asarray(scene.running_shroud.gap) < 0)))


def counted_reduction(scene: Scene) -> RequiredReduction:
    """The reduction that counts where none is requested: of a preloaded scene that of the vibration about its mean."""
    return "P_d_vibration" if is_preloaded(scene) else "P_d"


def check_vibration(of: str, scenes: Scene, lanes: Callable[[Any], Any] = np.any) -> None:
    """Raise an InputError where `of` is compared with nothing in these `lanes` of one scene or many.

    Args:
        of: The quantity, a `Quantity`.
        scenes: The scenes.
        lanes: Whether it counts that the blades of some lanes (lanes,) do not vibrate without contact.
    """
    if not lanes((compared_powers(of, scenes) == 0).any(axis=1)):
        return
    if scenes.row is None:
        nothing = "The left blade does not vibrate without contact"
    else:
        which = "a blade of the row does not vibrate" if of == "P_d_worst" else "no blade of the row vibrates"
        nothing = f"Without contact {which}"
    lost = f"there is no {of}" if is_reduction(of) else f"{of} has nothing to be compared with"
    force = "force in drive.harmonic" if scenes.drive.of_harmonics() else "drive.F_0"
    raise InputError(f"{nothing}, and {lost}; give it a {force}.")


def check_resonance(of: str, scenes: Scene, lanes: Callable[[Any], Any] = np.any) -> None:
    """Raise an InputError where `of` is compared with an infinite amplitude: every motion is a reduction by 100 %.

    The arguments are those of `check_vibration`.
    """
    if lanes(np.isinf(compared_powers(of, scenes)).any(axis=1)):
        raise InputError(
            f"The drive meets an undamped natural frequency: without contact the amplitude, with which {of} is "
            "compared, is infinite; change drive.omega or give the blades a damping."
        )
