"""Rows with patterns of mistuning that respond in closed form: all interfaces stay in one state of contact.

Under several harmonics the amplitude of a blade is that of their sum, and the worst blade is the one with the largest.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.threads import in_chunks
from jaxshroud.cache.programs import kept
from jaxshroud.linear.mistuned import (
    MistunedSystem,
    linear_systems,
    linear_waves,
    moving_directions,
    part_of,
    wave_slopes,
)
from jaxshroud.linear.natural_modes import NaturalContact
from jaxshroud.model.modes import Status
from jaxshroud.model.steady_numbers import SteadyNumbers, steady_course, steady_peak, steady_rms, turning_phases
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.quantities import amplitude_of
from jaxshroud.scene.scene import without_given
from jaxshroud.scene.typed import FloatArray
from jaxshroud.scene.vary import with_numbers
from jaxshroud.signals.waves import LargestAmplitude, RowResponses
from jaxshroud.verbs.mistuned_rows import MistunedRow, PatternProblem, PatternSlopes

PEAK_NODES = 32, 8  # of polynomials between the neighbours of the largest value, and close to the peak that these have
LOOK, NEAR_PEAK = 129, 4  # values at which the first are looked at, and how many of these to either side are close
CLOSER_LOOKS, ZOOM_VALUES = 4, 33  # closer looks at the second
AT_ONCE = 4  # patterns
NUMBERS_PER_CALL = 1 << 12  # of which amplitudes are found
TIED = 1e-6  # relative distance of two amplitudes, or slopes, that count as one
TURNED = 1e-6  # relative rate up to which a phase is one at which a number turns

WavesByOrder = dict[int, np.ndarray]  # complex amplitudes by order


def linear_problem(
    row: MistunedRow, contact: NaturalContact, tick: Callable[[int], None] = lambda _: None
) -> PatternProblem:
    """A linear row: every interface stays in one state of contact. Costs are solutions of the linear system.

    Args:
        row: The row.
        contact: The state of contact.
        tick: Called with the numbers of solutions that are done.
    """
    amplitude = amplitude_of(row.of)
    numbered = with_numbers(row.scene, [row.along])
    assert amplitude is not None  # which `of` is
    cost = len(row.values) + sum(PEAK_NODES) + 1

    def at(values: FloatArray, moving: np.ndarray | None = None) -> MistunedSystem:
        scenes = without_given(scenes_at(numbered, [row.along], np.ravel(values)[:, None]))
        return _systems(scenes, contact, amplitude.row, moving)

    def levels(waves: WavesByOrder) -> FloatArray:
        return _levels(waves, amplitude.measure)

    whole = at(row.values)
    moving = moving_directions(whole)
    everywhere = part_of(whole, moving)

    def respond(patterns: FloatArray) -> RowResponses:
        blocks = [_responses(patterns[i : i + AT_ONCE]) for i in range(0, len(patterns), AT_ONCE)]
        level, value, peak = (np.concatenate(a) for a in zip(*blocks, strict=True))
        lanes = (len(patterns), 1, len(row.values))
        ended = np.full(lanes, Status.OK, np.int32)
        settled = np.ones(lanes, bool)
        return RowResponses(amplitude=level[:, None], status=ended, settled=settled, peak_value=value, peak=peak)

    def _responses(patterns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The amplitudes (n, values, N) of n patterns, and where their peaks lie, with the amplitudes there."""
        waves = [linear_waves(everywhere, pattern) for pattern in patterns]
        level = levels({n: np.stack([one[n] for one in waves]) for n in everywhere.loads})

        def waves_at(values: FloatArray) -> WavesByOrder:
            every = np.repeat(patterns, values.shape[1], axis=0)
            found = linear_waves(at(values, moving), every)
            return {n: a.reshape(*values.shape, -1) for n, a in found.items()}

        value = _peak_values(row.values, level, waves_at, levels)
        peak = levels(waves_at(value[:, None]))[:, 0]
        tick(len(patterns) * cost)
        return level, value, peak

    def slopes(patterns: FloatArray, top: LargestAmplitude) -> PatternSlopes:
        systems = at(top.value, moving)
        lanes = [jax.tree.map(lambda a, i=i: a[i], systems) for i in range(len(patterns))]
        found = [_slope(lane, pattern, amplitude.measure) for lane, pattern in zip(lanes, patterns, strict=True)]
        tick(2 * len(patterns))
        return PatternSlopes(np.array([slope for slope, _ in found]), sum(tied for _, tied in found))

    return PatternProblem(values=row.values, respond=respond, slopes=slopes, cost=cost, slope_cost=2)


def _systems(scenes: Any, contact: NaturalContact, coordinate: int, moving: np.ndarray | None) -> MistunedSystem:
    """The linear systems of scenes (leading axis), in some of their directions if these are given."""

    def chunk(_, lanes):
        some = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[lanes]), scenes)
        found = jax.tree.map(np.asarray, linear_systems(some, contact, coordinate))
        return found if moving is None else part_of(found, moving)

    return in_chunks(chunk, len(scenes.drive.omega), LANES_PER_CALL)


def _levels(waves: WavesByOrder, measure: str) -> FloatArray:
    """The peaks or root mean squares of numbers with these complex amplitudes, of any shape."""
    shape = next(iter(waves.values())).shape
    flat = {n: a.ravel() for n, a in waves.items()}

    def chunk(_, numbers):
        return _kept_levels({n: a[numbers] for n, a in flat.items()}, measure)

    return np.asarray(in_chunks(chunk, int(np.prod(shape)), NUMBERS_PER_CALL), float).reshape(shape)


@kept("measure")
def _kept_levels(waves: dict[int, Any], measure: str) -> Any:
    return steady_peak(waves) if measure == "peak" else steady_rms(waves)


def _peak_values(
    values: FloatArray,
    level: FloatArray,
    waves_at: Callable[[FloatArray], WavesByOrder],
    levels: Callable[[WavesByOrder], FloatArray],
) -> FloatArray:
    """Where, about the largest amplitude (n, values, N) of each pattern, the largest of all blades has its peak.

    The amplitude has kinks where another blade or instant becomes the largest, but the complex amplitudes of harmonics
    have none: between the neighbours of the largest value these are polynomials.

    Args:
        values: The values (values,).
        level: The amplitudes there.
        waves_at: The complex amplitudes (n, m, N) at m values for each pattern, (n, m).
        levels: The amplitudes of such numbers.
    """
    order = np.sort(values)
    place = np.searchsorted(order, values[level.max(axis=-1).argmax(axis=1)])
    ends = order[np.maximum(place - 1, 0)], order[np.minimum(place + 1, len(order) - 1)]
    _, ends = _about_largest(ends, LOOK, NEAR_PEAK, _between(ends, PEAK_NODES[0], waves_at, levels))
    at = _between(ends, PEAK_NODES[1], waves_at, levels)
    value = ends[0]
    for _ in range(CLOSER_LOOKS):
        value, ends = _about_largest(ends, ZOOM_VALUES, 1, at)
    return value


def _between(
    ends: tuple[FloatArray, FloatArray],
    nodes: int,
    waves_at: Callable[[FloatArray], WavesByOrder],
    levels: Callable[[WavesByOrder], FloatArray],
) -> Callable[[FloatArray], FloatArray]:
    """The amplitudes between ends (n,), by polynomials of the waves through so many Chebyshev nodes."""
    chebyshev = np.polynomial.chebyshev
    middle, half = ((ends[1] + sign * ends[0])[:, None] / 2 for sign in (1, -1))
    known = waves_at(middle + half * chebyshev.chebpts1(nodes))
    to_series = np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts1(nodes), nodes - 1))
    series = {n: to_series @ a for n, a in known.items()}

    def at(values: FloatArray) -> FloatArray:
        shares = chebyshev.chebvander((values - middle) / half, nodes - 1)
        return levels({n: shares @ a for n, a in series.items()})

    return at


def _about_largest(
    ends: tuple[FloatArray, FloatArray], count: int, apart: int, at: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Of so many values between ends (n,) that with the largest amplitude of all blades, and those so far `apart`."""
    fine = np.linspace(*ends, count, axis=1)
    rows = np.arange(len(ends[0]))
    k = at(fine).max(axis=-1).argmax(axis=1)
    return fine[rows, k], (fine[rows, np.maximum(k - apart, 0)], fine[rows, np.minimum(k + apart, count - 1)])


def _slope(system: MistunedSystem, pattern: FloatArray, measure: str) -> tuple[FloatArray, bool]:
    """The derivatives of the largest amplitude of a row by its pattern, and whether others as large move differently.

    The instant of a peak is held: there the rate is 0.
    """
    waves = linear_waves(system, pattern)
    candidates = _peak_candidates(waves) if measure == "peak" else _rms_candidates(waves)
    largest = max(level for level, _, _ in candidates)
    tied = [one for one in candidates if one[0] >= (1 - TIED) * largest]
    by_blade = {blade: wave_slopes(system, pattern, blade) for blade in {blade for _, blade, _ in tied}}
    every = [np.sum([(shares[n] * a).real for n, a in by_blade[blade].items()], axis=0) for _, blade, shares in tied]
    first = every[int(np.argmax([level for level, _, _ in tied]))]
    return first, any(np.abs(other - first).max() > TIED * np.abs(first).max() for other in every)


Candidate = tuple[float, int, dict[int, Any]]  # level, blade, and the numbers by which slopes of its waves count


def _rms_candidates(waves: WavesByOrder) -> list[Candidate]:
    """The root mean square of each blade."""
    level = np.sqrt(np.sum([np.abs(a) ** 2 for a in waves.values()], axis=0) / 2)
    return [
        (float(rms), i, {n: np.conj(a[i]) / (2 * rms or np.inf) for n, a in waves.items()})
        for i, rms in enumerate(level)
    ]


def _peak_candidates(waves: WavesByOrder) -> list[Candidate]:
    """The distances from their means at which the displacements of blades turn."""
    phase, course, rate = (np.asarray(a) for a in _turns(waves))
    level = np.abs(course)
    sign = np.sign(course)
    turns = (np.abs(rate) <= TURNED * level) | (level == level.max())
    return [
        (float(level[k, i]), int(i), {n: -1j * sign[k, i] * np.exp(1j * n * phase[k, i]) for n in waves})
        for k, i in np.argwhere(turns & (level >= (1 - TIED) * level.max()))
    ]


@kept()
def _turns(waves: dict[int, Any]) -> tuple[Any, Any, Any]:
    """Phases (samples, N) at which displacements turn, their values there and their rates by the phase."""
    phase = turning_phases(waves)
    course, rate, _ = steady_course(SteadyNumbers(0.0, waves), phase)
    return phase, course, rate
