"""A data sheet in words."""

import math

from jaxshroud.verbs.check import NAMES, Coordinate, Sheet

HEADS = ["", "natural [Hz]", "over the drive's", "zeta", "static", "free at drive", "at resonance", "free over gap"]


def rows_of(sheet: Sheet) -> tuple[list[str], list[list[str]]]:
    """What each coordinate of each free blade is and does: the head of a table, and its rows."""
    return HEADS, [
        [f"{NAMES[name]}, {side}", *_row(sheet, name, one, i)]
        for name, one in sheet.coordinates.items()
        for i, side in enumerate(("left", "right"))
    ]


def lines_of(sheet: Sheet) -> dict[str, str]:
    """All else, by its name."""
    reached = f"{sheet.approach * 1e3:.4g} mm by translation, {_pair(sheet.corner, 1e3)} mm by rotation at corners"
    rest = {
        "drive": f"{sheet.drive:.5g} Hz",
        "gap": f"{sheet.gap * 1e3:.4g} mm; the free blades approach by {reached}",
        "inertia": f"{_pair(sheet.inertia)} times that of a uniform block",
        "contact": f"gamma = k / k_x = {sheet.gamma:.4g}",
        "stiffest motion": f"{sheet.omega_max / math.tau:.5g} Hz; {sheet.steps} steps a period (auto, rk4)",
        **{f"doubtful {i}": text for i, text in enumerate(sheet.doubts, 1)},
    }
    return rest if sheet.doubts else {**rest, "doubtful": "nothing"}


def _row(sheet: Sheet, name: str, one: Coordinate, i: int) -> list[str]:
    unit, scale = ("deg", math.degrees(1)) if name == "theta" else ("mm", 1e3)
    lengths = [f"{values[i] * scale:.4g} {unit}" for values in (one.static, one.amplitude, one.resonant)]
    moved = sheet.corner[i] if name == "theta" else one.amplitude[i]
    gaps = f"{moved / abs(sheet.gap):.3g}" if sheet.gap else "-"
    return [f"{one.frequency[i]:.5g}", f"{one.frequency[i] / sheet.drive:.4g}", f"{one.zeta[i]:.4g}", *lengths, gaps]


def _pair(values: tuple[float, float], scale: float = 1.0) -> str:
    left, right = (f"{value * scale:.3g}" for value in values)
    return left if left == right else f"{left} and {right}"
