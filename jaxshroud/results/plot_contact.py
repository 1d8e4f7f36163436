"""Panels of what contact does over the last periods of a run: forces, states, friction loop and where it acts."""

import tomllib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.results.drawing import BLUE, GREY, INK, ORANGE, PINK, SKY, Floats
from jaxshroud.results.drawn import Drawn, Touching, touching
from jaxshroud.results.panels import limits

MODES = {
    Mode.STICK: ("stick", SKY),
    Mode.SLIP_PLUS: ("slip +", ORANGE),
    Mode.SLIP_MINUS: ("slip −", PINK),
    Mode.SMOOTH: ("contact", BLUE),
}
CASES = {
    1: ("case 1", "#004488"),
    2: ("case 2", "#6699CC"),
    3: ("case 3", "#997700"),
    4: ("case 4", "#EECC66"),
    FLAT: ("flat", "#994455"),
}
MICRO, MILLI = 1e6, 1e3


def ribbon(panel: Axes, run: Drawn) -> None:
    """Contact state and case over the period: a row for each period of the motion, the first on top."""
    at = touching(run)
    rows = max(round(at.t[-1]), 1)
    for row in range(rows):
        _draw_row(panel, at, row, rows - 1 - row)
    panel.set(xlim=(0, min(at.t[-1], 1)), ylim=(0, rows), xlabel=PHASE)
    panel.set(title="contact state and case" if rows == 1 else "contact state, and case below it")
    places, names = ([0.2, 0.675], ["case", "state"]) if rows == 1 else (np.arange(rows) + 0.5, np.arange(rows, 0, -1))
    panel.set_yticks(places, names)
    panel.set(ylabel="" if rows == 1 else "period")
    panel.tick_params(axis="y", length=0)


def _draw_row(panel: Axes, at: Touching, row: int, foot: int) -> None:
    """One period: the mode above, the case below."""
    here = (at.t >= row - 1e-9) & (at.t <= row + 1 + 1e-9)
    t = at.t[here] - row
    known: dict[Any, tuple[str, str]]
    for values, known, place in ((at.mode, MODES, (foot + 0.4, 0.55)), (at.case, CASES, (foot + 0.05, 0.3))):
        for value, spans in _spans(t, values[here]).items():
            if value in known:
                panel.broken_barh(spans, place, color=known[value][1], lw=0)


def _spans(t: Floats, values: Any) -> dict[int, list[tuple[float, float]]]:
    """Value -> beginnings and lengths of the stretches that have it."""
    first = np.flatnonzero(np.diff(values, prepend=-1))
    lengths = np.diff(t[first], append=t[-1])
    found: dict[int, list[tuple[float, float]]] = {}
    for i, length in zip(first, lengths, strict=True):
        found.setdefault(int(values[i]), []).append((float(t[i]), float(length)))
    return found


def loop(panel: Axes, run: Drawn) -> None:
    """The friction force over the slide: the area inside is the work of friction."""
    at = touching(run)
    u = at.u * MICRO
    _draw_pieces(panel, at, u, at.F, at.pieces)
    touched = at.mode != Mode.APART
    panel.set(xlim=limits(u[touched]) if touched.any() else None)
    panel.set(xlabel="slide $u$ [µm]", ylabel="friction force $F$ [N]", title="friction loop")


def path(panel: Axes, run: Drawn) -> None:
    """Where contact acts along the left block's face, whose ends are dashed."""
    at = touching(run)
    panel.set(xlabel=TIME, ylabel="place on the face [mm]", title="where contact acts", xlim=_ends(at))
    if at.contact_point is None:
        panel.text(0.5, 0.5, "the blocks do not turn", ha="center", va="center", transform=panel.transAxes)
        return
    _draw_pieces(panel, at, at.t, at.contact_point * MILLI, at.stretches)
    half = _number(run, "shroud", "l_ab")
    if half is not None:
        for side in (-1, 1):
            panel.axhline(side * half / 2 * MILLI, color=GREY, lw=0.6, ls="--")
        panel.set(ylim=np.array([-0.55, 0.55]) * half * MILLI)


def forces(panel: Axes, run: Drawn) -> None:
    """Normal and friction force over time; friction between its limits, at which contact slips."""
    at = touching(run)
    mu = _number(run, "friction", "mu")
    if mu:
        panel.fill_between(at.t, -mu * at.N, mu * at.N, color=SKY, alpha=0.35, lw=0, label=r"$\pm\mu N$")
    panel.plot(at.t, at.N, color=INK, lw=0.8, label="$N$")
    if np.any(at.F):
        panel.plot(at.t, at.F, color=BLUE, lw=0.8, label="$F$")
    low, high = limits(np.concatenate([at.N, at.F, -mu * at.N if mu else at.F]))
    panel.set(xlabel=TIME, ylabel="force [N]", title="contact forces", xlim=_ends(at))
    panel.set(ylim=(low, high + 0.15 * (high - low)))  # room for the legend
    panel.legend(loc="upper right", ncols=3)


TIME, PHASE = "time $t/T$", "time within a period $t/T$"
PANELS: dict[str, Callable[[Axes, Drawn], None]] = {"forces": forces, "ribbon": ribbon, "loop": loop, "path": path}


def handles(run: Drawn, cases: bool = True) -> list[Patch]:
    """Legend entries of the contact states, and cases, that occur."""
    at = touching(run)
    shown = _entries(MODES, at.mode) + (_entries(CASES, at.case) if cases else [])
    return [Patch(color=color, label=name) for name, color in shown]


def _entries(known: dict[Any, tuple[str, str]], values: Iterable[int]) -> list[tuple[str, str]]:
    present = set(map(int, values))
    return [entry for value, entry in known.items() if int(value) in present]


def _ends(at: Touching) -> tuple[float, float]:
    return float(at.t[0]), float(at.t[-1])


def _draw_pieces(panel: Axes, at: Touching, x: Floats, y: Floats, pieces: list[slice]) -> None:
    """A line in the colours of the contact states, in pieces; grey when apart."""
    strokes: dict[int, list[Floats]] = {}
    for piece in pieces:
        points = np.stack([x[piece], y[piece]])
        strokes.setdefault(int(at.mode[piece.start]), []).extend([points, np.full((2, 1), np.nan)])
    for mode, points in strokes.items():
        color = MODES[Mode(mode)][1] if mode in MODES else GREY
        style: Any = {"color": color, "lw": 0.5 if mode == Mode.APART else 1.0, "solid_capstyle": "round"}
        panel.plot(*np.concatenate(points, axis=1), **style)


def _number(run: Drawn, table: str, name: str) -> float | None:
    """A number of the run's scene, None where the file does not tell."""
    value = tomllib.loads(str(run.ds.attrs.get("scene", ""))).get(table, {}).get(name)
    return float(value) if isinstance(value, int | float) else None
