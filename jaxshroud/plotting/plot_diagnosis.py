"""Pictures of a diagnosis (all panels of a run with the verdict), and of the convergence of P_d."""

from collections.abc import Mapping
from dataclasses import replace
from textwrap import fill
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxshroud.plotting.page import LEAST_SPAN, Page, Panel, Summary, axis_limits, interval_ends, is_visible, title_of
from jaxshroud.plotting.plot_blades import BLADE_PANELS
from jaxshroud.plotting.plot_run import CONTACT_PANELS, MOTION_PANELS, contact_handles
from jaxshroud.plotting.run_data import RunData, contact_data, run_data
from jaxshroud.plotting.style import (
    AVERAGED_PERIODS,
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    PINK,
    SKY,
    TIGHT_LEGEND,
    AnyFigure,
    Appearance,
    PlotArray,
    Properties,
    fitting_title,
    legend_below,
    typeset,
    wrapped,
)
from jaxshroud.scene.checks import InputError
from jaxshroud.signals.effects import exponent_text, with_interval


def power_page(data: Summary, appearance: Appearance) -> Page[Summary]:
    """P_d over the number of averaged periods (Fig. 15).

    Args:
        data: `n`, `P_d` and `P_d_ci` (lists, with None for missing numbers), `final` and `title`.
        appearance: The requested appearance.
    """
    title = fitting_title(str(data.get("title", "")), [AVERAGED_PERIODS], ["P_d"])
    nothing = "" if np.isfinite(_curve(data)[1]).any() else "no period was finished"
    return Page(data, POWER_PANELS, title, (COLUMN_WIDTH, 2.8), finish=_add_power_legend, nothing=nothing)


def _add_power_legend(figure: AnyFigure, axes: Mapping[str, Axes], data: Summary) -> None:
    legend_below(figure, axes["P_d"].get_legend_handles_labels()[0])


def draw_convergence(panel: Axes, data: Summary) -> None:
    """The convergence of P_d, in one panel."""
    n, P_d, ci = _curve(data)
    ends = axis_limits(np.concatenate(interval_ends(P_d, ci)), min_length=LEAST_SPAN)
    band = "95 % interval" if is_visible(ci, np.array(ends)) else None
    panel.fill_between(n, *interval_ends(P_d, ci), color=BLUE, alpha=0.25, lw=0, label=band)
    panel.plot(n, P_d, color=BLUE, lw=0.9, marker="." if n.size < 60 else "", ms=3, label="$P_d(n)$")
    final = data["final"]
    if final["P_d"] is not None:
        panel.axhline(final["P_d"], color=INK, lw=0.7, ls="--", label=_final_text(**final))
    panel.set(xlabel="periods averaged over, $n$", ylabel="power reduction $P_d$ [%]")
    panel.set(ylim=ends)
    if n.max() > 10 * n.min() > 0:
        panel.set(xscale="log", xlim=(n.min(), n.max()))


POWER_PANELS = (Panel("P_d", draw_convergence),)


def _curve(data: Summary) -> list[PlotArray]:
    return [np.array(data[key], dtype=float) for key in ("n", "P_d", "P_d_ci")]


def _final_text(P_d: float, ci: float | None, n: int, settled: bool, period_number: int, **_: object) -> str:
    motion = f"period {period_number}" if period_number else "aperiodic"
    number = with_interval(P_d, np.nan_to_num(ci or 0.0)).replace("+-", "±")
    return f"{number} % ($n$ = {n}, {motion}{'' if settled else ', not settled'})"


DIAGNOSIS_WIDTH, ROW_HEIGHT = 180 / 25.4, 46 / 25.4  # [inch]
LEAST_PAGE = 130 / 25.4  # of three panels side by side; a narrower page has two [inch]
COLUMNS_OF = {"history": 3, "ribbon": 2, "map": 2}  # columns of the panels that span several
NARROW_COLUMNS_OF = {"history": 2, "map": 2, "summary": 2}
NAMES_AT, VALUES_AT = -0.15, 0.38  # places of the columns of the summary, relative to the width of its panel
EVIDENCE_LETTERS = 19  # in a line of the title, per inch
MOST_EXPONENTS = 6  # exponents shown at most
FEW_PERIODS = 8  # averages over fewer periods may be outside the axis of P_d
SMALL_PRINT: Any = {"font.size": 7, "axes.titlesize": 7.5, "axes.labelsize": 7, "legend.fontsize": 6.5}
SMALL_PRINT |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 6.5)


class DiagnosisResult(Protocol):
    """The attributes of a diagnosis, some of them None; see `results.diagnosis.Diagnosis`."""

    data: xr.Dataset
    verdict: str
    evidence: str
    periods: int
    period_number: int
    status: int
    K: float
    exponents: np.ndarray
    exponents_ci: np.ndarray
    slider_stuck: bool
    multipliers: np.ndarray
    n: np.ndarray
    P_d: np.ndarray
    P_d_ci: np.ndarray
    P_d_settled: bool
    P_d_worst: float | None
    participation_ratio: np.ndarray
    time_apart: float | np.ndarray | None
    time_stick: float | np.ndarray
    time_slip: float | np.ndarray
    energy_residual: float

    @property
    def has_multipliers(self) -> bool:
        """Whether a stable orbit was found."""
        ...

    @property
    def largest_force(self) -> float:
        """The largest resultant of normal and friction force [N]."""
        ...

    @property
    def powers(self) -> dict[str, float]:
        """The mean powers [W]."""
        ...


class DiagnosisData(NamedTuple):
    """A diagnosis with its prepared run."""

    diagnosis: DiagnosisResult
    run: RunData | None


def diagnosis_page(diagnosis: DiagnosisResult, appearance: Appearance) -> Page[DiagnosisData]:
    """Motion, contact, P_d, energy, stability and a summary, without the panels that the model has no data for."""
    content = DiagnosisData(diagnosis, run_data(diagnosis.data, 0.0))
    known = ROW_DIAGNOSIS_PANELS if "interface" in diagnosis.data.dims else DIAGNOSIS_PANELS
    panels = [panel for panel in known if _is_shown(panel.name, content)]
    if appearance.inches(DIAGNOSIS_WIDTH) < LEAST_PAGE:
        columns = 2
        panels = [panel._replace(columns=NARROW_COLUMNS_OF.get(panel.name, 1)) for panel in panels]
    else:
        columns = 3
    page = Page(content, panels, "", (DIAGNOSIS_WIDTH, 0.0), columns=columns, finish=_finish_diagnosis)
    size = DIAGNOSIS_WIDTH, ROW_HEIGHT * len(page.rows) + 0.75
    return replace(page, size=size, set_ticks=False, rc=SMALL_PRINT)


def _finish_diagnosis(figure: AnyFigure, axes: Mapping[str, Axes], content: DiagnosisData) -> None:
    """Add the title with the evidence, and the legend of the contact states."""
    letters = round(EVIDENCE_LETTERS * figure.bbox.width / figure.dpi)
    title = wrapped(typeset(title_of(content.diagnosis.data)), letters)
    title = f"{title}\n{fill(content.diagnosis.evidence, letters)}".strip()
    figure.suptitle(title, ha="left", x=0.01, fontsize=7.5)
    if "ribbon" in axes and content.run is not None:
        legend_below(figure, contact_handles(content.run))


def _is_shown(name: str, content: DiagnosisData) -> bool:
    """Whether there is data for a panel."""
    diagnosis, run = content
    if name == "summary":
        return True
    if name == "stability":
        return diagnosis.has_multipliers or (diagnosis.exponents is not None and np.isfinite(diagnosis.exponents[0]))
    if name == "power":
        return diagnosis.P_d is not None and bool(np.isfinite(diagnosis.P_d).any())
    if name == "energy":
        return bool(diagnosis.powers) and diagnosis.status == 0
    if run is None:
        return False
    return name not in {panel.name for panel in CONTACT_PANELS} or _touches(name, run)


def _touches(name: str, run: RunData) -> bool:
    try:
        contact = contact_data(run)
    except InputError:
        return False
    is_empty = (name == "loop" and not np.any(contact.F)) or (name == "path" and contact.contact_point is None)
    return bool(np.any(contact.N)) and not is_empty


def _of_run(panel: Panel[RunData]) -> Panel[DiagnosisData]:
    """A panel of a run as a panel of the page of its diagnosis."""

    def draw(axes: Axes, content: DiagnosisData) -> None:
        assert content.run is not None  # else the panel is not shown
        panel.draw(axes, content.run)
        if panel.name == "history":
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=5, **TIGHT_LEGEND)

    return Panel(panel.name, draw, columns=COLUMNS_OF.get(panel.name, 1))


def _draw_curve(panel: Axes, content: DiagnosisData) -> None:
    """P_d over the number of averaged periods."""
    diagnosis = content.diagnosis
    final = {"P_d": float(diagnosis.P_d[-1]), "ci": float(diagnosis.P_d_ci[-1]), "n": int(diagnosis.n[-1])}
    final = {**final, "settled": diagnosis.P_d_settled, "period_number": diagnosis.period_number}
    draw_convergence(panel, {"n": diagnosis.n, "P_d": diagnosis.P_d, "P_d_ci": diagnosis.P_d_ci, "final": final})
    # The first intervals are so wide that they would flatten the rest.
    drawn = np.isfinite(diagnosis.P_d) & (diagnosis.n >= min(FEW_PERIODS, diagnosis.n[-1]))
    panel.set(title=f"$P_d$ = {final['P_d']:.4g} %", ylabel="$P_d$ [%]")
    panel.tick_params(axis="x", which="minor", labelbottom=False)  # the numbers within a decade would touch
    ends = interval_ends(diagnosis.P_d[drawn], diagnosis.P_d_ci[drawn])
    panel.set(ylim=axis_limits(np.concatenate(ends), min_length=0.1))


def _draw_energy(panel: Axes, content: DiagnosisData) -> None:
    """The mean power of the drive, and of the losses."""
    diagnosis = content.diagnosis
    powers = diagnosis.powers
    colors = {"drive": INK, "viscous": SKY, "friction": ORANGE}
    panel.barh(list(powers), list(powers.values()), color=[colors[name] for name in powers], height=0.6)
    panel.invert_yaxis()
    panel.margins(x=0.4)  # room for the numbers
    for i, value in enumerate(powers.values()):
        panel.annotate(f"{value:.3g} W", (value, i), (2, 0), textcoords="offset points", va="center", fontsize=6.5)
    panel.set(xlabel="mean power [W]", title=f"energy; residual {abs(diagnosis.energy_residual):.0e}")


def _draw_stability(panel: Axes, content: DiagnosisData) -> None:
    """The Floquet multipliers with the unit circle, or without an orbit the largest Lyapunov exponents."""
    diagnosis = content.diagnosis
    if diagnosis.has_multipliers:
        angles = 2 * np.pi * np.linspace(0, 1, 200)
        panel.plot(np.cos(angles), np.sin(angles), color=GREY, lw=0.6)
        panel.plot(np.real(diagnosis.multipliers), np.imag(diagnosis.multipliers), "o", color=BLUE, ms=3, mew=0)
        panel.set(title="Floquet multipliers", xlabel="real part", ylabel="imaginary part", aspect="equal")
        return
    finite = np.flatnonzero(np.isfinite(diagnosis.exponents))[:MOST_EXPONENTS]
    panel.errorbar(
        finite + 1, diagnosis.exponents[finite], diagnosis.exponents_ci[finite], fmt="o", color=PINK, ms=3, capsize=2
    )
    panel.axhline(0, color=GREY, lw=0.6)
    panel.set(title="Lyapunov exponents", xlabel="direction", ylabel="per drive period", xticks=finite + 1)


def _draw_summary(panel: Axes, content: DiagnosisData) -> None:
    """The rows of numbers that summarise the page."""
    panel.set_axis_off()
    panel.set(title="summary")
    style: Properties = {"va": "top", "transform": panel.transAxes, "fontsize": 6.5, "in_layout": False}
    for i, (name, value) in enumerate(diagnosis_rows(content.diagnosis).items()):
        panel.text(NAMES_AT, 0.97 - 0.095 * i, name.replace("P_d", "$P_d$"), **style)
        panel.text(VALUES_AT, 0.97 - 0.095 * i, value.replace("percentage points", "points"), **style)


def diagnosis_rows(result: object) -> dict[str, str]:
    """A diagnosis in a few rows, for the page and for the terminal."""
    diagnosis = cast(DiagnosisResult, result)  # whose attributes are descriptors, which protocols do not know
    rows = {"verdict": diagnosis.verdict, "periods before": str(diagnosis.periods)}
    if diagnosis.exponents is not None:
        for i, (value, ci) in enumerate(zip(diagnosis.exponents[:2], diagnosis.exponents_ci[:2], strict=True)):
            rows[f"exponent {i + 1} [1/T]"] = exponent_text(value, ci, diagnosis.slider_stuck).replace("+-", "±")
    if np.isfinite(diagnosis.K):
        rows["0–1 test K"] = f"{diagnosis.K:.2f}"
    if diagnosis.has_multipliers:
        rows["largest multiplier"] = f"{np.max(np.abs(diagnosis.multipliers)):.4g}"
    if diagnosis.P_d is not None and np.isfinite(diagnosis.P_d).any():
        rows["P_d"] = _interval_text(diagnosis.P_d[-1], diagnosis.P_d_ci[-1], "%")
    if diagnosis.P_d_worst is not None:
        rows["worst P_d"] = f"{diagnosis.P_d_worst:.4g} %"
        rows["participation"] = f"{float(diagnosis.participation_ratio):.4g}"
    if diagnosis.time_apart is not None:
        times = diagnosis.time_apart, diagnosis.time_stick, diagnosis.time_slip
        shares = [f"{100 * float(np.mean(time)):.3g}" for time in times]  # of a row over all interfaces
        rows["apart, stick, slip"] = f"{', '.join(shares)} %"
    if np.isfinite(diagnosis.largest_force):
        rows["largest force"] = f"{diagnosis.largest_force:.4g} N"
        rows["friction power"] = f"{diagnosis.powers.get('friction', 0.0):.3g} W"
    return rows


def _interval_text(value: float, ci: float, unit: str = "") -> str:
    return with_interval(value, ci, unit).replace("+-", "±")


DIAGNOSIS_PANELS = (
    *(_of_run(panel) for panel in (*MOTION_PANELS, *sorted(CONTACT_PANELS, key=lambda panel: panel.name != "ribbon"))),
    Panel("power", _draw_curve),
    Panel("energy", _draw_energy),
    Panel("stability", _draw_stability),
    Panel("summary", _draw_summary),
)
ROW_DIAGNOSIS_PANELS = (*map(_of_run, BLADE_PANELS), *DIAGNOSIS_PANELS[-4:])
