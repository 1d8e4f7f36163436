"""Pictures of a row of blades: displacements over blades and time, amplitudes, and nodal diameters."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxshroud.motion.waves import BladeSpectrum, blade_spectrum
from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.style import BLUE, INK, PAGE_WIDTH, Look, fitting_title

SHOWN_PERIODS = 3.0  # in the map, at the end of the run
HARMONICS = 4  # of the drive, from 1
MICRO = 1e6


class RowData(NamedTuple):
    """What the picture of a row shows."""

    periods: np.ndarray  # time of each sample of the map [drive periods]
    x: np.ndarray  # displacements of the map (samples, N) [m]
    peak: np.ndarray  # amplitude of each blade [m]
    free: np.ndarray  # and without contact
    spectrum: BladeSpectrum | None  # None where the samples do not divide the period


def row_page(ds: xr.Dataset, look: Look) -> Page[RowData]:
    """A single run of a row.

    Args:
        ds: A `RowTrajectory` of one scene.
        look: The appearance asked for.
    """
    title = fitting_title(str(ds.attrs.get("title", "")), [])
    size = (PAGE_WIDTH, 4.6)
    if "status" not in ds.attrs:
        return Page(None, (), title, size, nothing="many runs: choose one of them by `lane`")
    per_period = ds.attrs["steps_per_period"] / ds.attrs["every"]
    periods, x = np.arange(ds.sizes["time"]) / per_period, ds["x"].to_numpy()
    kept = periods >= periods[-1] - SHOWN_PERIODS
    try:
        spectrum = blade_spectrum(x, per_period, 1)
    except ValueError:
        spectrum = None
    content = RowData(periods[kept], x[kept], ds["x_peak"].to_numpy(), ds["x_free"].to_numpy(), spectrum)
    return Page(content, ROW_PANELS, title, size, columns=2)


def _draw_map(panel: Axes, data: RowData) -> None:
    """The displacements of all blades over time; each row of the picture is a blade."""
    extent = float(np.nanmax(np.abs(data.x), initial=0.0)) * MICRO or 1.0
    edges = np.arange(data.x.shape[1] + 1) - 0.5
    times = np.append(data.periods, 2 * data.periods[-1] - data.periods[-2]) if len(data.periods) > 1 else [0.0, 1.0]
    mesh = panel.pcolormesh(times, edges, MICRO * data.x.T, cmap="RdBu_r", vmin=-extent, vmax=extent, rasterized=True)
    panel.figure.colorbar(mesh, ax=panel, label="$x$ [μm]", pad=0.01)
    panel.set(xlabel="time [drive periods]", ylabel="blade")
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_amplitudes(panel: Axes, data: RowData) -> None:
    """The amplitude of each blade with contact and without."""
    blades = np.arange(len(data.peak))
    panel.bar(blades, MICRO * data.peak, width=0.7, color=BLUE, label="with contact")
    panel.plot(blades, MICRO * data.free, "_", ms=9, color=INK, label="without")
    panel.set(xlabel="blade", ylabel="amplitude of $x$ [μm]")
    panel.set_ylim(0, 1.25 * MICRO * float(np.nanmax([*data.peak, *data.free])))
    panel.legend(ncols=2, loc="upper center", frameon=False)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_diameters(panel: Axes, data: RowData) -> None:
    """The waves of the last period by harmonic and nodal diameter."""
    panel.set(xlabel="nodal diameter", ylabel="harmonic of the drive")
    if data.spectrum is None:
        panel.text(0.5, 0.5, "too few samples in a period", transform=panel.transAxes, ha="center")
        return
    amplitude = data.spectrum.amplitude[1 : HARMONICS + 1]
    largest = amplitude.max() or 1.0
    decades = np.log10(np.maximum(amplitude / largest, 1e-4))
    edges = data.spectrum.diameters[0] + np.arange(len(data.spectrum.diameters) + 1) - 0.5
    rows = np.arange(len(amplitude) + 1) + 0.5
    mesh = panel.pcolormesh(edges, rows, decades, cmap="Greys", vmin=-4, vmax=0, rasterized=True)
    bar = panel.figure.colorbar(mesh, ax=panel, label="amplitude / largest", pad=0.02, ticks=[-4, -3, -2, -1, 0])
    bar.set_ticklabels(["$10^{-4}$", "$10^{-3}$", "$10^{-2}$", "$10^{-1}$", "1"])
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


ROW_PANELS = (
    Panel("map", _draw_map, columns=2),
    Panel("amplitudes", _draw_amplitudes),
    Panel("diameters", _draw_diameters),
)
