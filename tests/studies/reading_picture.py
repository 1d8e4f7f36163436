"""The reading study as a picture of a column's width."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from reading_scenes import FIG16, FIG17, FIG18, LOST, SI, Reading, columns, readings
from reading_verdict import Found, hits_of

from jaxshroud.plotting.style import BLUE, RED, SKY, STYLE

SMALL: dict[Any, Any] = STYLE | {"font.size": 7, "lines.linewidth": 1.0}
WIDTH, DPI = 90 / 25.4, 200  # of a column [in], and the dots that notebooks show it with


def picture(found: Found, told: dict[str, Any]) -> Figure:
    """Labels met by all readings against scrambled labels, and the trends of the plausible readings."""
    with plt.rc_context(SMALL):
        figure, axes = plt.subplot_mosaic(
            [["eight"] * 3, ["gamma", "gap", "force"]], figsize=(WIDTH, 1.05 * WIDTH), dpi=DPI, layout="constrained"
        )
        _labels(axes["eight"], found, told)
        over = {
            "gamma": (FIG16, "gamma", 1.0, r"$\gamma$"),
            "gap": (FIG17[LOST.index((2.6, 60.0))], "gap", 1e3, r"$\Delta$ [mm]"),
            "force": (FIG18, "F_0", 1.0, r"$F_0$ [N]"),
        }
        for name, (points, field, scale, label) in over.items():
            x = np.array([scale * getattr(point, field) for point in points])
            _curves(axes[name], x, found.P_d[:, columns(points)])
            axes[name].set_xlabel(label)
        axes["gap"].set_xscale("log")
        axes["gamma"].set_ylabel(r"$P_d$ [%]")
        axes["gap"].annotate(r"$M_0 \leq 1$ N m", (0.05, 10), xycoords=("axes fraction", "data"), color=BLUE)
        axes["gap"].annotate(r"$M_0 = 100$ N m", (0.05, -95), xycoords=("axes fraction", "data"), color=RED)
        for letter, ax in zip("abcd", axes.values(), strict=True):
            ax.annotate(f"({letter})", (0, 1), (2, -2), "axes fraction", "offset points", va="top")
        for name in ("gap", "force"):
            axes[name].tick_params(labelleft=False)
        return figure


def _labels(ax: Axes, found: Found, told: dict[str, Any]) -> None:
    eight = hits_of(found).chosen_by[:, 0, 0]
    counts = np.bincount(eight, minlength=9)
    ax.bar(np.arange(9), counts, color=SKY, width=0.8)
    for n, count in enumerate(counts):
        if count:
            ax.annotate(str(count), (n, 1.1 * count), ha="center", va="bottom", fontsize=6)
    null = told["null"]["choice"]
    ax.axvspan(null["scrambled"]["50 %"] - 0.5, null["scrambled"]["95 %"] + 0.5, color=RED, alpha=0.12, lw=0)
    right = null["scrambled"]["95 %"] + 0.6
    ax.annotate(
        "best reading\nwith scrambled\nlabels", (right, 0.96), xycoords=("data", "axes fraction"), va="top", color=RED
    )
    ax.annotate(
        "guess", (told["guess"]["of 8"], 5 * counts[told["guess"]["of 8"]]), (0, 18), textcoords="offset points",
        ha="center", arrowprops={"arrowstyle": "->", "lw": 0.6},
    )  # fmt: skip
    ax.set(
        yscale="log",
        xlim=(-0.6, 9.4),
        xlabel="labels of Figs. 10 and 14 met",
        ylabel="readings",
        ylim=(0.7, 12 * counts.max()),
    )


def _curves(ax: Axes, x: np.ndarray, P_d: np.ndarray) -> None:
    for colour, rows in ((BLUE, _plausible()), (RED, _printed())):
        every = P_d[rows]
        ax.fill_between(x, np.nanmin(every, axis=0), np.nanmax(every, axis=0), color=colour, alpha=0.2, lw=0)
        ax.plot(x, every[0], color=colour, marker=".", ms=3)
    ax.axhline(0, color="0.5", lw=0.5)
    ax.set_ylim(-100, 75)


def _plausible() -> list[int]:
    return _among(lambda row: row.M_0 <= 1)


def _printed() -> list[int]:
    return _among(lambda row: row.M_0 == 100)


def _among(fits) -> list[int]:
    """Readings of Eq. (1) in SI with consistent formulas; first the one with all else but M_0 as printed."""
    rows = list(enumerate(readings()))
    like = [(i, r) for i, r in rows if (r.formulas, r.angles, r.equation) == ("consistent", "as drawn", SI) and fits(r)]
    return [i for i, r in sorted(like, key=lambda pair: pair[1] != Reading(M_0=pair[1].M_0))]
