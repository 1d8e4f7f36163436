"""Matrices of finite elements in files: of NumPy, Matrix Market and the text of CalculiX, with labels of unknowns.

| file | holds |
|---|---|
| `.npz` of NumPy | arrays `K`, `M`, perhaps `C`, `dofs` and `nodes`, dense; or one matrix as scipy.sparse saves it |
| Matrix Market, under any suffix | one matrix |
| three columns of text: row, column, value from 1 on | one matrix, as CalculiX writes it (.sti, .mas) |
| unknowns: a line `node.direction` for each row | directions 1 to 3: along x, y, z; 4 to 6: turns about them |
| nodes: lines `node, x, y, z` | coordinates, of the shroud's nodes at least |
"""

import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.csv_text import read_csv_text
from jaxshroud.scene.typed import FloatArray

MARKET = b"%%MatrixMarket"
ZIP = b"PK\x03\x04"
HDF5 = b"\x89HDF"
LABEL = re.compile(r"\s*(?P<node>[^\s.,]+)\s*[.,\s]\s*(?P<direction>[1-6])\s*")
INSTEAD_OF_OTHERS = "save K and M as Matrix Market (scipy.io.mmwrite) or in one .npz (numpy.savez)"


class Unknown(NamedTuple):
    """What a row of the matrices is."""

    node: str
    direction: int  # 1 to 3: along x, y and z; 4 to 6: turns about them

    def __str__(self) -> str:
        """As in files."""
        return f"{self.node}.{self.direction}"


def unknown_of(label: str) -> Unknown:
    """The unknown of a label, "node.direction" as text, as 7.1 is not 7.10.

    Raises:
        InputError: It is none.
    """
    match = LABEL.fullmatch(label)
    if match is None:
        raise InputError(f"an unknown is {label.strip()!r}, but must be node.direction with a direction from 1 to 6")
    return Unknown(match["node"], int(match["direction"]))


class ModelArrays(NamedTuple):
    """What files give of a model; None for what they do not."""

    K: Any = None
    M: Any = None
    C: Any = None
    dofs: tuple[str, ...] | None = None
    nodes: dict[str, FloatArray] | None = None


def read_model(paths: Sequence[Path]) -> ModelArrays:
    """The matrices of files: one .npz with all of them, or K, then M, and C if there is one.

    Raises:
        InputError: A file cannot be read, or holds something else.
    """
    first = paths[0]
    if len(paths) == 1:
        arrays = _arrays_of_zip(first) if _head(first).startswith(ZIP) else {}
        missing = [name for name in ("K", "M") if name not in arrays]
        if missing:
            raise InputError(f"{first}: holds no {missing[0]}; name the files of K and of M, or an .npz with both")
        dofs = arrays.get("dofs")
        labels = None if dofs is None else _unknowns((".".join(map(str, np.atleast_1d(one))) for one in dofs), first)
        rows = arrays.get("nodes")
        nodes = None if rows is None else _nodes((list(map(_plain, row)) for row in rows), first)
        return ModelArrays(arrays["K"], arrays["M"], arrays.get("C"), labels, nodes)
    matrices = dict(zip(("K", "M", "C"), map(read_matrix, paths), strict=False))
    return ModelArrays(**matrices)


def _plain(value: Any) -> str:
    """A number of a table of nodes as text: labels are whole."""
    return str(int(value)) if isinstance(value, float) and float(value).is_integer() else str(value)


def read_matrix(path: Path) -> Any:
    """One matrix of a file; dense, or sparse with the entries that are stored."""
    from scipy.io import mmread
    from scipy.sparse import coo_array, load_npz

    head = _head(path)
    try:
        if head.startswith(MARKET):
            return mmread(path)
        if head.startswith(ZIP):
            arrays = _arrays_of_zip(path)
            return load_npz(path) if "format" in arrays else next(iter(arrays.values()))
    except (ValueError, KeyError, OSError, NotImplementedError) as error:
        raise InputError(f"{path}: cannot be read as a matrix ({error}); {INSTEAD_OF_OTHERS}") from None
    if head.startswith(HDF5) or b"\0" in head:
        raise InputError(f"{path}: is in a form that is not read; {INSTEAD_OF_OTHERS}")
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (ValueError, OSError) as error:
        raise InputError(
            f"{path}: is no Matrix Market file, nor columns `row column value` ({_first_line(error)}); "
            f"files that Abaqus calls .mtx are neither: {INSTEAD_OF_OTHERS}"
        ) from None
    if rows.shape[1] != 3 or not len(rows) or np.any(rows[:, :2] < 1) or np.any(rows[:, :2] % 1):
        raise InputError(
            f"{path}: must have columns `row column value` with rows and columns from 1 on, as CalculiX writes them; "
            f"other text, as of Abaqus, is not read: {INSTEAD_OF_OTHERS}"
        )
    i, j = rows[:, :2].T.astype(int) - 1
    size = max(i.max(), j.max()) + 1
    return coo_array((rows[:, 2], (i, j)), shape=(size, size))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0].rstrip(".;")


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(512)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _arrays_of_zip(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as .npz of plain arrays ({_first_line(error)})") from None


def read_dofs(path: Path) -> tuple[str, ...]:
    """What each row of the matrices is, from lines `node.direction`."""
    lines = read_csv_text(path, "a text file with a line node.direction for each row").splitlines()
    return _unknowns((line for line in lines if line.strip()), path)


def _unknowns(labels: Iterable[str], path: Path) -> tuple[str, ...]:
    try:
        found = tuple(str(unknown_of(label)) for label in labels)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if len(set(found)) < len(found):
        twice = next(one for one, count in Counter(found).items() if count > 1)
        raise InputError(f"{path}: {twice} stands for two rows; each is one unknown")
    return found


def read_nodes(path: Path) -> dict[str, FloatArray]:
    """The coordinates of nodes, from lines `node, x, y, z`; other lines, such as keywords, are left out."""
    lines = read_csv_text(path, "a text file with lines node, x, y, z").splitlines()
    rows = (re.split(r"[,;\s]+", line.strip()) for line in lines)
    return _nodes((row for row in rows if len(row) >= 4 and _are_numbers(row[1:4])), path)


def _are_numbers(cells: Sequence[str]) -> bool:
    try:
        return bool(np.isfinite([*map(float, cells)]).all())
    except ValueError:
        return False


def _nodes(rows: Iterable[Sequence[str]], path: Path) -> dict[str, FloatArray]:
    found = {row[0]: np.array([*map(float, row[1:4])]) for row in rows}
    if not found:
        raise InputError(f"{path}: holds no nodes; give lines node, x, y, z")
    return found
