"""Accuracy against cost of methods, measured around a scene; diffrax's adaptive solvers are among the methods."""

import timeit
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress
from jaxshroud.march.method import FAST, Method, choices
from jaxshroud.march.stability import steps_for, stiffest
from jaxshroud.orbits.short_runs import (
    HORIZON,
    ShortRuns,
    adaptive_gap_slopes,
    adaptive_runs,
    gap_slopes,
    motions_at,
    run_from_start,
    softened,
    state_errors,
)
from jaxshroud.results.trade import Trade
from jaxshroud.scene.checks import InputError, count_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of
from jaxshroud.scene.typed import typed
from jaxshroud.scene.vary import value_of
from jaxshroud.signals.amplitudes import check_vibration
from jaxshroud.signals.averages import averages
from jaxshroud.verbs.accuracy import Setting, by_series
from jaxshroud.verbs.lanes import one_scene

LANE_SCATTER = 0.05  # relative, of the lanes around a scene
SCATTERED_KEYS = ("contact.gamma", "shroud.gap", "drive.F_0[0]", "drive.F_0[1]", "drive.omega", "friction.mu")
FORCE_LEVEL = "drive.level"  # in place of the forces where the drive is a list of harmonics


class Measurable(NamedTuple):
    """A method with all that it needs to march lanes (leading axis) from the initial states of their scenes."""

    setting: str
    kind: str  # the setting without its numbers
    options: Callable[[Scene], tuple]  # which the functions take after scenes and periods
    run: Callable[..., ShortRuns] = run_from_start
    slopes: Callable[..., np.ndarray] = gap_slopes
    width: float = 0.0  # as in `Setting`


def by_setting(one: Setting) -> Measurable:
    """A setting of those from which an accuracy chooses."""
    return Measurable(
        setting=str(one),
        kind=one.kind,
        options=lambda scenes: (one.steps(*stiffest(scenes, 1)), one.method),
        width=one.width,
    )


def by_method(one: Method) -> Measurable:
    """A method with its own steps."""
    method = choices(one)
    return Measurable(
        setting=str(one),
        kind=str(method),
        options=lambda scenes: (steps_for(scenes, 1, one.steps or "auto", method.tableau), method),
    )


def adaptive(solver: str, rtol: float, width: float = 0.0) -> Measurable:
    """A solver of diffrax with its tolerance, see `adaptive_samples`."""
    kind = f"diffrax {solver}{', smooth' if width else ''}"
    return Measurable(
        setting=f"{kind}{f', width {width:.3g}' if width else ''}, rtol {rtol:.0e}",
        kind=kind,
        options=lambda _: (solver, rtol),
        run=adaptive_runs,
        slopes=adaptive_gap_slopes,
        width=width,
    )


REFERENCE_SETTING = Setting("dopri8", "cubic", "float64", 0.15)
PRODUCTS = (2.0, 1.0, 0.5, 0.25)  # omega_max h
RUNGE_KUTTA_SETTINGS = [
    by_setting(Setting(tableau, "cubic", precision, product))
    for tableau in ("rk4", "tsit5", "dopri8")
    for precision in ("float64", "float32")
    for product in PRODUCTS
]
ADAPTIVE = [adaptive(solver, rtol) for solver in ("Tsit5", "Dopri8") for rtol in (1e-3, 1e-6)]
SETTINGS = {
    "spring": [
        *RUNGE_KUTTA_SETTINGS,
        *(by_setting(by_series(14, 10.0**-digits)) for digits in (5, 8, 12)),
        *(by_setting(Setting("rk4", "none", "float64", product)) for product in PRODUCTS),
        *(
            smooth
            for width in (0.25, 0.0625, 0.015625)
            for smooth in (by_setting(Setting("rk4", "cubic", "float64", 1.0, width)), adaptive("Tsit5", 1e-4, width))
        ),
    ],
    "smooth": [*RUNGE_KUTTA_SETTINGS, *ADAPTIVE],
    "none": [Measurable(setting="closed form", kind="closed form", options=lambda _: (1, FAST)), *ADAPTIVE],
}


def neighbourhood(scene: Scene, lanes: int, seed: int = 0) -> Scene:
    """The scene and others (leading axis) around it: each of `SCATTERED_KEYS` scatters by `LANE_SCATTER`.

    The forces on both blades scatter alike, and so do all harmonics of a drive that is a list of them.
    """
    places = np.random.default_rng(seed).uniform(-1, 1, (lanes, 5))[:, [0, 1, 2, 2, 3, 4]]
    places[0] = 0.0
    keys = [FORCE_LEVEL if scene.drive.harmonic and "F_0" in key else key for key in SCATTERED_KEYS]
    numbers = np.array([value_of(scene, key) for key in keys]) * (1 + LANE_SCATTER * places)
    return scenes_at(scene, keys, numbers)


@typed
def trade(
    scene: Scene | SceneFile,
    *,
    methods: Sequence[Method | Measurable] | None = None,
    lanes: int = 64,
    seed: int = 0,
    n_periods: int = 64,
    transient: int = 64,
    progress: Progress | None = None,
) -> Trade:
    """Measure the accuracy and the cost of methods on scenes around the given one.

    Args:
        scene: One scene, or a scene file.
        methods: Methods to measure; by default those of `SETTINGS`, each with several steps or tolerances.
        lanes: The number of scenes: the given one, and others with `SCATTERED_KEYS` scattered by `LANE_SCATTER`.
        seed: Seed of the scatter.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first, with the kept ones at least `HORIZON`; by default 64.
        progress: Called with (methods done, methods in all).

    Returns:
        The cost and the errors of each method, by comparison with `REFERENCE_SETTING`.

    Raises:
        ValueError: A count is too small, the run would be too long or too large, there are many scenes,
            or the left blade does not vibrate without contact.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.trade(scene, methods=[js.RungeKutta(steps=200)], lanes=8, n_periods=4, transient=4)
        >>> found[0].state_error < 1e-2
        True
    """
    seed_argument(seed)
    count_argument("lanes", lanes, 1)
    scene = one_scene("trade", scene)
    check_size(lanes, transient, n_periods)
    check_vibration("P_d", scene)
    by_modes = scene.mode_numbers is not None  # which the solvers of diffrax do not march
    ways = None if by_modes else SETTINGS.get(scene.parts.contact)
    if ways is None:
        what = "blades by modes" if by_modes else f"{scene.parts.contact} contact"
        raise InputError(f"`trade` has no reference for {what}; compare powers by js.power.")
    if methods is not None:
        ways = [one if isinstance(one, Measurable) else by_method(one) for one in methods]
    scenes = neighbourhood(scene, lanes, seed)
    exact = _outcome(scenes, by_setting(REFERENCE_SETTING), transient, n_periods)
    outcomes = []
    for way in ways:
        outcomes.append(_outcome(scenes, way, transient, n_periods))
        if progress:
            progress(len(outcomes), len(ways))
    found = jax.tree.map(lambda *own: np.array(own), *outcomes)
    errors = np.nan_to_num([state_errors(state, exact.state) for state in found.state], nan=np.inf)
    return Trade.from_values(
        {
            "kind": [way.kind for way in ways],
            "steps_per_period": found.steps,
            "cost": found.seconds / lanes / (transient + n_periods),
            "state_error": np.quantile(errors, 0.95, axis=1, method="higher"),  # of nearly all lanes
            "state_error_median": np.median(errors, axis=1),
            "P_d": np.median(np.nan_to_num(np.abs(found.P_d - exact.P_d), nan=np.inf), axis=1),
            "ci": [np.nanmedian(exact.ci)] * len(ways),
            "period": np.mean(found.number == exact.number, axis=1),
            "gradient": np.median(np.abs(found.slope / exact.slope - 1), axis=1),
            "horizon": HORIZON,
        },
        lanes=("setting",),
        coords={"setting": [way.setting for way in ways]},
        attrs={"title": "", "scene": text_of(scene, {"periods": n_periods, "transient": transient})},
    )


class _Outcome(NamedTuple):
    seconds: float
    steps: int
    state: np.ndarray
    P_d: np.ndarray
    ci: np.ndarray
    number: np.ndarray
    slope: np.ndarray


def _outcome(scenes: Scene, way: Measurable, transient: int, kept: int) -> _Outcome:
    marched = softened(scenes, way.width)
    options = way.options(marched)
    run = partial(way.run, marched, transient + kept, *options)
    runs = run()  # compiles
    repetition, reduction, _ = averages(scenes, jax.tree.map(lambda a: a[:, transient:].astype(float), runs.samples))
    return _Outcome(
        seconds=min(timeit.repeat(run, number=1, repeat=2)),
        steps=runs.steps,
        state=motions_at(runs.samples, HORIZON - 1),
        P_d=reduction.P_d,
        ci=reduction.ci,
        number=repetition.number,
        slope=way.slopes(marched, HORIZON, *options),
    )
