"""The verdict of a report, with its reasons: limits that are not kept, and doubts about the results."""

import re
from collections.abc import Iterator

import numpy as np

from jaxshroud.verbs.gradient_ascent import checks_agree
from jaxshroud.verbs.report_sections import ReportData, largest_value

MAX_RESIDUAL = 1e-4  # energy residual over the drive's work: about a hundredth of a percentage point of P_d
ALLOWED_DEFICIT = 1.0  # percentage points by which a coexisting motion may be worse
REQUIRED_PROBABILITY = 0.95  # that a stated P_d is met


def report_verdict(data: ReportData) -> tuple[str, tuple[str, ...]]:
    """The verdict, "fails", "doubtful" or "sound", and its reasons."""
    failures, doubts = tuple(_failures(data)), tuple(_report_doubts(data))
    if failures:
        return "fails", failures + doubts
    return ("doubtful", doubts) if doubts else ("sound", ("every limit is kept, and every check agrees",))


def _failures(data: ReportData) -> Iterator[str]:
    """The limits that are not kept."""
    at_least, most_force, most_penetration = data.limits
    worst = float(data.judged.objective[0])
    force, deepest = (data.force, data.penetration)
    where = f" at {data.where(data.worst)}, the worst condition" if data.conditions else ""
    if not np.isfinite(worst):
        yield "a condition stops before its end"
    elif at_least is not None and worst < at_least:
        yield f"{data.of} is {worst:.4g} %{where}, less than {at_least:g} %"
    if force > most_force:
        yield f"the normal force reaches {force:.4g} N, more than {most_force:g} N"
    if deepest > most_penetration:
        yield f"the penetration reaches {deepest * 1e3:.4g} mm, more than {most_penetration * 1e3:g} mm"
    spread = data.spread
    if spread is not None and at_least is not None and spread.probability_high < REQUIRED_PROBABILITY:
        yield f"under the scatter {at_least:g} % is met with probability {spread.chance}"


def _report_doubts(data: ReportData) -> Iterator[str]:
    """The results that do not agree, or may not last."""
    runs, spread, at_least = data.runs, data.spread, data.limits.at_least
    yield from _doubts_of_sheets(data)
    if not checks_agree(data.judged, data.checks):
        yield "runs with half the step, four times as long or from other starts do not all agree"
    if largest_value([runs.energy_residual]) > MAX_RESIDUAL:
        yield f"the energy balance is left open by {largest_value([runs.energy_residual]):.2g} of the drive's work"
    if not runs.P_d_settled.all():
        i = int(np.argmin(runs.P_d_settled))
        yield f"P_d still drifts, or is not known to have settled{_at(data, i)}"
    yield from (f"{doubt}{_at(data, data.worst)}" for doubt in data.findings.doubts)
    if spread is not None:
        if at_least is not None and spread.probability_low < REQUIRED_PROBABILITY <= spread.probability_high:
            question = f"whether {at_least:g} % is met with probability {REQUIRED_PROBABILITY:g}"
            yield f"{question} is left open by {len(spread.P_d)} draws"
        if spread.stopped:
            yield f"{spread.stopped} of {spread.runs} runs of the scatter stopped"
    for i, motions in enumerate(data.motions):
        levels = motions.P_d_least if data.of == "P_d" else getattr(motions, data.of)
        least = float(np.nanmin(levels, initial=np.inf))
        if len(motions.share) > 1 and least < float(data.levels[i]) - ALLOWED_DEFICIT:
            yield f"from other starts another motion is found{_at(data, i)}, with a {data.of} of {least:.4g} % at worst"
        if motions.undecided > 0:
            left = f"{motions.undecided:.0%} of {motions.label.size} starts were left undecided, or stopped"
            yield f"{left}{_at(data, i)}"


def _doubts_of_sheets(data: ReportData) -> Iterator[str]:
    """The doubts of the data sheets; of conditions in which a doubt differs by its numbers only, the first one."""
    kinds = set()
    for i, sheet in enumerate(data.sheets):
        for doubt in sheet.doubts:
            kind = re.sub(r"[\d.]+(e[+-]?\d+)?", "", doubt)
            if kind not in kinds:
                kinds.add(kind)
                yield f"{doubt}{_at(data, i)}"


def _at(data: ReportData, condition: int) -> str:
    """The end of a sentence that names a condition, if there are operating conditions."""
    return f" at {data.where(condition)}" if data.conditions else ""
