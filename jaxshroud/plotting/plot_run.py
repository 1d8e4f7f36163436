"""Pictures of runs: the motion, and the contact over the last periods."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from textwrap import fill

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.plotting.page import Page, Panel, axis_limits, scale_of, title_of
from jaxshroud.plotting.plot_blades import BLADE_PANELS
from jaxshroud.plotting.run_data import ContactData, RunData, contact_data, mean_gap, run_data, scene_number
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    PAGE_WIDTH,
    PER_MICRO,
    PER_MILLI,
    PINK,
    SKY,
    TIGHT_LEGEND,
    AnyFigure,
    Appearance,
    IntegerArray,
    PlotArray,
    Properties,
    legend_below,
)
from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.signals.spectrum import label_lines

MODE_STYLES: Mapping[int, tuple[str, str]] = {
    Mode.STICK: ("stick", SKY),
    Mode.SLIP_PLUS: ("slip +", ORANGE),
    Mode.SLIP_MINUS: ("slip −", PINK),
    Mode.SMOOTH: ("contact", BLUE),
}
CASE_STYLES: Mapping[int, tuple[str, str]] = {
    1: ("case 1", "#004488"),
    2: ("case 2", "#6699CC"),
    3: ("case 3", "#997700"),
    4: ("case 4", "#EECC66"),
    FLAT: ("flat", "#994455"),
}


def draw_ribbon(panel: Axes, run: RunData) -> None:
    """The contact state and case over the period, in a row for each period of the motion, the first on top.

    In the place of the case faces of several points show the state of each, the uppermost on top.
    """
    contact = contact_data(run)
    rows = max(round(contact.t[-1]), 1)
    for row in range(rows):
        _draw_period(panel, contact, row, rows - 1 - row)
    panel.set(xlim=(0, min(contact.t[-1], 1)), ylim=(0, rows), xlabel=PHASE_LABEL)
    below = "case" if contact.point_mode is None else "points"
    panel.set(title=f"state and {below}" if rows == 1 else f"state, {below} below")
    places, names = ([0.2, 0.675], [below, "state"]) if rows == 1 else (np.arange(rows) + 0.5, np.arange(rows, 0, -1))
    panel.set_yticks(places, names)
    panel.set(ylabel="" if rows == 1 else "period")
    panel.tick_params(axis="y", length=0)


def _draw_period(panel: Axes, contact: ContactData, row: int, foot: int) -> None:
    """Draw one period, with the mode above the case, or above those of the points."""
    in_period = (contact.t >= row - 1e-9) & (contact.t <= row + 1 + 1e-9)
    t = contact.t[in_period] - row
    styles: Mapping[int, tuple[str, str]]
    below = [(contact.case, CASE_STYLES, (foot + 0.05, 0.3))]
    if contact.point_mode is not None:
        height = 0.3 / contact.point_mode.shape[1]
        of_points = enumerate(contact.point_mode.T)
        below = [(mode, MODE_STYLES, (foot + 0.05 + m * height, 0.9 * height)) for m, mode in of_points]
    for values, styles, place in ((contact.mode, MODE_STYLES, (foot + 0.4, 0.55)), *below):
        for value, spans in _mode_spans(t, values[in_period]).items():
            if value in styles:
                panel.broken_barh(spans, place, color=styles[value][1], lw=0)


def _mode_spans(t: PlotArray, values: IntegerArray) -> dict[int, list[tuple[float, float]]]:
    """Value -> beginning and length of each span of time that has it."""
    first = np.flatnonzero(np.diff(values, prepend=-1))
    lengths = np.diff(t[first], append=t[-1])
    spans: dict[int, list[tuple[float, float]]] = {}
    for i, length in zip(first, lengths, strict=True):
        spans.setdefault(int(values[i]), []).append((float(t[i]), float(length)))
    return spans


def draw_loop(panel: Axes, run: RunData) -> None:
    """The friction force over the slide, of each point of contact; the enclosed area is the work of friction."""
    contact = contact_data(run)
    u = contact.u * PER_MICRO
    points = () if contact.point_mode is None else range(contact.point_mode.shape[1])
    for own in [contact.of_point(m) for m in points] or [contact]:
        _draw_pieces(panel, own, u, own.F, own.pieces)
    touching = contact.mode != Mode.APART
    panel.set(xlim=axis_limits(u[touching]) if touching.any() else None)
    panel.set(xlabel="slide $u$ [µm]", ylabel="friction force $F$ [N]", title="friction loop")


def draw_path(panel: Axes, run: RunData) -> None:
    """The point on the left block's face at which contact acts; the ends of the face are dashed.

    Faces of several points have a line at the place of each, and the resultant in between.
    """
    contact = contact_data(run)
    panel.set(
        xlabel=TIME_LABEL, ylabel="place on the face [mm]", title="where contact acts", xlim=_time_limits(contact)
    )
    if contact.contact_point is None:
        panel.text(0.5, 0.5, "the blocks do not turn", ha="center", va="center", transform=panel.transAxes)
        return
    if contact.places is None:
        _draw_pieces(panel, contact, contact.t, contact.contact_point * PER_MILLI, contact.segments)
    else:
        panel.plot(contact.t, contact.contact_point * PER_MILLI, color=INK, lw=0.6)
        for m, place in enumerate(contact.places * PER_MILLI):
            own = contact.of_point(m)
            _draw_pieces(panel, own, own.t, np.full_like(own.t, place), own.pieces)
    l_ab = scene_number(run, "shroud", "l_ab")
    if l_ab is not None:
        for side in (-1, 1):
            panel.axhline(side * l_ab / 2 * PER_MILLI, color=GREY, lw=0.6, ls="--")
        panel.set(ylim=np.array([-0.55, 0.55]) * l_ab * PER_MILLI)


def draw_forces(panel: Axes, run: RunData) -> None:
    """The normal force and the friction force over time, with the limits at which contact slips."""
    contact = contact_data(run)
    mu = scene_number(run, "friction", "mu")
    if mu:
        panel.fill_between(contact.t, -mu * contact.N, mu * contact.N, color=SKY, alpha=0.35, lw=0, label=r"$\pm\mu N$")
    panel.plot(contact.t, contact.N, color=INK, lw=0.8, label="$N$")
    if np.any(contact.F):
        panel.plot(contact.t, contact.F, color=BLUE, lw=0.8, label="$F$")
    low, high = axis_limits(np.concatenate([contact.N, contact.F, -mu * contact.N if mu else contact.F]))
    panel.set(xlabel=TIME_LABEL, ylabel="force [N]", title="contact forces", xlim=_time_limits(contact))
    panel.set(ylim=(low, high + 0.15 * (high - low)))  # room for the legend
    panel.legend(loc="upper right", ncols=3, **TIGHT_LEGEND)


TIME_LABEL, PHASE_LABEL = "time $t/T$", "time in a period $t/T$"
CONTACT_PANELS = (
    Panel("forces", draw_forces),
    Panel("ribbon", draw_ribbon),
    Panel("loop", draw_loop),
    Panel("path", draw_path),
)


def contact_handles(run: RunData, cases: bool = True) -> list[Patch]:
    """Legend entries of the contact states, and of the cases, that occur."""
    contact = contact_data(run)
    modes = contact.mode if contact.point_mode is None else np.append(contact.mode, contact.point_mode)
    cases = cases and contact.point_mode is None
    entries = legend_entries(MODE_STYLES, modes) + (legend_entries(CASE_STYLES, contact.case) if cases else [])
    return [Patch(color=color, label=name) for name, color in entries]


def legend_entries(styles: Mapping[int, tuple[str, str]], values: Iterable[int]) -> list[tuple[str, str]]:
    """The words and colours of those of the values that have a style."""
    present = set(map(int, values))
    return [entry for value, entry in styles.items() if int(value) in present]


def _time_limits(contact: ContactData) -> tuple[float, float]:
    return float(contact.t[0]), float(contact.t[-1])


def _draw_pieces(panel: Axes, contact: ContactData, x: PlotArray, y: PlotArray, pieces: list[slice]) -> None:
    """Draw a line in pieces, in the colours of the contact states; grey when apart."""
    lines: dict[int, list[PlotArray]] = {}
    for piece in pieces:
        points = np.stack([x[piece], y[piece]])
        lines.setdefault(int(contact.mode[piece.start]), []).extend([points, np.full((2, 1), np.nan)])
    for mode, points in lines.items():
        color = MODE_STYLES[Mode(mode)][1] if mode in MODE_STYLES else GREY
        style: Properties = {"color": color, "lw": 0.5 if mode == Mode.APART else 1.0, "solid_capstyle": "round"}
        panel.plot(*np.concatenate(points, axis=1), **style)


def run_page(
    ds: xr.Dataset, appearance: Appearance, *, kind: str | None = None, settled_from: float = 0.5
) -> Page[RunData]:
    """Time history, phase portrait, Poincare points and spectrum of x_1 (Figs. 10, 12 and 14), or panels of contact.

    Args:
        ds: A stored run. The samples from the first that is not finite are left out.
        appearance: The requested appearance.
        kind: One of `RUN_PAGES`: "motion", "forces" or "all" for a page of panels, or the name of a panel; of a row one
            of `ROW_PAGES`. By default "motion", where a panel that cannot be drawn shows the reason.
        settled_from: The share of the run that all panels but the time history leave out as its transient.

    Raises:
        ValueError: There are many runs, or there is no such kind.
    """
    if "status" in ds.variables:
        raise InputError("A picture shows one run of many: choose it by `lane`.")
    pages = ROW_PAGES if "interface" in ds.dims else RUN_PAGES
    if kind is not None:
        word_argument("kind", kind, pages)
    panels = pages[kind or "motion"]
    if kind is None:
        panels = [panel._replace(draw=_or_reason(panel.draw)) for panel in panels]
    rows = (sum(panel.columns for panel in panels) + 1) // 2
    run = run_data(ds, settled_from, scale_of(mean_gap(ds), appearance.unit))
    return Page(
        run,
        panels,
        title_of(ds),
        (PAGE_WIDTH, 2.2 * rows) if len(panels) > 1 else (COLUMN_WIDTH, 2.5),
        columns=min(sum(panel.columns for panel in panels), 2),
        finish=_add_run_legend,
        nothing="" if run is not None else "the run has no finite step",
        single=[panel for page in pages.values() for panel in page if len(page) == 1],
    )


def _or_reason(draw: Callable[[Axes, RunData], None]) -> Callable[[Axes, RunData], None]:
    """A function that draws a panel, or shows the reason why it cannot be drawn."""

    def draw_or_explain(panel: Axes, run: RunData) -> None:
        try:
            draw(panel, run)
        except InputError as error:
            panel.text(0.5, 0.5, fill(str(error), 32), ha="center", va="center", transform=panel.transAxes)

    return draw_or_explain


def _add_run_legend(figure: AnyFigure, axes: Mapping[str, Axes], run: RunData) -> None:
    """Add a legend of the colours."""
    legend_below(figure, _run_handles(run, axes))


def _run_handles(run: RunData, axes: Mapping[str, Axes]) -> Sequence[Artist]:
    if "history" not in axes:
        contact_panels = {panel.name for panel in CONTACT_PANELS} & set(axes)
        return contact_handles(run, "ribbon" in axes) if contact_panels else []
    lines = axes["history"].get_legend_handles_labels()[0]
    if "ribbon" not in axes:
        return lines
    return [*lines[:2], *contact_handles(run)]


def draw_history(panel: Axes, run: RunData) -> None:
    """The last ten periods of both blades, with the contact mode as colours."""
    _draw_last_periods(panel, run.t, run.x, run.mode)
    panel.set(ylabel=run.scale.label("i"))


def draw_phase(panel: Axes, run: RunData) -> None:
    """The velocity of the left blade over its displacement."""
    few = run.ends.sum() < 200
    panel.plot(run.x[run.settled, 0], run.v[run.settled], color=BLUE, lw=0.5 if few else 0.25, rasterized=True)
    panel.set(title="phase portrait", xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def draw_poincare(panel: Axes, run: RunData) -> None:
    """The points of the orbit at the ends of periods, on axes at least a quarter as long as the orbit."""
    if not run.ends.any():
        raise InputError("No end of a period is among the samples after the transient; keep a divisor of the steps.")
    x = run.x[:, 0]
    v = run.v
    few = run.ends.sum() < 200
    panel.plot(x[run.ends], v[run.ends], "o", color=INK, ms=2.2 if few else 0.9, mew=0, rasterized=True)
    lengths = [axis_limits(a[run.ends], np.ptp(a[run.settled]) / 4) for a in (x, v)]
    points = int(run.ends.sum())
    panel.set(title=f"{points} Poincaré point{'s' if points != 1 else ''}", xlim=lengths[0], ylim=lengths[1])
    panel.set(xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def draw_spectrum(panel: Axes, run: RunData) -> None:
    """The amplitude spectrum of x_1 with labels at its lines."""
    if run.rate < 2:
        raise InputError(f"{float(run.rate):.3g} samples of a period are too few for a spectrum; keep more steps.")
    _draw_lines_of_spectrum(panel, run)
    panel.set(xlabel="frequency $f/f_e$", ylabel=f"amplitude of {run.scale.label('1')}", title="spectrum")


MOTION_PANELS = (
    Panel("history", draw_history),
    Panel("phase", draw_phase),
    Panel("poincare", draw_poincare),
    Panel("spectrum", draw_spectrum),
)
RUN_PANELS = (*MOTION_PANELS, *CONTACT_PANELS)
RUN_PAGES: dict[str, Sequence[Panel]] = {
    **{panel.name: (panel,) for panel in RUN_PANELS},
    "motion": MOTION_PANELS,
    "forces": CONTACT_PANELS,
    "all": RUN_PANELS,
}
ROW_PAGES = {**{panel.name: (panel,) for panel in BLADE_PANELS}, "motion": BLADE_PANELS}


def _draw_last_periods(panel: Axes, t: PlotArray, x: PlotArray, mode: IntegerArray) -> None:
    last = t > t[-1] - 10 - 1e-9  # t is a quotient, so ten periods are subject to rounding
    t, x, mode = t[last], x[last], mode[last]
    for blade, color, width in ((0, INK, 0.9), (1, BLUE, 0.6)):
        panel.plot(t, x[:, blade], color=color, lw=width, zorder=3 - blade, label=f"$x_{blade + 1}$")
    first = np.flatnonzero(np.diff(mode, prepend=-1))
    spans = np.stack([t[first], np.diff(t[first], append=t[-1])], axis=-1)
    style: Properties = {"transform": panel.get_xaxis_transform(), "alpha": 0.35, "lw": 0}
    for value, (name, color) in MODE_STYLES.items():
        runs = spans[mode[first] == value]
        if runs.size:
            panel.broken_barh(runs.tolist(), (0, 1), color=color, label=name, **style)
    panel.set(xlabel="time $t/T$", title="time history", xlim=t[[0, -1]], ylim=axis_limits(x))


def _draw_lines_of_spectrum(panel: Axes, run: RunData) -> None:
    """Lines from a multiple of the period number, or a Hann-windowed curve where the motion does not repeat."""
    q = run.repeats
    if run.spectrum is None:
        panel.text(0.5, 0.5, "no oscillation over\na whole period", ha="center", transform=panel.transAxes)
        return
    f, a = run.spectrum
    top = a[1:].max()
    reach = float(np.clip(f[a > 1e-3 * top].max(), 3, 6)) + 0.25
    shown = (f > 0) & (f < 1.1 * reach)  # the others would take long to draw
    if q:
        panel.vlines(f[shown], 1e-9 * top, a[shown], color=BLUE, lw=0.8)
    else:
        panel.plot(f[shown], a[shown], color=BLUE, lw=0.5)
    panel.set(yscale="log", xlim=(0, reach), ylim=(1e-4 * top, 20 * top))
    _write_lines(panel, [line for line in label_lines(f, a, q) if line[0] < reach], f, a, reach / 30)


def _write_lines(panel: Axes, lines: list[tuple[float, str]], f: PlotArray, a: PlotArray, spacing: float) -> None:
    """Write labels above the lines, the strongest first, without those that would touch another one."""
    written: list[float] = []
    style: Properties = {"textcoords": "offset points", "rotation": 90, "ha": "center", "fontsize": 6}
    for line, label in sorted(lines, key=lambda line: -np.interp(line[0], f, a)):
        if all(abs(line - other) > spacing for other in written):
            written.append(line)
            panel.annotate(f"${label}$", (line, float(np.interp(line, f, a))), (0, 2), **style)
