"""What a scene would have shown in measurements, at points of the unit cube of its fitted numbers."""

import copy
import math

import numpy as np

from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import initial_states
from jaxshroud.fitting.measured import (
    Predicted,
    history_schedule,
    orbit_amplitudes_by,
    predicted_history,
    steps_between_samples,
)
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import run_together
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import CLOSING_TOLERANCE, ShootingOptions, settled_orbit
from jaxshroud.scene.measurements import Measurements
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.arguments import MarchPlan
from jaxshroud.verbs.design_problem import Problem, design_corners, scenes_of

QUARTERS = 4  # steps of a finer march for one


class HistoryModel:
    """The model of a time history: the march from the scene's initial motion."""

    def __init__(self, problem: Problem, data: Measurements, steps: int, method: Choices, shortest_period: float):
        self.problem, self.data = problem, data
        self.method = as_differentiable(method)
        self.schedule = history_schedule(float(data.at[-1]), shortest_period, steps, self.method)

    @property
    def steps(self) -> int:
        """The steps of the march in a period."""
        return self.schedule.steps

    def refined(self) -> "HistoryModel":
        """The same with steps of a quarter, and as many samples."""
        finer = copy.copy(self)
        every, steps = (QUARTERS * count for count in (self.schedule.every, self.schedule.steps))
        finer.schedule = self.schedule._replace(every=every, steps=steps)
        return finer

    def __call__(self, points: np.ndarray, rows: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Displacements at the measured times (points, n, channels), and slopes in the unit cube (..., keys).

        After the first `rows` of them they are NaN.
        """
        values, slopes = self._at(points, self.data, rows)
        return values, slopes * self.problem.rates(points)[:, None, None, :]

    def curve(self, u: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The motion from the start to the last measured time."""
        t = np.linspace(0.0, self.data.at[-1], count)
        return t, self._at(u[None], self.data._replace(at=t)).values[0]

    def _at(self, points: np.ndarray, data: Measurements, rows: int | None = None) -> Predicted:
        scenes = in_precision(scenes_of(self.problem, self.problem.values(points)), self.method.precision)
        return predicted_history(scenes, tuple(self.problem.over), data, self.schedule, rows or len(data.at))


class ResponseModel:
    """The model of a frequency response: amplitudes on the orbits on which the scene settles.

    Each orbit is sought from that of the latest point at the same frequency, first from the scene's initial motion.
    """

    def __init__(self, problem: Problem, data: Measurements, steps: int, method: Choices, most_periods: int):
        self.problem, self.data, self.steps, self.most_periods = problem, data, steps, most_periods
        self.aim = ShootingOptions(steps, CLOSING_TOLERANCE[method.precision], method)
        self.latest: dict[int, State] = {}  # by frequencies

    def __call__(self, points: np.ndarray, rows: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes at the measured frequencies (points, n, channels), and slopes in the unit cube (..., keys)."""
        del rows  # all frequencies are one batch
        orbits = self._orbits(points)
        values, slopes = orbit_amplitudes_by(orbits, tuple(self.problem.over), self.data.channels)

        def by_point(a):
            return a.reshape(len(points), -1, *a.shape[1:])

        return by_point(values), by_point(slopes) * self.problem.rates(points)[:, None, None, :]

    def curve(self, u: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The amplitudes at the measured frequencies, in order."""
        order = np.argsort(self.data.at, kind="stable")
        return self.data.at[order], self(u[None])[0][0][order]

    def _orbits(self, points: np.ndarray) -> list[PeriodicOrbit | None]:
        scenes = in_precision(scenes_of(self.problem, self.problem.values(points)), self.aim.method.precision)
        count = len(self.data.at)
        first = initial_states(scenes)

        def lane(tree, i):
            return jax_lane_arrays(tree, (i,))

        lanes = range(len(points) * count)
        starts = [self.latest[i % count] if i % count in self.latest else lane(first, i) for i in lanes]
        searches = [settled_orbit(lane(scenes, i), starts[i], self.most_periods, self.aim) for i in lanes]
        orbits = [orbit if isinstance(orbit, PeriodicOrbit) else None for orbit in run_together(searches)]
        if len(points) == 1:
            self.latest |= {i: orbit.start for i, orbit in enumerate(orbits) if orbit is not None and orbit.sound}
        return orbits


FitModel = HistoryModel | ResponseModel


def fit_corners(problem: Problem) -> Scene:
    """The scenes at the ends of the bounds, at the ends of the frequencies."""
    ends = {key: (min(values), max(values)) for key, values in problem.conditions.items()}
    return design_corners(problem._replace(conditions=ends))


def model_of(problem: Problem, data: Measurements, march: MarchPlan, most_periods: int) -> FitModel:
    """The model of the measurements."""
    corners = fit_corners(problem)
    omega_max, _ = stiffest(corners, 1)
    slowest, fastest = (float(f(np.asarray(corners.drive.omega))) for f in (np.min, np.max))
    steps = steps_between_samples(omega_max, math.tau / slowest, march.steps, data.kind)
    if data.kind == "history":
        return HistoryModel(problem, data, steps, march.method, math.tau / fastest)
    return ResponseModel(problem, data, steps, march.method, most_periods)
