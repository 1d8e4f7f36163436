"""Published cases that are met, or are not: the numbers of others, and the page that compares ours with them.

The rows of docs/validation.md are written by the tests that compute the cases: pytest -m published --write
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).parent.parent / "docs" / "validation.md"
OURS = 4  # the column of our numbers


class Case(NamedTuple):
    """What others print: a quantity, where, its numbers, and the largest relative difference of ours."""

    quantity: str
    source: str
    theirs: tuple[float, ...]
    within: float  # infinite: not met
    digits: int = 6  # of ours that are shown


CASES = {
    "SDND101a": Case(
        "largest force [N], length of contact and second peak [s] of a mass released onto a wall",
        "Code_Aster",
        (9950, 0.03126, 0.361),
        1e-3,
    ),
    "SDND102a": Case(
        "x [um] of a shaken mass at a wall after 0.05, 0.156, 0.25, 0.4, 0.5, 0.8, 0.9, 1 s",
        "Code_Aster",
        (-358.082, -122.321, -188.76, -189.772, -68.4454, -111.982, -120.103, -107.178),
        0.03,
    ),
    "SDND100a": Case(
        "turning points [um] of a block that friction stops", "Code_Aster", (-459.6, 318.2, -176.8, 35.36), 2e-4
    ),
    "SDND104a": Case(
        "power of wear [W] of a shaken block, accelerations of 15, 1.5, 1.01, 0.99 m/s2",
        "Code_Aster",
        (15.2670995894, 0.40906245, 2.261641e-4, 0.0),
        5e-3,
    ),
    "SDND108a": Case(
        "a bouncing mass: onset, separation [s], x after 1 and 1.1 s [m]",
        "Code_Aster",
        (0.54031242374329, 0.88545615307643, 1.332162981855, 0.856394405035),
        1e-8,
    ),
    "SDND122a": Case("frequency of a free bilinear oscillator [Hz]", "Code_Aster", (0.6467033,), 2e-4),
    "SDLD02a": Case(
        "natural frequencies of a chain of 8 [Hz]",
        "Code_Aster",
        (5.5274, 10.8868, 15.9155, 20.4606, 24.384, 27.5664, 29.9113, 31.3474),
        1e-5,
    ),
    "SDLD21a": Case(
        "amplitude of its driven fourth mass [um] at 5, 5.5, 40 Hz, damped",
        "Code_Aster",
        (102.7238, 900.085, 2.58433),
        1e-5,
    ),
    "SDNL105a": Case(
        "three tubes that hit each other after 1 s: x [mm] and velocities [mm/s], five modes each",
        "Code_Aster",
        (16.4264, 11.1627, 5.88736, 25.4155, 44.1197, 104.55),
        1e-3,
    ),
    "SDNL104a": Case(
        "beam at a stop, five modes: y after 0.1315 s [um], velocity after 0.1566 s [mm/s]; theirs of all 20 modes",
        "Code_Aster",
        (-1.85356696663, -4.63289359505),
        0.08,
    ),
    "Blisk of 24 sectors": Case(
        "natural frequencies [Hz], nodal diameters 0 and 12",
        "pyHarm",
        (88.26374399, 249.31165161, 619.34330474, 195.67605066, 617.32579659, 2062.97567761),
        1e-9,
    ),
    "Whitehead's bound": Case(
        "largest amplification of 12 mistuned blades; ours is found by a search", "Whitehead", (2.23205,), 0.1, digits=2
    ),
    "2dof_eldry_fric": Case(
        "largest y [m] under 25, 50, 80, 100 N; theirs by 8 harmonics", "tmdsimpy", (9.552, 27.486, 51.82, 68.384), 1e-4
    ),
    "Griffin's oscillator": Case(
        "amplitude at resonance [m]; theirs is the closed form of one harmonic", "textbook", (4.65979,), 0.03, digits=5
    ),
    "Fig. 10": Case("period numbers of the labelled points, 0: chaos", "the article", (1, 2, 3, 0), math.inf),
    "Figs. 10, 12, 14": Case("labels that one reading meets", "the article", (12,), math.inf),
}


def difference(case: Case, ours: Sequence[float]) -> float:
    """The largest relative difference of our numbers; an absolute one from zero."""
    return max(abs(a - b) / (abs(b) or 1.0) for a, b in zip(ours, case.theirs, strict=True))


def cells(name: str, ours: Sequence[float], test: str) -> list[str]:
    """The cells of a row of the page."""
    case = CASES[name]
    shown = [f"{value:.{case.digits}g}" for value in ours]
    theirs = ", ".join(f"{value:.10g}" for value in case.theirs)
    off = "not met" if math.isinf(case.within) else f"{100 * difference(case, [*map(float, shown)]):.1g} %"
    return [name, case.quantity, case.source, theirs, ", ".join(shown), off, f"`{test}`"]


def rows() -> dict[str, list[str]]:
    """The cells of all rows of the page, by the names of their cases."""
    lines = [line.strip("| ").split(" | ") for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| ")]
    return {line[0]: line for line in lines if line[0] in CASES}


def numbers_shown(cell: str) -> list[float]:
    """The numbers in a cell."""
    return [float(number) for number in cell.split(", ")]


def write_row(row: list[str]) -> None:
    """Put a row in place of the one of its case; a new one comes in the order of the cases."""
    table = {**rows(), row[0]: row}
    lines = [line for line in PAGE.read_text("utf-8").splitlines() if line.strip("| ").split(" | ")[0] not in CASES]
    head = lines.index("|---|---|---|---|---|---|---|") + 1
    lines[head:head] = ["| " + " | ".join(table[name]) + " |" for name in CASES if name in table]
    PAGE.write_text("\n".join(lines) + "\n", "utf-8")


def compare(name: str, ours: Sequence[float], test: str, write: bool) -> None:
    """Hold our numbers of a case against the published ones, and against those on the page, which `write` renews."""
    case = CASES[name]
    ours = [float(value) for value in ours]
    assert difference(case, ours) <= case.within, (name, ours)
    row = cells(name, ours, test)
    if write:
        write_row(row)
    told = rows()[name]
    for value, shown in zip(ours, numbers_shown(told[OURS]), strict=True):
        assert abs(value - shown) <= 2 * 10.0 ** (1 - case.digits) * abs(value), (name, value, shown)
