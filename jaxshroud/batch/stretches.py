"""Marches with samples, stretch by stretch: what is kept of them, and where the displacements of the last steps lie.

Between samples a motion is the cubic through these and their rates: by it means over time and largest values are found.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.lanes import Sampled, final_states, shroud_motion
from jaxshroud.batch.sampling import EventStates, SampledMarch, SampleGrid, Stretch, concatenated_events
from jaxshroud.march.accumulator import ContactTimes
from jaxshroud.march.locate import HermiteCubic
from jaxshroud.model.arithmetic import ZERO, is_zero
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.scene.scene import Scene

SAMPLES_AT_ONCE = 1 << 12  # of each lane, in NumPy's temporary arrays


def cubic_mean(q: Any, rate: Any, h: Any) -> Any:
    """The mean over time of the cubics through samples (lanes, n, ...) and their rates at intervals `h`."""
    intervals = q.shape[1] - 1
    trapezoid = q.mean(axis=1) * (intervals + 1) - (q[:, 0] + q[:, -1]) / 2
    return (trapezoid + h[:, 0] / 12 * (rate[:, 0] - rate[:, -1])) / intervals


def hermite_largest(q: Any, slope: Any) -> Any:
    """The largest value of the cubics through samples (lanes, n, columns) with these slopes per interval."""
    like: Any = np if isinstance(q, np.ndarray) else jnp
    (g_0, g_1), (m_0, m_1) = ((a[:, :-1], a[:, 1:]) for a in (q, slope))
    cubic = HermiteCubic(g_0, g_1, m_0, m_1)
    _, b, c = cubic.coefficients
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        s = m_0 / (like.sqrt(b * b - 3 * m_0 * c) - b)
    top = cubic(s)
    return like.maximum(q.max(axis=1), like.where((s > 0) & (s < 1), top, -np.inf).max(axis=1))


class SampledAmplitudes(NamedTuple):
    """Where displacements of runs lie, fields (lanes, blades, 3): x, y [m] and theta [rad]."""

    mean: np.ndarray
    rms: np.ndarray  # about the mean
    peak: np.ndarray  # largest distance from the mean


class RunningAmplitudes:
    """The amplitudes of displacements from samples that come in parts, none of which is kept.

    Sums are those of distances from the first sample: of a motion that hardly moves they keep their digits.
    """

    def __init__(self, first: Motion, interval: np.ndarray):
        """`first` is the sample that the next ones follow at `interval` [s], (lanes,); fields (lanes, blades)."""
        self._h = interval[:, None, None, None]
        q, rate = _displacements(Motion._make(a[:, None] for a in first))
        self._origin = q[:, 0]
        self._last = (q, rate)
        self._count = 0
        self._sum = np.zeros_like(q[:, 0])
        self._squares = np.zeros_like(q[:, 0])
        self._highest, self._lowest = np.full_like(q[:, 0], -np.inf), np.full_like(q[:, 0], np.inf)

    def add(self, motion: Motion) -> None:
        """Count the next samples, fields (lanes, n, blades)."""
        for begin in range(0, motion.x.shape[1], SAMPLES_AT_ONCE):
            self._add(Motion._make(a[:, begin : begin + SAMPLES_AT_ONCE] for a in motion))

    def _add(self, motion: Motion) -> None:
        n = motion.x.shape[1]
        q, rate = (np.concatenate(pair, axis=1) for pair in zip(self._last, _displacements(motion), strict=True))

        def columns(a):
            return a.reshape(*a.shape[:2], -1)

        with np.errstate(invalid="ignore", over="ignore"):  # of a motion that has overflowed
            away = q - self._origin[:, None]
            slope = rate * self._h
            self._sum += n * cubic_mean(away, rate, self._h)
            self._squares += n * cubic_mean(away**2, 2 * away * rate, self._h)
            top = hermite_largest(columns(away), columns(slope)).reshape(self._sum.shape)
            bottom = -hermite_largest(columns(-away), columns(-slope)).reshape(self._sum.shape)
        self._highest = np.maximum(self._highest, top)
        self._lowest = np.minimum(self._lowest, bottom)
        self._last = (q[:, -1:], rate[:, -1:])
        self._count = self._count + n

    @property
    def amplitudes(self) -> SampledAmplitudes:
        """The amplitudes over all samples so far."""
        mean = self._sum / self._count
        with np.errstate(invalid="ignore", over="ignore"):  # of a motion that has overflowed
            square = self._squares / self._count - mean**2
            peak = np.maximum(self._highest - mean, mean - self._lowest)
            return SampledAmplitudes(self._origin + mean, np.sqrt(np.maximum(square, 0.0)), peak)


def _displacements(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The displacements and their rates, (lanes, n, blades, 3) each."""

    def stacked(prefix):
        return np.stack([np.asarray(getattr(motion, prefix + n), float) for n in DISPLACEMENTS], axis=-1)

    return stacked(""), stacked("v_")


class SampledRun(NamedTuple):
    """The result of a march with samples."""

    lanes: Any  # at the end
    samples: Any  # (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    events: EventStates | None  # None unless they are kept


class Trajectories(NamedTuple):
    """The trajectories of lanes (leading axis)."""

    samples: dict[str, Any]  # name -> values (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    status: np.ndarray  # (lanes,)
    counters: dict[str, np.ndarray]  # numbers of events by their names
    energy: dict[str, np.ndarray]  # those of the energy balance, by the names of results
    loads: ContactLoads | None = None  # None unless they were requested
    times: ContactTimes | None = None  # in each state of contact; None in closed form, as are the next two
    last: Any = None  # the lanes at the end
    events: dict[str, Any] | None = None  # samples of both sides of every event, with `t` [steps] and `after`


def march_in_stretches(
    march: Callable[[Any, Stretch], SampledMarch],
    scenes: Scene,
    lanes: Any,
    first: Sampled,
    grid: SampleGrid,
) -> SampledRun:
    """March lanes (leading axis) over the grid.

    Args:
        march: Marches lanes over a stretch: the lanes at its end, its samples, and its events.
        scenes: The scenes.
        lanes: Where they start.
        first: The first sample.
        grid: The time grid, and what is kept.
    """
    blocks = [jax.tree.map(lambda a: np.asarray(a)[:, None], first)]
    events = []
    running = None
    for stretch in grid.stretches(len(lanes.status)):
        counts = stretch.first >= grid.length - grid.counted
        if counts and running is None:
            start = shroud_motion(final_states(lanes.state).motion, scenes)
            running = RunningAmplitudes(start, grid.step_lengths(scenes))
        lanes, states, some = march(lanes, stretch)
        if running is not None:
            running.add(states.state.motion)
        kept = stretch.kept(grid)
        blocks.append(jax.tree.map(lambda a, kept=kept: a if len(kept) == a.shape[1] else a[:, kept], states))
        events += [] if some is None else [some]
    samples = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    amplitudes = None if running is None else running.amplitudes
    return SampledRun(lanes, samples, amplitudes, concatenated_events(events) if events else None)


def values_by_name(samples: Sampled) -> dict[str, Any]:
    """The quantities of samples, by the names of results; those that a model lacks are left out."""
    states, forces = samples
    assert forces is not None  # results have them
    of_face = {name: a for name, a in forces._replace(points=ZERO)._asdict().items() if not is_zero(a)}
    slider = np.where(states.mode == Mode.APART, np.nan, states.u_s)
    states_of_points = {}
    if not is_zero(forces.points):
        of_each = {"mode": states.mode, "u_s": slider, **forces.points._asdict()}
        states_of_points = {f"point_{name}": a for name, a in of_each.items()}
    return {
        "motion": states.motion,
        **({} if states_of_points else {"u_s": slider}),
        "mode": np.asarray(interface_mode(by_point(states.mode, states.case))),
        "case": states.case,
        **of_face,
        **states_of_points,
    }
