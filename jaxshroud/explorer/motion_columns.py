"""The columns that the figures of one motion show, from a run that is simulated."""

from typing import Any

import numpy as np
import xarray as xr

from jaxshroud.model.modes import Mode
from jaxshroud.motion.spectrum import amplitude_spectrum, whole_periods
from jaxshroud.motion.waves import blade_spectrum
from jaxshroud.plotting.animation import ARROW, MILLIMETRES
from jaxshroud.plotting.film import Blocks, fitting_factor, last_frames, stored_blocks
from jaxshroud.plotting.plot_blades import HARMONICS
from jaxshroud.plotting.plot_run import CASE_STYLES, MODE_STYLES
from jaxshroud.plotting.run_data import FEWEST_SAMPLES, RunData, contact_data, run_data

HISTORY_PERIODS = 10
PORTRAIT_PERIODS = 16  # the longest orbit that has a period number
CORNERS = 4
SPAN_NAMES = "left", "right", "bottom", "top", "color", "word"
NO_SPANS: dict[str, list[Any]] = {name: [] for name in SPAN_NAMES}
PlotColumns = dict[str, Any]


def prepared_run(ds: xr.Dataset) -> RunData | None:
    """A run for the figures; None where it ended before its second sample."""
    return run_data(ds, scale=MILLIMETRES)


def history_columns(run: RunData) -> PlotColumns:
    """The displacements of the first two blades [m] over the last periods, over time in drive periods."""
    last = run.t > run.t[-1] - HISTORY_PERIODS - 1e-9
    x = run.ds["x"].to_numpy()[last]
    return {"t": run.t[last], "x_1": x[:, 0], "x_2": x[:, 1]}


def portrait_columns(run: RunData) -> PlotColumns:
    """Velocity over displacement of the left blade over the last periods."""
    last = run.settled & (run.t > run.t[-1] - PORTRAIT_PERIODS - 1e-9)
    return {"x": run.ds["x"].to_numpy()[last, 0], "v": run.v[last]}


def poincare_columns(run: RunData) -> PlotColumns:
    """The points of the portrait at the ends of periods."""
    return {"x": run.ds["x"].to_numpy()[run.ends, 0], "v": run.v[run.ends]}


def spectrum_columns(run: RunData, most: float = 6.0) -> PlotColumns:
    """The amplitude spectrum of the left blade [m] up to a frequency in units of the drive's."""
    x, rate, q = run.ds["x"].to_numpy()[run.settled, 0], run.rate, run.repeats
    n_periods = whole_periods(x.size, rate)
    if n_periods < 1 or np.ptp(x) == 0:
        return {"f": np.zeros(0), "a": np.zeros(0), "foot": np.zeros(0)}
    if q:
        x = x[x.size - int(n_periods // q * q * rate) :]
    f, a = amplitude_spectrum(x, rate, "rectangular" if q or n_periods < 3 else "hann")
    shown = (f > 0) & (f <= most)
    top = a[1:].max()
    return {"f": f[shown], "a": np.maximum(a[shown], 1e-6 * top), "foot": np.full(shown.sum(), 1e-6 * top)}


def contact_columns(run: RunData) -> tuple[PlotColumns, PlotColumns]:
    """Forces over the last periods, and the spans of contact state and case; both empty without contact."""
    if "N" not in run.ds or run.rate < FEWEST_SAMPLES:
        nothing = np.zeros(0)
        return dict.fromkeys(("t", "N", "F"), nothing), NO_SPANS
    contact = contact_data(run)
    spans = [*_spans(contact.t, contact.mode, MODE_STYLES, 1.0), *_spans(contact.t, contact.case, CASE_STYLES, 0.0)]
    columns: PlotColumns = dict(zip(SPAN_NAMES, map(list, zip(*spans, strict=True)), strict=True)) if spans else {}
    return {"t": contact.t, "N": contact.N, "F": contact.F}, columns or NO_SPANS


def _spans(t: np.ndarray, values: np.ndarray, styles: Any, bottom: float) -> list[tuple[Any, ...]]:
    """The spans of time in which a state holds that has a style."""
    first = np.flatnonzero(np.diff(values, prepend=-1))
    ends = np.append(t[first[1:]], t[-1])
    found = []
    for i, end in zip(first, ends, strict=True):
        if int(values[i]) in styles:
            word, colour = styles[int(values[i])]
            found.append((float(t[i]), float(end), bottom + 0.1, bottom + 0.9, colour, word))
    return found


def film_columns(run: RunData) -> tuple[PlotColumns, float]:
    """The corners, the contact point and the ends of the arrows of every frame, and the factor of exaggeration."""
    frames, blocks = last_frames(run, None), stored_blocks(run.ds)
    factor = fitting_factor(frames, blocks)
    rests = [np.array([blade * (blocks.l_oa + factor * blocks.gap), 0.0]) for blade in (0, 1)]
    instants = [frames.isel(time=i) for i in range(frames.sizes["time"])]
    corners = np.array([[blocks.corners(f, factor, rests[b], b) for b in (0, 1)] for f in instants])
    columns: PlotColumns = {"t": frames["periods"].to_numpy()}
    for blade in (0, 1):
        for k in range(CORNERS):
            columns |= {f"x{blade}{k}": corners[:, blade, k, 0], f"y{blade}{k}": corners[:, blade, k, 1]}
    return columns | _arrow_columns(frames, blocks, corners[:, 0]), factor


def _arrow_columns(frames: xr.Dataset, blocks: Blocks, left: np.ndarray) -> PlotColumns:
    """The contact point, and the vectors of the normal and the friction force on the right block; NaN when apart."""
    count = len(left)
    if "N" not in frames:
        nothing = np.full(count, np.nan)
        return {**dict.fromkeys(("px", "py", "nx", "ny", "fx", "fy"), nothing), "state": ["apart"] * count}
    N, F, mode = (frames[name].to_numpy() for name in ("N", "F", "mode"))
    place = np.nan_to_num(frames["contact_point"].to_numpy()) if "contact_point" in frames else np.zeros(count)
    touching = (mode != Mode.APART) & (N > 0)
    edge = left[:, 0] - left[:, 1]
    tangent = edge / np.linalg.norm(edge, axis=1)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    points = (left[:, 0] + left[:, 1]) / 2 + place[:, None] * tangent
    scale = ARROW * blocks.l_ab / (float(np.nanmax(np.abs(N), initial=0.0)) or 1.0)
    ends = {"p": points, "n": points + scale * N[:, None] * normal, "f": points + scale * F[:, None] * tangent}
    columns = {
        f"{name}{axis}": np.where(touching, a[:, i], np.nan) for name, a in ends.items() for i, axis in enumerate("xy")
    }
    words = {-1: "apart", **{int(mode): word for mode, (word, _) in MODE_STYLES.items()}}
    state = [words.get(m, "contact") for m in np.where(touching, mode, -1).astype(int).tolist()]
    return {**columns, "state": state}


def ring_columns(run: RunData) -> PlotColumns:
    """The amplitude of each blade of a row with contact and without, and where it is drawn."""
    ds = run.ds
    peak, free, count = ds["x_peak"].to_numpy(), ds["x_free"].to_numpy(), ds.sizes["blade"]
    angle = 2 * np.pi * np.arange(count) / count
    closed = ds.sizes["interface"] == count
    x, y = (np.sin(angle), np.cos(angle)) if closed else (np.linspace(-1, 1, count), np.zeros(count))
    names = {"name_x": (0.78 if closed else 1.0) * x, "name_y": 0.78 * y if closed else y - 0.25}
    place = {"x": x, "y": y, **names, "name": list(map(str, range(count)))}
    return {"blade": np.arange(count), "peak": peak, "free": free, **place}


def diameter_columns(run: RunData) -> PlotColumns:
    """The waves of the last period: the amplitude of each harmonic of the drive and nodal diameter."""
    try:
        spectrum = blade_spectrum(run.ds["x"].to_numpy(), float(run.rate), 1)
    except ValueError:
        return {"diameter": [], "harmonic": [], "decades": [], "amplitude": []}
    amplitude = spectrum.amplitude[1 : HARMONICS + 1]
    harmonic, diameter = np.meshgrid(np.arange(1, len(amplitude) + 1), spectrum.diameters, indexing="ij")
    decades = np.log10(np.maximum(amplitude / (amplitude.max() or 1.0), 1e-4))
    columns = {"diameter": diameter, "harmonic": harmonic, "decades": decades, "amplitude": amplitude}
    return {name: a.ravel() for name, a in columns.items()}
