"""Accuracy against cost, measured on scenes of one's own."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.checks import in_precision
from jaxshroud.integrate import Method
from jaxshroud.locate import Locate
from jaxshroud.scene import Scene, vary
from jaxshroud.stability import stiffest
from jaxshroud.state import Status
from jaxshroud.sweep import Plan, Progress, averages, run_lanes, starts
from jaxshroud.tableau import LEAST_STEPS, tableau
from jaxshroud.tangents import Dual, differentiable, direction, resting, run_flow

HORIZON = 3  # periods over which states are compared: chaos has not grown errors much yet
SPREAD = 0.05  # relative, of the lanes around a scene
NEIGHBOURS = ("contact.gamma", "shroud.gap", "drive.F_0", "drive.omega", "friction.mu")
REPEATS = 3  # of a timing; the fastest counts
LEVELS = tuple(10.0**-n for n in range(2, 11))


class Setting(NamedTuple):
    """One way to march: static choices of the one engine."""

    tableau: str
    locate: Locate
    precision: str
    product: float  # omega_max h

    @property
    def method(self) -> Method:
        """The choices but the step."""
        return Method(tableau(self.tableau), self.locate, False, self.precision)  # type: ignore[arg-type]

    def steps(self, omega_max: float, period: float) -> int:
        """Steps per period for a scene of that largest frequency."""
        return max(int(np.ceil(omega_max * period / self.product)), LEAST_STEPS)

    def __str__(self) -> str:
        located = {"cubic": "", "bisection": ", bisection", "none": ", not located"}[self.locate]
        return f"{self.tableau}{', float32' if self.precision == 'float32' else ''}{located}, {self.product:.3g}"


TRUTH = Setting("dopri8", "cubic", "float64", 0.15)
SETTINGS = (
    *(Setting("rk4", "cubic", "float64", p) for p in (2.0, 1.0, 0.5, 0.25, 0.12, 0.06)),
    *(Setting("tsit5", "cubic", "float64", p) for p in (2.0, 1.0, 0.5, 0.25, 0.12)),
    *(Setting("dopri8", "cubic", "float64", p) for p in (2.0, 1.2, 0.8, 0.5, 0.3)),
    *(Setting("rk4", "cubic", "float32", p) for p in (2.0, 1.0, 0.5)),
    *(Setting("tsit5", "cubic", "float32", p) for p in (2.0, 1.0, 0.5)),
    *(Setting("rk4", "bisection", "float64", p) for p in (0.5, 0.25)),
    *(Setting("rk4", "none", "float64", p) for p in (0.5, 0.12)),
)


class Measured(NamedTuple):
    """What one setting costs and how far it errs, on lanes around a scene."""

    setting: Setting
    steps: int
    cost: float  # seconds per lane and period
    state: np.ndarray  # (lanes,) error of the state after `HORIZON` periods over its largest number; NaN if stopped
    P_d: float  # median error of P_d over the kept periods [percentage points]
    ci: float  # median half width of the truth's own interval [percentage points]
    period: float  # share of lanes with the truth's period number
    gradient: float  # median relative error of d(power)/d(gap) over the horizon; NaN where events are not located


def neighbourhood(scene: Scene, lanes: int, seed: int = 0) -> Scene:
    """The scene and others (leading axis) scattered around it, by `SPREAD` in each of `NEIGHBOURS`."""
    factors = 1 + SPREAD * np.random.default_rng(seed).uniform(-1, 1, (lanes, len(NEIGHBOURS)))
    factors[0] = 1.0
    drive = scene.drive.F_0

    def one(row):
        near = vary(scene, "drive.F_0", drive * row[2])
        for i, key in enumerate(NEIGHBOURS):
            if key != "drive.F_0":
                near = vary(near, key, _value(scene, key) * row[i])
        return near

    return jax.jit(jax.vmap(one))(jnp.asarray(factors))


def _value(scene: Scene, key: str) -> Any:
    if key == "contact.gamma":
        return scene.k / scene.blades.k_x[0]
    table, name = key.split(".")
    return getattr(getattr(scene, table), name)


def end_states(scenes: Scene, steps: int, method: Method, periods: int = HORIZON) -> np.ndarray:
    """Motions (lanes, 12) after some periods from the scenes' starts; NaN where a lane has stopped."""
    scenes = in_precision(scenes, method.precision)
    runs = run_lanes(scenes, starts(scenes), Plan(periods - 1, 1, steps, 0.0, method), lambda _: None)
    return np.concatenate([np.stack(pair, axis=-1)[:, 0] for pair in runs.samples.motion], axis=-1).astype(float)


def state_errors(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Largest error of each state over its largest number, (lanes,)."""
    return np.abs(got - exact).max(axis=1) / np.abs(exact).max(axis=1)


def trade(
    scene: Scene,
    *,
    settings: Sequence[Setting] = SETTINGS,
    lanes: int = 64,
    transient: int = 64,
    n_periods: int = 64,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure settings of the march on lanes around a scene.

    Args:
        scene: The scene, of spring contact.
        settings: What to measure.
        lanes: Scenes scattered around it, by `SPREAD` in each of `NEIGHBOURS`.
        transient: Periods before those over which P_d is averaged.
        n_periods: Periods over which P_d is averaged.
        seed: Of the scattering.
        progress: Called with (settings done, settings in all).

    Returns:
        One entry for each setting that is stable, in the order of `settings`. Errors are against `TRUTH`.

    Raises:
        ValueError: The scene's contact is not the spring's.
    """
    if scene.parts.contact != "spring":
        raise ValueError(f"Only spring contact has settings to trade, but the scene's is {scene.parts.contact}.")
    scenes = neighbourhood(scene, lanes, seed)
    omega_max, period = stiffest(scenes, 1)
    truth = _outcome(scenes, TRUTH, TRUTH.steps(omega_max, period), transient, n_periods)
    found = []
    for done, setting in enumerate(settings, 1):
        steps = setting.steps(omega_max, period)
        found.append(_compared(scenes, setting, steps, _outcome(scenes, setting, steps, transient, n_periods), truth))
        if progress is not None:
            progress(done, len(settings))
    return found


class _Outcome(NamedTuple):
    state: np.ndarray
    P_d: np.ndarray
    ci: np.ndarray
    number: np.ndarray
    slope: np.ndarray


def _outcome(scenes: Scene, setting: Setting, steps: int, transient: int, kept: int) -> _Outcome:
    method = setting.method
    mine = in_precision(scenes, method.precision)
    runs = run_lanes(mine, starts(mine), Plan(transient, kept, steps, 0.0, method), lambda _: None)
    motion, got, _ = averages(scenes, jax.tree.map(lambda a: a.astype(float) if a.dtype == np.float32 else a, runs))
    P_d = np.where(np.asarray(runs.last.status) == Status.OK, got.P_d, np.nan)
    return _Outcome(end_states(scenes, steps, method), P_d, got.ci, motion.number, _slopes(scenes, setting, steps))


def _slopes(scenes: Scene, setting: Setting, steps: int, most: int = 16) -> np.ndarray:
    """Derivative of the left block's power over the horizon with respect to the gap, on the first lanes."""
    if setting.locate == "none" or setting.precision == "float32":
        return np.full(most, np.nan)
    few = jax.tree.map(lambda a: np.asarray(a)[:most], scenes)
    along = direction(few, "shroud.gap")
    state = jax.tree.map(np.asarray, starts(few))
    flow = run_flow(Dual(few, along), resting(state), HORIZON, steps, differentiable(setting.method))
    return np.asarray(flow.tangent.power[0])


def _compared(scenes: Scene, setting: Setting, steps: int, got: _Outcome, truth: _Outcome) -> Measured:
    slope = np.abs(got.slope - truth.slope) / np.abs(truth.slope)
    with np.errstate(invalid="ignore"):
        return Measured(
            setting,
            steps,
            cost(scenes, setting, steps),
            state_errors(got.state, truth.state),
            float(np.nanmedian(np.abs(got.P_d - truth.P_d))),
            float(np.nanmedian(truth.ci)),
            float(np.mean(got.number == truth.number)),
            float(np.median(slope)),
        )


def cost(scenes: Scene, setting: Setting, steps: int, periods: int = 16) -> float:
    """Seconds per lane and period, on all cores."""
    scenes = in_precision(scenes, setting.method.precision)
    first, plan = starts(scenes), Plan(0, periods, steps, 0.0, setting.method)
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        run_lanes(scenes, first, plan, lambda _: None)
        seconds.append(time.perf_counter() - began)
    return min(seconds) / len(scenes.drive.omega) / periods


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
