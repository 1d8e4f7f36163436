"""Pictures of stored runs and sweeps, sized for a journal column; nothing here simulates."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from jaxshroud.model.modes import Mode, Status
from jaxshroud.motion.spectrum import amplitude_spectrum, label_lines, repeats_after, whole_periods
from jaxshroud.results.drawing import (
    BLUE,
    COLUMN,
    GREY,
    INK,
    ORANGE,
    PINK,
    QUANTITIES,
    SKY,
    STYLE,
    WIDE,
    Floats,
    legend_below,
    new_figure,
    say,
)

MOTIONS = {
    "period 1": BLUE,
    "period 2": ORANGE,
    "period 3": "#009E73",
    "period 4": PINK,
    "periods 5–8": SKY,
    "periods 9–16": "#D55E00",
    "aperiodic": "#4d4d4d",
}
MOTION_OF = np.array([6, 0, 1, 2, 3, *[4] * 4, *[5] * 8])  # period number -> place in MOTIONS
MODES = {Mode.STICK: ("stick", SKY), Mode.SLIP_PLUS: ("slip +", ORANGE), Mode.SLIP_MINUS: ("slip −", PINK)}
STOPPED: Any = {"facecolor": "#ededed", "edgecolor": "#9c9c9c", "hatch": "//////"}

Integers = NDArray[np.integer[Any]]
Booleans = NDArray[np.bool_]


class Axis(NamedTuple):
    """A sweep's parameter in the unit of the picture."""

    values: Floats
    edges: Floats  # borders of the cells around the values
    label: str


class Scale(NamedTuple):
    """How displacements are drawn: x / gap or, where a gap is not positive, in mm."""

    factor: Any  # times x [m]; a number, or one per lane
    symbol: str  # with a place for the blade
    unit: str

    def label(self, blade: str) -> str:
        """Axis label of a displacement."""
        return f"${self.symbol.format(blade)}${self.unit}"


@mpl.rc_context(STYLE)
def bifurcation(ds: xr.Dataset) -> Figure:
    """Stroboscopic x_1, period number and P_d over the one key of a sweep (Figs. 9, 11, 13 and 16 to 18).

    Args:
        ds: A sweep along one axis. x_1 is drawn over the gap, or in mm where a gap is not positive.
            Lanes whose status is not OK are marked and never drawn as numbers.

    Raises:
        ValueError: The sweep has not exactly one axis.
    """
    (dim,) = _dims(ds, 1)
    ds = ds.sortby(dim).transpose(dim, "period", "blade", ...)
    figure, axis, motion = new_figure(_title(ds), COLUMN, 4.4), _axis(ds[dim]), _motion(ds)
    if not (motion >= 0).any():
        return say(figure, _nothing(ds))
    samples, strip, power = figure.subplots(3, 1, sharex=True, height_ratios=[3, 0.2, 1.7])
    _draw_samples(samples, ds, axis, motion)
    _draw_motions(strip, axis.edges, np.array([0.0, 1.0]), motion[None])
    _draw_power(power, ds, axis, motion)
    strip.set(yticks=[])
    power.set(xlabel=axis.label, xlim=axis.edges[[0, -1]])
    _mark_stopped(samples, ds, axis)
    figure.align_ylabels([samples, power])
    for panel in (samples, power):
        _legend_above(panel)
    legend_below(figure, _motion_handles(motion))
    return figure


@mpl.rc_context(STYLE)
def power_map(ds: xr.Dataset) -> Figure:
    """P_d and the period number over the two keys of a sweep.

    Args:
        ds: A sweep along two axes, the first of which is drawn to the right. Lanes whose status is not OK
            are hatched. The lowest twentieth of the P_d values share a colour, so that a few outliers do not
            flatten the rest.

    Raises:
        ValueError: The sweep has not exactly two axes.
    """
    across, up = _dims(ds, 2)
    ds = ds.sortby([across, up]).transpose(up, across, ...)
    figure, motion = new_figure(_title(ds), COLUMN, 5.2), _motion(ds)
    if not (motion >= 0).any():
        return say(figure, _nothing(ds))
    x, y = _axis(ds[across]), _axis(ds[up])
    power, motions = figure.subplots(2, 1, sharex=True, sharey=True)
    P_d = np.ma.masked_invalid(np.where(motion >= 0, ds["P_d"].to_numpy(), np.nan))
    floor = np.percentile(P_d.compressed(), 5, method="higher") if P_d.count() else 0.0
    mesh = power.pcolormesh(x.edges, y.edges, P_d.clip(min=floor), rasterized=True)
    power.patch.set(**STOPPED)
    bar = figure.colorbar(mesh, ax=power, extend="min" if (P_d < floor).any() else "neither", pad=0.02)
    bar.set_label("power reduction $P_d$ [%]")
    _draw_motions(motions, x.edges, y.edges, motion)
    power.set(ylabel=y.label)
    motions.set(xlabel=x.label, ylabel=y.label)
    if (motion < 0).any():
        power.add_patch(Rectangle((0, 0), 0, 0, label="stopped: " + ",\n".join(_stopped(ds)), **STOPPED))
    _legend_above(power)
    legend_below(figure, _motion_handles(motion))
    return figure


@mpl.rc_context(STYLE)
def trajectory(ds: xr.Dataset, settled_from: float = 0.5) -> Figure:
    """Time history, phase portrait, Poincare points and spectrum of x_1 (Figs. 10, 12 and 14).

    Args:
        ds: A stored trajectory. What lies after its first value that is not finite is left out.
        settled_from: The share of the run that all panels but the time history leave out, as its transient.
    """
    figure = new_figure(_title(ds), WIDE, 4.4)
    bad = ~np.isfinite(ds["x"].to_numpy() + ds["v_x"].to_numpy()).all(axis=1)
    ds = ds.isel(time=slice(0, int(bad.argmax()) if bad.any() else None))
    if ds.sizes["time"] < 2:
        return say(figure, "the run has no finite step")
    scale, steps = _scale(np.asarray(ds.attrs["gap"])), int(ds.attrs["steps_per_period"])
    t = ds["time"].to_numpy() * float(ds.attrs["omega"]) / (2 * np.pi)
    x, v = ds["x"].to_numpy() * scale.factor, ds["v_x"].to_numpy()[:, 0]
    kept = t > t[0] + settled_from * (t[-1] - t[0]) + 1e-9  # not the sample that ends the transient
    ends = kept & (np.rint(t * steps) % steps == 0)
    (history, phase), (poincare, spectrum) = figure.subplots(2, 2)
    _draw_history(history, t, x, ds["mode"].to_numpy())
    history.set(ylabel=scale.label("i"))
    _draw_orbit(phase, poincare, x[:, 0], v, kept, ends)
    phase.set(xlabel=scale.label("1"))
    poincare.set(xlabel=scale.label("1"))
    _draw_spectrum(spectrum, x[kept, 0], Fraction(steps, int(ds.attrs["every"])))
    spectrum.set(xlabel="frequency $f/f_e$", ylabel=f"amplitude of {scale.label('1')}", title="spectrum")
    legend_below(figure, history.get_legend_handles_labels()[0])
    return figure


@mpl.rc_context(STYLE)
def power_convergence(data: Mapping[str, Any]) -> Figure:
    """P_d over the number of periods it is averaged over (Fig. 15).

    Args:
        data: `n`, `P_d` and `P_d_ci` (lists; None is a missing number), `final` and `title`.
    """
    figure = new_figure(str(data.get("title", "")), COLUMN, 2.8)
    n, P_d, ci = (np.array(data[key], dtype=float) for key in ("n", "P_d", "P_d_ci"))
    if not np.isfinite(P_d).any():
        return say(figure, "no period was finished")
    panel = figure.subplots()
    panel.fill_between(n, *_interval(P_d, ci), color=BLUE, alpha=0.25, lw=0, label="95 % interval")
    panel.plot(n, P_d, color=BLUE, lw=0.9, marker="." if n.size < 60 else "", ms=3, label="$P_d(n)$")
    final = data["final"]
    if final["P_d"] is not None:
        panel.axhline(final["P_d"], color=INK, lw=0.7, ls="--", label=_final(**final))
    panel.set(xlabel="periods averaged over, $n$", ylabel="power reduction $P_d$ [%]")
    panel.set(ylim=_limits(np.concatenate(_interval(P_d, ci)), least=0.1))  # else a periodic orbit shows rounding
    if n.max() > 10 * n.min() > 0:
        panel.set(xscale="log", xlim=(n.min(), n.max()))
    legend_below(figure, panel.get_legend_handles_labels()[0])
    return figure


def _title(ds: xr.Dataset) -> str:
    status = int(ds.attrs.get("status", Status.OK))
    return str(ds.attrs.get("title", "")) + (f" (stopped: {_status(status)})" if status else "")


def _legend_above(panel: Axes) -> None:
    handles = panel.get_legend_handles_labels()[0]
    style: Any = {"bbox_to_anchor": (0, 1), "borderpad": 0.2, "borderaxespad": 0}
    if handles:
        panel.legend(handles=handles, loc="lower left", ncols=2 if len(handles) == 2 else 1, **style)


def _dims(ds: xr.Dataset, count: int) -> list[str]:
    dims = [dim.strip() for dim in str(ds.attrs["axes"]).split(",")]
    if len(dims) != count:
        raise ValueError(f"This picture needs a sweep along {count} key(s), but got {', '.join(dims)}.")
    return dims


def _axis(coordinate: xr.DataArray) -> Axis:
    key = str(coordinate.attrs.get("key", coordinate.name))
    stem, _, blade = key.partition("[")
    unit = str(coordinate.attrs.get("units", "1")).removeprefix("1")
    symbol, words, unit, scale = QUANTITIES.get(stem, ("", key, unit, 1))
    if blade and symbol:
        words += ", left blade" if blade[0] == "0" else ", right blade"
    values = coordinate.to_numpy().astype(float) * scale
    label = words + (f" ${symbol}$" if symbol else "") + (f" [{unit}]" if unit else "")
    return Axis(values, _edges(values), label)


def _edges(values: Floats) -> Floats:
    if values.size < 2:
        return values.sum() + np.array([-0.5, 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.array([2 * values[0] - middle[0], *middle, 2 * values[-1] - middle[-1]])


def _scale(gap: Floats) -> Scale:
    return Scale(1 / gap, r"x_{}/\Delta", "") if (gap > 0).all() else Scale(1e3, "x_{}", " [mm]")


def _limits(values: Floats, least: float = 0.0) -> tuple[float, float]:
    """Ends of an axis that shows `values` with a margin and is at least `least` long."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    half = max(0.55 * (high - low), least / 2) or 1.0
    return (low + high) / 2 - half, (low + high) / 2 + half


def _interval(P_d: Floats, ci: Floats) -> tuple[Floats, Floats]:
    half = np.where(np.isfinite(ci), ci, np.nan)
    return P_d - half, P_d + half


def _final(P_d: float, ci: float | None, n: int, settled: bool, period_number: int, **_: Any) -> str:
    motion = f"period {period_number}" if period_number else "aperiodic"
    interval = f" ± {ci:.2g}" if ci else ""
    return f"{P_d:.4g}{interval} % ($n$ = {n}, {motion}{'' if settled else ', not settled'})"


def _status(code: int) -> str:
    return Status(code).name if code in set(Status) else f"status {code}"


def _stopped(ds: xr.Dataset) -> dict[str, Booleans]:
    """Name of each status but OK that occurs -> the lanes that have it."""
    status = ds["status"].to_numpy()
    return {_status(int(code)): status == code for code in np.unique(status) if code != Status.OK}


def _nothing(ds: xr.Dataset) -> str:
    counts = [f"{lanes.sum()} × {name}" for name, lanes in _stopped(ds).items()]
    return "\n".join(["no lane finished:", *counts]) if counts else "the sweep is empty"


def _motion(ds: xr.Dataset) -> Integers:
    """Place of each lane's period number in MOTIONS, or -1 where the lane was stopped."""
    number = np.nan_to_num(ds["period_number"].to_numpy()).astype(int)
    return np.where(ds["status"].to_numpy() == Status.OK, MOTION_OF[np.clip(number, 0, 16)], -1)


def _motion_handles(motion: Integers) -> list[Any]:
    return [Patch(color=c, label=name) for i, (name, c) in enumerate(MOTIONS.items()) if i in motion]


def _mark_stopped(panel: Axes, ds: xr.Dataset, axis: Axis) -> None:
    """A mark at the foot of `panel` for each lane that was stopped, one shape per status."""
    style: Any = {"transform": panel.get_xaxis_transform(), "ms": 3, "mew": 0.6, "color": INK}
    for marker, (name, lanes) in zip("xv^dsP*", _stopped(ds).items(), strict=False):
        foot = np.full(lanes.sum(), 0.02)
        panel.plot(axis.values[lanes], foot, marker, label=f"stopped: {name}", **style)


def _draw_samples(panel: Axes, ds: xr.Dataset, axis: Axis, motion: Integers) -> None:
    scale = _scale(ds["gap"].to_numpy())
    x = (ds["x"].to_numpy()[:, :, 0].T * scale.factor).T
    lane = np.broadcast_to(axis.values[:, None], x.shape)
    style: Any = {"ms": 1.5 if motion.size > 100 else 2.5, "mew": 0, "rasterized": True}
    for i, color in enumerate(MOTIONS.values()):
        here, alpha = motion == i, float(np.clip(5e4 / max(x.size, 1), 0.2, 1))
        panel.plot(lane[here].ravel(), x[here].ravel(), ".", color=color, alpha=alpha, **style)
    panel.set(ylabel=scale.label("1"))


def _draw_motions(panel: Axes, x_edges: Floats, y_edges: Floats, motion: Integers) -> None:
    """Cells coloured by period number; lanes that were stopped show the hatched ground."""
    panel.patch.set(**STOPPED)
    cells, colors = np.ma.masked_less(motion, 0), ListedColormap(list(MOTIONS.values()))
    panel.pcolormesh(x_edges, y_edges, cells, cmap=colors, vmin=-0.5, vmax=6.5, rasterized=True)


def _draw_power(panel: Axes, ds: xr.Dataset, axis: Axis, motion: Integers) -> None:
    P_d, ci = (np.where(motion >= 0, ds[key].to_numpy(), np.nan) for key in ("P_d", "P_d_ci"))
    sure = (ds["P_d_settled"] == 1) & (ds["settled"] == 1) & (ds["period_number"] > 0)
    hollow, many = ~sure.to_numpy() & (motion >= 0), motion.size > 100
    panel.fill_between(axis.values, *_interval(P_d, ci), color=BLUE, alpha=0.25, lw=0, label="95 % interval")
    panel.plot(axis.values, P_d, color=BLUE, lw=0.8, marker="" if many else ".", ms=3)
    if hollow.any():
        style: Any = {"ms": 1.8 if many else 2.5, "mfc": "white", "mec": BLUE, "mew": 0.5}
        panel.plot(axis.values[hollow], P_d[hollow], "o", label="aperiodic or unsettled", **style)
    panel.set(ylabel="$P_d$ [%]")


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
    panel.set(xlabel="time $t/T$", title="time history", xlim=t[[0, -1]], ylim=_limits(x))


def _draw_orbit(phase: Axes, poincare: Axes, x: Floats, v: Floats, kept: Booleans, ends: Booleans) -> None:
    """Phase portrait, and its points at the periods' ends on axes at least a quarter as long."""
    few = ends.sum() < 200
    phase.plot(x[kept], v[kept], color=BLUE, lw=0.5 if few else 0.25, rasterized=True)
    poincare.plot(x[ends], v[ends], "o", color=INK, ms=2.2 if few else 0.9, mew=0, rasterized=True)
    x_limits, v_limits = _limits(x[ends], np.ptp(x[kept]) / 4), _limits(v[ends], np.ptp(v[kept]) / 4)
    poincare.set(title=f"Poincaré points of {ends.sum()} periods", xlim=x_limits, ylim=v_limits)
    phase.set(title="phase portrait", ylabel="$v_{x1}$ [m/s]")
    poincare.set(ylabel="$v_{x1}$ [m/s]")


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
