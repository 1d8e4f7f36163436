"""Pictures of how P_d converges."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxshroud.results.drawing import BLUE, COLUMN, INK, PLAIN, Floats, Look, legend_below, new_figure, say
from jaxshroud.results.look import styled
from jaxshroud.results.panels import LEAST, interval, is_seen, limits
from jaxshroud.results.words import fitting


@styled
def power_convergence(data: Mapping[str, Any], *, look: Look = PLAIN) -> Figure:
    """P_d over the number of periods it is averaged over (Fig. 15).

    Args:
        data: `n`, `P_d` and `P_d_ci` (lists; None is a missing number), `final` and `title`.
        look: What is asked for otherwise.
    """
    figure = new_figure(fitting(str(data.get("title", "")), ()), COLUMN, 2.8, look)
    if not np.isfinite(_numbers(data)[1]).any():
        return say(figure, "no period was finished")
    panel = figure.subplots()
    draw(panel, data)
    legend_below(figure, panel.get_legend_handles_labels()[0])
    return figure


def draw(panel: Axes, data: Mapping[str, Any]) -> None:
    """The convergence as one panel."""
    n, P_d, ci = _numbers(data)
    ends = limits(np.concatenate(interval(P_d, ci)), least=LEAST)
    band = "95 % interval" if is_seen(ci, np.array(ends)) else None
    panel.fill_between(n, *interval(P_d, ci), color=BLUE, alpha=0.25, lw=0, label=band)
    panel.plot(n, P_d, color=BLUE, lw=0.9, marker="." if n.size < 60 else "", ms=3, label="$P_d(n)$")
    final = data["final"]
    if final["P_d"] is not None:
        panel.axhline(final["P_d"], color=INK, lw=0.7, ls="--", label=_final(**final))
    panel.set(xlabel="periods averaged over, $n$", ylabel="power reduction $P_d$ [%]")
    panel.set(ylim=ends)
    if n.max() > 10 * n.min() > 0:
        panel.set(xscale="log", xlim=(n.min(), n.max()))


def _numbers(data: Mapping[str, Any]) -> list[Floats]:
    return [np.array(data[key], dtype=float) for key in ("n", "P_d", "P_d_ci")]


def _final(P_d: float, ci: float | None, n: int, settled: bool, period_number: int, **_: Any) -> str:
    motion = f"period {period_number}" if period_number else "aperiodic"
    interval = f" ± {ci:.2g}" if ci else ""
    return f"{P_d:.4g}{interval} % ($n$ = {n}, {motion}{'' if settled else ', not settled'})"
