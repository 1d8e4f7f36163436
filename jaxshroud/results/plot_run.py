"""Pictures of runs."""

from collections.abc import Callable
from textwrap import fill
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxshroud.motion.spectrum import amplitude_spectrum, label_lines, whole_periods
from jaxshroud.results import plot_contact
from jaxshroud.results.drawing import (
    BLUE,
    COLUMN,
    GREY,
    INK,
    PLAIN,
    WIDE,
    Floats,
    Look,
    legend_below,
    new_figure,
    say,
)
from jaxshroud.results.drawn import Drawn, Integers, drawn
from jaxshroud.results.look import on_axes, styled
from jaxshroud.results.panels import figure_of, limits, panel_of, scale_of, title_of
from jaxshroud.results.plot_contact import MODES
from jaxshroud.scene.checks import word_argument
from jaxshroud.scene.errors import InputError


@styled
def trajectory(ds: xr.Dataset, settled_from: float = 0.5, *, look: Look = PLAIN) -> Figure:
    """Time history, phase portrait, Poincare points and spectrum of x_1 (Figs. 10, 12 and 14).

    Args:
        ds: A stored trajectory. What lies after its first value that is not finite is left out.
        settled_from: The share of the run that all panels but the time history leave out, as its transient.
        look: What is asked for otherwise.
    """
    return _page(ds, settled_from, MOTION, _draw_or_say, look)


@styled
def picture(ds: xr.Dataset, kind: str, settled_from: float = 0.5, *, look: Look = PLAIN) -> Figure:
    """A run in one of the `KINDS` of pictures.

    Args:
        ds: A stored trajectory, as for `trajectory`.
        kind: "motion", "forces" or "all" for a page of panels, or the name of a panel.
        settled_from: As for `trajectory`.
        look: What is asked for otherwise.

    Raises:
        ValueError: There is no such picture, or too little is stored for it.
    """
    word_argument("kind", kind, KINDS)
    return _page(ds, settled_from, KINDS[kind], _draw, look)


def _draw(name: str, panel: Axes, run: Drawn) -> None:
    PANELS[name](panel, run)


def _draw_or_say(name: str, panel: Axes, run: Drawn) -> None:
    """A panel, or in its place why it cannot be drawn."""
    try:
        _draw(name, panel, run)
    except InputError as error:
        panel.text(0.5, 0.5, fill(str(error), 32), ha="center", va="center", transform=panel.transAxes)


def _page(ds: xr.Dataset, settled_from: float, names: tuple[str, ...], draw: Callable[..., None], look: Look) -> Figure:
    """Panels two by two, or a single one a column wide."""
    rows = (len(names) + 1) // 2
    figure = new_figure(title_of(ds), *((WIDE, 2.2 * rows) if len(names) > 1 else (COLUMN, 2.5)), look)
    run = drawn(ds, settled_from, scale_of(np.asarray(ds.attrs["gap"]), look.unit))
    if run is None:
        return say(figure, "the run has no finite step")
    panels = np.atleast_1d(figure.subplots(rows, min(len(names), 2))).ravel()
    for panel, name in zip(panels, names, strict=True):
        draw(name, panel, run)
    legend_below(figure, _handles(run, panels[0], names))
    return figure


def _handles(run: Drawn, first: Axes, names: tuple[str, ...]) -> list[Any]:
    """What the colours of a page mean."""
    if "history" not in names:
        shown = set(names) & set(plot_contact.PANELS)
        return plot_contact.handles(run, "ribbon" in names) if shown else []
    lines = first.get_legend_handles_labels()[0]
    if "ribbon" not in names:
        return lines
    return [*lines[:2], *plot_contact.handles(run)]


def one_panel(
    ds: xr.Dataset,
    ax: Axes | None = None,
    panel: str | None = None,
    settled_from: float = 0.5,
    kind: str | None = None,
    **looks: Any,
) -> Figure:
    """A run; on `ax` its time history, or another panel.

    Args:
        ds: The run of a single scene.
        ax: Draw there, and only one panel.
        panel: One of `PANELS`: "history" (the default), "phase", "poincare", "spectrum", "forces", "ribbon", "loop" or
            "path".
        settled_from: As for `trajectory`.
        kind: Of the whole figure, as for `picture`; by default `trajectory`.
        looks: As in `Look`: a title, an xlabel, a unit, a width and a style.

    Raises:
        ValueError: There are many runs, there is no such panel, or too little is stored for it.
    """
    if "status" not in ds.attrs:
        raise InputError("A picture shows one run of many: choose it by `lane`.")
    look = Look(**looks)
    if ax is None:
        return trajectory(ds, settled_from, look=look) if kind is None else picture(ds, kind, settled_from, look=look)
    scale = scale_of(np.asarray(ds.attrs["gap"]), look.unit)
    draw, run = panel_of(PANELS, panel), drawn(ds, settled_from, scale)
    if run is not None:
        draw(ax, run)
    on_axes(ax, look)
    return figure_of(ax)


def history(panel: Axes, run: Drawn) -> None:
    """The last ten periods of both blades over the contact's mode."""
    _draw_history(panel, run.t, run.x, run.mode)
    panel.set(ylabel=run.scale.label("i"))


def phase(panel: Axes, run: Drawn) -> None:
    """The velocity of the left blade over its displacement."""
    few = run.ends.sum() < 200
    panel.plot(run.x[run.kept, 0], run.v[run.kept], color=BLUE, lw=0.5 if few else 0.25, rasterized=True)
    panel.set(title="phase portrait", xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def poincare(panel: Axes, run: Drawn) -> None:
    """The orbit's points at the periods' ends, on axes at least a quarter as long as the orbit."""
    if not run.ends.any():
        raise InputError("No end of a period is among the samples after the transient; keep a divisor of the steps.")
    (x, v), few = (run.x[:, 0], run.v), run.ends.sum() < 200
    panel.plot(x[run.ends], v[run.ends], "o", color=INK, ms=2.2 if few else 0.9, mew=0, rasterized=True)
    lengths = [limits(a[run.ends], np.ptp(a[run.kept]) / 4) for a in (x, v)]
    panel.set(title=f"Poincaré points of {_count(run.ends.sum())}", xlim=lengths[0], ylim=lengths[1])
    panel.set(xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def _count(periods: int) -> str:
    return f"{periods} period{'s' if periods != 1 else ''}"


def spectrum(panel: Axes, run: Drawn) -> None:
    """Amplitudes of x_1, its lines named."""
    if run.rate < 2:
        raise InputError(f"{float(run.rate):.3g} samples of a period are too few for a spectrum; keep more steps.")
    _draw_spectrum(panel, run)
    panel.set(xlabel="frequency $f/f_e$", ylabel=f"amplitude of {run.scale.label('1')}", title="spectrum")


MOTION = ("history", "phase", "poincare", "spectrum")
PANELS: dict[str, Callable[[Axes, Drawn], None]] = {
    **dict(zip(MOTION, (history, phase, poincare, spectrum), strict=True)),
    **plot_contact.PANELS,
}
KINDS = {
    **{name: (name,) for name in PANELS},
    "motion": MOTION,
    "forces": tuple(plot_contact.PANELS),
    "all": tuple(PANELS),
}


def _draw_history(panel: Axes, t: Floats, x: Floats, mode: Integers) -> None:
    last = t > t[-1] - 10 - 1e-9  # t is a quotient: 10 periods to rounding
    t, x, mode = t[last], x[last], mode[last]
    for blade, color, width in ((0, INK, 0.9), (1, GREY, 0.6)):
        panel.plot(t, x[:, blade], color=color, lw=width, zorder=3 - blade, label=f"$x_{blade + 1}$")
    first = np.flatnonzero(np.diff(mode, prepend=-1))
    spans = np.stack([t[first], np.diff(t[first], append=t[-1])], axis=-1)
    style: Any = {"transform": panel.get_xaxis_transform(), "alpha": 0.35, "lw": 0}
    for value, (name, color) in MODES.items():
        runs = spans[mode[first] == value]
        if runs.size:
            panel.broken_barh(runs.tolist(), (0, 1), color=color, label=name, **style)
    panel.set(xlabel="time $t/T$", title="time history", xlim=t[[0, -1]], ylim=limits(x))


def _draw_spectrum(panel: Axes, run: Drawn) -> None:
    """Lines over a multiple of the period number; a Hann-windowed curve where the motion does not repeat."""
    x, rate, q = run.x[run.kept, 0], run.rate, run.repeats
    n_periods = whole_periods(x.size, rate)
    if n_periods < 1 or np.ptp(x) == 0:
        panel.text(0.5, 0.5, "no oscillation over\na whole period", ha="center", transform=panel.transAxes)
        return
    if q:
        x = x[x.size - int(n_periods // q * q * rate) :]
    f, a = amplitude_spectrum(x, rate, "rectangular" if q or n_periods < 3 else "hann")
    top = a[1:].max()
    if q:
        panel.vlines(f[1:], 1e-9 * top, a[1:], color=BLUE, lw=0.8)
    else:
        panel.plot(f[1:], a[1:], color=BLUE, lw=0.5)
    reach = float(np.clip(f[a > 1e-3 * top].max(), 3, 6)) + 0.25
    panel.set(yscale="log", xlim=(0, reach), ylim=(1e-4 * top, 20 * top))
    _write_lines(panel, [line for line in label_lines(f, a, q) if line[0] < reach], f, a, reach / 30)


def _write_lines(panel: Axes, lines: list[tuple[float, str]], f: Floats, a: Floats, apart: float) -> None:
    """Labels over their lines, the strongest first; one that would touch another is left out."""
    written: list[float] = []
    style: Any = {"textcoords": "offset points", "rotation": 90, "ha": "center", "fontsize": 6}
    for line, label in sorted(lines, key=lambda line: -np.interp(line[0], f, a)):
        if all(abs(line - other) > apart for other in written):
            written.append(line)
            panel.annotate(f"${label}$", (line, float(np.interp(line, f, a))), (0, 2), **style)
