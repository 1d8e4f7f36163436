"""A table of the load over one base period, as CFD gives it, fitted by harmonics of a drive.

`[drive] table = "pressure.csv"` names a CSV file with a head `angle [deg], F_x [N], F_y [N], M [N m]`, of which the
angle and one load are needed, and `harmonics = 3` says how many are fitted. Its mean is the mean load.
"""

from collections.abc import Collection
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import InputError, SceneError, fail, toml_text
from jaxshroud.scene.csv_text import csv_rows, number_head, number_in_cell, read_csv_text
from jaxshroud.scene.keys import MAX_ORDER
from jaxshroud.scene.typed import FloatArray

UNITS_OF_LOADS = {"angle": "rad", "F_x": "N", "F_y": "N", "M": "N m"}  # of the columns
INSTEAD = ("beta", "F_0", "M_0", "F_x_mean", "F_y_mean", "M_mean")  # what a table stands for
EXAMPLE_OF_HEAD = "angle [deg], F_x [N], F_y [N], M [N m]"
SAME_ANGLE = 1e-9  # [rad] within which two angles are one
LARGEST_CONDITION = 30.0  # of the fit: where angles leave a part of the period out, loads there would be invented


class FittedTable(NamedTuple):
    """The harmonics of a table."""

    entries: dict[str, Any]  # of the table [drive]
    residuals: dict[str, float]  # of each load: RMS of the rest over that of the table about its mean

    @property
    def words(self) -> str:
        """What the harmonics leave out, in words."""
        count = sum(entry.endswith(".order") for entry in self.entries)
        rests = ", ".join(f"{100 * rest:.3g} % of {load}" for load, rest in self.residuals.items())
        return f"{'1 harmonic leaves' if count == 1 else f'{count} harmonics leave'} {rests} (RMS, about the mean)"


def resolve_table(document: dict[str, Any], folder: Path, name: str, overridden: Collection[tuple[str, str]]) -> str:
    """Replace the table of a [drive] by harmonics and mean loads, in place; what they leave out, in words.

    Args:
        document: The document of a scene file.
        folder: Of the file, from which the table's path counts; that of an override counts from where one is.
        name: The name of the file in messages.
        overridden: The tables and keys that were overridden.

    Raises:
        SceneError: The table cannot be read or fitted, or stands beside what it gives.
    """
    drive = document.get("drive")
    if not isinstance(drive, dict) or "table" not in drive:
        return ""
    path, count = drive.pop("table"), drive.pop("harmonics", None)
    given = [key for key in drive if key in INSTEAD or key.startswith("harmonic")]
    if given:
        fail(name, f"[drive] gives both `table` and `{given[0]}`; keep one of them")
    if not isinstance(path, str) or not path.strip():
        fail(name, f'[drive] table = {toml_text(path)} must name a CSV file, e.g. table = "pressure.csv"')
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_ORDER:
        fail(
            name, f"[drive] harmonics = {toml_text(count)} must be from 1 to {MAX_ORDER}: so many are fitted to `table`"
        )
    here = Path() if ("drive", "table") in overridden else folder
    fitted = fitted_table(here / path, count)
    drive |= fitted.entries
    return fitted.words


def fitted_table(path: Path, count: int) -> FittedTable:
    """The harmonics of orders 1 to `count` that fit a table best, by least squares.

    Raises:
        SceneError: The table cannot be read, or its angles do not determine so many harmonics.
    """
    columns = _one_period(_columns_of_loads(path))
    angle = columns.pop("angle")
    _check_angles(angle, count, path)
    waves = [np.ones_like(angle), *(f(n * angle) for n in range(1, count + 1) for f in (np.sin, np.cos))]
    basis = np.stack(waves, axis=-1)
    if np.linalg.cond(basis) > LARGEST_CONDITION:
        fail(str(path), f"its angles leave a part of the period out, by which {count} harmonics are undetermined")
    entries: dict[str, Any] = {f"harmonic[{n}].order": n + 1 for n in range(count)}
    residuals = {}
    for load, values in columns.items():
        parts = np.linalg.lstsq(basis, values, rcond=None)[0]
        entries[f"{load}_mean"] = float(parts[0])
        for n in range(count):
            sine, cosine = map(float, parts[1 + 2 * n : 3 + 2 * n])
            entries |= {f"harmonic[{n}].{load}_re": sine, f"harmonic[{n}].{load}_im": cosine}
        about_mean = np.sqrt(np.mean((values - parts[0]) ** 2))
        rest = np.sqrt(np.mean((values - basis @ parts) ** 2))
        residuals[load] = float(rest / about_mean) if about_mean else 0.0
    return FittedTable(entries, residuals)


def _one_period(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """The columns without a last row that closes the period: that repeats the loads of the first one."""
    first, last = ({name: values[i] for name, values in columns.items() if len(values)} for i in (0, -1))
    turn = last.pop("angle", 0.0) - first.pop("angle", 0.0)
    if abs(abs(turn) - 2 * np.pi) < SAME_ANGLE and last == first:
        return {name: values[:-1] for name, values in columns.items()}
    return columns


def _check_angles(angle: FloatArray, count: int, path: Path) -> None:
    """Raise a SceneError unless all angles differ within a period, and are enough for so many harmonics."""
    if len(angle) < 2 * count + 1:
        fail(str(path), f"has {len(angle)} angles; {count} harmonics need at least {2 * count + 1}")
    turned = np.sort(np.mod(angle, 2 * np.pi))
    apart = np.diff(turned, append=turned[0] + 2 * np.pi)
    if np.any(apart < SAME_ANGLE):
        same = np.degrees(turned[np.argmin(apart)])
        fail(str(path), f"two angles are alike, at {same:.6g} deg of the base period; keep one of them")


def _columns_of_loads(path: Path) -> dict[str, FloatArray]:
    """The columns of a table in SI units."""
    try:
        text = read_csv_text(path, f"a CSV file with a head such as {EXAMPLE_OF_HEAD}")
        lines = csv_rows(path, enumerate(StringIO(text, newline=""), 1), ",")
    except InputError as error:
        raise SceneError(str(error)) from None
    rows = [row for _, row in lines if any(cell.strip() for cell in row)]
    heads = [number_head(cell, UNITS_OF_LOADS, EXAMPLE_OF_HEAD, path) for cell in rows[0]] if rows else []
    names = [head.name for head in heads]
    if bare := next((head.name for head in heads if not head.unit), ""):
        fail(str(path), f"column {bare} has no unit; write such as {EXAMPLE_OF_HEAD}")
    if "angle" not in names or len(names) < 2 or len(set(names)) < len(names):
        fail(str(path), f"needs a head with the angle and a load, each once, such as {EXAMPLE_OF_HEAD}")
    if ragged := next((i for i, row in enumerate(rows[1:], 2) if len(row) != len(heads)), None):
        fail(str(path), f"row {ragged} has {len(rows[ragged - 1])} cells, but there are {len(heads)} columns")
    cells = zip(*rows[1:], strict=True) if len(rows) > 1 else ([] for _ in heads)
    return {
        head.name: np.array([number_in_cell(cell, head.name, f"row {i}", path) for i, cell in enumerate(column, 2)])
        * head.factor
        for head, column in zip(heads, cells, strict=True)
    }
