"""The page of a diagnosis: all panels of a run, its energy, its stability and the verdict."""

from collections.abc import Callable
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxshroud.results import plot_contact, plot_power, plot_run
from jaxshroud.results.drawing import BLUE, GREY, INK, ORANGE, PINK, SKY, STYLE, legend_below, new_figure
from jaxshroud.results.drawn import Drawn, drawn, touching
from jaxshroud.results.panels import interval, limits, title_of
from jaxshroud.scene.errors import InputError

Diagnosis = Any  # that of `results.diagnosis`, which imports this module
PAGE, ROW, COLUMNS = 180 / 25.4, 46 / 25.4, 3  # width of the page and height of a row of panels [inch]
SPANS = {"history": 3, "ribbon": 2}  # columns of panels that are wider than one
FORGOTTEN = 6  # exponents shown at most
FEW = 8  # periods, with fewer of which P_d may be cut off
SMALL: Any = {"font.size": 7, "axes.titlesize": 7.5, "axes.labelsize": 7, "legend.fontsize": 6.5}
SMALL |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 6.5)


@mpl.rc_context({**STYLE, **SMALL})
def page(found: Diagnosis) -> Figure:
    """One page: motion, contact, P_d, energy, stability and a summary; panels of what the model lacks are left out."""
    run = drawn(found.data, 0.0)
    names = [name for name in PANELS if _shown(name, found, run)]
    rows: Any = _rows(names)
    figure = new_figure("", PAGE, ROW * len(rows) + 0.75)
    figure.suptitle(f"{title_of(found.data)}\n{fill(found.evidence, 135)}".strip(), ha="left", x=0.01, fontsize=7.5)
    panels = figure.subplot_mosaic(rows, empty_sentinel="")
    for name in names:
        PANELS[name](panels[name], found, run)
    if "ribbon" in names and run is not None:
        legend_below(figure, plot_contact.handles(run))
    return figure


def _rows(names: list[str]) -> list[list[str]]:
    """Panels in rows of three columns."""
    rows: list[list[str]] = [[]]
    for name in names:
        span = SPANS.get(name, 1)
        if len(rows[-1]) + span > COLUMNS:
            rows.append([])
        rows[-1] += [name] * span
    return [row + [""] * (COLUMNS - len(row)) for row in rows]


def _shown(name: str, found: Diagnosis, run: Drawn | None) -> bool:
    """Whether there is something to show in a panel."""
    if name == "summary":
        return True
    if name == "stability":
        return found.has_multipliers or (found.exponents is not None and np.isfinite(found.exponents[0]))
    if name == "power":
        return found.P_d is not None and bool(np.isfinite(found.P_d).any())
    if name == "energy":
        return bool(found.powers) and found.status == 0
    if run is None:
        return False
    return name not in plot_contact.PANELS or _touches(name, run)


def _touches(name: str, run: Drawn) -> bool:
    try:
        at = touching(run)
    except InputError:
        return False
    lacks = (name == "loop" and not np.any(at.F)) or (name == "path" and at.contact_point is None)
    return bool(np.any(at.N)) and not lacks


def _of_run(name: str) -> Callable[..., None]:
    def draw(panel: Axes, _: Diagnosis, run: Drawn) -> None:
        plot_run.PANELS[name](panel, run)
        if name == "history":
            panel.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, ncols=5)

    return draw


def power(panel: Axes, found: Diagnosis, _: Drawn) -> None:
    """P_d over the number of periods averaged over."""
    final = {"P_d": float(found.P_d[-1]), "ci": float(found.P_d_ci[-1]), "n": int(found.n[-1])}
    told = {**final, "settled": found.P_d_settled, "period_number": found.period_number}
    plot_power.draw(panel, {"n": found.n, "P_d": found.P_d, "P_d_ci": found.P_d_ci, "final": told})
    known = (found.n >= min(FEW, found.n[-1])) & np.isfinite(found.P_d)  # the first intervals would flatten the rest
    panel.set(title=f"$P_d$ = {final['P_d']:.4g} %", ylabel="$P_d$ [%]")
    panel.tick_params(axis="x", which="minor", labelbottom=False)  # a decade's own numbers would touch
    panel.set(ylim=limits(np.concatenate(interval(found.P_d[known], found.P_d_ci[known])), least=0.1))


def energy(panel: Axes, found: Diagnosis, _: Drawn) -> None:
    """Where the work of the drive goes."""
    powers, colors = found.powers, {"drive": INK, "viscous": SKY, "friction": ORANGE}
    panel.barh(list(powers), list(powers.values()), color=[colors[name] for name in powers], height=0.6)
    panel.invert_yaxis()
    panel.margins(x=0.3)
    for i, value in enumerate(powers.values()):
        panel.annotate(f"{value:.3g} W", (value, i), (2, 0), textcoords="offset points", va="center", fontsize=6.5)
    panel.set(xlabel="mean power [W]", title=f"energy; residual {abs(found.energy_residual):.0e} of the drive's")


def stability(panel: Axes, found: Diagnosis, _: Drawn) -> None:
    """Floquet multipliers and the unit circle; without an orbit the largest Lyapunov exponents."""
    if found.has_multipliers:
        turn = 2 * np.pi * np.linspace(0, 1, 200)
        panel.plot(np.cos(turn), np.sin(turn), color=GREY, lw=0.6)
        panel.plot(np.real(found.multipliers), np.imag(found.multipliers), "o", color=BLUE, ms=3, mew=0)
        panel.set(title="Floquet multipliers", xlabel="real part", ylabel="imaginary part", aspect="equal")
        return
    fine = np.flatnonzero(np.isfinite(found.exponents))[:FORGOTTEN]
    panel.errorbar(fine + 1, found.exponents[fine], found.exponents_ci[fine], fmt="o", color=PINK, ms=3, capsize=2)
    panel.axhline(0, color=GREY, lw=0.6)
    panel.set(title="Lyapunov exponents", xlabel="direction", ylabel="per drive period", xticks=fine + 1)


def summary(panel: Axes, found: Diagnosis, _: Drawn) -> None:
    """What the page says in numbers."""
    panel.set_axis_off()
    panel.set(title="summary")
    style: Any = {"va": "top", "transform": panel.transAxes, "fontsize": 6.5, "in_layout": False}
    for i, (name, value) in enumerate(told(found).items()):
        panel.text(0, 0.97 - 0.095 * i, name.replace("P_d", "$P_d$"), **style)
        panel.text(0.52, 0.97 - 0.095 * i, value, **style)


def told(found: Diagnosis) -> dict[str, str]:
    """A diagnosis in a few lines, for the page and for the terminal."""
    out = {"verdict": found.verdict, "periods before": str(found.periods)}
    if found.exponents is not None:
        for i in np.flatnonzero(np.isfinite(found.exponents[:2] + found.exponents_ci[:2])):
            out[f"exponent {i + 1} [1/T]"] = _number(found.exponents[i], found.exponents_ci[i])
    if np.isfinite(found.K):
        out["0–1 test K"] = f"{found.K:.2f}"
    if found.has_multipliers:
        out["largest multiplier"] = f"{np.max(np.abs(found.multipliers)):.4g}"
    if found.P_d is not None and np.isfinite(found.P_d).any():
        out["P_d"] = f"{_number(found.P_d[-1], found.P_d_ci[-1])} %"
    if found.time_apart is not None:
        shares = [f"{100 * share:.3g}" for share in (found.time_apart, found.time_stick, found.time_slip)]
        out["apart, stick, slip"] = f"{', '.join(shares)} %"
    if np.isfinite(found.largest_force):
        out["largest force"] = f"{found.largest_force:.4g} N"
        out["friction power"] = f"{found.powers.get('friction', 0.0):.3g} W"
    return out


def _number(value: float, ci: float) -> str:
    """A number with its half width, where that is more than rounding."""
    return f"{value:.4g} ± {ci:.2g}" if ci > 1e-6 * abs(value) else f"{value:.4g}"


PANELS: dict[str, Callable[..., None]] = {
    **{
        name: _of_run(name) for name in ("history", "phase", "poincare", "spectrum", "ribbon", "forces", "loop", "path")
    },
    **{"power": power, "energy": energy, "stability": stability, "summary": summary},
}
