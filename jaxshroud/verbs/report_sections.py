"""The data of a report, and its sections in words, tables and pictures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.plotting.documents import Section
from jaxshroud.plotting.style import shade
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.data_sheet import DataSheet
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.power import PowerResult
from jaxshroud.results.scatter import SHARES, Scatter
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.tuned import DesignJudgement, Tuned
from jaxshroud.scene.quantities import RequiredReduction
from jaxshroud.signals.effects import between, mean_shift_text, with_interval
from jaxshroud.verbs.report_findings import MM_PER_M, DesignFindings
from jaxshroud.verbs.response import PeakRatio
from jaxshroud.verbs.sheet_tables import lines_of, rows_of
from jaxshroud.version import __version__


class Limits(NamedTuple):
    """The limits that a design is to keep."""

    at_least: float | None = None  # P_d, or of a row that of the worst blade [percent]
    most_force: float = np.inf  # [N]
    most_penetration: float = np.inf  # [m]


class ReportData(NamedTuple):
    """The results on which a report rests; those of one condition are of the worst, unless noted otherwise."""

    sheets: Sequence[DataSheet]  # one for each condition
    limits: Limits
    conditions: Mapping[str, Sequence[float]]
    rows: np.ndarray  # (conditions, keys) values
    judged: DesignJudgement  # of the design in all conditions
    checks: dict[str, DesignJudgement]
    runs: SweepResult  # (conditions,)
    over_gap: SweepResult
    spread: Scatter | None  # of the worst condition of each draw
    slopes: Gradient
    motions: Sequence[Attractors]  # one for each condition
    on_motions: Sequence[SweepResult | Attractors | None]  # runs on these, one for each condition; None without any
    findings: DesignFindings
    tuned: Tuned | None = None  # where the design comes from
    power: PowerResult | None = None  # of the worst condition
    peaks: PeakRatio | None = None  # of the worst condition, over the drive frequency
    of: RequiredReduction = "P_d"  # the reduction that is judged

    @property
    def worst(self) -> int:
        """The condition with the least P_d of those that run to their end."""
        return worst_of(self.judged)

    def where(self, condition: int) -> str:
        """A condition in words; "" without operating conditions."""
        values = zip(self.conditions, self.rows[condition].tolist(), strict=True)
        return ", ".join(f"{key} = {value:.6g}" for key, value in values)

    @property
    def force(self) -> float:
        """The largest normal force of any run shown [N]."""
        return largest_value(self._of_runs("force", "N_max"))

    @property
    def friction(self) -> float:
        """The largest friction force of the design's runs [N]."""
        return largest_value([getattr(run, "F_max", None) for run in (self.runs, *self.on_motions)])

    @property
    def levels(self) -> np.ndarray:
        """The reduction that is judged, of the run in each condition [percent]."""
        return getattr(self.runs, self.of)

    @property
    def penetration(self) -> float:
        """The largest penetration of any run shown [m]."""
        return largest_value(self._of_runs("v_max", "v_max"))

    def _of_runs(self, in_judgement: str, in_result: str) -> list[ArrayLike | None]:
        """A number of all runs shown, by its name in judgements and its name in results."""
        results = (result for result in (self.runs, self.spread, *self.on_motions) if result is not None)
        judgements = (self.judged, *self.checks.values())
        return [getattr(judged, in_judgement) for judged in judgements] + [getattr(run, in_result) for run in results]


def worst_of(judged: DesignJudgement) -> int:
    """The condition with the least P_d of those that run to their end."""
    P_d = judged.P_d[0]
    return int(np.argmin(np.where(np.isfinite(P_d), P_d, np.inf)))


def largest_value(values: Iterable[ArrayLike | None]) -> float:
    """The largest of many numbers and arrays, without NaN and None; 0 if there is none."""
    arrays = [np.ravel(np.asarray(one, float)) for one in values if one is not None]
    return float(np.nanmax(np.concatenate(arrays), initial=0.0)) if arrays else 0.0


def sections_of(data: ReportData, verdict: str, reasons: Sequence[str], text: str, command: str) -> list[Section]:
    """The sections of a report, the most important first."""
    sections = [
        Section("Verdict", [f"{verdict}: {'; '.join(reasons)}."], _limits(data)),
        _sheet(data),
        _conditions(data),
        *data.findings.sections(data.sheets[data.worst], _one_condition(data)),
        _mechanism_section(data),
        _gap(data),
        _scatter(data),
        _tolerances_section(data),
        _sensitivity(data),
        _motions_section(data),
        _checks(data),
        _origin(data, text, command),
    ]
    return [section for section in sections if section is not None]


def _limits(data: ReportData) -> list[list[str]]:
    """The table of values against limits."""
    limits, judged = data.limits, data.judged
    worst = f", worst condition: {data.where(data.worst)}" if data.conditions else ""
    rows = [
        (f"{data.of}{worst}", judged.objective[0], "%", limits.at_least, "at least"),
        ("largest normal force of all runs", data.force, "N", limits.most_force, "at most"),
        (
            "largest penetration of all runs",
            data.penetration * MM_PER_M,
            "mm",
            limits.most_penetration * MM_PER_M,
            "at most",
        ),
    ]
    table = [["", "is", "is to be"]]
    for name, value, unit, limit, side in rows:
        required = "-" if limit is None or not np.isfinite(limit) else f"{side} {limit:g} {unit}"
        table.append([name, f"{value:.5g} {unit}", required])
    if data.conditions:
        its_mean = data.tuned is not None and (data.tuned.quantity, data.tuned.goal) == (data.of, "mean")
        tuned = ", which was tuned" if its_mean else ""
        table.append([f"{data.of}, mean of the conditions{tuned}", f"{judged.P_d[0].mean():.5g} %", "-"])
    found = data.findings
    at_worst = _at_worst(data)
    cells = zip(found.heads(data.of), found.cells(data.of, data.worst), strict=True)
    table += [[f"{head}{at_worst}", cell, "-"] for head, cell in cells]
    table.append(["largest friction force", f"{data.friction:.5g} N", "-"])
    table.append([f"work of friction per period{at_worst}", f"{found.friction_work:.5g} J", "-"])
    return table


def _at_worst(data: ReportData) -> str:
    """The end of a phrase that names the worst condition, if there are operating conditions."""
    return f" at {data.where(data.worst)}" if data.conditions else ""


def _one_condition(data: ReportData) -> list[str]:
    """The paragraph that says which condition a section is about, if there are operating conditions."""
    return [f"Of the worst condition, {data.where(data.worst)}."] if data.conditions else []


def _sheet(data: ReportData) -> Section:
    sheet = data.sheets[data.worst]
    head, rows = rows_of(sheet)
    paragraphs = [f"{name}: {words}." for name, words in lines_of(sheet).items()]
    return Section("Data sheet", [*_one_condition(data), *paragraphs], [head, *rows])


def _conditions(data: ReportData) -> Section | None:
    if not data.conditions:
        return None
    judged, found = data.judged, data.findings
    forces = found.forces
    titles = f"{data.of} [%] +- points", "period number", "largest normal force [N]"
    table = [[*data.conditions, *titles, *found.heads(data.of)]]
    for i, row in enumerate(data.rows):
        number = int(judged.period_number[0, i])
        cells = [with_interval(judged.P_d[0, i], judged.ci[0, i]), str(number) if number else "aperiodic"]
        force = "-" if forces is None else f"{float(forces[i]):.5g}"
        table.append([*(f"{value:.6g}" for value in row), *cells, force, *found.cells(data.of, i)])
    words = f"All combinations, in SI units. The worst is {data.where(data.worst)}; forces are of the kept periods."
    return Section("Operating conditions", [words], table)


def _mechanism_section(data: ReportData) -> Section | None:
    if data.power is None:
        return None
    P_d = f"P_d is {with_interval(data.power.final['P_d'], data.power.final['ci'], '%')}."
    peaks = [] if data.peaks is None else [data.peaks.words]
    peaks += data.findings.amplitudes_of
    final = data.power.final
    if difference := mean_shift_text(final["P_d"], final["P_d_vibration"], data.of, "--of "):
        P_d = f"{P_d} {difference[0].upper()}{difference[1:]}."
    return Section("Damping or detuning", [*_one_condition(data), P_d, data.power.mechanism, *peaks])


def _gap(data: ReportData) -> Section:
    figure = data.over_gap.plot(title="")
    words = "The gap upwards, downwards and each value from rest"
    spread = data.spread
    if len(set(data.sheets[data.worst].gaps)) > 1:
        words += "; here all interfaces have the same gap, while those of the design differ"
    if spread is not None and "shroud.gap" in spread.keys:
        i = spread.keys.index("shroud.gap")
        shade(figure, spread.low[i] * MM_PER_M, spread.high[i] * MM_PER_M)
        words += "; shaded in blue: the gap's own scatter"
    return Section("Over the gap", [*_one_condition(data), f"{words}."], figure=figure)


def _scatter(data: ReportData) -> Section | None:
    if data.spread is None:
        return None
    spread = data.spread
    table = [["number", "low [SI]", "high [SI]", "share alone", "share in all"]]
    for i, key in enumerate(spread.keys):
        shares = [spread.share_text(name, i) for name in SHARES]
        table.append([key, f"{spread.low[i]:.6g}", f"{spread.high[i]:.6g}", *shares])
    words = (
        f"{len(spread.P_d)} draws, uniform between the bounds: median {spread.median:.4g} %, nine in ten between "
        f"{spread.likely_low:.4g} and {spread.likely_high:.4g} %."
    )
    if data.conditions:
        words = f"{data.of} of a draw is its least over all conditions ({_ranges_text(data)}). {words}"
    if spread.at_least is not None:
        words += f" {data.of} is at least {spread.at_least:g} % with probability {spread.chance}."
    note = f"Shares of the variance of {data.of} (Sobol indices), with 95 % intervals; estimated ends may leave 0 to 1."
    forces = f"The largest normal force of all {spread.runs} runs is {spread.N_max:.5g} N."
    return Section("Scatter", [words, forces, note], table, spread.plot(title=""))


def _ranges_text(data: ReportData) -> str:
    """All conditions in words."""
    return "; ".join(f"{key} = {', '.join(f'{v:.6g}' for v in values)}" for key, values in data.conditions.items())


def _tolerances_section(data: ReportData) -> Section | None:
    tuned = data.tuned
    if tuned is None or not tuned.intervals:
        return None
    table = [["number", "is [SI]", "from", "to", "searched every"]]
    for key, interval in tuned.intervals.items():
        ends = (f"{end:.6g} ({why})" for end, why in zip((interval.low, interval.high), interval.ended_by, strict=True))
        table.append([key, f"{interval.at:.6g}", *ends, f"{interval.apart:.2g}"])
    of = "" if tuned.quantity == "P_d" else f" of the reduction of {tuned.quantity}"
    lost = f"{tuned.loss:g} points{of}"
    words = f"From the tuning: values of each number alone with which no condition loses more than {lost}."
    note = "An interval ends by a loss, a limit or a run that stops, or at the bound of the search."
    conditions = ", ".join(f"{key} = {values}" for key, values in tuned.conditions.items())
    paragraphs = [f"The tuning's conditions: {conditions}."] if conditions else []
    return Section("Tolerances", [words, *paragraphs, note], table, tuned.plot(panel="robust", title=""))


def _sensitivity(data: ReportData) -> Section:
    slopes = data.slopes
    table = [
        ["number", "value [SI]", "more by", f"changes {data.of} by [points]"],
        *(effect.cells for effect in slopes.effects),
    ]
    kind = {
        "periodic": f"Exact, on the orbit of period {slopes.orbit.q}.",
        "smoothed": f"Averaged over a neighbourhood of {slopes.sigma:g} of each value: the motion has no orbit.",
    }.get(slopes.kind, "There is none.")
    flags = f"Flags: {', '.join(slopes.flags)}." if slopes.flags else "No flags."
    level = data.findings.level_words(f"{data.of} there is {with_interval(slopes.level, slopes.level_ci, '%')}.")
    return Section("Sensitivity", [*_one_condition(data), kind, *level, flags], table, slopes.plot(title=""))


def _motions_section(data: ReportData) -> Section:
    titles = "motion", "share of starts", "P_d [%] +- points", "least [%]", "largest normal force [N]"
    table = [[*data.conditions, *titles, *data.findings.motion_heads]]
    for i, (motions, runs) in enumerate(zip(data.motions, data.on_motions, strict=True)):
        forces = None if runs is None else runs.N_max
        for j, name in enumerate(motions.names):
            share = between(motions.share[j], motions.share_low[j], motions.share_high[j])
            P_d = with_interval(motions.P_d[j], motions.P_d_ci[j])
            force = "-" if forces is None else f"{float(forces[j]):.5g}"
            cells = [name, share, P_d, f"{motions.P_d_least[j]:.5g}", force]
            cells += data.findings.motion_cells(motions, j)
            table.append([*(f"{value:.6g}" for value in data.rows[i]), *cells])
    undecided = np.mean([motions.undecided for motions in data.motions])
    each = " in each condition" if data.conditions else ""
    words = [
        f"From {data.motions[0].label.size} random starts{each}; {undecided:.0%} were left undecided, or stopped.",
        *([f"The picture is of the worst condition, {data.where(data.worst)}."] if data.conditions else []),
        *data.findings.motions_by,
    ]
    return Section("Coexisting motions", words, table, data.motions[data.worst].plot(title=""))


def _checks(data: ReportData) -> Section:
    over = ", least of all conditions" if data.conditions else ""
    table = [["run again", f"{data.of} [%]{over}", "largest normal force [N]"]]
    table.append(["as above", f"{data.judged.objective[0]:.6g}", f"{data.judged.force[0]:.6g}"])
    for name, judged in data.checks.items():
        table.append([name, f"{judged.objective[0]:.6g}", f"{judged.force[0]:.6g}"])
    run = data.runs.lane(data.worst)
    settled = "settled" if run.P_d_settled else "not been seen to settle"
    residual = f"{largest_value([data.runs.energy_residual]):.2g} of the drive's work"
    words = (
        f"The energy balance is left open by {residual} in the worst period; P_d has {settled}{_at_worst(data)}, with "
        f"period number {int(run.period_number) or 'none'}."
    )
    return Section("Checks", [words, "Forces are of whole runs, transients included."], table)


def _origin(data: ReportData, text: str, command: str) -> Section:
    run = data.runs
    asked = f" {run.accuracy}." if run.accuracy else ""
    program = f"jaxshroud {__version__}; {run.method}, {run.steps_per_period} steps a period.{asked}"
    command_line = f"# {command}\n" if command else ""
    return Section("To compute it again", [program, "The scene, as a file:"], verbatim=command_line + text.strip())
