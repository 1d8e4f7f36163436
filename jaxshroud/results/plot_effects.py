"""Pictures of what matters most (tornado charts)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxshroud.results.drawing import BLUE, COLUMN, INK, ORANGE, PLAIN, Look, new_figure, say
from jaxshroud.results.effects import Effect, effects
from jaxshroud.results.look import styled
from jaxshroud.scene.keys import found

SHOWN = 24  # bars at most
UNITS = {"P_d": "percentage points", "P": "m$^4$"}


@styled
def tornado(data: Mapping[str, Any], *, look: Look = PLAIN) -> Figure:
    """What each number changes per 1 % (1 degree of angles), the largest effect on top.

    Args:
        data: `of`, `title`, and `value`, `ci` and `number` by their keys, as `gradient.json` holds them.
        look: What is asked for otherwise.
    """
    known = [e for e in effects(data["value"], data["ci"], data["number"]) if np.isfinite(e.change)]
    told = [e for e in known if e.change] or known
    shown, rest = told[:SHOWN], told[SHOWN:]
    subject = str(data.get("title", "")).partition(":")[0]  # what follows tells of a sweep
    figure = new_figure(subject, COLUMN, 1.1 + 0.21 * max(len(shown), 2), look)
    if not shown:
        return say(figure, "there is no derivative")
    panel, rows = figure.subplots(), np.arange(len(shown))
    change = np.array([e.change for e in shown])
    panel.barh(rows, change, color=np.where(change > 0, BLUE, ORANGE), height=0.7)
    ci = np.array([e.ci for e in shown])
    if ci.any():
        panel.errorbar(change, rows, xerr=ci, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5)
    panel.axvline(0.0, color=INK, lw=0.7)
    panel.set_yticks(rows, [_label(e) for e in shown])
    panel.tick_params(axis="y", length=0, which="both")
    symbol = {"P_d": "$P_d$", "P": "$P$"}[data["of"]]
    more = f", {len(rest)} smaller ones left out" if rest else ""
    panel.set(xlabel=f"{symbol} per 1 % more [{UNITS[data['of']]}]{more}", ylim=(len(shown) - 0.4, -0.6))
    return figure


def _label(e: Effect) -> str:
    """The number, and what it is changed by where that is not 1 %."""
    row, blade = found(e.key)
    side = "" if blade is None else f", {('left', 'right')[blade]}"
    per = "" if e.per == "1 %" else f" (per {e.per})"
    return f"{row.label}{side} ${row.symbol}${per}"
