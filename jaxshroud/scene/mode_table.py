"""A table of the modes of a blade, in a file of its own beside the scene or in the scene itself.

`[blades] modes = "blade.csv"` names a CSV file with a line for each mode under a head such as `f [Hz], zeta, phi_x,
phi_y, phi_theta`; in the place of f there may be omega2, its circular square. Bare numbers are in SI units.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

from jaxshroud.scene.checks import InputError, SceneError, fail, toml_text
from jaxshroud.scene.csv_text import number_head, number_in_cell, read_csv
from jaxshroud.scene.keys import LIMIT_KEYS, MAX_MODES, MODE_ENTRY, MODE_KEYS
from jaxshroud.scene.nested_tables import list_entries
from jaxshroud.scene.optional import split_list
from jaxshroud.scene.typed import is_number

SQUARE = "omega2"  # [rad^2/s^2], in the place of f
UNITS_OF_MODES = {name: key.unit for name, key in MODE_KEYS.items()} | {SQUARE: "rad^2/s^2"}
KIND = "kind"  # "residual" of what is no mode, whose frequency does not make others rigid
NOTES = ("misfit", "unseen")  # columns that `reduce` writes beside the numbers
EXAMPLE_OF_MODES = "f [Hz], zeta, phi_x, phi_y, phi_theta, omega2 and B"
RIGID = 1e-6  # of the square of a frequency over that of the next mode, below which it is 0


def resolve_modes(document: dict[str, Any], folder: Path, name: str, is_set: bool) -> None:
    """Read the modes of a [blades], in place: those of a file, and frequencies in the place of their squares.

    Args:
        document: The document of a scene file.
        folder: Of the file, from which the table's path counts.
        name: The name of the file in messages.
        is_set: Whether an override names the table: then its path counts from where one is, and it takes the place of
            all that the file says of its blades.

    Raises:
        SceneError: The table cannot be read, or stands beside numbers of lumped blades.
    """
    blades = document.get("blades")
    if not isinstance(blades, dict):
        return
    path = blades.pop("modes", None)
    if path is not None:
        if not isinstance(path, str) or not path.strip():
            fail(name, f'[blades] modes = {toml_text(path)} must name a CSV file, e.g. modes = "blade.csv"')
        if is_set:
            blades.clear()
        blades |= list_entries("modes", modes_in_csv((Path() if is_set else folder) / path))
    plain, modes = split_list(blades, MODE_ENTRY)
    if not modes:
        return
    if of_lumped := [entry for entry in plain if f"blades.{entry}" not in LIMIT_KEYS]:
        fail(name, f"[blades] gives both modes and `{of_lumped[0]}`; keep one of them")
    if len(modes) > MAX_MODES:
        fail(name, f"[blades] has {len(modes)} modes, but a blade has at most {MAX_MODES}; leave the highest ones out")
    document["blades"] = plain | list_entries("modes", with_frequencies(modes, f"{name}: [blades]"))


def modes_in_csv(path: Path) -> list[dict[str, Any]]:
    """The modes of a CSV file, by their names, in SI units.

    Raises:
        SceneError: It cannot be read, or a cell is no number.
    """
    try:
        table = read_csv(path)
    except InputError as error:
        raise SceneError(str(error).replace("has no designs", "has no modes")) from None
    for row, fault in table.faults.items():
        fail(str(path), f"mode [{row}]: {fault}")
    columns: dict[str, list[Any]] = {KIND: [cell.strip() for cell in table.columns.pop(KIND, [])]}
    for text, cells in table.columns.items():
        if text.strip() not in NOTES:
            head = number_head(text, UNITS_OF_MODES, EXAMPLE_OF_MODES, path)
            columns[head.name] = [
                number_in_cell(cell, head.name, f"mode [{i}]", path) * head.factor if cell.strip() else None
                for i, cell in enumerate(cells)
            ]
    rows = zip_longest(*columns.values())
    return [{name: value for name, value in zip(columns, row, strict=True) if value is not None} for row in rows]


def with_frequencies(modes: Sequence[Mapping[str, Any]], where: str) -> list[dict[str, Any]]:
    """Modes with frequencies in the place of their squares, those of rigid motions 0.

    Raises:
        SceneError: A mode has both, or a square is negative.
    """
    listed = [dict(mode) for mode in modes]
    own = [mode for mode in listed if mode.pop(KIND, None) != "residual"]
    for j, mode in enumerate(listed):
        if SQUARE in mode and "f" in mode:
            fail(where, f"modes[{j}] gives both `f` and `{SQUARE}`; keep one of them")
        if SQUARE in mode:
            square = mode.pop(SQUARE)
            if not is_number(square):
                fail(where, f"modes[{j}].{SQUARE} = {toml_text(square)} must be a number in rad^2/s^2")
            mode["f"] = math.copysign(math.sqrt(abs(square)), square) / math.tau
    rigid = highest_rigid([mode["f"] for mode in own if is_number(mode.get("f"))])
    for j, mode in enumerate(listed):
        if not is_number(mode.get("f")):
            continue
        if abs(mode["f"]) <= rigid:
            mode["f"] = 0.0
        if mode["f"] < 0:
            fail(where, f"modes[{j}] has a negative omega^2: its blade is unstable, or the stiffness has a wrong sign")
    return listed


def highest_rigid(frequencies: Iterable[float | int]) -> float:
    """The frequency up to which modes with these are rigid motions; -1 where none is."""
    known = sorted(map(abs, frequencies))
    return max((float(below) for below, above in pairwise(known) if below**2 < RIGID * above**2), default=-1.0)
