"""A design judged: all that is known of it, with a verdict and its reasons, as one document."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from jaxshroud.batch.runs import Plan, Progress, Ticker
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import FAST, Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.modes import Status
from jaxshroud.results.report import Report
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.errors import InputError, NumericalError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.attractors import attractors
from jaxshroud.verbs.check import check
from jaxshroud.verbs.confirm import agree, checked
from jaxshroud.verbs.design import Problem, judge_designs
from jaxshroud.verbs.door import Asked, Marched, asked, marched
from jaxshroud.verbs.gradient import gradient
from jaxshroud.verbs.known import Known, Limits
from jaxshroud.verbs.lanes import one_scene
from jaxshroud.verbs.scatter import scatter
from jaxshroud.verbs.sections import sections_of
from jaxshroud.verbs.sweep import sweep

T = TypeVar("T")
GAPS, NARROW, WIDE, LEAST = 61, 0.75, 2.0, 1e-6  # gaps that are looked at, and how far off in gaps, at least 1 um
BALANCED = 1e-4  # energy residual over the drive's work: about a hundredth of a point of P_d
ALIKE = 1.0  # percentage points by which a coexisting motion may be worse
SURE = 0.95  # probability that a stated P_d is to be met with, at least


def report(
    scene: Scene | SceneFile,
    *,
    scatters: Mapping[str, tuple[float, float]] | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
    at_least: float | None = None,
    most_force: float = np.inf,
    most_penetration: float = np.inf,
    samples: int = 128,
    starts: int = 64,
    seed: int = 0,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    command: str = "",
    tuned: Tuned | None = None,
    progress: Progress | None = None,
) -> Report:
    """All that is known of a design: data sheet, forces, scatter, sensitivities, coexisting motions and checks.

    The verdict is "fails" where a stated limit is not kept, "doubtful" where what is known does not hold together or
    may not last, and "sound" otherwise.

    Args:
        scene: The design, as a scene or a scene file, whose [run] counts where an argument is not given.
        scatters: Keys of numbers that scatter, each with its bounds in SI units; see `scatter`.
        conditions: Keys of operating conditions, each with its values; all combinations count.
        at_least: P_d [percent] that is to be met in every condition, and with 95 % probability under the scatter.
        most_force: Largest normal force of contact that may be [N].
        most_penetration: Largest penetration that may be [m].
        samples: Of the scatter.
        starts: Random starts from which coexisting motions are looked for.
        seed: Of both.
        n_periods: Drive periods that P_d is averaged over; by default 64.
        transient: Drive periods run before; by default 64.
        steps_per_period: Runge-Kutta steps in one period.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: Chooses steps and method, in float64.
        command: What was asked for, to be told in the document.
        tuned: The tuning that the design comes from, whose tolerances are told too.
        progress: Called with (parts done, parts).

    Returns:
        The report; `save` writes it as .html or .pdf.

    Raises:
        KeyError: A scene has no such number.
        ValueError: Bounds are not in order, a count is too small, or many scenes are given.
        NumericalError: The design itself stops before its end.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> small = dict(starts=8, n_periods=2, transient=16, steps_per_period=100)
        >>> js.report(scene, at_least=90, **small).verdict
        'fails'
    """
    own = one_scene("report", scene)
    for name, value in {"most_force": most_force, "most_penetration": most_penetration}.items():
        if not value > 0:
            raise InputError(f"Argument `{name}` must be positive, but is {value}.")
    given = {"steps_per_period": steps_per_period, "method": method, "accuracy": accuracy}
    door = asked(scene, n_periods=n_periods, transient=transient, **given)
    how = marched(door, door.lanes, FAST, derivatives=True)
    limits = Limits(at_least, most_force, most_penetration)
    known = _known(own, door, how, limits, scatters or {}, conditions or {}, (samples, starts, seed), progress)
    known = known._replace(tuned=tuned)
    verdict, reasons = judgement(known)
    about, _ = door.about(door.transient, how.steps)
    title = str(about.get("title") or "A design").partition(":")[0]
    sections = sections_of(known, verdict, reasons, str(about["scene"]), command)
    return Report(
        title, verdict, reasons, known.run, known.over_gap, known.spread, known.slopes, known.motions, sections
    )


def _known(
    own: Scene, door: Asked, how: Marched, limits: Limits, scatters: Any, conditions: Any, counts: Any, progress: Any
) -> Known:
    """The runs, part by part."""
    samples, starts, seed = counts
    ticker = Ticker(6 + bool(scatters), progress)

    def tell(part: T) -> T:
        ticker(1)
        return part

    march = {"steps_per_period": how.steps, "method": how.method}
    run_for = {"n_periods": door.n_periods, "transient": door.transient, **march}
    run = tell(sweep(alone(own), forces=True, **run_for).lane(0))
    if int(run.status) != Status.OK:
        raise NumericalError(f"The design stops before its end, with {Status(int(run.status)).name}.")
    choices = how.method._replace(within=own.parts.contact == "spring")
    plan = Plan(door.transient, door.n_periods, how.steps, 0.0, choices)
    ranges = {key: tuple(map(float, values)) for key, values in conditions.items()}
    problem = Problem(own, {}, ranges, "worst", limits.most_penetration, limits.most_force, plan)
    judged = judge_designs(problem, np.empty((1, 0)), lambda _: None)
    checks = tell(checked(problem, np.empty(0), seed))
    over_gap = tell(sweep(own, {"shroud.gap": gaps_about(own)}, direction="both", **run_for))
    spread = tell(scatter(own, scatters, at_least=limits.at_least, samples=samples, **run_for)) if scatters else None
    slopes = tell(gradient(own, "all", n_periods=door.n_periods, transient=door.transient, **march))
    motions = tell(attractors(own, starts, seed=seed, **march))
    sheet = tell(check(own))
    return Known(sheet, limits, ranges, problem.rows, judged, checks, run, over_gap, spread, slopes, motions)


def gaps_about(scene: Scene) -> np.ndarray:
    """Gaps about that of a scene [m]."""
    gap = float(scene.shroud.gap)
    size = max(abs(gap), LEAST)
    return np.linspace(gap - NARROW * size, gap + WIDE * size, GAPS)


def judgement(known: Known) -> tuple[str, tuple[str, ...]]:
    """The verdict and its reasons."""
    failures, doubts = tuple(_failures(known)), tuple(_doubts(known))
    if failures:
        return "fails", failures + doubts
    return ("doubtful", doubts) if doubts else ("sound", ("every limit is kept, and every check agrees",))


def _failures(known: Known) -> Iterator[str]:
    """Limits that are not kept."""
    at_least, most_force, most_penetration = known.limits
    worst, force, deepest = (float(a[0]) for a in (known.judged.objective, known.judged.force, known.judged.v_max))
    where = "in the worst condition " if known.conditions else ""
    if not np.isfinite(worst):
        yield "a condition stops before its end"
    elif at_least is not None and worst < at_least:
        yield f"P_d is {where}{worst:.4g} %, less than {at_least:g} %"
    if force > most_force:
        yield f"the normal force reaches {where}{force:.4g} N, more than {most_force:g} N"
    if deepest > most_penetration:
        yield f"the penetration reaches {where}{deepest * 1e3:.4g} mm, more than {most_penetration * 1e3:g} mm"
    spread = known.spread
    if spread is not None and at_least is not None and spread.probability_high < SURE:
        yield f"under the scatter {at_least:g} % is met with probability {spread.chance}"


def _doubts(known: Known) -> Iterator[str]:
    """What does not hold together, or may not last."""
    run, spread, motions, at_least = known.run, known.spread, known.motions, known.limits.at_least
    yield from known.sheet.doubts
    if not agree(known.judged, known.checks):
        yield "runs with half the step, four times as long or from other starts do not all agree"
    if float(run.energy_residual) > BALANCED:
        yield f"the energy balance is left open by {float(run.energy_residual):.2g} of the drive's work"
    if not bool(run.P_d_settled):
        yield "P_d still drifts, or cannot be told to have settled"
    if spread is not None and at_least is not None and spread.probability_low < SURE <= spread.probability_high:
        yield f"whether {at_least:g} % is met with probability {SURE:g} is left open by {len(spread.P_d)} draws"
    if spread is not None and spread.stopped:
        yield f"{spread.stopped} of {spread.runs} runs of the scatter stopped"
    least = np.nan if motions.worst is None else float(motions.P_d_least[motions.worst])
    if len(motions.share) > 1 and least < float(run.P_d) - ALIKE:
        yield f"from other starts another motion is found, with a P_d of {least:.4g} % at worst"
    if motions.undecided > 0:
        yield f"{motions.undecided:.0%} of {motions.label.size} starts were left undecided, or stopped"
