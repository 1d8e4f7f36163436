"""The report on a design: what is required, its runs, a verdict with its reasons, and one document of all."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import TypedDict, cast

import jax
import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress, Ticker
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march.method import FOR_P_D
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import stored_state
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.scatter import Report
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.checks import InputError, NumericalError, count_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.layout import PAIR, SINGLE_DIRECTIONS
from jaxshroud.scene.quantities import RequiredReduction, check_quantity
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import T, typed
from jaxshroud.scene.vary import level_of, value_of, with_numbers
from jaxshroud.signals.amplitudes import check_resonance, check_vibration, counted_reduction
from jaxshroud.verbs.arguments import Asked, MarchPlan, MethodArgument, ResolvedOptions, plan_march, resolve_options
from jaxshroud.verbs.attractors import attractors, row_motions
from jaxshroud.verbs.check import check
from jaxshroud.verbs.design_problem import (
    Problem,
    check_condition,
    design_corners,
    judge_designs,
    problem_of,
    scenes_of,
)
from jaxshroud.verbs.gradient import gradient
from jaxshroud.verbs.gradient_ascent import verify_design
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.power import power
from jaxshroud.verbs.report_findings import DesignFindings, RowFindings
from jaxshroud.verbs.report_sections import Limits, ReportData, sections_of, worst_of
from jaxshroud.verbs.report_verdict import report_verdict
from jaxshroud.verbs.response import VALUES, ZOOMS, peak_ratio
from jaxshroud.verbs.scatter import check_at_least, draw_rows, scatter
from jaxshroud.verbs.scattering import Spread, scatter_bounds
from jaxshroud.verbs.sweep import sweep

Bounds = Mapping[str, tuple[float, float]]
Conditions = Mapping[str, Sequence[float]]


def report_request(
    scene: Scene,
    limits: Limits,
    scatters: Mapping[str, Spread],
    conditions: Conditions,
    tuned: Tuned | None,
    of: RequiredReduction | None = None,
) -> tuple[Limits, dict[str, tuple[float, float]], dict[str, Sequence[float]]]:
    """The limits, the bounds of numbers that scatter and the conditions of a report, merged with those of a tuning.

    Raises:
        KeyError: The scene has no such number.
        InputError: A half width is not positive.
    """
    bounds = scatter_bounds(scene, scatters)
    if tuned is None:
        return limits, bounds, dict(conditions)
    own_bounds = tuned.ends_of_scatter({key: value_of(scene, key) for key in tuned.scatters})
    limits = Limits(
        tuned.at_least if limits.at_least is None and of in (None, tuned.quantity) else limits.at_least,
        min(limits.most_force, tuned.most_force),
        min(limits.most_penetration, tuned.most_penetration),
    )
    return limits, own_bounds | bounds, {**tuned.conditions, **conditions}


def varied_by(scene: Scene, scatters: Bounds, conditions: Conditions) -> Scene:
    """The scenes (leading axis) of a report: the design in all its conditions, and at the ends of its scatter.

    Raises:
        KeyError: The scene has no such number.
        ValueError: A value is out of its range, or there is none.
    """
    scene = with_numbers(scene, list(dict.fromkeys([*scatters, *conditions])))
    for key, values in conditions.items():
        check_condition(key, values, scene.layout)
    in_conditions = scenes_at(scene, list(conditions), np.array(list(product(*conditions.values())), float))
    if not scatters:
        return in_conditions
    at_ends = design_corners(problem_of(scene, scatters, {}))
    return jax.tree.map(lambda *a: np.concatenate(a), in_conditions, at_ends)


GAPS = 61  # values of the sweep over the gap
GAPS_BELOW, GAPS_ABOVE, MIN_GAP_SIZE = 0.75, 2.0, 1e-6  # its range about the gap, in gaps of at least 1 um
SPEEDS = 0.75, 1.25  # range of drive frequencies, over the drive's own, in which peaks are compared
SCENE_ITSELF = np.empty((1, 0))  # the design of a problem in which nothing is tuned


class RunOptions(TypedDict):
    """The arguments that the runs of a report share."""

    n_periods: int
    transient: int
    method: Asked


@typed
def report(
    scene: Scene | SceneFile,
    *,
    scatters: Mapping[str, Spread] | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
    of: RequiredReduction | None = None,
    at_least: float | None = None,
    most_force: float = np.inf,
    most_penetration: float = np.inf,
    draws: int = 128,
    starts: int = 64,
    seed: int = 0,
    tuned: Tuned | None = None,
    command: str = "",
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Report:
    """The report on a design: data sheet, forces, scatter, sensitivities, coexisting motions, checks and a verdict.

    Where there are operating conditions, the worst one counts, as for `tune`: the scatter takes the worst of every
    draw, coexisting motions are found in each, the largest forces are those of all runs that are shown, and sections
    about one condition are about the worst, which they name. The scene's own values of these keys are not used.

    Of a row of blades P_d is that of all, or by `of` that of the blade that gains the least; amplitudes are those of
    the blade that swings most, forces those of the interface where they are largest. There are its natural modes,
    waves, blades and interfaces, and coexisting motions are told apart by their Poincaré points.

    The verdict is "fails" where a stated limit is not kept, "doubtful" where results do not agree or may not last, and
    "sound" otherwise.

    Args:
        scene: The design: one scene, or a scene file, whose [run] counts where an argument is not given.
        scatters: Keys of numbers that scatter, each with a half width or bounds; see `scatter`.
        conditions: Keys of operating conditions, each with its values; all combinations count.
        of: The reduction that is judged: "P_d", or of a row "P_d_worst", that of its worst blade; by default that of
            the tuning, else "P_d", and where there is a mean load or interference "P_d_vibration".
        at_least: P_d, or P_d_worst, [percent] required in every condition, and with 95 % probability under the scatter.
        most_force: Largest allowed normal force of the contact [N].
        most_penetration: Largest allowed penetration [m].
        draws: Draws of the scatter, see `scatter`.
        starts: Random starts from which coexisting motions are found.
        seed: Seed of the draws and of the starts.
        tuned: The tuning that the design comes from. Its tolerances are shown; its scatter, conditions, limits and
            `at_least` count where they are not given here, and of two limits the tighter one.
        command: The command line to show in the document.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (parts done, parts in all).

    Returns:
        The report; `save` writes it as .html or .pdf.

    Raises:
        KeyError: A scene has no such number.
        ValueError: Bounds are not in order, a count is too small, or many scenes are given.
        NumericalError: The design stops before its end in all conditions.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> small = dict(starts=8, n_periods=2, transient=16, method=js.RungeKutta(steps=100))
        >>> js.report(scene, at_least=90.0, **small).verdict
        'fails'
    """
    design = one_scene("report", scene)
    check_row(design)
    limits = Limits(at_least, most_force, most_penetration)
    limits, bounds, conditions = report_request(design, limits, scatters or {}, conditions or {}, tuned, of)
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method)
    judged_by = of or _reduction_of(tuned, design)
    check_quantity(judged_by, design)
    for name in ("most_force", "most_penetration"):
        if not (value := getattr(limits, name)) > 0:
            raise InputError(f"Argument `{name}` must be positive, but is {value}.")
    check_at_least(limits.at_least)
    count_argument("starts", starts, 1)
    seed_argument(seed)
    if bounds:
        n_conditions = math.prod(map(np.size, conditions.values()))
        draw_rows(design, bounds, limits.at_least, draws, seed, resolved, n_conditions)
    in_conditions = varied_by(design, {}, conditions)
    check_vibration(judged_by, in_conditions)
    check_resonance(judged_by, in_conditions)
    lanes = len(SINGLE_DIRECTIONS) * max(GAPS, ZOOMS * VALUES)
    blades = design.layout.blades
    check_size(lanes, resolved.transient, resolved.n_periods, blades=blades)
    march = plan_march(resolved, varied_by(design, bounds, conditions), FOR_P_D)
    problem = _problem(design, conditions, limits)._replace(of=judged_by)
    counts = draws, starts, seed
    data = _report_data(problem, resolved, march, limits, bounds, counts, progress)._replace(tuned=tuned)
    verdict, reasons = report_verdict(data)
    provenance, _ = resolved.provenance(march.steps)
    title = str(provenance.get("title") or "A design").partition(":")[0]
    sections = sections_of(data, verdict, reasons, str(provenance["scene"]), command)
    return Report(
        title=title,
        verdict=verdict,
        reasons=reasons,
        run=data.runs.lane(data.worst),
        over_gap=data.over_gap,
        scatter=data.spread,
        gradient=data.slopes,
        attractors=data.motions[data.worst],
        coexisting=tuple(data.motions),
        sections=sections,
        diagnosis=data.findings.diagnosis,
    )


def _reduction_of(tuned: Tuned | None, design: Scene) -> RequiredReduction:
    """The reduction that is judged where no argument names it."""
    return "P_d_worst" if tuned is not None and tuned.quantity == "P_d_worst" else counted_reduction(design)


def _problem(design: Scene, conditions: Conditions, limits: Limits) -> Problem:
    """The design in its conditions, of which the worst counts, as a problem in which nothing is tuned."""
    values = {key: tuple(np.ravel(at).astype(float).tolist()) for key, at in conditions.items()}
    return Problem(with_numbers(design, list(values)), {}, values, "worst", limits.most_penetration, limits.most_force)


def _report_data(
    problem: Problem,
    resolved: ResolvedOptions,
    march: MarchPlan,
    limits: Limits,
    scatters: Bounds,
    counts: tuple[int, int, int],
    progress: Progress | None,
) -> ReportData:
    """The runs of all parts of the report.

    Raises:
        NumericalError: The design stops before its end in all conditions.
    """
    draws, starts, seed = counts
    design = problem.scene
    rows = problem.rows
    of = cast(RequiredReduction, problem.of)
    kind = DesignFindings if design.layout == PAIR else RowFindings
    ticker = Ticker(8 + bool(scatters) + len(rows), progress)

    def done(part: T) -> T:
        ticker(1)
        return part

    method = march.untried.again  # methods are not tried again in parts
    run_options: RunOptions = {"n_periods": resolved.n_periods, "transient": resolved.transient, "method": method}
    scenes = scenes_of(problem, SCENE_ITSELF)
    runs = done(sweep(scenes, dims=["condition"], **kind.run_for, **run_options))
    if np.all(runs.status != Status.OK):
        raise NumericalError(f"The design stops before its end, with {Status(int(runs.status[0])).name}.")
    choices = march.method._replace(within=design.parts.contact == "spring")
    problem = problem._replace(plan=march._replace(method=choices).plan(resolved.transient, resolved.n_periods))
    judged = judge_designs(problem, SCENE_ITSELF, lambda _: None)
    checks = done(verify_design(problem, SCENE_ITSELF[0], seed, lambda _: None))
    in_conditions = [jax.tree.map(lambda a, i=i: a[i], scenes) for i in range(len(rows))]
    at = worst_of(judged)
    worst = in_conditions[at]
    over_gap = done(sweep(worst, {"shroud.gap": gaps_about(worst)}, direction="both", **run_options))
    spread = None
    if scatters:
        draw_options = {"conditions": problem.conditions, "at_least": limits.at_least, "draws": draws, "seed": seed}
        spread = done(scatter(design, scatters, of=of, **draw_options, **run_options))
    slopes = done(gradient(worst, "all", of=of, **run_options))
    found = [done(_motions_of(scene, (starts, seed), march, run_options)) for scene in in_conditions]
    return ReportData(
        sheets=[check(scene) for scene in in_conditions],
        limits=limits,
        conditions=problem.conditions,
        rows=rows,
        judged=judged,
        checks=checks,
        runs=runs,
        over_gap=over_gap,
        power=done(power(worst, **run_options)),
        peaks=done(peak_ratio(worst, "drive.omega", *_speeds_about(worst), "x_peak", run_options)),
        spread=spread,
        slopes=slopes,
        motions=[motions for motions, _ in found],
        on_motions=[runs for _, runs in found],
        of=of,
        findings=done(kind.of_runs(scenes, at, runs, run_options)),
    )


def _motions_of(
    scene: Scene, counts: tuple[int, int], march: MarchPlan, run_options: RunOptions
) -> tuple[Attractors, SweepResult | Attractors | None]:
    """The coexisting motions of a scene, from so many random starts with that seed, and runs on them, if there are any.

    The motions of a row are found by runs themselves.
    """
    starts, seed = counts
    if scene.layout != PAIR:
        found = row_motions(scene, starts, seed, march, run_options["transient"], run_options["n_periods"])
        return found, found if found.names else None
    motions = attractors(scene, starts, seed=seed, method=run_options["method"])
    if not motions.names:
        return motions, None
    states = stored_state(motions, motions.motion)
    lanes = repeat_lane(scene, len(motions.names))
    return motions, sweep(lanes, state=states, forces=True, **{**run_options, "transient": 0})


def _speeds_about(scene: Scene) -> tuple[float, float]:
    """The ends of the range of drive frequencies in which peaks are compared [rad/s]."""
    omega = float(scene.drive.omega)
    return omega * SPEEDS[0], omega * SPEEDS[1]


def gaps_about(scene: Scene) -> np.ndarray:
    """The gaps of the sweep about that of a scene, about the mean of a row's [m]."""
    gap = level_of(scene, "shroud.gap")
    size = max(abs(gap), MIN_GAP_SIZE)
    return np.linspace(gap - GAPS_BELOW * size, gap + GAPS_ABOVE * size, GAPS)
