"""The evidence for the kind of a motion, with a separate stretch of the run for each part of it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxshroud.batch.lanes import final_states, motion_rows
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.runs import run_lanes
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import Algorithm, Periods, run_together
from jaxshroud.orbits.lyapunov import ALIGNMENT_PERIODS, largest_exponents
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import RETURN_TOLERANCE, RETURN_WINDOW, ShootingOptions, nearby_orbit
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray, Tree, series_argument, typed
from jaxshroud.signals.averages import closing_tolerances_of, displacements
from jaxshroud.signals.period import PERIOD_TOLERANCE, Recurrence, recurrence

# of K, away from the resonances at 0 and pi
TEST_FREQUENCIES = 100
LOWEST_FREQUENCY = np.pi / 5
HIGHEST_FREQUENCY = 4 * np.pi / 5
NUMBERS_PER_LAG = 10  # the lags go up to a tenth of the series
MIN_NUMBERS = 50  # with fewer there are not five lags


@typed
def zero_one(series: ArrayLike, near: ArrayLike | float = 0.0) -> FloatArray:
    """K of the 0-1 test: near 0 for regular motion, near 1 for chaos.

    The series drives a point in the plane, p(n + 1) = p(n) + phi(n) cos(n c), q(n + 1) = q(n) + phi(n) sin(n c). Its
    mean square displacement M(n) stays bounded for regular motion and grows like n in chaos; K is the correlation of M
    with n, and the median over 100 frequencies c is taken, since some resonate with the motion.

    The numbers must be far apart in time: neighbours on a smooth curve are so similar that chaos seems regular. Samples
    at each drive period are, unless the motion itself is slow. A few hundred are needed, a thousand are good.

    Args:
        series: Numbers (..., n), at least 50, oldest first.
        near: A difference (...) that counts as zero: a series that spans no more is constant, and regular.

    Returns:
        K of each series, (...); NaN where it is not finite.

    Raises:
        ValueError: The series is too short.

    Source:
        Gottwald and Melbourne, "On the implementation of the 0-1 test for chaos", SIAM J. Appl. Dyn. Syst. 8 (2009),
        129: the correlation method. The mean is subtracted first, instead of the oscillating part of M.

    Example:
        >>> import numpy as np
        >>> t, x = np.arange(1000), [0.3]
        >>> for _ in t[1:]: x.append(4 * x[-1] * (1 - x[-1]))
        >>> bool(zero_one(x) > 0.9), bool(zero_one(np.sin(t)) < 0.1)
        (True, True)
    """
    phi = series_argument("series", series)
    if phi.shape[-1] < MIN_NUMBERS:
        raise InputError(f"The 0-1 test needs {MIN_NUMBERS} numbers, but has {phi.shape[-1]}.")
    flat = phi.reshape(-1, phi.shape[-1])
    try:
        tolerances = np.broadcast_to(near, phi.shape[:-1]).ravel()
    except ValueError:
        raise InputError(f"Argument `near` must be one number, or one of each of {phi.shape[:-1]} series.") from None
    return np.array([_zero_one_of_series(*row) for row in zip(flat, tolerances, strict=True)]).reshape(phi.shape[:-1])


def _zero_one_of_series(phi: FloatArray, near: float) -> float:
    """The K of one series."""
    if np.isnan(near) or not np.isfinite(phi).all():
        return float("nan")
    if np.ptp(phi) <= near:
        return 0.0
    frequencies = np.random.default_rng(0).uniform(LOWEST_FREQUENCY, HIGHEST_FREQUENCY, TEST_FREQUENCIES)
    n = len(phi)
    scaled = (phi - phi.mean()) / np.ptp(phi)  # scaled, as squares might overflow
    points = np.cumsum(scaled * np.exp(1j * frequencies[:, None] * np.arange(n)), axis=1)
    lags = np.arange(1, n // NUMBERS_PER_LAG + 1)
    last = n - n // NUMBERS_PER_LAG
    growth = np.stack([(np.abs(points[:, lag : last + lag] - points[:, :last]) ** 2).mean(axis=1) for lag in lags])
    return float(np.median([np.corrcoef(lags, column)[0, 1] for column in growth.T]))


PERTURBED_COPIES = 32
PERTURBATION = 1e-4  # largest relative perturbation of x, or of the first modal coordinate
RETURN_PERIODS = 4 * RETURN_WINDOW  # last periods, in which a copy must return
CONSTANT_TOLERANCE = 1e-6  # of a displacement's size: samples that vary less are constant for the 0-1 test


class SettledCopies(NamedTuple):
    """The outcome of the perturbed copies of one lane."""

    copies: int  # number of copies that return at the end
    of: int
    q: int  # period number of a stable orbit on which one of them is; 0: none


def settled_copies(scenes: Scene, states: State, periods: int, aim: ShootingOptions) -> list[SettledCopies]:
    """The number of copies of each lane that settle within so many periods from its state."""
    lanes = len(scenes.drive.omega)
    copies, starts = jax.tree.map(lambda a: np.repeat(np.asarray(a), PERTURBED_COPIES, axis=0), (scenes, states))
    factors = 1 + PERTURBATION * np.random.default_rng(0).uniform(-1, 1, (PERTURBED_COPIES, 1))
    x = np.asarray(jax.tree.leaves(starts.motion)[0]) * np.tile(factors, (lanes, 1))
    starts = eqx.tree_at(lambda s: jax.tree.leaves(s.motion)[0], starts, x.astype(scenes.drive.omega.dtype))
    kept = min(RETURN_PERIODS, periods)
    runs = run_lanes(copies, starts, Plan(periods - kept, kept, aim.steps, 0.0, aim.method), lambda _: None)
    near = closing_tolerances_of(copies, runs.samples, RETURN_TOLERANCE, aim.method.precision)
    is_ok = np.asarray(runs.last.status) == Status.OK
    number = np.where(is_ok, recurrence(displacements(runs.samples), near).number, 0)
    returned = (number > 0).reshape(lanes, PERTURBED_COPIES)
    settling = np.flatnonzero(returned.any(axis=1))
    samples = motion_rows(runs.samples.motion)
    ends = final_states(runs.last.state)
    candidates = settling * PERTURBED_COPIES + returned[settling].argmax(axis=1)
    searches = [
        nearby_orbit(_lane_of(copies, i), _lane_of(ends, i), int(number[i]), samples[i, -RETURN_WINDOW:], aim)
        for i in candidates
    ]
    orbits = dict(zip(settling.tolist(), run_together(searches), strict=True))
    return [SettledCopies(int(returned[i].sum()), PERTURBED_COPIES, _sound_period(orbits.get(i))) for i in range(lanes)]


def _lane_of(tree: Tree, lane: int | np.integer) -> Tree:
    """One lane of a tree of arrays."""
    return jax.tree.map(lambda a: jnp.asarray(a[lane]), tree)


def _sound_period(cycle: object) -> int:
    """The period number of a reliable orbit; 0 for anything else."""
    return cycle.q if isinstance(cycle, PeriodicOrbit) and cycle.sound else 0


class Stretches(NamedTuple):
    """The lengths of the stretches in periods: at least 16, 16 (a multiple of 4) and 50."""

    returns: int = 64
    growth: int = 64
    series: int = 192

    @property
    def all(self) -> int:
        """The total number of periods, with those in which a tangent aligns."""
        return self.returns + ALIGNMENT_PERIODS + self.growth + self.series

    def longer(self, times: int) -> "Stretches":
        """The stretches, `times` as long."""
        return Stretches._make(times * n for n in self)


class Evidence(NamedTuple):
    """The evidence on one lane."""

    first: int  # periods before the first stretch
    stretches: Stretches
    status: int
    q: int  # number of periods after which all samples return; 0: they do not
    error: float  # of the return relative to a displacement's size; the least one if they do not return
    drifts: bool  # samples drift one way
    cycle: PeriodicOrbit | None  # the orbit that Newton's method closed, whatever its flags
    away: (
        float  # distance of the last samples from the orbit, or from those of the first stretch, relative to their size
    )
    exponent: float  # the largest, per period
    ci: float
    K: float
    last: State
    settled: SettledCopies | None = None  # only for a run that seems chaotic


def gather_evidence(
    scenes: Scene, states: State, status: np.ndarray, first: int, stretches: Stretches, aim: ShootingOptions, tick: Tick
) -> list[Evidence]:
    """The evidence on each lane (leading axis) from its state, reached with that status after `first` periods."""
    early, states = _run_stretch(scenes, states, stretches.returns, aim, tick)
    near, size = (
        closing_tolerances_of(scenes, early.samples, tolerance, aim.method.precision)
        for tolerance in (PERIOD_TOLERANCE, 1.0)
    )
    z = displacements(early.samples)
    tight = recurrence(z, near)
    loose = recurrence(z[:, -RETURN_WINDOW:], near * RETURN_TOLERANCE / PERIOD_TOLERANCE)
    orbits = _nearby_orbits(scenes, states, early, tight, loose, aim)
    grown = largest_exponents(scenes, states, stretches.growth, aim.steps, aim.method, tick)
    late, states = _run_stretch(scenes, grown.last, stretches.series, aim, tick)
    K = _zero_one_of_lanes(displacements(late.samples), tight.nearest, near * CONSTANT_TOLERANCE / PERIOD_TOLERANCE)
    for statuses in (early.last.status, grown.status, late.last.status):
        status = np.where(status == Status.OK, statuses, status)
    cycles = [None if orbit is None else orbit.cycle for orbit in orbits]
    away = _orbit_offsets(early, late, tight, orbits, size, ALIGNMENT_PERIODS + stretches.growth)
    return [
        Evidence(
            first,
            stretches,
            int(status[i]),
            int(tight.number[i]),
            float(tight.error[i]) * PERIOD_TOLERANCE,
            bool(tight.one_way[i]),
            cycles[i],
            float(away[i]),
            float(grown.exponent[i]),
            float(grown.ci[i]),
            float(K[i]),
            _lane_of(states, i),
        )
        for i in range(len(status))
    ]


def _run_stretch(scenes: Scene, states: State, n: int, aim: ShootingOptions, tick: Tick) -> tuple[Runs, State]:
    """A run of `n` kept periods, and its final states."""
    runs = run_lanes(scenes, states, Plan(0, n, aim.steps, 0.0, aim.method), tick)
    return runs, final_states(runs.last.state)


class _SampledOrbit(NamedTuple):
    cycle: PeriodicOrbit
    samples: np.ndarray  # (q, 6) after 1, 2, ... periods


def _nearby_orbits(
    scenes: Scene, states: State, runs: Runs, tight: Recurrence, loose: Recurrence, aim: ShootingOptions
) -> list[_SampledOrbit | None]:
    """The orbit near each lane whose samples return, at least loosely."""
    number = np.where(tight.number > 0, tight.number, loose.number)
    samples = motion_rows(runs.samples.motion)
    lanes = np.flatnonzero((number > 0) & (runs.last.status == Status.OK))
    searches = [
        _orbit_or_doubled(_lane_of(scenes, i), _lane_of(states, i), int(number[i]), samples[i, -RETURN_WINDOW:], aim)
        for i in lanes
    ]
    results = dict(zip(lanes.tolist(), run_together(searches), strict=True))
    orbits = [results.get(i) for i in range(len(number))]
    return [None if isinstance(orbit, Exception) else orbit for orbit in orbits]


def _orbit_or_doubled(
    scene: Scene, state: State, q: int, samples: np.ndarray, aim: ShootingOptions
) -> Algorithm[_SampledOrbit]:
    """The orbit of period number `q` or, where that is not stable, of 2 q, with its samples.

    An orbit whose period has doubled by less than the tolerance resembles the original one.
    """
    cycle = yield from nearby_orbit(scene, state, q, samples, aim)
    if not cycle.sound:
        cycle = yield from nearby_orbit(scene, state, 2 * q, samples, aim, cycle.periods)
    runs = yield Periods(scene, cycle.start, Plan(0, cycle.q, aim.steps, 0.0, aim.method))
    return _SampledOrbit(cycle, displacements(runs.samples)[0])


def _zero_one_of_lanes(z: np.ndarray, nearest: np.ndarray, near: np.ndarray) -> np.ndarray:
    """K of the 0-1 test of each lane, for the displacement that varies most relative to its size.

    The part that repeats with the period of the nearest return is removed. Like the mean, it adds a bounded part to M,
    in which the weak chaos of narrow bands would be lost.
    """
    residual = np.stack([_without_repetition(samples, q) for samples, q in zip(z, nearest.tolist(), strict=True)])
    with np.errstate(invalid="ignore", divide="ignore"):  # a displacement that stays 0
        relative = np.ptp(residual, axis=1) / near
    largest = np.where(np.isfinite(relative), relative, 0.0).argmax(axis=1)
    lanes = np.arange(len(z))
    return zero_one(residual[lanes, :, largest], near[lanes, largest])


def _without_repetition(z: np.ndarray, q: int) -> np.ndarray:
    """The samples (n, k) minus the means of those that are multiples of `q` periods apart."""
    means = np.stack([z[i::q].mean(axis=0) for i in range(q)])
    return z - means[np.arange(len(z)) % q]


def _orbit_offsets(
    early: Runs, late: Runs, tight: Recurrence, orbits: list[_SampledOrbit | None], size: np.ndarray, between: int
) -> np.ndarray:
    """The distance of the last samples from the prediction of the first stretch (lanes,); NaN without a prediction."""
    before, after = displacements(early.samples), displacements(late.samples)
    away = np.full(len(after), np.nan)
    for i, orbit in enumerate(orbits):
        q = int(tight.number[i]) if orbit is None else orbit.cycle.q
        if q == 0:
            continue
        expected = before[i, -q:] if orbit is None else orbit.samples
        last = np.arange(after.shape[1] - q, after.shape[1])
        phase = (between + last) % q  # number of periods since the first stretch, less one
        distance = np.abs(after[i, last] - expected[phase])
        with np.errstate(invalid="ignore", divide="ignore"):  # a displacement that stays 0
            away[i] = np.max(np.where(distance == 0, 0.0, distance / size[i]))
    return away
