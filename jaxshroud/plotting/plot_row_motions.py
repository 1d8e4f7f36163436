"""The picture of the motions that a row of blades settles on: the amplitude of every blade on each."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.plot_attractors import AttractorsData
from jaxshroud.plotting.scales import legend_above, title_of
from jaxshroud.plotting.style import BLUE, COLUMN_WIDTH, GREEN, INK, ORANGE, PINK, RED, SKY, Look

MOTION_LOOKS = list(zip((BLUE, ORANGE, GREEN, PINK, RED, SKY), "osD^vP", strict=True))  # of the most frequent motions
MICRONS_PER_M = 1e6
MOST_FREE = 2.0  # times the largest amplitude: larger ones without contact would hide the differences


def row_motions_page(found: AttractorsData, look: Look) -> Page[xr.Dataset]:
    """The amplitudes of all blades on the most frequent motions, with those without contact unless they are far larger.

    Args:
        found: The motions.
        look: The appearance asked for.
    """
    ds = found.data
    nothing = "" if ds.sizes.get("attractor", 0) else "no start settled on a motion"
    panels = (Panel("amplitudes", _draw_motion_amplitudes),)
    return Page(ds, panels, title_of(ds), (COLUMN_WIDTH, 2.9), nothing=nothing)


def _draw_motion_amplitudes(panel: Axes, ds: xr.Dataset) -> None:
    """The amplitude of each blade on each motion, and without contact."""
    blades, peaks = ds["blade"].to_numpy(), MICRONS_PER_M * ds["x_peak"].to_numpy()
    free = MICRONS_PER_M * ds["x_free"].to_numpy()[0]
    for i, (color, marker) in enumerate(MOTION_LOOKS[: len(peaks)]):
        label = f"motion {i + 1}: $P_d$ = {float(ds['P_d'][i]):.4g} %"
        panel.plot(blades, peaks[i], marker, ls="-", lw=0.7, ms=4 - 0.4 * i, color=color, label=label)
    top, most = (float(np.nanmax(levels, initial=0.0)) for levels in (peaks, free))
    if most < MOST_FREE * top:
        panel.plot(blades, free, "_", ms=9, color=INK, label="without contact")
        top = max(top, most)
    panel.set(xlabel="blade", ylabel="amplitude of $x$ [μm]", ylim=(0, 1.08 * top or 1.0))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_above(panel)
