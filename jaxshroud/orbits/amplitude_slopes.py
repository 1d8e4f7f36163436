"""The derivatives of amplitudes on a periodic orbit.

At the time of an extreme the rate of a displacement vanishes, so that the extreme moves with a number of the scene as
the displacement does at that drive phase. Where two extremes are equally far from the mean, the amplitude is that of
one on either side, and its derivative is one-sided: that of the side which raises the amplitude.
"""

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import sampled_motions
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.tangents import TangentProblem, Tangents
from jaxshroud.march.locate import HermiteCubic
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives, stacked
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import moved_start
from jaxshroud.scene.keys import LIMIT_KEYS
from jaxshroud.scene.quantities import DISPLACEMENTS, Amplitude
from jaxshroud.scene.scene import without_given
from jaxshroud.scene.vary import named_number
from jaxshroud.signals.amplitudes import stress_levels

LEAST_SAMPLES = 256  # of a drive period, between which an extreme is looked for
CLOSE = 1e-4  # relative distance within which an extreme may be the largest: above the error of the samples' cubics
TIE = 1e-6  # relative distance of two extremes at which the derivative counts as one-sided
MAX_SECANTS = 8
PHASE_TOLERANCE = 1e-12  # of a drive period, of the place of an extreme: derivatives miss by some hundred times this


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
    blade: int


def amplitude_slope(orbit: PeriodicOrbit, amplitude: Amplitude, problem: TangentProblem) -> Algorithm[AmplitudeSlope]:
    """The derivatives of an amplitude along the directions of a problem, which begins at the start of the orbit."""
    assert orbit.jacobian is not None  # there is an orbit
    method = orbit.method._replace(amplitudes=True, vibration=False)
    whole = yield Derivatives(problem, orbit.q, orbit.steps_per_period, method)
    shift = moved_start(orbit.jacobian.by_state, whole.by_parameter, orbit.free_sliders)
    if amplitude.row == len(DISPLACEMENTS):
        return (yield from _stress_slope(amplitude, orbit, problem, shift))
    by = whole.moments_by_parameter + whole.moments_by_state @ shift
    counts = orbit.scene.layout.counting
    (mean, square), (mean_by, square_by) = whole.moments[:, amplitude.row, counts], by[:, amplitude.row, counts]
    if amplitude.measure == "mean":
        return largest_level([*zip(mean, mean_by, strict=True)], "blades tie")
    if amplitude.measure == "rms":
        rms = np.sqrt(np.maximum(square - mean**2, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):  # a blade that stands still
            rms_by = (square_by - 2 * mean[:, None] * mean_by) / (2 * rms[:, None])
        return largest_level([*zip(rms, rms_by, strict=True)], "blades tie")
    found = []
    blades = len(orbit.P)
    extremes = farthest_extremes(orbit, amplitude, mean)
    row = blades * amplitude.row

    def rates(at: Tangents) -> np.ndarray:
        assert at.shroud is not None  # as of all flows
        return at.shroud[row + 3 * blades :]

    for extreme in extremes:
        at = yield from _tangents_at(extreme, orbit, problem, rates)
        assert at.shroud is not None
        place = row + extreme.blade
        side = 1.0 if extreme.value > mean[extreme.blade] else -1.0
        moved = (at.shroud_by_parameter + at.shroud_by_state @ shift)[place]
        found.append((side * (at.shroud[place] - mean[extreme.blade]), side * (moved - mean_by[extreme.blade])))
    several = len({extreme.blade for extreme in extremes}) > 1
    return largest_level(found, "blades tie" if several else "two peaks")


def _stress_slope(
    amplitude: Amplitude, orbit: PeriodicOrbit, problem: TangentProblem, shift: np.ndarray
) -> Algorithm[AmplitudeSlope]:
    """The derivatives of half the range of the stress, or of Goodman's utilisation.

    `shift` is that of the start, (numbers, keys). Where the middle of the range, with the constant stress, is 0, the
    utilisation has a derivative on either side of each number.
    """

    def stress(at: Tangents) -> np.ndarray:
        """The stress and its rate, (2, blades)."""
        return np.sum(sigma * at.vector[: 2 * sigma.size].reshape(2, *sigma.shape), axis=1)

    def levels(numbers: Any) -> Any:
        """Those of which the largest counts."""
        return jnp.stack(stress_levels(*numbers))[counted]

    counted = slice(0, 1) if amplitude.measure else slice(1, None)
    keys = [*(f"blades.modes[{j}].sigma" for j in range(problem.scene.coordinates)), *LIMIT_KEYS]
    # The stress of each mode, and the limits, with their slopes, (modes + 3, blades, 1 + keys).
    own = np.stack([[named_number(one, key) for key in keys] for one in (problem.scene, *problem.directions)], axis=-1)
    sigma = own[:-3, :, 0]
    places = np.arange(1, LEAST_SAMPLES * orbit.q + 1) / LEAST_SAMPLES
    alone = problem._replace(directions=(), by_state=False)
    requests = [_flow_to(place, orbit, alone) for place in places]
    course = np.stack([stress(at) for at in Derivatives.answers(requests)])
    course = np.concatenate([course[-1:], course])  # (times, the stress and its rate, blades)
    period = float(orbit.scene.drive.period)
    found = []
    for blade in range(sigma.shape[1])[orbit.scene.layout.counting]:
        turns = turning_points(course[:, 0, blade], course[:, 1, blade], period, LEAST_SAMPLES, blade)
        heights = np.array([one.value for one in turns])
        near = CLOSE * np.ptp(heights)
        ends = []
        for is_end in (heights >= heights.max() - near, heights <= heights.min() + near):
            values = []
            for i in np.flatnonzero(is_end):
                at = yield from _tangents_at(turns[i], orbit, problem, lambda at: stress(at)[1])
                q = at.vector[: sigma.size].reshape(sigma.shape)[:, blade, None]
                moved = (at.by_parameter + at.by_state @ shift)[: sigma.size].reshape(*sigma.shape, -1)[:, blade]
                by = np.sum(sigma[:, blade, None] * moved + own[:-3, blade, 1:] * q, axis=0)
                values.append([stress(at)[0, blade], *by])
            ends.append(values)
        for of_ends in product(*ends):
            numbers = np.array([*of_ends, *own[-3:, blade]])
            slopes = np.asarray(jax.jacfwd(levels)(numbers[:, 0])) @ numbers[:, 1:]
            found += zip(levels(numbers[:, 0]), slopes, strict=True)
    return largest_level(found, "blades tie" if sigma.shape[1] > 2 else "two peaks")


def largest_level(found: list[tuple[float, np.ndarray]], flag: str) -> AmplitudeSlope:
    """The largest of some levels with its slopes, flagged where another is as large and moves differently.

    There the largest has a derivative on either side of each number. The one on the side which raises it most is given:
    that of the steepest of the levels.
    """
    level, slope = max(found, key=lambda pair: pair[0])
    tied = np.array([other for value, other in found if value >= level - TIE * abs(level)])
    if all(np.allclose(other, slope, rtol=TIE, atol=0.0, equal_nan=True) for other in tied):
        return AmplitudeSlope(float(level), slope)
    steepest = np.take_along_axis(tied, np.abs(tied).argmax(axis=0)[None], axis=0)[0]
    return AmplitudeSlope(float(level), steepest, (flag,))


def farthest_extremes(orbit: PeriodicOrbit, amplitude: Amplitude, mean: np.ndarray) -> list[Extreme]:
    """The turning points of an orbit's displacement that may be farthest from the mean of their blade."""
    finer = -(-LEAST_SAMPLES // orbit.steps_per_period)
    steps = orbit.steps_per_period * finer
    grid = SampleGrid(0.0, steps, 1, steps * orbit.q)
    scenes, states = stacked([(without_given(orbit.scene), orbit.start)])
    motion = sampled_motions(scenes, states, grid, orbit.method)
    names = (amplitude.displacement, f"v_{amplitude.displacement}")
    period = float(orbit.scene.drive.period)
    q, rate = (getattr(motion, name)[0] for name in names)
    extremes = [
        e for blade in range(len(mean)) for e in turning_points(q[:, blade], rate[:, blade], period, steps, blade)
    ]
    distance = [abs(extreme.value - mean[extreme.blade]) for extreme in extremes]
    return [e for e, away in zip(extremes, distance, strict=True) if away >= (1 - CLOSE) * max(distance)]


def turning_points(q: np.ndarray, rate: np.ndarray, period: float, steps: int, blade: int = 0) -> list[Extreme]:
    """The turning points of samples (n,) of a blade with their rates, by cubics; at rest its start."""
    slope = rate * (period / steps)  # per interval
    places = np.flatnonzero((slope[:-1] * slope[1:] <= 0) & (slope[:-1] != slope[1:]) & (slope[1:] != 0))
    cubic = HermiteCubic(q[places], q[places + 1], slope[places], slope[places + 1])
    s = cubic.m_0 / (cubic.m_0 - cubic.m_1)
    columns = (places + s) / steps, cubic(s), places / steps, rate[places]
    turns = [Extreme._make((*map(float, row), blade)) for row in zip(*columns, strict=True)]
    return turns or [Extreme(1.0, float(q[0]), 0.0, 0.0, blade)]


def _tangents_at(
    extreme: Extreme, orbit: PeriodicOrbit, problem: TangentProblem, rates: Callable[[Tangents], np.ndarray]
) -> Algorithm[Tangents]:
    """The flow to an extreme with its tangents; the place is found by the secants of its blade's rate."""
    turns, _, last, last_rate, blade = extreme
    at = yield _flow_to(turns, orbit, problem)
    for _ in range(MAX_SECANTS):
        rate = float(rates(at)[blade])
        step = -rate * (turns - last) / (rate - last_rate) if rate != last_rate else 0.0
        if abs(step) <= PHASE_TOLERANCE:
            break
        last = turns
        last_rate = rate
        turns = turns + step
        at = yield _flow_to(turns, orbit, problem)
    return at


def _flow_to(turns: float, orbit: PeriodicOrbit, problem: TangentProblem) -> Derivatives:
    """The request for the flow over so many drive periods; the start and the end of an orbit are one place."""
    method = orbit.method._replace(amplitudes=True, vibration=False)
    return Derivatives(problem, 1, orbit.steps_per_period, method, turns % orbit.q or float(orbit.q))
