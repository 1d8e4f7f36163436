"""Pictures of stored results, sized for a journal column; nothing here simulates.

Figures are built on `matplotlib.figure.Figure` alone: no window, no global state, nothing left open.
"""

import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from jaxshroud.analysis.spectrum import amplitude_spectrum, label_lines, repeats_after, whole_periods
from jaxshroud.state import Mode, Status

COLUMN, WIDE = 88 / 25.4, 140 / 25.4  # one and one and a half columns [inch]
STYLE: Any = {
    **dict.fromkeys(("font.size", "axes.titlesize", "figure.titlesize"), 8),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7),
    **dict.fromkeys(("xtick.direction", "ytick.direction"), "in"),
    **{"axes.titlelocation": "left", "axes.linewidth": 0.6, "hatch.linewidth": 0.4},
    **{"legend.frameon": False, "legend.handlelength": 1.2, "legend.columnspacing": 1.2},
    **{"pdf.fonttype": 42, "svg.fonttype": "none"},  # text stays text
}
DEGREE = 180 / np.pi
# Key of the scene -> symbol, words, unit, units per SI unit. A key that is not here is written as it stands.
QUANTITIES = {
    "blades.m": ("m", "mass", "g", 1e3),
    "blades.m_y": ("m_y", "mass in y", "g", 1e3),
    "blades.I": ("I", "moment of inertia", "g m²", 1e3),
    "blades.k_x": ("k_x", "bending stiffness", "kN/m", 1e-3),
    "blades.k_y": ("k_y", "bending stiffness", "kN/m", 1e-3),
    "blades.k_T": ("k_T", "torsion stiffness", "N m/rad", 1),
    "blades.c_x": ("c_x", "damping", "N s/m", 1),
    "blades.c_y": ("c_y", "damping", "N s/m", 1),
    "blades.c_T": ("c_T", "torsion damping", "N m s/rad", 1),
    "shroud.alpha": (r"\alpha", "shroud angle", "°", DEGREE),
    "shroud.l_oa": ("l_{oa}", "side of the block", "mm", 1e3),
    "shroud.l_ab": ("l_{ab}", "contact side", "mm", 1e3),
    "shroud.gap": (r"\Delta", "initial gap", "mm", 1e3),
    "contact.k": ("k", "contact stiffness", "kN/m", 1e-3),
    "contact.gamma": (r"\gamma = k/k_x", "stiffness ratio", "", 1),
    "friction.k_d": ("k_d", "friction stiffness", "kN/m", 1e-3),
    "friction.mu": (r"\mu", "friction coefficient", "", 1),
    "drive.omega": (r"\omega", "drive frequency", "rad/s", 1),
    "drive.beta": (r"\beta", "force direction", "°", DEGREE),
    "drive.F_0": ("F_0", "force amplitude", "N", 1),
    "drive.M_0": ("M_0", "moment amplitude", "N m", 1),
    "drive.phase": (r"\phi", "drive phase", "°", DEGREE),
    "initial.x": ("x(0)", "initial displacement", "mm", 1e3),
    "initial.y": ("y(0)", "initial displacement", "mm", 1e3),
    "initial.theta": (r"\theta(0)", "initial angle", "°", DEGREE),
}
# Colours after Okabe and Ito, which colour-blind readers tell apart.
INK, GREY, BLUE, ORANGE, SKY, PINK = "#1a1a1a", "#8c8c8c", "#0072B2", "#E69F00", "#56B4E9", "#CC79A7"
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

Floats = NDArray[np.float64]
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
    figure, axis, motion = _figure(_title(ds), COLUMN, 4.4), _axis(ds[dim]), _motion(ds)
    if not (motion >= 0).any():
        return _say(figure, _nothing(ds))
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
    _legend(figure, _motion_handles(motion))
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
    figure, motion = _figure(_title(ds), COLUMN, 5.2), _motion(ds)
    if not (motion >= 0).any():
        return _say(figure, _nothing(ds))
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
    _legend(figure, _motion_handles(motion))
    return figure


@mpl.rc_context(STYLE)
def trajectory(ds: xr.Dataset, settled_from: float = 0.5) -> Figure:
    """Time history, phase portrait, Poincare points and spectrum of x_1 (Figs. 10, 12 and 14).

    Args:
        ds: A stored trajectory. What lies after its first value that is not finite is left out.
        settled_from: The share of the run that all panels but the time history leave out, as its transient.
    """
    figure = _figure(_title(ds), WIDE, 4.4)
    bad = ~np.isfinite(ds["x"].to_numpy() + ds["v_x"].to_numpy()).all(axis=1)
    ds = ds.isel(time=slice(0, int(bad.argmax()) if bad.any() else None))
    if ds.sizes["time"] < 2:
        return _say(figure, "the run has no finite step")
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
    _legend(figure, history.get_legend_handles_labels()[0])
    return figure


@mpl.rc_context(STYLE)
def power_convergence(data: Mapping[str, Any]) -> Figure:
    """P_d over the number of periods it is averaged over (Fig. 15).

    Args:
        data: `n`, `P_d` and `P_d_ci` (lists; None is a missing number), `final` and `title`.
    """
    figure = _figure(str(data.get("title", "")), COLUMN, 2.8)
    n, P_d, ci = (np.array(data[key], dtype=float) for key in ("n", "P_d", "P_d_ci"))
    if not np.isfinite(P_d).any():
        return _say(figure, "no period was finished")
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
    _legend(figure, panel.get_legend_handles_labels()[0])
    return figure


@mpl.rc_context(STYLE)
def tuning(data: Mapping[str, Any]) -> Figure:
    """Paths of a tuning over the map of its objective, or key by key where it has no map, and the paths' scores.

    Args:
        data: A tuning as `tune.json` holds it.
    """
    figure = _figure(f"{data['title']}: {data['goal']} of $P_d$", WIDE, WIDE * 0.5)
    left, right = figure.subplots(1, 2)
    points, scores = np.array(data["points"]), np.array(data["scores"], float)
    best = int(np.nanargmax(scores[-1]))
    if data["map"] is None:
        _draw_keys(left, data, points, best)
    else:
        _draw_paths(figure, left, data, points, best)
    for i in range(scores.shape[1]):
        right.plot(scores[:, i], color=BLUE if i == best else GREY, lw=1.2 if i == best else 0.6)
    right.set(xlabel="update", ylabel="objective less penalties [%]", title="each start; the best in blue")
    return figure


@mpl.rc_context(STYLE)
def trade(data: Mapping[str, Any]) -> Figure:
    """Errors against cost for every setting, the front in the errors of the state marked.

    Args:
        data: Measured settings as `trade.json` holds them.
    """
    figure = _figure(data["title"], WIDE, WIDE * 0.9)
    rows = data["settings"]
    wanted = {
        "state_error": f"state after {data['horizon']} periods",
        "P_d": "$P_d$ [percentage points]",
        "gradient": "d(power)/d(gap), relative",
        "period": "share with the right period",
    }
    kinds = list(dict.fromkeys(r["kind"] for r in rows))
    panels = figure.subplots(2, 2).ravel()
    for panel, (name, title) in zip(panels, wanted.items(), strict=True):
        drawn = [r for r in rows if r[name] is not None and (r[name] > 0 or name == "period")]
        for i, kind in enumerate(kinds):
            mine = [r for r in drawn if r["kind"] == kind]
            cost, error = [r["cost"] * 1e6 for r in mine], [r[name] for r in mine]
            dashes = {"float32": ":", "smooth": "--"}.get(kind.split(", ")[-1], "-")
            panel.plot(cost, error, dashes, marker="osv^DPX*"[i % 8], ms=3, lw=0.8, color=f"C{i}", label=kind)
        panel.set(xscale="log", ylabel=title)
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_minor_formatter(NullFormatter())
        if name != "period" and drawn:
            panel.set(yscale="log")
        if not drawn:
            panel.text(0.5, 0.5, "nothing to compare", ha="center", transform=panel.transAxes)
    for panel in panels[2:]:
        panel.set(xlabel="µs per lane and period")
    best = sorted((r for r in rows if r["front"]), key=lambda r: r["cost"])
    panels[0].plot([r["cost"] * 1e6 for r in best], [r["state_error"] for r in best], color="k", lw=4, alpha=0.15)
    _legend(figure, panels[0].get_legend_handles_labels()[0])
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write `figure` under a temporary name beside `path`, then rename it: never half a file.

    Args:
        figure: Any figure.
        path: Its suffix says the format: .png (200 dpi), .pdf or .svg.

    Raises:
        ValueError: The suffix names no format of matplotlib.
        OSError: The folder is missing or not writable.
    """
    path = Path(path)
    if not path.suffix:
        raise ValueError(f"{path}: a picture needs a suffix, such as .png, .pdf or .svg.")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        figure.savefig(part, format=path.suffix[1:].lower(), dpi=200)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _figure(title: str, width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(fill(title, round(15 * width)))
    return figure


def _title(ds: xr.Dataset) -> str:
    status = int(ds.attrs.get("status", Status.OK))
    return str(ds.attrs.get("title", "")) + (f" (stopped: {_status(status)})" if status else "")


def _say(figure: Figure, text: str) -> Figure:
    figure.set_figheight(1.5)
    figure.text(0.5, 0.45, text, ha="center", va="center", color=INK)
    return figure


def _legend(figure: Figure, handles: list[Any]) -> None:
    """Below the panels, in as many columns as fit."""
    for columns in range(min(6, len(handles)), 0, -1):
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=columns)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


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


def _quantity(key: str) -> tuple[str, float]:
    """Axis label of one of the scene's numbers, and its unit per SI unit."""
    symbol, words, unit, factor = QUANTITIES.get(key.split("[")[0], (None, key, "SI", 1))
    name = words if symbol is None else f"{words} ${symbol}$"
    return f"{name} [{unit}]" if unit else name, float(factor)


def _draw_paths(figure: Figure, panel: Axes, data: Mapping[str, Any], points: Floats, best: int) -> None:
    (x_key, x_ends), (y_key, y_ends) = data["over"].items()
    (x_label, x_unit), (y_label, y_unit) = _quantity(x_key), _quantity(y_key)
    x, y = np.array(data["map"]["first"]) * x_unit, np.array(data["map"]["second"]) * y_unit
    drawn = panel.pcolormesh(
        x, y, np.array(data["map"]["objective"], float).T, cmap="viridis", shading="nearest", rasterized=True
    )
    figure.colorbar(drawn, ax=panel, label="objective [%]")
    for i in range(points.shape[1]):
        path = points[:, i] * [x_unit, y_unit]
        width, size = (1.4, 3.5) if i == best else (0.7, 2.0)
        panel.plot(*path.T, color="white", lw=width + 1.2)
        panel.plot(*path.T, color=INK, lw=width)
        panel.plot(*path[0], "o", color="white", mec=INK, mew=0.6, ms=size)
    end = np.array(list(data["design"].values())) * [x_unit, y_unit]
    panel.plot(*end, "*", color=ORANGE, mec=INK, mew=0.5, ms=9, label="tuned design", clip_on=False)
    panel.set(xlabel=x_label, ylabel=y_label, xlim=x[[0, -1]], ylim=y[[0, -1]])
    panel.set_xscale("log" if x_ends[0] > 0 else "linear")
    panel.set_yscale("log" if y_ends[0] > 0 else "linear")
    panel.set_title("paths from their starts (circles)")


def _draw_keys(panel: Axes, data: Mapping[str, Any], points: Floats, best: int) -> None:
    """The best path, every key from its lower to its upper bound."""
    colors = [BLUE, ORANGE, PINK, SKY, INK, GREY]
    for i, (key, (low, high)) in enumerate(data["over"].items()):
        value = points[:, best, i]
        share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
        panel.plot(share, color=colors[i % len(colors)], ls="-" if i < len(colors) else "--", label=key)
    panel.set(xlabel="update", ylabel="place between the bounds", ylim=(-0.02, 1.02), title="the best path")
    panel.legend(loc="best")
