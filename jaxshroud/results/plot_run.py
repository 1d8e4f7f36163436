"""Pictures of runs."""

from fractions import Fraction
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxshroud.model.modes import Mode
from jaxshroud.motion.spectrum import amplitude_spectrum, label_lines, repeats_after, whole_periods
from jaxshroud.results.drawing import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PINK,
    SKY,
    STYLE,
    WIDE,
    Floats,
    legend_below,
    new_figure,
    say,
)
from jaxshroud.results.panels import Scale, figure_of, limits, panel_of, scale_of, title_of
from jaxshroud.scene.errors import InputError

MODES = {Mode.STICK: ("stick", SKY), Mode.SLIP_PLUS: ("slip +", ORANGE), Mode.SLIP_MINUS: ("slip −", PINK)}

Integers = NDArray[np.integer[Any]]
Booleans = NDArray[np.bool_]


@mpl.rc_context(STYLE)
def trajectory(ds: xr.Dataset, settled_from: float = 0.5) -> Figure:
    """Time history, phase portrait, Poincare points and spectrum of x_1 (Figs. 10, 12 and 14).

    Args:
        ds: A stored trajectory. What lies after its first value that is not finite is left out.
        settled_from: The share of the run that all panels but the time history leave out, as its transient.
    """
    figure = new_figure(title_of(ds), WIDE, 4.4)
    run = _drawn(ds, settled_from)
    if run is None:
        return say(figure, "the run has no finite step")
    panels = figure.subplots(2, 2).ravel()
    for panel, draw in zip(panels, PANELS.values(), strict=True):
        draw(panel, run)
    legend_below(figure, panels[0].get_legend_handles_labels()[0])
    return figure


def one_panel(ds: xr.Dataset, ax: Axes | None = None, panel: str | None = None, settled_from: float = 0.5) -> Figure:
    """A run; on `ax` its time history, or another panel.

    Args:
        ds: The run of a single scene.
        ax: Draw there, and only one panel.
        panel: "history" (the default), "phase", "poincare" or "spectrum".
        settled_from: As for `trajectory`.

    Raises:
        ValueError: There are many runs, or there is no such panel.
    """
    if "status" not in ds.attrs:
        raise InputError("A picture shows one run of many: choose it by `lane`.")
    if ax is None:
        return trajectory(ds, settled_from)
    draw, run = panel_of(PANELS, panel), _drawn(ds, settled_from)
    if run is not None:
        draw(ax, run)
    return figure_of(ax)


class Drawn(NamedTuple):
    """A run in the units of the picture."""

    scale: Scale
    t: Floats  # [drive periods]
    x: Floats  # (n, 2)
    v: Floats  # of the left blade [m/s]
    mode: Integers
    kept: Booleans  # after the transient
    ends: Booleans  # of these, the ends of periods
    rate: Fraction  # samples in a period


def _drawn(ds: xr.Dataset, settled_from: float) -> Drawn | None:
    """What is finite of a run, if anything is."""
    bad = ~np.isfinite(ds["x"].to_numpy() + ds["v_x"].to_numpy()).all(axis=1)
    ds = ds.isel(time=slice(0, int(bad.argmax()) if bad.any() else None))
    if ds.sizes["time"] < 2:
        return None
    scale, steps = scale_of(np.asarray(ds.attrs["gap"])), int(ds.attrs["steps_per_period"])
    t = ds["time"].to_numpy() * float(ds.attrs["omega"]) / (2 * np.pi)
    kept = t > t[0] + settled_from * (t[-1] - t[0]) + 1e-9  # not the sample that ends the transient
    ends = kept & (np.rint(t * steps) % steps == 0)
    x, v = ds["x"].to_numpy() * scale.factor, ds["v_x"].to_numpy()[:, 0]
    return Drawn(scale, t, x, v, ds["mode"].to_numpy(), kept, ends, Fraction(steps, int(ds.attrs["every"])))


def _history(panel: Axes, run: Drawn) -> None:
    _draw_history(panel, run.t, run.x, run.mode)
    panel.set(ylabel=run.scale.label("i"))


def _phase(panel: Axes, run: Drawn) -> None:
    few = run.ends.sum() < 200
    panel.plot(run.x[run.kept, 0], run.v[run.kept], color=BLUE, lw=0.5 if few else 0.25, rasterized=True)
    panel.set(title="phase portrait", xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def _poincare(panel: Axes, run: Drawn) -> None:
    """The orbit's points at the periods' ends, on axes at least a quarter as long as the orbit."""
    (x, v), few = (run.x[:, 0], run.v), run.ends.sum() < 200
    panel.plot(x[run.ends], v[run.ends], "o", color=INK, ms=2.2 if few else 0.9, mew=0, rasterized=True)
    lengths = [limits(a[run.ends], np.ptp(a[run.kept]) / 4) for a in (x, v)]
    panel.set(title=f"Poincaré points of {run.ends.sum()} periods", xlim=lengths[0], ylim=lengths[1])
    panel.set(xlabel=run.scale.label("1"), ylabel="$v_{x1}$ [m/s]")


def _spectrum(panel: Axes, run: Drawn) -> None:
    _draw_spectrum(panel, run.x[run.kept, 0], run.rate)
    panel.set(xlabel="frequency $f/f_e$", ylabel=f"amplitude of {run.scale.label('1')}", title="spectrum")


PANELS = {"history": _history, "phase": _phase, "poincare": _poincare, "spectrum": _spectrum}


def _draw_history(panel: Axes, t: Floats, x: Floats, mode: Integers) -> None:
    """The last ten periods of both blades over the contact's mode."""
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


def _draw_spectrum(panel: Axes, x: Floats, rate: Fraction) -> None:
    """Lines over a multiple of the period number; a Hann-windowed curve where the motion does not repeat."""
    n_periods, q = whole_periods(x.size, rate), repeats_after(x, rate)
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
