"""Accuracy against cost of methods, measured around a scene; diffrax's adaptive solvers are among the methods."""

import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.periods import pair_sample
from jaxshroud.batch.plan import Plan, Progress
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import initial_states
from jaxshroud.march.method import FAST, Method, choices
from jaxshroud.march.stability import steps_for
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import law_type
from jaxshroud.orbits.short_runs import (
    HORIZON,
    ShortRuns,
    adaptive_gap_slopes,
    adaptive_samples,
    gap_slopes,
    motions_at,
    run_from_start,
    softened,
    state_errors,
)
from jaxshroud.results.trade import MeasuredSetting, Trade
from jaxshroud.scene.checks import InputError, count_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of
from jaxshroud.scene.typed import typed
from jaxshroud.scene.vary import value_of
from jaxshroud.signals.amplitudes import check_vibration
from jaxshroud.signals.averages import averages
from jaxshroud.verbs.arguments import one_scene
from jaxshroud.verbs.asked import Setting, by_series

SHORT_PERIODS = 16  # periods that even slow methods can be run for
IMPLICIT = {"Kvaerno5"}


class Adaptive(NamedTuple):
    """An adaptive solver of diffrax with its tolerance."""

    solver: str  # Tsit5, Dopri8 or Kvaerno5
    rtol: float  # see `adaptive_samples`
    width: float = 0.0  # as in `Setting`

    @property
    def kind(self) -> str:
        """The method in words, without its numbers."""
        return f"diffrax {self.solver}{', smooth' if self.width else ''}"

    def run(self, scenes: Scene, periods: int) -> ShortRuns | None:
        """March lanes (leading axis) from the initial states of their scenes; None if that would take too long."""
        if self.solver in IMPLICIT and periods > SHORT_PERIODS:
            return None
        solved = adaptive_samples(softened(scenes, self.width), periods, self.solver, self.rtol)
        samples = pair_sample(solved[0])
        steps = np.asarray(solved[1])
        finite = np.isfinite(samples.power[..., 0]).all(axis=1)
        return ShortRuns(samples, np.where(finite, Status.OK, Status.NOT_FINITE), round(float(steps.mean())))

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """The derivative of each lane's power over the horizon with respect to the gap; None if there is none."""
        scenes = softened(scenes, self.width)
        if self.solver in IMPLICIT or scenes.parts.contact == "none":
            return None
        return adaptive_gap_slopes(scenes, HORIZON, self.solver, self.rtol)

    def __str__(self) -> str:
        width = f", width {self.width:.3g}" if self.width else ""
        return f"{self.kind}{width}, rtol {self.rtol:.0e}"


LANE_SCATTER = 0.05  # relative, of the lanes around a scene
SCATTERED_KEYS = ("contact.gamma", "shroud.gap", "drive.F_0[0]", "drive.F_0[1]", "drive.omega", "friction.mu")
TIMING_REPEATS = 3  # of which the fastest counts
MIN_TIMING_SECONDS = 0.5  # a run that takes less is timed over more periods
LONG_TIMING_SECONDS = 5.0  # a run that takes more is not repeated
SLOPE_LANES = 16  # lanes whose derivatives are compared


@runtime_checkable
class Measurable(Protocol):
    """A setting that can be measured: a method with all that it needs to march scenes."""

    @property
    def kind(self) -> str:
        """The method in words, without its numbers."""
        ...

    def run(self, scenes: Scene, periods: int) -> ShortRuns | None:
        """March lanes (leading axis) from the initial states of their scenes; None if that would take too long."""
        ...

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """The derivative of each lane's power over the horizon with respect to the gap; None if there is none."""
        ...


class ClosedForm(NamedTuple):
    """The closed form of scenes without contact."""

    kind: str = "closed form"

    def run(self, scenes: Scene, periods: int) -> ShortRuns:
        """Samples and status of lanes (leading axis) from the initial states of their scenes."""
        runs = run_lanes(scenes, initial_states(scenes), Plan(0, periods, 1, 0.0, FAST), lambda _: None)
        return ShortRuns(runs.samples, runs.last.status, 0)

    def slopes(self, scenes: Scene) -> None:
        """None: the power does not depend on the gap."""

    def __str__(self) -> str:
        return self.kind


class GivenMethod(NamedTuple):
    """A method that a user has given, with its own steps."""

    method: Method

    @property
    def kind(self) -> str:
        """The method in words."""
        return str(self.method)

    def run(self, scenes: Scene, periods: int) -> ShortRuns:
        """March lanes (leading axis) from the initial states of their scenes."""
        return run_from_start(scenes, periods, self._steps(scenes), choices(self.method))

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """The derivative of each lane's power over the horizon with respect to the gap; None if there is none."""
        return gap_slopes(scenes, self._steps(scenes), choices(self.method))

    def _steps(self, scenes: Scene) -> int:
        steps = "auto" if self.method.steps is None else self.method.steps
        return steps_for(scenes, 1, steps, choices(self.method).tableau)

    def __str__(self) -> str:
        return f"{self.kind}, {self.method.steps or 'auto'} steps"


REFERENCE_SETTING = Setting("dopri8", "cubic", "float64", 0.15)
# The slider of smooth contact follows so fast that omega_max says little about the motion.
SMOOTH_REFERENCE_SETTING = REFERENCE_SETTING._replace(product=0.5)
REFERENCE_SETTINGS: dict[str, Measurable] = {
    "spring": REFERENCE_SETTING,
    "smooth": SMOOTH_REFERENCE_SETTING,
    "none": ClosedForm(),
}
RUNGE_KUTTA_PRODUCTS = {
    ("rk4", "float64"): (2.0, 1.0, 0.5, 0.25, 0.12, 0.06),
    ("tsit5", "float64"): (2.0, 1.0, 0.5, 0.25, 0.12),
    ("dopri8", "float64"): (2.0, 1.2, 0.8, 0.5, 0.3),
    ("rk4", "float32"): (2.0, 1.0, 0.5),
    ("tsit5", "float32"): (2.0, 1.0, 0.5),
}
RUNGE_KUTTA_SETTINGS = tuple(
    Setting(name, "cubic", digits, p) for (name, digits), steps in RUNGE_KUTTA_PRODUCTS.items() for p in steps
)
ADAPTIVE_TOLERANCES = {"Tsit5": (1e-3, 1e-6), "Dopri8": (1e-5, 1e-9), "Kvaerno5": (1e-3, 1e-5)}
SERIES_ORDERS = ((8, 1e-5), (10, 1e-6), (12, 1e-8), (14, 1e-10), (16, 1e-12))  # orders and tolerances
ADAPTIVE_SETTINGS = tuple(Adaptive(solver, rtol) for solver, levels in ADAPTIVE_TOLERANCES.items() for rtol in levels)
SMOOTH_WIDTHS = (1 / 4, 1 / 16, 1 / 64)
SETTINGS: dict[str, tuple[Measurable, ...]] = {
    "spring": (
        *RUNGE_KUTTA_SETTINGS,
        *(by_series(*choice) for choice in SERIES_ORDERS),
        *(Setting("rk4", "bisection", "float64", p) for p in (0.5, 0.25)),
        *(Setting("rk4", "none", "float64", p) for p in (0.5, 0.12)),
        *(Setting("rk4", "cubic", "float64", 1.0, width) for width in SMOOTH_WIDTHS),
        *(Adaptive("Tsit5", 1e-4, width) for width in SMOOTH_WIDTHS),
    ),
    "smooth": (
        *(setting for setting in RUNGE_KUTTA_SETTINGS if setting.product > SMOOTH_REFERENCE_SETTING.product),
        *ADAPTIVE_SETTINGS,
    ),
    "none": (ClosedForm(), *ADAPTIVE_SETTINGS),
}


def neighbourhood(scene: Scene, lanes: int, seed: int = 0) -> Scene:
    """The scene and others (leading axis) around it: each of `SCATTERED_KEYS` scatters by `LANE_SCATTER`.

    The forces on both blades scatter alike.
    """
    centre = np.array([value_of(scene, key) for key in SCATTERED_KEYS])
    draws = np.random.default_rng(seed).uniform(-1, 1, (lanes, len(SCATTERED_KEYS) - 1))
    factors = 1 + LANE_SCATTER * np.insert(draws, 3, draws[:, 2], axis=1)
    factors[0] = 1.0
    return scenes_at(scene, SCATTERED_KEYS, centre * factors)


@typed
def trade(
    scene: Scene | SceneFile,
    *,
    methods: Sequence[Method] | None = None,
    lanes: int = 64,
    seed: int = 0,
    n_periods: int = 64,
    transient: int = 64,
    progress: Progress | None = None,
) -> Trade:
    """Measure the accuracy and the cost of methods on scenes around the given one.

    Args:
        scene: One scene, or a scene file.
        methods: Methods to measure; by default many, each with several steps or tolerances.
        lanes: The number of scenes: the given one, and others with `SCATTERED_KEYS` scattered by `LANE_SCATTER`.
        seed: Seed of the scatter.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first, with the kept ones at least `HORIZON`; by default 64.
        progress: Called with (methods done, methods in all).

    Returns:
        The cost and the errors of each method; the errors are relative to the one of `REFERENCE_SETTINGS` for the
        scene's kind of contact.

    Raises:
        ValueError: A count is too small, the run would be too long or too large, there are many scenes,
            or the left blade does not vibrate without contact.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.trade(scene, methods=[js.RungeKutta(steps=200)], lanes=8, n_periods=4, transient=4)
        >>> found[0].error < 1e-2
        True
    """
    seed_argument(seed)
    count_argument("lanes", lanes, 1)
    scene = one_scene("trade", scene)
    check_size(lanes, transient, n_periods)
    check_vibration("P_d", scene)
    if scene.parts.contact not in SETTINGS:
        raise InputError(f"`trade` has no reference for {law_type(scene).called}; compare powers by js.power.")
    settings = SETTINGS[scene.parts.contact] if methods is None else [GivenMethod(one) for one in methods]
    return measure_settings(scene, settings, lanes, seed, n_periods, transient, progress)


def measure_settings(
    scene: Scene,
    settings: Sequence[Measurable],
    lanes: int,
    seed: int = 0,
    n_periods: int = 64,
    transient: int = 64,
    progress: Progress | None = None,
) -> Trade:
    """Measure settings of any kind; see `trade`."""
    scenes = neighbourhood(scene, lanes, seed)
    reference = _outcome(scenes, REFERENCE_SETTINGS[scene.parts.contact], transient, n_periods)
    measured = []
    for done, setting in enumerate(settings, 1):
        measured.append(_compared(scenes, setting, _outcome(scenes, setting, transient, n_periods), reference))
        if progress is not None:
            progress(done, len(settings))
    run = {"periods": n_periods, "transient": transient}
    return Trade.of_settings(measured, HORIZON, {"title": "", "scene": text_of(scene, run)})


class _Outcome(NamedTuple):
    steps: int
    state: np.ndarray
    P_d: np.ndarray
    ci: np.ndarray
    number: np.ndarray
    slope: np.ndarray


def _outcome(scenes: Scene, setting: Measurable, transient: int, kept: int) -> _Outcome:
    probe = jax.tree.map(lambda a: np.asarray(a)[:SLOPE_LANES], scenes)
    slopes = setting.slopes(probe)
    slopes = np.full(len(probe.drive.omega), np.nan) if slopes is None else slopes
    runs = setting.run(scenes, transient + kept)
    if runs is None:
        short_runs = setting.run(scenes, HORIZON)
        assert short_runs is not None
        unknown = np.full(len(short_runs.status), np.nan)
        return _Outcome(
            short_runs.steps, motions_at(short_runs.samples, HORIZON - 1), unknown, unknown, unknown, slopes
        )
    settled = jax.tree.map(lambda a: a[:, transient:].astype(float), runs.samples)
    repetition, reduction, _ = averages(scenes, settled)
    P_d = np.where(runs.status == Status.OK, reduction.P_d, np.nan)
    return _Outcome(runs.steps, motions_at(runs.samples, HORIZON - 1), P_d, reduction.ci, repetition.number, slopes)


def _compared(scenes: Scene, setting: Measurable, outcome: _Outcome, reference: _Outcome) -> MeasuredSetting:
    with np.errstate(invalid="ignore"):
        return MeasuredSetting(
            str(setting),
            setting.kind,
            outcome.steps,
            cost(scenes, setting),
            state_errors(outcome.state, reference.state),
            _median(np.abs(outcome.P_d - reference.P_d)),
            _median(reference.ci),
            float(np.mean(outcome.number == reference.number)) if np.isfinite(outcome.number).all() else np.nan,
            float(np.median(np.abs(outcome.slope - reference.slope) / np.abs(reference.slope))),
        )


def _median(errors: np.ndarray) -> float:
    return float(np.nanmedian(errors)) if np.isfinite(errors).any() else np.nan


def cost(scenes: Scene, setting: Measurable) -> float:
    """The run time per lane and period, on all cores [s]."""

    def seconds(periods: int) -> float:
        began = time.perf_counter()
        setting.run(scenes, periods)
        return time.perf_counter() - began

    seconds(HORIZON)  # compiles
    first = seconds(HORIZON)
    periods = SHORT_PERIODS if first < MIN_TIMING_SECONDS else HORIZON
    best = first if first > LONG_TIMING_SECONDS else min(seconds(periods) for _ in range(TIMING_REPEATS))
    return best / len(scenes.drive.omega) / periods
