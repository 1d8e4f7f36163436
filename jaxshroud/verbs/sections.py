"""A report in words, tables and pictures."""

from collections.abc import Sequence

import numpy as np

from jaxshroud.results.drawing import shade
from jaxshroud.results.pages import Section
from jaxshroud.verbs.known import Known
from jaxshroud.verbs.sheet import lines_of, rows_of
from jaxshroud.version import __version__

MILLI = 1e3


def sections_of(known: Known, verdict: str, reasons: Sequence[str], text: str, command: str) -> list[Section]:
    """The sections of a report: what a reader asks first comes first."""
    made = [
        Section("Verdict", [f"{verdict}: {'; '.join(reasons)}."], _limits(known)),
        _sheet(known),
        _conditions(known),
        _gap(known),
        _scatter(known),
        _tolerances(known),
        _sensitivity(known),
        _motions(known),
        _checks(known),
        _origin(known, text, command),
    ]
    return [section for section in made if section is not None]


def _limits(known: Known) -> list[list[str]]:
    """What is asked for against what is there."""
    limits, judged = known.limits, known.judged
    rows = [
        ("P_d, worst condition", judged.objective[0], "%", limits.at_least, "at least"),
        ("largest normal force", judged.force[0], "N", limits.most_force, "at most"),
        ("largest penetration", judged.v_max[0] * MILLI, "mm", limits.most_penetration * MILLI, "at most"),
    ]
    table = [["", "is", "is to be"]]
    for name, value, unit, limit, side in rows:
        asked = "-" if limit is None or not np.isfinite(limit) else f"{side} {limit:g} {unit}"
        table.append([name, f"{value:.5g} {unit}", asked])
    run = known.run
    table.append(["largest friction force", f"{float(run.F_max):.5g} N", "-"])
    table.append(["work of friction per period", f"{float(run.friction_work):.5g} J", "-"])
    return table


def _sheet(known: Known) -> Section:
    head, rows = rows_of(known.sheet)
    rest = [f"{name}: {words}." for name, words in lines_of(known.sheet).items()]
    return Section("Data sheet", rest, [head, *rows])


def _conditions(known: Known) -> Section | None:
    if not known.conditions:
        return None
    judged = known.judged
    table = [[*known.conditions, "P_d [%]", "+-", "period number"]]
    for i, row in enumerate(known.rows):
        number = int(judged.period_number[0, i])
        told = [f"{judged.P_d[0, i]:.5g}", f"{judged.ci[0, i]:.2g}", str(number) if number else "aperiodic"]
        table.append([*(f"{value:.6g}" for value in row), *told])
    return Section("Operating conditions", ["All combinations, in SI units."], table)


def _gap(known: Known) -> Section:
    figure = known.over_gap.plot(title="")
    words, spread = "The gap upwards, downwards and each value from rest", known.spread
    if spread is not None and "shroud.gap" in spread.keys:
        i = spread.keys.index("shroud.gap")
        shade(figure, spread.low[i] * MILLI, spread.high[i] * MILLI)
        words += "; shaded in blue: the gap's own scatter"
    return Section("Over the gap", [f"{words}."], figure=figure)


def _scatter(known: Known) -> Section | None:
    if known.spread is None:
        return None
    spread = known.spread
    table = [["number", "low [SI]", "high [SI]", "share alone", "share in all"]]
    for i, key in enumerate(spread.keys):
        shares = [
            f"{share[i]:.3f} ({low[i]:.3f} to {high[i]:.3f})"
            for share, low, high in (
                (spread.first, spread.first_low, spread.first_high),
                (spread.total, spread.total_low, spread.total_high),
            )
        ]
        table.append([key, f"{spread.low[i]:.6g}", f"{spread.high[i]:.6g}", *shares])
    words = (
        f"{len(spread.P_d)} draws, uniform between the bounds: median {spread.median:.4g} %, nine in ten between "
        f"{spread.likely_low:.4g} and {spread.likely_high:.4g} %."
    )
    if spread.at_least is not None:
        words += f" P_d is at least {spread.at_least:g} % with probability {spread.chance}."
    note = "Shares of the variance of P_d (Sobol indices), with 95 % intervals."
    return Section("Scatter", [words, note], table, spread.plot(title=""))


def _tolerances(known: Known) -> Section | None:
    tuned = known.tuned
    if tuned is None or not tuned.intervals:
        return None
    table = [["number", "is [SI]", "from", "to", "looked at every"]]
    for key, one in tuned.intervals.items():
        ends = (f"{end:.6g} ({why})" for end, why in zip((one.low, one.high), one.ended_by, strict=True))
        table.append([key, f"{one.at:.6g}", *ends, f"{one.apart:.2g}"])
    words = (
        f"From the tuning: values of each number alone with which no condition loses more than {tuned.loss:g} points."
    )
    note = "An interval ends by a loss, a limit or a run that stops, or at the bound of what was looked at."
    return Section("Tolerances", [words, note], table, tuned.plot(panel="robust", title=""))


def _sensitivity(known: Known) -> Section:
    slopes = known.slopes
    table = [
        ["number", "value [SI]", "more by", "changes P_d by [points]", "+-"],
        *(effect.cells for effect in slopes.effects),
    ]
    kind = {
        "periodic": f"Exact, on the orbit of period {slopes.orbit.q}.",
        "smoothed": f"Averaged over a neighbourhood of {slopes.sigma:g} of each value: the motion has no orbit.",
    }.get(slopes.kind, "There is none.")
    flags = f"Flags: {', '.join(slopes.flags)}." if slopes.flags else "No flags."
    return Section("Sensitivity", [kind, flags], table, slopes.plot(title=""))


def _motions(known: Known) -> Section:
    found = known.motions
    table = [["motion", "share of starts", "P_d [%]", "least [%]"]]
    for i, name in enumerate(found.names):
        share = f"{found.share[i]:.3f} ({found.share_low[i]:.3f} to {found.share_high[i]:.3f})"
        table.append([name, share, f"{found.P_d[i]:.5g}", f"{found.P_d_least[i]:.5g}"])
    words = f"From {found.label.size} random starts; {found.undecided:.0%} were left undecided, or stopped."
    return Section("Coexisting motions", [words], table, found.plot(title=""))


def _checks(known: Known) -> Section:
    table = [["run again", "P_d [%]", "largest normal force [N]"]]
    table.append(["as above", f"{known.judged.objective[0]:.6g}", f"{known.judged.force[0]:.6g}"])
    for name, judged in known.checks.items():
        table.append([name, f"{judged.objective[0]:.6g}", f"{judged.force[0]:.6g}"])
    run = known.run
    words = (
        f"The energy balance is left open by {float(run.energy_residual):.2g} of the drive's work in the worst period; "
        f"P_d has {'settled' if run.P_d_settled else 'not been seen to settle'}; period number "
        f"{int(run.period_number) or 'none'}."
    )
    return Section("Checks", [words], table)


def _origin(known: Known, text: str, command: str) -> Section:
    run = known.run
    made = f"jaxshroud {__version__}; {run.method}, {run.steps_per_period} steps a period."
    asked = f"# {command}\n" if command else ""
    return Section("To compute it again", [made, "The scene, as a file:"], verbatim=asked + text.strip())
