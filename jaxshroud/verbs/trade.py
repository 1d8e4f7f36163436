"""Accuracy against cost, measured on scenes of one's own."""

import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.free import free_runs
from jaxshroud.batch.runs import Progress, starts
from jaxshroud.march.method import FAST
from jaxshroud.model.modes import Status
from jaxshroud.motion.averages import averages
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of
from jaxshroud.verbs.adaptive import Adaptive
from jaxshroud.verbs.lanes import one_scene
from jaxshroud.verbs.setting import HORIZON, SHORT, Ran, Setting, by_series, state_errors, states

SPREAD = 0.05  # relative, of the lanes around a scene
NEIGHBOURS = ("contact.gamma", "shroud.gap", "drive.F_0[0]", "drive.F_0[1]", "drive.omega", "friction.mu")
REPEATS = 3  # of a timing; the fastest counts
ENOUGH = 0.5  # seconds for a timing
PLENTY = 5.0  # seconds of a timing that need not be repeated
SLOPES = 16  # lanes whose derivatives are compared


@runtime_checkable
class Way(Protocol):
    """A way to march a scene."""

    @property
    def kind(self) -> str:
        """The choices that are no numbers, in words."""
        ...

    def run(self, scenes: Scene, periods: int) -> Ran | None:
        """March lanes (leading axis) from their starts; None where that would take too long."""
        ...

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """Derivative of each lane's power over the horizon with respect to the gap; None where there is none."""
        ...


class ClosedForm(NamedTuple):
    """The way through scenes without contact."""

    kind: str = "closed form"

    def run(self, scenes: Scene, periods: int) -> Ran:
        """All samples at once."""
        samples, last = free_runs(scenes, starts(scenes), 0, periods, 0.0, FAST)
        return Ran(samples, last.status, 0)

    def slopes(self, scenes: Scene) -> None:
        """The gap does not matter."""

    def __str__(self) -> str:
        return self.kind


TRUTH = Setting("dopri8", "cubic", "float64", 0.15)
SMOOTH_TRUTH = TRUTH._replace(product=0.5)  # its slider follows so fast that omega_max says little of the motion
TRUTHS: dict[str, Way] = {"spring": TRUTH, "smooth": SMOOTH_TRUTH, "none": ClosedForm()}
MARCHED = {
    ("rk4", "float64"): (2.0, 1.0, 0.5, 0.25, 0.12, 0.06),
    ("tsit5", "float64"): (2.0, 1.0, 0.5, 0.25, 0.12),
    ("dopri8", "float64"): (2.0, 1.2, 0.8, 0.5, 0.3),
    ("rk4", "float32"): (2.0, 1.0, 0.5),
    ("tsit5", "float32"): (2.0, 1.0, 0.5),
}
LOCATED = tuple(Setting(name, "cubic", digits, p) for (name, digits), steps in MARCHED.items() for p in steps)
TOLERANCES = {"Tsit5": (1e-3, 1e-6), "Dopri8": (1e-5, 1e-9), "Kvaerno5": (1e-3, 1e-5)}
SERIES = ((8, 1e-5), (10, 1e-6), (12, 1e-8), (14, 1e-10), (16, 1e-12))  # orders and tolerances
ADAPTIVE = tuple(Adaptive(solver, rtol) for solver, levels in TOLERANCES.items() for rtol in levels)
WIDTHS = (1 / 4, 1 / 16, 1 / 64)
SETTINGS: dict[str, tuple[Way, ...]] = {
    "spring": (
        *LOCATED,
        *(by_series(*choice) for choice in SERIES),
        *(Setting("rk4", "bisection", "float64", p) for p in (0.5, 0.25)),
        *(Setting("rk4", "none", "float64", p) for p in (0.5, 0.12)),
        *(Setting("rk4", "cubic", "float64", 1.0, width) for width in WIDTHS),
        *(Adaptive("Tsit5", 1e-4, width) for width in WIDTHS),
    ),
    "smooth": (*(setting for setting in LOCATED if setting.product > SMOOTH_TRUTH.product), *ADAPTIVE),
    "none": (ClosedForm(), *ADAPTIVE),
}


class Measured(NamedTuple):
    """What one setting costs and how far it errs, on lanes around a scene."""

    setting: Way
    steps: int  # per period, on average; 0 for the closed form
    cost: float  # seconds per lane and period
    state: np.ndarray  # (lanes,) error of the state after `HORIZON` periods over its largest number; NaN if stopped
    P_d: float  # median error of P_d over the kept periods [percentage points]; NaN where that takes too long
    ci: float  # median half width of the truth's own interval [percentage points]
    period: float  # share of lanes with the truth's period number; NaN like P_d
    gradient: float  # median relative error of d(power)/d(gap) over the horizon; NaN where there is none


def neighbourhood(scene: Scene, lanes: int, seed: int = 0) -> Scene:
    """The scene and others (leading axis) scattered around it, by `SPREAD` in each of `NEIGHBOURS`.

    The forces on both blades are scattered alike.
    """
    centre = np.array([value_of(scene, key) for key in NEIGHBOURS])
    draws = np.random.default_rng(seed).uniform(-1, 1, (lanes, len(NEIGHBOURS) - 1))
    factors = 1 + SPREAD * np.insert(draws, 3, draws[:, 2], axis=1)
    factors[0] = 1.0
    return scenes_at(scene, NEIGHBOURS, centre * factors)


def trade(
    scene: Scene | SceneFile,
    *,
    settings: Sequence[Way] | None = None,
    lanes: int = 64,
    seed: int = 0,
    n_periods: int = 64,
    transient: int = 64,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure ways to march on lanes around a scene.

    Args:
        scene: One scene.
        settings: What to measure; by default `SETTINGS` of the scene's kind of contact.
        lanes: Scenes scattered around it, by `SPREAD` in each of `NEIGHBOURS`.
        seed: Of the scattering.
        n_periods: Drive periods over which P_d is averaged.
        transient: Drive periods before these, with them no fewer than `HORIZON`.
        progress: Called with (settings done, settings in all).

    Returns:
        One entry for each setting, with its errors against one of `TRUTHS`.

    Raises:
        ValueError: The run would be too long or too large, or there are many scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.contact="none"']).scene
        >>> [found] = js.trade(scene, settings=[ClosedForm()], lanes=8, n_periods=4, transient=4)
        >>> found.setting.kind
        'closed form'
    """
    scene = one_scene("trade", scene)
    fits(lanes, transient, n_periods)
    settings = SETTINGS[scene.parts.contact] if settings is None else settings
    scenes = neighbourhood(scene, lanes, seed)
    truth, found = _outcome(scenes, TRUTHS[scene.parts.contact], transient, n_periods), []
    for done, setting in enumerate(settings, 1):
        found.append(_compared(scenes, setting, _outcome(scenes, setting, transient, n_periods), truth))
        if progress is not None:
            progress(done, len(settings))
    return found


class _Outcome(NamedTuple):
    steps: int
    state: np.ndarray
    P_d: np.ndarray
    ci: np.ndarray
    number: np.ndarray
    slope: np.ndarray


def _outcome(scenes: Scene, way: Way, transient: int, kept: int) -> _Outcome:
    few = jax.tree.map(lambda a: np.asarray(a)[:SLOPES], scenes)
    slopes = way.slopes(few)
    slopes = np.full(len(few.drive.omega), np.nan) if slopes is None else slopes
    ran = way.run(scenes, transient + kept)
    if ran is None:
        short = way.run(scenes, HORIZON)
        assert short is not None
        unknown = np.full(len(short.status), np.nan)
        return _Outcome(short.steps, states(short.samples, HORIZON - 1), unknown, unknown, unknown, slopes)
    settled = jax.tree.map(lambda a: a[:, transient:].astype(float), ran.samples)
    motion, got, _ = averages(scenes, settled)
    P_d = np.where(ran.status == Status.OK, got.P_d, np.nan)
    return _Outcome(ran.steps, states(ran.samples, HORIZON - 1), P_d, got.ci, motion.number, slopes)


def _compared(scenes: Scene, way: Way, got: _Outcome, truth: _Outcome) -> Measured:
    with np.errstate(invalid="ignore"):
        return Measured(
            way,
            got.steps,
            cost(scenes, way),
            state_errors(got.state, truth.state),
            _median(np.abs(got.P_d - truth.P_d)),
            _median(truth.ci),
            float(np.mean(got.number == truth.number)) if np.isfinite(got.number).all() else np.nan,
            float(np.median(np.abs(got.slope - truth.slope) / np.abs(truth.slope))),
        )


def _median(errors: np.ndarray) -> float:
    return float(np.nanmedian(errors)) if np.isfinite(errors).any() else np.nan


def cost(scenes: Scene, way: Way) -> float:
    """Seconds per lane and period, on all cores."""

    def seconds(periods: int) -> float:
        began = time.perf_counter()
        way.run(scenes, periods)
        return time.perf_counter() - began

    seconds(HORIZON)  # which compiles
    first = seconds(HORIZON)
    periods = SHORT if first < ENOUGH else HORIZON
    best = first if first > PLENTY else min(seconds(periods) for _ in range(REPEATS))
    return best / len(scenes.drive.omega) / periods


def error_of(measured: Measured, share: float = 0.95) -> float:
    """The state error that so many lanes stay below."""
    return float(np.quantile(np.nan_to_num(measured.state, nan=np.inf), share, method="higher"))


def front(found: Sequence[Measured]) -> list[int]:
    """Indices of the settings that no other beats in both cost and error, the cheapest first."""
    best, kept = np.inf, []
    for i in sorted(range(len(found)), key=lambda i: found[i].cost):
        if error_of(found[i]) < best:
            best = error_of(found[i])
            kept.append(i)
    return kept


def cheapest(found: Sequence[Measured], level: float) -> Measured | None:
    """The cheapest setting whose error 95 % of the lanes stay below; None if there is none."""
    able = [m for m in found if error_of(m) <= level]
    return min(able, key=lambda m: m.cost, default=None)
