"""Waves around a row of blades: harmonics in time by nodal diameters around the row.

A travelling wave of harmonic n and nodal diameter h is Re a exp(i (n omega t + 2 pi h i / N)) at blade i: it travels
forward, from blade to blade in the order of time, for h < 0 and backward for h > 0. A drive of engine order EO, whose
phase at blade i is 2 pi EO i / N, alone excites the harmonics n at h = n EO modulo N. A motion that repeats after q
drive periods T can be a wave as well, in which each blade is ahead of its neighbour by one of the q shifts
(EO + m N) T / N, m = 0 .. q - 1, that a turn around the row closes: those of which q divides EO + m N.

The amplification of mistuned rows: their largest amplitude over that of the tuned row, by one rule for both.

The rule: the largest over all blades, over all values of the number along which the row is driven through its
resonances, and over all directions in which these are taken. Whitehead's factor (1 + sqrt(N)) / 2 bounds it for a
linear row with one mode per blade.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.typed import FloatArray


class BladeSpectrum(NamedTuple):
    """Amplitudes of waves, (..., harmonics, N): |a| by harmonic 0, 1, ... of the drive and by nodal diameter."""

    amplitude: FloatArray  # [m] or [rad]; of all blades alike
    diameters: np.ndarray  # (N,) from -N/2 to N/2


def blade_spectrum(q: FloatArray, per_period: float, periods: int) -> BladeSpectrum:
    """The waves of a displacement over its last drive periods.

    Args:
        q: Samples (..., time, N), the last one at the end of a period.
        per_period: Samples in a drive period.
        periods: Drive periods.

    Raises:
        ValueError: The samples do not divide the period, or there are too few.
    """
    count = round(per_period)
    if abs(count - per_period) > 1e-9 * per_period or count < 4:
        raise InputError(f"{per_period:g} samples in a drive period: waves need a whole number, at least 4.")
    if q.shape[-2] <= count * periods:
        raise InputError(f"The run has fewer than {periods} drive periods of samples.")
    last = np.asarray(q, float)[..., -count * periods :, :]
    blades = q.shape[-1]
    both = np.fft.fft2(last, axes=(-2, -1)) / (count * periods * blades)
    harmonics = both[..., : count * periods // 2 : periods, :]
    twice = np.where(np.arange(harmonics.shape[-2]) > 0, 2.0, 1.0)[:, None]  # positive and negative frequencies
    diameters = np.fft.fftfreq(blades, 1 / blades).round().astype(int)
    order = np.argsort(diameters, kind="stable")
    return BladeSpectrum((twice * np.abs(harmonics))[..., order], diameters[order])


def closing_shifts(order: int, blades: int, periods: int) -> list[int]:
    """The shifts [T / N] from blade to blade of waves of so many periods that a turn around the row closes."""
    return [shift for shift in range(order, order + periods * blades, blades) if shift % periods == 0]


class WaveDistance(NamedTuple):
    """How far a displacement of a row is from a travelling wave of its drive."""

    share: float  # of its square outside such a wave; NaN without motion
    shift: int | None  # by which each blade is ahead of its neighbour [T / N]; None where no shift closes the row


def wave_distance(q: FloatArray, per_period: int, periods: int, order: int, shifts: Sequence[int]) -> WaveDistance:
    """The share of a displacement's mean square that no travelling wave of the drive explains.

    Counted are all that varies in time, and the differences of the blades' means. Outside is what is at another nodal
    diameter than the wave's, what is at fractions of the drive's harmonics where no wave of so many periods fits the
    row, and all of those differences. A static deflection of all blades alike is neither.

    Args:
        q: Samples (time, N), the last one at the end of a period.
        per_period: Samples in a drive period.
        periods: Drive periods after which the motion repeats.
        order: The engine order, modulo N.
        shifts: The `closing_shifts` of waves of so many periods; none where the motion does not repeat.
    """
    blades = q.shape[-1]
    count = per_period * periods
    waves = np.fft.fft2(np.asarray(q, float)[-count:]) / (count * blades)
    square = np.abs(waves[: (count + 1) // 2]) ** 2
    static = square[0, 1:].sum()
    moving = 2 * square[1:]  # positive and negative frequencies
    total = moving.sum() + static
    if not total > 0:
        return WaveDistance(np.nan, None)
    frequency = np.arange(1, len(moving) + 1)
    if not shifts:
        whole = frequency[periods - 1 :: periods]
        inside = moving[whole - 1, whole // periods * order % blades].sum()
        return WaveDistance(float(max(total - inside, 0.0) / total), None)
    explained = [moving[frequency - 1, frequency * shift // periods % blades].sum() for shift in shifts]
    best = int(np.argmax(explained))
    return WaveDistance(float(max(total - explained[best], 0.0) / total), shifts[best])


MOST_REPEATED = 16  # drive periods after which a motion may repeat
REPEAT_TOLERANCE = 1e-3  # of the largest displacement
QUIET = 1e-9  # of the largest displacement: what moves less about its mean is rounding


def repeats_after_periods(displacements: Sequence[FloatArray], per_period: int) -> int:
    """The least number of drive periods after which displacements (time, N) repeat at their end; 0 for none.

    Other than `repeats_after` it compares the last two orbits only, so that a transient may come first.
    """
    for periods in range(1, MOST_REPEATED + 1):
        count = per_period * periods
        if 2 * count >= len(displacements[0]):
            return 0
        ends = [(q[-count:], q[-2 * count : -count]) for q in displacements]
        if all(np.abs(last - before).max() <= REPEAT_TOLERANCE * np.abs(last).max() for last, before in ends):
            return periods
    return 0


class RowWave(NamedTuple):
    """How far a run of a row is from a travelling wave: of x, y and theta the one that is furthest."""

    distance: WaveDistance
    name: str  # of that displacement
    periods: int  # over which it is measured
    repeats: bool  # whether the motion repeats after these
    unknown: str = ""  # why there is no distance

    @property
    def words(self) -> str:
        """The distance in words, or why there is none."""
        if self.unknown:
            return f"its distance from a travelling wave is unknown: {self.unknown}"
        text = f"{self.distance.share:.2g} of the motion in {self.name} is outside a travelling wave"
        if not self.repeats:
            return f"{text} (the motion does not repeat; over {self.periods} periods)"
        if self.periods == 1:
            return text
        if self.distance.shift is None:
            return f"{text} (over {self.periods} periods, of which no wave fits the row)"
        return f"{text} of {self.periods} periods (each blade ahead of its neighbour by {self.distance.shift} T/N)"


def without_wave(reason: str) -> RowWave:
    """The result where a distance is unknown."""
    return RowWave(WaveDistance(np.nan, None), "", 0, False, reason)


def row_wave(motion: Mapping[str, FloatArray], per_period: float, order: int | None, repeats: int = 0) -> RowWave:
    """How far the last orbit of a run is from a travelling wave; without an orbit, the second half of the run.

    Args:
        motion: Displacements (time, N) by name, the last sample at the end of a period.
        per_period: Samples in a drive period.
        order: The engine order modulo N; None where the drive has none.
        repeats: Drive periods after which the motion repeats, where they are known.
    """
    count = round(per_period)
    samples = len(next(iter(motion.values())))
    if order is None:
        return without_wave("the phases of the drive are those of no engine order")
    if not all(np.isfinite(q).all() for q in motion.values()):
        return without_wave("the run has stopped")
    if abs(count - per_period) > 1e-9 * per_period or count < 4 or samples <= count:
        return without_wave("a wave needs a whole number of samples in a drive period, at least 4, and one period")
    largest = max(float(np.abs(q).max()) for q in motion.values())
    heard = {name: q for name, q in motion.items() if np.abs(q - q.mean()).max() > QUIET * largest}
    if not heard:
        return without_wave("nothing moves")
    repeats = repeats or repeats_after_periods([*heard.values()], count)
    periods = repeats or max((samples - 1) // count // 2, 1)
    shifts = closing_shifts(order, next(iter(heard.values())).shape[-1], periods) if repeats else []
    distances = {name: wave_distance(q, count, periods, order, shifts) for name, q in heard.items()}
    furthest = max(distances, key=lambda name: np.nan_to_num(distances[name].share, nan=-1.0))
    return RowWave(distances[furthest], furthest, periods, repeats > 0)


def participation_ratio(amplitude: FloatArray) -> FloatArray:
    """How many of the blades take part, of all: (sum a^2)^2 / (N sum a^4), 1 if all alike and 1/N if one alone."""
    square = np.asarray(amplitude, float) ** 2
    whole = square.shape[-1] * np.sum(square**2, axis=-1)
    return np.where(whole > 0, np.sum(square, axis=-1) ** 2 / np.where(whole > 0, whole, 1.0), np.nan)


HALF_POWER = math.sqrt(0.5)  # of a peak's amplitude, where its width is taken


class RowResponses(NamedTuple):
    """The amplitudes of rows with n patterns of mistuning."""

    amplitude: FloatArray  # (n, directions, values, N); NaN where a lane stopped
    status: np.ndarray  # (n, directions, values)
    settled: np.ndarray  # (n, directions, values) whether the transient was over
    to_keep: FloatArray | None = None  # (n, directions, values) periods, where those kept are too few; None: linear
    peak_value: FloatArray | None = None  # (n,) where, between the values, a linear row has its peak
    peak: FloatArray | None = None  # (n, N) the amplitudes there


class LargestAmplitude(NamedTuple):
    """The largest amplitude of each pattern, and where it is."""

    amplitude: FloatArray  # (n,); NaN where no lane came to its end
    direction: np.ndarray  # (n,) its index
    nearest: np.ndarray  # (n,) index of the value, or of the one beside it
    value: FloatArray  # (n,)
    blade: np.ndarray  # (n,)
    participation_ratio: FloatArray  # (n,) of the amplitudes of all blades there
    whole: np.ndarray  # (n,) whether all lanes came to their ends
    at_end: np.ndarray  # (n,) whether it is at an end of the range of values: the peak may lie beyond
    coarse: np.ndarray  # (n,) whether the amplitudes at both values beside it are below half power


def largest_amplitudes(found: RowResponses, values: FloatArray) -> LargestAmplitude:
    """The largest amplitude over blades, `values` and directions of each pattern; of a linear row, between them too."""
    amplitude = np.where(np.isfinite(found.amplitude), found.amplitude, -np.inf)
    n = len(amplitude)
    rows = np.arange(len(amplitude))
    flat = amplitude.reshape(n, -1)
    direction, index, blade = (np.asarray(i) for i in np.unravel_index(flat.argmax(axis=1), amplitude.shape[1:]))
    top = flat.max(axis=1)
    value = values[index]
    of_blades = found.amplitude[rows, direction, index]
    beside = _beside(amplitude[rows, direction, :, blade], index)
    if found.peak is not None and found.peak_value is not None:
        higher = found.peak.max(axis=1) >= top
        top = np.maximum(top, found.peak.max(axis=1))
        value = np.where(higher, found.peak_value, value)
        blade = np.where(higher, found.peak.argmax(axis=1), blade)
        of_blades = np.where(higher[:, None], found.peak, of_blades)
    return LargestAmplitude(
        amplitude=np.where(np.isfinite(top), top, np.nan),
        direction=direction,
        nearest=index,
        value=value,
        blade=blade,
        participation_ratio=participation_ratio(of_blades),
        whole=(found.status == Status.OK).all(axis=(1, 2)),
        at_end=(index == 0) | (index == len(values) - 1),
        coarse=beside < HALF_POWER * flat.max(axis=1),
    )


def _beside(of_blade: FloatArray, index: np.ndarray) -> FloatArray:
    """The larger of the amplitudes (n, values) at both neighbours of each index."""
    padded = np.pad(of_blade, ((0, 0), (1, 1)), constant_values=-np.inf)
    rows = np.arange(len(index))
    return np.maximum(padded[rows, index], padded[rows, index + 2])


def whitehead_factor(blades: int) -> float:
    """Whitehead's factor (1 + sqrt(N)) / 2: the bound of the amplification of a linear row with one mode per blade."""
    return (1 + math.sqrt(blades)) / 2
