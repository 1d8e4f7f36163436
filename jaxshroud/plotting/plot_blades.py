"""Panels of all blades of a run: displacements over blades and time, amplitudes, and nodal diameters."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxshroud.plotting.page import Panel
from jaxshroud.plotting.run_data import RunData
from jaxshroud.plotting.style import BLUE, INK, PER_MICRO
from jaxshroud.signals.waves import blade_spectrum

SHOWN_PERIODS = 3.0  # in the map, at the end of the run
HARMONICS = 4  # of the drive, from 1


def _draw_map(panel: Axes, run: RunData) -> None:
    """The displacements of all blades over time; each row of the picture is a blade."""
    kept = run.t >= run.t[-1] - SHOWN_PERIODS - 1e-9
    t = run.t[kept]
    x = PER_MICRO * run.ds["x"].to_numpy()[kept]
    extent = float(np.abs(x).max()) or 1.0
    edges = np.arange(x.shape[1] + 1) - 0.5
    times = np.append(t, 2 * t[-1] - t[-2]) if len(t) > 1 else [0.0, 1.0]
    mesh = panel.pcolormesh(times, edges, x.T, cmap="RdBu_r", vmin=-extent, vmax=extent, rasterized=True)
    panel.figure.colorbar(mesh, ax=panel, label="$x$ [μm]", pad=0.01)
    panel.set(xlabel="time [drive periods]", ylabel="blade")
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_amplitudes(panel: Axes, run: RunData) -> None:
    """The amplitude of each blade with contact and without."""
    peak, free = (PER_MICRO * run.ds[name].to_numpy() for name in ("x_peak", "x_free"))
    blades = np.arange(len(peak))
    panel.bar(blades, peak, width=0.7, color=BLUE, label="with contact")
    panel.plot(blades, free, "_", ms=9, color=INK, label="without contact")
    panel.set(xlabel="blade", ylabel="amplitude of $x$ [μm]")
    panel.set_ylim(0, 1.25 * float(np.nanmax([*peak, *free])))
    panel.legend(ncols=2, loc="upper center", frameon=False)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_diameters(panel: Axes, run: RunData) -> None:
    """The waves of the last period by harmonic and nodal diameter."""
    panel.set(xlabel="nodal diameter", ylabel="harmonic of the drive")
    try:
        spectrum = blade_spectrum(run.ds["x"].to_numpy(), float(run.rate), 1)
    except ValueError:
        panel.text(0.5, 0.5, "too few samples in a period", transform=panel.transAxes, ha="center")
        return
    amplitude = spectrum.amplitude[1 : HARMONICS + 1]
    largest = amplitude.max() or 1.0
    decades = np.log10(np.maximum(amplitude / largest, 1e-4))
    edges = spectrum.diameters[0] + np.arange(len(spectrum.diameters) + 1) - 0.5
    rows = np.arange(len(amplitude) + 1) + 0.5
    mesh = panel.pcolormesh(edges, rows, decades, cmap="Greys", vmin=-4, vmax=0, rasterized=True)
    bar = panel.figure.colorbar(mesh, ax=panel, label="amplitude / largest", pad=0.02, ticks=[-4, -3, -2, -1, 0])
    bar.set_ticklabels(["$10^{-4}$", "$10^{-3}$", "$10^{-2}$", "$10^{-1}$", "1"])
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


BLADE_PANELS = (
    Panel("map", _draw_map, columns=2),
    Panel("amplitudes", _draw_amplitudes),
    Panel("diameters", _draw_diameters),
)
