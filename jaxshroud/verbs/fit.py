"""Numbers of a scene from measurements, by least squares with exact derivatives."""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.plan import Progress
from jaxshroud.fitting.identifiability import MARCH_ERROR, Findings, ProfiledNumber, better_place, findings, profiles
from jaxshroud.fitting.least_squares import MOST_EVALUATIONS, Estimate, Misfit, estimate
from jaxshroud.fitting.measured import weighted_data
from jaxshroud.fitting.searches import (
    MOST_SEARCHES,
    MOST_STEPS,
    descended,
    estimate_of_history,
    evaluations_of_search,
    remarched,
)
from jaxshroud.io.measurements import measurements_from, read_measurements
from jaxshroud.march.method import FAST
from jaxshroud.results.fit import Fit
from jaxshroud.scene.checks import InputError, count_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.measurements import BLADES, Measurements
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.arguments import MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.design_problem import Problem, first_points, problem_of
from jaxshroud.verbs.fit_models import FitModel, HistoryModel, ResponseModel, fit_corners, model_of
from jaxshroud.verbs.lanes import one_scene

CURVE_POINTS = 1000  # of the fitted history that is drawn
FEWEST_POINTS = 8  # of a search
USUAL_SEARCHES = 2
MOST_BETTER = 3  # times that a profile shows a better place, from which the fit goes on
NODE_EVALUATIONS = 60  # about so many for the profile of a number


@typed
def fit(
    scene: Scene | SceneFile,
    measurements: str | os.PathLike[str] | Mapping[str, Any],
    over: Mapping[str, tuple[float | int, float | int]],
    *,
    scan: int = 64,
    starts: int = 4,
    most_periods: int = 512,
    seed: int = 0,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the numbers of a scene with which it moves as was measured, their 95 % intervals, and what stays unknown.

    A time history starts from the scene's initial motion at drive phase 0, where `t` is 0; it may be recorded from
    later on. A frequency response is that of the motion on which the scene settles at each frequency.

    Over a whole history with contact chi^2 has many valleys. The numbers are therefore sought along its beginning
    first, by many points at once, and then along ever longer parts of it, until two independent searches end alike
    where noise may have such a chi^2; else there are up to four. What the noise contradicts has no interval.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        measurements: A CSV file or a table of columns by headers `name [unit]`: `t [s]` and displacements, `x_left
            [mm]`, `theta_right [deg]`, ...; or `omega [rad/s]`, `f [Hz]`, or `speed [rpm]` with `engine_order`, and
            amplitudes about the mean, `x_rms_left [um]`, `x_peak_right [um]`, ... The blades of a row have numbers,
            from 1: `x_1 [mm]`, `x_rms_12 [um]`. Columns `x_left_sigma [mm]`, ... give the standard deviation of the
            noise of each value; without them that of each channel is estimated: of a history by how far residuals
            depart from the line through both neighbours, so that a bad fit has a large chi^2; of a response by the
            residuals themselves.
        over: Keys as for `vary`, each with its bounds in SI units.
        scan: Points within the bounds that are tried first, besides the scene itself; half in each search of a history.
        starts: The best of them from which least squares begin, of a history the ends of a search.
        most_periods: Drive periods after which a motion that has not repeated is treated as aperiodic, in a response.
        seed: Seed of the points.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (evaluations of the model done, evaluations at most) now and then.

    Returns:
        The best fit, with 95 % intervals and `notes`. A number that the data do not determine has none, nor has any
        number of a fit that the noise contradicts, or of a history whose residuals are no noise, which the march's own
        error moves, or that fits as well elsewhere.

    Raises:
        KeyNameError: The scene has no such number.
        InputError: The measurements are not such a table, their channels do not move in the scene, they are fewer than
            the numbers, bounds are not in order or out of range, or JAX has no float64.
        NumericalError: No start runs to its end, or none finds an orbit.

    Source:
        Damped Gauss-Newton steps of a batch of points (`fitting/least_squares.py`), of responses
        scipy.optimize.least_squares (trust region reflective), in scaled numbers with the tangents of the march; on
        orbits by the implicit function theorem. Intervals are those of the fit made linear (Student's t where the noise
        is estimated), or the profile of chi^2 where they are wide, confounded or not linear.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js, numpy as np
        >>> scene = js.load("table1", ['parts.motion=["x"]', 'parts.contact="none"']).scene
        >>> run = js.simulate(scene.replace({"blades.c_x": 5.0}), n_periods=2, method=js.RungeKutta(steps=100))
        >>> table = {"t [s]": run.t[::10], "x_left [m]": run.motion.x[::10, 0]}
        >>> found = js.fit(scene, table, {"blades.c_x": (1.0, 20.0)}, scan=4, starts=1, method=js.RungeKutta(steps=100))
        >>> round(found.value["blades.c_x"], 3)
        5.0
    """
    nominal = one_scene("fit", scene)
    is_file = isinstance(measurements, str | os.PathLike)
    data = read_measurements(measurements) if is_file else measurements_from(measurements)
    for name, count in {"scan": scan, "starts": starts, "most_periods": most_periods}.items():
        count_argument(name, count, 1)
    seed_argument(seed)
    problem = fit_problem(nominal, data, {key: (float(low), float(high)) for key, (low, high) in over.items()})
    resolved = resolve_options(scene, method=method)
    march = plan_march(resolved, fit_corners(problem), FAST, tangents=True)
    model = model_of(problem, data, march, most_periods)
    found, profiled, model, march_error = _estimated(problem, data, model, (scan, starts, seed), progress)
    judged = findings(found, tuple(over), profiled, problem.values, data.kind == "history", march_error)
    attrs, _ = resolved.provenance(march.steps)
    settings = {**march._replace(steps=model.steps, choice=None).attributes, "seed": seed, "data_kind": data.kind}
    return _result(problem, data, model, found, profiled, judged, settings, attrs)


class Estimated(NamedTuple):
    """The best fit, with the profiles of its numbers."""

    found: Estimate
    profiled: list[ProfiledNumber]
    model: FitModel  # by whose march it was found in the end
    march_error: float = 0.0  # how far the march's error moves a number, over the half width of its interval


def _estimated(
    problem: Problem, data: Measurements, model: FitModel, search: tuple[int, int, int], progress: Progress | None
) -> Estimated:
    """The best fit, with the profiles of its numbers."""
    scan, starts, seed = search
    weighted = weighted_data(data)
    nodes = NODE_EVALUATIONS * len(problem.over)
    if isinstance(model, ResponseModel):
        points = first_points(problem, scan, seed)
        counted = _Counted(model, len(points) + starts * MOST_EVALUATIONS + nodes, progress)
        found = estimate(Misfit(counted, weighted, counted.skip), points, min(starts, len(points)))
        return Estimated(found, profiles(found), model)
    count = max(scan // USUAL_SEARCHES, FEWEST_POINTS)
    draws = [first_points(problem, count, seed, n) for n in range(MOST_SEARCHES)]
    most = USUAL_SEARCHES * (evaluations_of_search(count) + 2 * starts * MOST_STEPS) + nodes
    counted = _Counted(model, most, progress)
    misfit = Misfit(counted, weighted, counted.skip)
    rng = np.random.default_rng(seed)
    found = estimate_of_history(misfit, data.at, draws, starts, rng, lambda found: _errs(found, model))
    return refined_fit(found, counted, model)


def refined_fit(found: Estimate, counted: "_Counted", model: HistoryModel) -> Estimated:
    """The fit to a history with its profiles, by a march whose own error is small beside the intervals if a finer is.

    The search makes do with the march that is asked; where it errs, the minima that it found are those of another.
    """
    if _errs(found, model):
        counted.model = model = model.refined()
        found = remarched(found, model.data.at)
    found, profiled = _profiled(found)
    return Estimated(found, profiled, model, _march_error(found, model))


def _errs(found: Estimate, model: HistoryModel) -> bool:
    return _march_error(found, model) > MARCH_ERROR


def _march_error(found: Estimate, model: HistoryModel) -> float:
    """How far the error of the march moves a number, over the half width of its interval, by a finer march."""
    return found.moved_by(Misfit(model.refined(), found.misfit.data).at(found.u))


def _profiled(found: Estimate) -> tuple[Estimate, list[ProfiledNumber]]:
    """The fit to a history, from which its profiles show no better place, and these."""
    profiled = profiles(found)
    for _ in range(MOST_BETTER):
        better = better_place(found, profiled)
        if better is None:
            break
        found = descended(found.misfit, found, better)
        profiled = profiles(found)
    return found, profiled


def fit_problem(nominal: Scene, data: Measurements, over: Mapping[str, tuple[float, float]]) -> Problem:
    """The numbers to fit with their bounds, and the frequencies of a response as conditions.

    Raises:
        InputError: See `fit`.
    """
    for channel in data.channels:
        if channel.blade >= nominal.layout.blades:
            raise InputError(f"{channel.name} is measured, but the scene has {nominal.layout.blades} blades.")
        if nominal.row is not None and channel.label in BLADES:
            raise InputError(f"{channel.name}: the blades of a row have numbers, from 1; write x_1, x_2, ...")
        if not nominal.parts.has(channel.place, channel.blade):
            raise InputError(f"{channel.name} is measured, but does not move in the scene's [parts].")
    if data.values.size <= len(over):
        raise InputError(
            f"{data.values.size} values cannot determine {len(over)} numbers and their intervals; measure more."
        )
    still = [name for name, size in zip(data.names, data.sizes, strict=True) if not size > 0]
    if data.sigma is None and still:
        raise InputError(f"{still[0]} is 0 throughout, which says nothing of its noise; leave it out.")
    if data.kind == "history":
        return problem_of(nominal, over, {})
    if "drive.omega" in over:
        raise InputError("drive.omega is given by the frequency response; it cannot be fitted.")
    return problem_of(nominal, over, {"drive.omega": data.at.tolist()})


class _Counted:
    """A model whose evaluations are counted and reported."""

    def __init__(self, model: FitModel, most: int, progress: Progress | None):
        self.model = model
        self.done = 0
        self.most = most
        self.progress = progress

    def __call__(self, points: np.ndarray, rows: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """What the model says."""
        predicted = self.model(points, rows)
        self.skip(len(points))
        return predicted

    def skip(self, count: int) -> None:
        """Count evaluations without making them."""
        self.done += count
        if self.progress is not None:
            self.progress(self.done, self.most if self.done <= self.most else 0)


def _result(
    problem: Problem,
    data: Measurements,
    model: FitModel,
    found: Estimate,
    profiled: Sequence[ProfiledNumber],
    judged: Findings,
    settings: Mapping[str, object],
    attrs: Mapping[str, object],
) -> Fit:
    """The result in SI units."""
    ends = [number.interval for number in profiled]
    nodes = max(len(number.nodes) for number in profiled)

    def padded(values):
        return np.pad(np.asarray(values, float), (0, nodes - len(values)), constant_values=np.nan)

    def place(i: int, u: float) -> float:
        return float(problem.values(np.where(np.arange(len(found.u)) == i, u, found.u)[None])[0, i])

    def end(i: int, u: float) -> float:
        return place(i, u) if judged.determined[i] else np.nan

    of_data = found.misfit.data
    fitted = np.where(found.known, np.ravel(of_data.values) + found.residuals * np.ravel(of_data.sigma), np.nan)
    curve_at, curve = model.curve(found.u, CURVE_POINTS)
    low, high = np.array(list(problem.over.values())).T
    values = {
        "best": problem.values(found.u[None])[0],
        "low": [end(i, interval.low) for i, interval in enumerate(ends)],
        "high": [end(i, interval.high) for i, interval in enumerate(ends)],
        "by_profile": [interval.by == "profile" for interval in ends],
        "bound_low": low,
        "bound_high": high,
        "correlation": found.correlation,
        "at": data.at,
        "measured": data.values,
        "fitted": fitted.reshape(of_data.values.shape),
        "sigma": of_data.sigma,
        "curve_at": curve_at,
        "curve": curve,
        "minima": [minimum.chi2 for minimum in found.minima],
        "minima_at": problem.values(np.array([minimum.u for minimum in found.minima])),
        "profile_at": [padded([place(i, u[i]) for u, _ in one.nodes]) for i, one in enumerate(profiled)],
        "profile_chi2": [padded([found.chi2 + rise for _, rise in one.nodes]) for one in profiled],
        "profile_limit": found.chi2 + found.limit,
        "chi2": found.chi2,
        "freedom": found.freedom,
        "evaluations": found.misfit.evaluations,
        "sigma_is_known": int(of_data.sigma_is_known),
        **settings,
        "notes_json": json.dumps(judged.notes),
    }
    keys = list(problem.over)
    coords = {"key": keys, "other": keys, "channel": list(data.names)}
    return Fit.from_values(jax.tree.map(np.asarray, values), coords=coords, attrs=attrs)
