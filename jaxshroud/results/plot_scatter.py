"""Pictures of how P_d scatters."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from jaxshroud.results.drawing import BLUE, COLUMN, GREY, INK, ORANGE, PLAIN, Look, legend_below, new_figure, say
from jaxshroud.results.look import styled
from jaxshroud.scene.keys import found

if TYPE_CHECKING:
    import xarray as xr


@styled
def scatter(ds: "xr.Dataset", *, look: Look = PLAIN) -> Figure:
    """The share of draws below each P_d, and the shares of its variance that numbers have alone and in all.

    Args:
        ds: A scatter.
        look: What is asked for otherwise.
    """
    keys = [str(key) for key in ds["key"].to_numpy()]
    subject = str(ds.attrs.get("title", "")).partition(":")[0]
    figure = new_figure(subject, COLUMN, 2.9 + 0.3 * len(keys), look)
    P_d = np.sort(ds["P_d"].to_numpy())
    if not np.isfinite(P_d).any():
        return say(figure, "every draw stopped")
    spread, shares = figure.subplots(2, 1, height_ratios=[2.0, 0.4 + 0.3 * len(keys)])
    spread.step(P_d, (np.arange(P_d.size) + 1) / P_d.size, where="post", color=BLUE, label="draws")
    wanted = ds.attrs.get("at_least")
    if wanted is not None:
        low, high = ds.attrs["probability_low"], ds.attrs["probability_high"]
        told = f"at least {wanted:g} %: {ds.attrs['probability']:.0%} ({low:.0%} to {high:.0%})"
        spread.axvline(wanted, color=ORANGE, ls="--", lw=0.9, label=told)
    spread.set(xlabel="$P_d$ [%]", ylabel="share of draws below", ylim=(0, 1))
    rows = np.arange(len(keys))
    for name, offset, color in (("first", -0.18, GREY), ("total", 0.18, BLUE)):
        share, low, high = (ds[n].to_numpy() for n in (name, f"{name}_low", f"{name}_high"))
        label = {"first": "alone", "total": "in all"}[name]
        shares.barh(rows + offset, np.maximum(share, 0), height=0.34, color=color, label=label)
        ends = np.maximum([share - low, high - share], 0)
        shares.errorbar(share, rows + offset, xerr=ends, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5)
    shares.set_yticks(rows, [f"{found(key)[0].label} ${found(key)[0].symbol}$" for key in keys])
    shares.tick_params(axis="y", length=0, which="both")
    shares.set(xlabel="share of the variance of $P_d$", ylim=(len(keys) - 0.5, -0.5))
    shares.set_xlim(left=0)
    handles = [*spread.get_legend_handles_labels()[0], *shares.get_legend_handles_labels()[0]]
    legend_below(figure, handles)
    return figure
