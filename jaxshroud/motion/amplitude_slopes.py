"""The derivatives of amplitudes on a periodic orbit.

At the time of an extreme the rate of a displacement vanishes, so that the extreme moves with a number of the scene as
the displacement does at that drive phase. Where two extremes are equally far from the mean, the amplitude is that of
one on either side, and its derivative is one-sided.
"""

from typing import NamedTuple

import numpy as np

from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.tangents import TangentProblem, Tangents
from jaxshroud.batch.trajectories import trajectories
from jaxshroud.motion.amplitudes import hermite_coefficients
from jaxshroud.motion.batched_algorithms import Algorithm, Derivatives, stacked
from jaxshroud.motion.orbit import PeriodicOrbit
from jaxshroud.motion.shooting import moved_start
from jaxshroud.scene.quantities import DISPLACEMENTS, Amplitude
from jaxshroud.scene.scene import without_given

LEAST_SAMPLES = 256  # of a drive period, between which an extreme is looked for
CLOSE = 1e-4  # relative distance within which an extreme may be the largest: above the error of the samples' cubics
TIE = 1e-6  # relative distance of two extremes at which the derivative counts as one-sided
MAX_SECANTS = 8
PHASE_TOLERANCE = 1e-9  # of a drive period, of the place of an extreme


class AmplitudeSlope(NamedTuple):
    """An amplitude and its derivatives."""

    level: float
    slope: np.ndarray  # (keys,)
    flags: tuple[str, ...] = ()


class Extreme(NamedTuple):
    """A turning point of a displacement between two samples, in drive periods from the section."""

    turns: float
    value: float
    before: float  # place of the sample before
    rate: float  # there


def amplitude_slope(orbit: PeriodicOrbit, amplitude: Amplitude, problem: TangentProblem) -> Algorithm[AmplitudeSlope]:
    """The derivatives of an amplitude along the directions of a problem, which begins at the start of the orbit."""
    assert orbit.jacobian is not None  # there is an orbit
    method = orbit.method._replace(amplitudes=True)
    whole = yield Derivatives(problem, orbit.q, orbit.steps_per_period, method)
    shift = moved_start(orbit.jacobian.by_state, whole.by_parameter, orbit.slider_is_free)
    (mean, square), by = whole.moments[:, amplitude.row], whole.moments_by_parameter + whole.moments_by_state @ shift
    mean_by, square_by = by[:, amplitude.row]
    if amplitude.measure == "mean":
        return AmplitudeSlope(float(mean), mean_by)
    if amplitude.measure == "rms":
        rms = np.sqrt(max(square - mean**2, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):  # a blade that stands still
            return AmplitudeSlope(float(rms), (square_by - 2 * mean * mean_by) / (2 * rms))
    found = []
    for extreme in farthest_extremes(orbit, amplitude, float(mean)):
        at = yield from _tangents_at(extreme, orbit, amplitude, problem)
        side = 1.0 if extreme.value > mean else -1.0
        moved = (at.by_parameter + at.by_state @ shift)[2 * amplitude.row]
        found.append((side * (at.vector[2 * amplitude.row] - mean), side * (moved - mean_by)))
    return _largest_peak(found)


def _largest_peak(found: list[tuple[float, np.ndarray]]) -> AmplitudeSlope:
    """The largest of some extremes, flagged where another is as large and moves differently."""
    level, slope = max(found, key=lambda pair: pair[0])
    tied = [other for value, other in found if value >= level * (1 - TIE)]
    differs = any(not np.allclose(other, slope, rtol=TIE, atol=0.0) for other in tied)
    return AmplitudeSlope(float(level), slope, ("two peaks",) if differs else ())


def farthest_extremes(orbit: PeriodicOrbit, amplitude: Amplitude, mean: float) -> list[Extreme]:
    """The turning points of an orbit's displacement that may be farthest from its mean."""
    finer = -(-LEAST_SAMPLES // orbit.steps_per_period)
    steps = orbit.steps_per_period * finer
    grid, (scenes, states) = (
        SampleGrid(0.0, steps, 1, steps * orbit.q, False),
        stacked([(without_given(orbit.scene), orbit.start)]),
    )
    motion = trajectories(scenes, states, grid, orbit.method, lambda _: None).samples["motion"]
    names = amplitude.displacement, f"v_{amplitude.displacement}"
    q, rate = (np.asarray(getattr(motion, name), float)[0, :, 0] for name in names)
    extremes = turning_points(q, rate, float(orbit.scene.drive.period), steps)
    farthest = max(abs(extreme.value - mean) for extreme in extremes)
    return [extreme for extreme in extremes if abs(extreme.value - mean) >= (1 - CLOSE) * farthest]


def turning_points(q: np.ndarray, rate: np.ndarray, period: float, steps: int) -> list[Extreme]:
    """The turning points of samples (n,) with their rates, by cubics; of a displacement at rest its start."""
    slope = rate * (period / steps)  # per interval
    places = np.flatnonzero((slope[:-1] * slope[1:] <= 0) & (slope[:-1] != slope[1:]) & (slope[1:] != 0))
    q_0, q_1, m_0, m_1 = q[places], q[places + 1], slope[places], slope[places + 1]
    s, (b, c) = m_0 / (m_0 - m_1), hermite_coefficients(q_0, q_1, m_0, m_1)
    columns = (places + s) / steps, q_0 + s * (m_0 + s * (b + s * c)), places / steps, rate[places]
    return [Extreme(*map(float, row)) for row in zip(*columns, strict=True)] or [Extreme(1.0, float(q[0]), 0.0, 0.0)]


def _tangents_at(
    extreme: Extreme, orbit: PeriodicOrbit, amplitude: Amplitude, problem: TangentProblem
) -> Algorithm[Tangents]:
    """The flow to an extreme with its tangents; the place is found by the secants of the rate."""
    (turns, _, last, last_rate), rate_index = extreme, 2 * (len(DISPLACEMENTS) + amplitude.row)
    at = yield _flow_to(turns, orbit, problem)
    for _ in range(MAX_SECANTS):
        rate = float(at.vector[rate_index])
        step = -rate * (turns - last) / (rate - last_rate) if rate != last_rate else 0.0
        if abs(step) <= PHASE_TOLERANCE:
            break
        last, last_rate, turns = turns, rate, turns + step
        at = yield _flow_to(turns, orbit, problem)
    return at


def _flow_to(turns: float, orbit: PeriodicOrbit, problem: TangentProblem) -> Derivatives:
    """The request for the flow over so many drive periods; the start and the end of an orbit are one place."""
    method = orbit.method._replace(amplitudes=True)
    return Derivatives(problem, 1, orbit.steps_per_period, method, turns % orbit.q or float(orbit.q))
