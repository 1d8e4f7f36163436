"""What speaks for the kind of a motion, each from a stretch of the run of its own.

A run goes on through three stretches: over the first its samples return or do not, which leads to a closed orbit; over
the second a tangent grows; the samples of the third go through the 0-1 test, and are compared with the orbit. So no
accident of one stretch speaks three times.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import Plan, Runs, Tick, run_lanes
from jaxshroud.batch.states import final_states, rows
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import displacements, nearness_of
from jaxshroud.motion.copies import Settled
from jaxshroud.motion.largest import TURNING, largest_exponents
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.period import PERIOD_TOLERANCE
from jaxshroud.motion.returns import Returns, returns
from jaxshroud.motion.shooting import NEAR, WINDOW, Aim, nearby_orbit
from jaxshroud.motion.together import Algorithm, Periods, together
from jaxshroud.motion.zero_one import zero_one
from jaxshroud.scene.scene import Scene

STILL = 1e-6  # of a displacement's size: samples that vary by less are constant to the 0-1 test


class Stretches(NamedTuple):
    """How many periods there are of each: at least 16, 16 (a multiple of 4) and 50."""

    returns: int = 64
    growth: int = 64
    series: int = 192

    @property
    def all(self) -> int:
        """Periods that they take together; a tangent first has to turn."""
        return self.returns + TURNING + self.growth + self.series

    def longer(self, times: int) -> "Stretches":
        """So many times as long."""
        return Stretches(*(times * n for n in self))


class Evidence(NamedTuple):
    """Of one lane."""

    first: int  # periods before the first stretch
    stretches: Stretches
    status: int
    q: int  # after so many periods all samples return; 0: they do not
    error: float  # of returning, relative to a displacement's size; the least there is if they do not
    drifts: bool  # samples move one way
    cycle: Cycle | None  # the orbit that Newton's method closed, whatever its flags
    away: float  # of the last samples of all from the orbit, or from the first stretch's, relative to their size
    exponent: float  # the largest, per period
    ci: float
    K: float
    last: State
    settled: Settled | None = None  # copies, of a run that looks chaotic


def gathered(
    scenes: Scene, states: State, status: np.ndarray, first: int, stretches: Stretches, aim: Aim, tick: Tick
) -> list[Evidence]:
    """Evidence on each lane (leading axis) from its state, to which it came with that status after `first` periods."""
    early, states = _run(scenes, states, stretches.returns, aim, tick)
    near, size = (
        nearness_of(scenes, early.samples, tolerance, aim.method.precision) for tolerance in (PERIOD_TOLERANCE, 1.0)
    )
    z = displacements(early.samples)
    told = returns(z, near)
    loosely = returns(z[:, -WINDOW:], near * NEAR / PERIOD_TOLERANCE)
    orbits = _orbits(scenes, states, early, told, loosely, aim)
    grown = largest_exponents(scenes, states, stretches.growth, aim.steps, aim.method, tick)
    late, states = _run(scenes, grown.last, stretches.series, aim, tick)
    K = _chaos(displacements(late.samples), told.nearest, near * STILL / PERIOD_TOLERANCE)
    for came in (early.last.status, grown.status, late.last.status):
        status = np.where(status == Status.OK, came, status)
    cycles = [None if orbit is None else orbit.cycle for orbit in orbits]
    away = _away(early, late, told, orbits, size, TURNING + stretches.growth)
    return [
        Evidence(
            first,
            stretches,
            int(status[i]),
            int(told.number[i]),
            float(told.error[i]) * PERIOD_TOLERANCE,
            bool(told.one_way[i]),
            cycles[i],
            float(away[i]),
            float(grown.exponent[i]),
            float(grown.ci[i]),
            float(K[i]),
            jax.tree.map(lambda a, i=i: jnp.asarray(a[i]), states),
        )
        for i in range(len(status))
    ]


def _run(scenes: Scene, states: State, n: int, aim: Aim, tick: Tick) -> tuple[Runs, State]:
    """`n` periods, all of them kept, and where they lead."""
    runs = run_lanes(scenes, states, Plan(0, n, aim.steps, 0.0, aim.method), tick)
    return runs, final_states(runs.last.state)


class _Orbit(NamedTuple):
    cycle: Cycle
    samples: np.ndarray  # (q, 6) after 1, 2, ... periods


def _orbits(scenes: Scene, states: State, runs: Runs, told: Returns, loosely: Returns, aim: Aim) -> list[_Orbit | None]:
    """The orbit near each lane whose samples return, if only loosely."""
    number, z = np.where(told.number > 0, told.number, loosely.number), rows(runs.samples.motion)
    lanes = np.flatnonzero((number > 0) & (runs.last.status == Status.OK))
    of = lambda tree, i: jax.tree.map(lambda a: jnp.asarray(a[i]), tree)  # noqa: E731
    sought = [_orbit(of(scenes, i), of(states, i), int(number[i]), z[i, -WINDOW:], aim) for i in lanes]
    found = dict(zip(lanes.tolist(), together(sought), strict=True))
    known = [found.get(i) for i in range(len(number))]
    return [None if isinstance(one, Exception) else one for one in known]


def _orbit(scene: Scene, state: State, q: int, samples: np.ndarray, aim: Aim) -> Algorithm[_Orbit]:
    """The orbit of period number `q` or, where that is none that lasts, of twice as many; its samples.

    An orbit that has doubled its period by less than what counts looks like the one that it has left.
    """
    cycle = yield from nearby_orbit(scene, state, q, samples, aim)
    if not cycle.sound:
        cycle = yield from nearby_orbit(scene, state, 2 * q, samples, aim, cycle.periods)
    runs = yield Periods(scene, cycle.start, Plan(0, cycle.q, aim.steps, 0.0, aim.method))
    return _Orbit(cycle, displacements(runs.samples)[0])


def _chaos(z: np.ndarray, nearest: np.ndarray, near: np.ndarray) -> np.ndarray:
    """K of each lane, of the displacement that varies most against its size.

    What repeats with the number of periods after which samples return most nearly is taken out. Like the mean it adds
    to M what is bounded, in which the weak chaos of narrow bands would be lost.
    """
    rest = np.stack([_without_repetition(one, q) for one, q in zip(z, nearest.tolist(), strict=True)])
    at = np.ptp(rest, axis=1) / near
    most, lanes = np.where(np.isfinite(at), at, 0.0).argmax(axis=1), np.arange(len(z))
    return zero_one(rest[lanes, :, most], near[lanes, most])


def _without_repetition(z: np.ndarray, q: int) -> np.ndarray:
    """Samples (n, k) less the means of those that are whole `q` periods apart."""
    means = np.stack([z[i::q].mean(axis=0) for i in range(q)])
    return z - means[np.arange(len(z)) % q]


def _away(
    early: Runs, late: Runs, told: Returns, orbits: list[_Orbit | None], size: np.ndarray, between: int
) -> np.ndarray:
    """How far the last samples are from where the first stretch expects them (lanes,); NaN where it expects nothing."""
    before, after = displacements(early.samples), displacements(late.samples)
    away = np.full(len(after), np.nan)
    for i, orbit in enumerate(orbits):
        q = int(told.number[i]) if orbit is None else orbit.cycle.q
        if q == 0:
            continue
        expected = before[i, -q:] if orbit is None else orbit.samples
        last = np.arange(after.shape[1] - q, after.shape[1])
        at = (between + last) % q  # of periods since the first stretch, less one
        away[i] = np.max(np.abs(after[i, last] - expected[at]) / size[i])
    return away
