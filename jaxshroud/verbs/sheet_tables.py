"""A data sheet in words and tables."""

import math
from collections.abc import Sequence

from jaxshroud.results.data_sheet import (
    MOTION_NAMES,
    Coordinate,
    Crossing,
    DataSheet,
    FlowMode,
    NaturalMode,
    excited_by,
)
from jaxshroud.scene.units import RPM

COORDINATE_HEADS = ["", "natural [Hz]", "over the drive's", "zeta"]
COORDINATE_HEADS += ["static", "free at drive", "at resonance", "free amplitude / gap"]
CONTACT_NAMES = {  # of natural modes
    "apart": "apart",
    "sliding": "faces sliding",
    "stuck": "faces stuck",
    "corner": "stuck at corners",
}
SAME_NUMBERS = 1e-9  # relative difference below which the numbers of blades are one
SHOWN_CONTACTS = ("apart", "stuck")  # whose crossings are printed; all are in files
# What is printed at most, so that the sheet of a row of many blades is a page.
MOST_BLADES, MOST_MODES, MOST_CROSSINGS, MOST_DOUBTS = 6, 18, 18, 8


def rows_of(sheet: DataSheet) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of all coordinates of the free blades, of a row once where all are alike."""
    return COORDINATE_HEADS, [
        [f"{MOTION_NAMES[name]}, {side}", *_table_row(sheet, name, coordinate, i)]
        for name, coordinate in sheet.coordinates.items()
        for i, side in _free_blades(sheet, coordinate)
    ]


def _free_blades(sheet: DataSheet, coordinate: Coordinate) -> list[tuple[int, str]]:
    """The blades of which a coordinate is given, with their names."""
    if not sheet.gaps:
        return [(0, "left"), (1, "right")]
    numbers = (coordinate.frequency, coordinate.zeta, coordinate.static, coordinate.amplitude, coordinate.resonant)
    if all(math.isclose(value, values[0], rel_tol=SAME_NUMBERS) for values in numbers for value in values):
        return [(0, "each blade")]
    if len(coordinate.frequency) <= MOST_BLADES:
        return [(i, f"blade {i}") for i in range(len(coordinate.frequency))]
    order = sorted(range(len(coordinate.frequency)), key=lambda i: coordinate.frequency[i])
    return [(i, f"{which}: blade {i}") for i, which in ((order[0], "lowest"), (order[-1], "highest"))]


def shown_modes(sheet: DataSheet) -> list[NaturalMode]:
    """The modes that are printed: all of few; of many those that the drive's order excites, the most driven ones."""
    if len(sheet.modes) <= MOST_MODES:
        return list(sheet.modes)
    excited = excited_by(sheet.modes, [sheet.drive_order], sheet.layout)
    known = range(len(sheet.modes)) if excited is None else [i for i, (drives,) in enumerate(excited) if drives]
    most = sorted(known, key=lambda i: -sheet.modes[i].driven)[:MOST_MODES]
    return [sheet.modes[i] for i in sorted(most)]


def mode_rows(sheet: DataSheet) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of the natural modes, apart and in contact."""
    heads = ["natural modes", "contact", "[Hz]", "over the drive's", "zeta", "x, y, theta [%]"]
    return [*heads, "share of the drive that excites it [%]"], [
        [
            mode.name,
            CONTACT_NAMES[mode.contact],
            f"{mode.frequency:.5g}",
            f"{mode.frequency / sheet.drive:.4g}",
            f"{mode.zeta:.3g}",
            ", ".join(f"{100 * share:.0f}" for share in mode.energy),
            f"{100 * mode.driven:.1f}",
        ]
        for mode in shown_modes(sheet)
    ]


def flow_rows(sheet: DataSheet) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of the waves of a row in a flow: of many those that are damped least."""
    heads = ["waves along x in the flow, apart", "[Hz]", "over the drive's", "zeta", "by the flow"]
    least = sorted(range(len(sheet.flow_modes)), key=lambda i: sheet.flow_modes[i].zeta)[:MOST_MODES]
    return heads, [_flow_row(sheet, sheet.flow_modes[i]) for i in sorted(least)]


def _flow_row(sheet: DataSheet, mode: FlowMode) -> list[str]:
    h = mode.nodal_diameter
    over = mode.frequency / sheet.drive
    name = "bending along x" if h is None else f"nodal diameter {h}"
    return [name, f"{mode.frequency:.5g}", f"{over:.4g}", f"{mode.zeta:.3g}", f"{mode.zeta_flow:.3g}"]


def crossing_rows(sheet: DataSheet) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of the speeds at which engine orders meet natural frequencies.

    Of a tuned ring it has only those of modes that the order excites, and of many those nearest to the scene's speed.
    A mode on which contact does not work has the frequency of free blades, and shares their row.
    """
    heads = ["crossings", "contact", "engine order", "speed [rpm]", "the scene's speed"]
    groups = _crossings(sheet)
    nearest = sorted(range(len(groups)), key=lambda i: abs(groups[i][0].margin))[:MOST_CROSSINGS]
    return heads, [_crossing_row(sheet, groups[i]) for i in sorted(nearest)]


def left_out(sheet: DataSheet) -> str:
    """How much of the sheet is not printed, in words; empty where all is."""
    counts = {
        "modes": (len(shown_modes(sheet)), len(sheet.modes)),
        "waves": (len(flow_rows(sheet)[1]), len(sheet.flow_modes)),
        "crossings": (len(crossing_rows(sheet)[1]), len(_crossings(sheet))),
        "doubts": (min(len(sheet.doubts), MOST_DOUBTS), len(sheet.doubts)),
    }
    hidden = [f"{total - shown} of {total} {name}" for name, (shown, total) in counts.items() if shown < total]
    return f"{', '.join(hidden)}; --out DIR writes all" if hidden else ""


def _crossings(sheet: DataSheet) -> list[list[Crossing]]:
    """All crossings, those that share a row together, in order of speed."""
    has_stuck = any(mode.contact == "stuck" for mode in sheet.modes)
    alike: dict[tuple[str, float, str], list[Crossing]] = {}
    for crossing in sheet.crossings:
        shown = crossing.contact in (SHOWN_CONTACTS if has_stuck else CONTACT_NAMES)
        if shown and crossing.excited is not False:
            motion = crossing.mode.partition(",")[0]
            speed = f"{crossing.speed * RPM:.5g}"
            alike.setdefault((speed, crossing.engine_order, motion), []).append(crossing)
    return [*alike.values()]


def lines_of(sheet: DataSheet) -> dict[str, str]:
    """All other lines of the data sheet, by name."""
    turned = f"{_texts_of(sheet.corner, 1e3)} mm by rotation at corners"
    approach = f"{_length_text(sheet.approach)} by translation, {turned}"
    lines = {
        "drive": f"{sheet.drive:.5g} Hz{_harmonics_text(sheet)}",
        "speed": _speed_text(sheet),
        "gap": f"{_gap_text(sheet)} mm; the free blades approach by {approach}",
        **({"static gap": f"{_texts_of(sheet.static_gaps, 1e3)} mm under the mean loads"} if sheet.static_gaps else {}),
        **({"settled motion": sheet.settled.words} if sheet.settled else {}),
        **({"faces": faces} if (faces := _pressed_text(sheet)) else {}),
        "inertia": f"{_texts_of(sheet.inertia)} times that of a uniform block",
        "contact": f"gamma = k / k_x = {_texts_of(sheet.gammas) if sheet.gammas else f'{sheet.gamma:.4g}'}",
        "stiffest motion": f"{sheet.omega_max / math.tau:.5g} Hz; {sheet.steps} steps a period (auto, rk4)",
        **{f"doubtful {i}": text for i, text in enumerate(sheet.doubts[:MOST_DOUBTS], 1)},
    }
    lines = lines if sheet.doubts else {**lines, "doubtful": "nothing"}
    return lines | {f"advice {i}": text for i, text in enumerate(sheet.advice, 1)}


def _crossing_row(sheet: DataSheet, crossings: Sequence[Crossing]) -> list[str]:
    """The row of modes that an engine order meets at one speed: that of free blades gives its name."""
    first, *_ = sorted(crossings, key=lambda crossing: crossing.contact)
    contacts = dict.fromkeys(CONTACT_NAMES[crossing.contact] for crossing in (first, *crossings))
    share = abs(first.margin)
    apart = f"{share:.{0 if share >= 10 else 1}f} % {'above' if first.margin > 0 else 'below'}"
    order = f"{first.engine_order:g}" + ", the drive's" * (first.engine_order in own_orders(sheet))
    return [first.mode, ", ".join(contacts), order, f"{first.speed * RPM:.5g}", apart]


def own_orders(sheet: DataSheet) -> list[float]:
    """The engine orders of the drive; none of a scene that has none of its own."""
    return [n * sheet.drive_order for n in sheet.harmonics] if sheet.is_own_order else []


def _harmonics_text(sheet: DataSheet) -> str:
    """The orders of the drive; empty where it has the first harmonic alone."""
    if sheet.harmonics == (1,):
        return ""
    own = own_orders(sheet)
    orders = ", ".join(f"{order:g}" for order in own or sheet.harmonics)
    return f", with {'engine orders' if own else 'harmonics of order'} {orders}"


def _speed_text(sheet: DataSheet) -> str:
    known = "" if sheet.is_own_order else ", taken as the scene has none"
    span = f"crossings from {sheet.start * RPM:.5g} to {sheet.stop * RPM:.5g} rpm"
    at_order = f"engine order {sheet.drive_order:g}{known}"
    growth = "with the stiffness of each speed" if sheet.over_speed else "without centrifugal stiffening"
    return f"{sheet.speed * RPM:.5g} rpm at {at_order}; {span}, {growth}"


def _pressed_text(sheet: DataSheet) -> str:
    """The ranges of speeds in which the faces are pressed together at rest, and where they open; empty for none."""
    pressed = sheet.over_speed.pressed if sheet.over_speed else ()
    if not pressed:
        return ""
    ranges = [f"{f'from {begin * RPM:.0f} ' if begin else ''}up to {end * RPM:.0f} rpm" for begin, end in pressed]
    together = f"pressed together {' and '.join(ranges)}: stuck modes count there, modes apart elsewhere"
    if pressed[-1][1] == sheet.stop:
        return together
    return f"{together}; once they open, the largest amplitude with contact may be at none of these crossings"


def _table_row(sheet: DataSheet, name: str, coordinate: Coordinate, i: int) -> list[str]:
    unit, scale = ("deg", math.degrees(1)) if name == "theta" else ("mm", 1e3)
    lengths = [
        f"{values[i] * scale:.4g} {unit}" for values in (coordinate.static, coordinate.amplitude, coordinate.resonant)
    ]
    displacement = sheet.corner[i] if name == "theta" else coordinate.amplitude[i]
    gaps = f"{displacement / abs(sheet.gap):.3g}" if sheet.gap else "-"
    return [
        f"{coordinate.frequency[i]:.5g}",
        f"{coordinate.frequency[i] / sheet.drive:.4g}",
        f"{coordinate.zeta[i]:.4g}",
        *lengths,
        gaps,
    ]


def _gap_text(sheet: DataSheet) -> str:
    return _texts_of(sheet.gaps, 1e3) if sheet.gaps else f"{sheet.gap * 1e3:.4g}"


def _length_text(length: float) -> str:
    """A length in mm; one without bound in words."""
    return f"{length * 1e3:.4g} mm" if math.isfinite(length) else "an infinite distance (resonance without damping)"


def _texts_of(values: tuple[float, ...], scale: float = 1.0) -> str:
    """The numbers of blades or interfaces: one if all are given alike, of many the ends of their range."""
    texts = [f"{value * scale:.3g}" for value in values]
    if len(set(texts)) == 1:
        return texts[0]
    return " and ".join(texts) if len(texts) == 2 else f"{min(values) * scale:.3g} to {max(values) * scale:.3g}"
