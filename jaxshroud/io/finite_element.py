"""Finite elements in files: of NumPy, MATLAB, Matrix Market and the text of CalculiX, with labels of unknowns.

| file | holds |
|---|---|
| `.npz` of NumPy | arrays `K`, `M`, perhaps `C`, `dofs` and `nodes`, dense; or one matrix as scipy.sparse saves it |
| `.mat` of MATLAB | the same, as plain arrays; before 7.3 sparse ones too |
| `.npz` or `.mat` of shapes | arrays `f`, `phi`, perhaps `zeta`, `mass`, `kind`, `dofs` and `nodes` |
| CSV of shapes | lines `f`, `zeta`, `mass`, `kind`, then `node.direction`, with a cell of each mode |
| Matrix Market, under any suffix | one matrix |
| three columns of text: row, column, value from 1 on | one matrix, as CalculiX writes it (.sti, .mas) |
| unknowns: a line `node.direction` for each row | directions 1 to 3: along x, y, z; 4 to 6: turns about them |
| nodes: lines `node, x, y, z` | coordinates; six more numbers are the x and the y axis of a node's unknowns |
"""

import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.csv_text import read_csv_text
from jaxshroud.scene.typed import FloatArray

MATLAB = b"MATLAB "
MARKET = b"%%MatrixMarket"
ZIP = b"PK\x03\x04"
HDF5 = b"\x89HDF"
LABEL = re.compile(r"\s*(?P<node>[^\s.,]+)\s*[.,\s]\s*(?P<direction>[1-6])\s*")
MOST_ROWS = 1e8  # of a matrix in text
INSTEAD_OF_OTHERS = (
    "save K and M as Matrix Market (scipy.io.mmwrite), or as plain arrays in one .npz (numpy.savez) or .mat (save -v7)"
)


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


ARRAYS_OF_MATRICES = (("K", "M"), ("C",))  # what a file must have, and what else it may
ARRAYS_OF_SHAPES = (("f", "phi"), ("zeta", "mass", "M", "kind"))


def read_model(paths: Sequence[Path]) -> dict[str, Any]:
    """The arguments of `reduce`, or with shapes those of `reduce_shapes`, that files give.

    Args:
        paths: One file with all of them, or those of K, then M, and C if there is one.

    Raises:
        InputError: A file cannot be read, or holds something else.
    """
    first = paths[0]
    if len(paths) > 1:
        return {name: read_matrix(path, name) for name, path in zip("KMC", paths, strict=False)}
    arrays = _arrays_of(first)
    if arrays is None:
        head = _head_of_text(first)
        arrays = _shapes_of_csv(first) if b"," in head and not head.startswith(MARKET) else {}
    needed, further = ARRAYS_OF_SHAPES if "phi" in arrays else ARRAYS_OF_MATRICES
    if missing := [name for name in needed if name not in arrays]:
        raise InputError(f"{first}: holds no {missing[0]}; name the files of K and of M, or an .npz with both")
    found = {name: arrays[name] for name in (*needed, *further, "dofs", "nodes") if name in arrays}
    if "dofs" in found:
        found["dofs"] = _unknowns((".".join(map(_plain, np.atleast_1d(one))) for one in found["dofs"]), first)
    if "nodes" in found:
        found["nodes"] = _nodes((list(map(_plain, row)) for row in found["nodes"]), first)
    if "kind" in found:
        found["residual"] = np.char.strip(np.ravel(found.pop("kind")).astype(str)) == "residual"
    return found


def _cells(path: Path) -> Any:
    """The cells of a CSV file below its head, as text (rows, columns)."""
    lines = read_csv_text(path, "a CSV file").splitlines()[1:]
    if not any(map(str.strip, lines)):
        raise InputError(f"{path}: has nothing below its head")
    try:
        return np.loadtxt(lines, str, delimiter=",", ndmin=2)
    except ValueError as error:
        raise InputError(f"{path}: is no table below a head ({_first_line(error)})") from None


def _numbers(cells: Any, kind: type, path: Path) -> Any:
    """The numbers of cells, complex ones with i or j."""
    try:
        return np.char.replace(np.char.replace(cells, "i", "j"), " ", "").astype(kind)
    except ValueError as error:
        raise InputError(f"{path}: {error}; a cell is a number, as 0.1 or 0.1+0.2j") from None


def read_numbers(path: Path) -> FloatArray:
    """The numbers of a CSV file below its head, (rows, columns)."""
    return _numbers(_cells(path), float, path)


def _shapes_of_csv(path: Path) -> dict[str, Any]:
    """The arrays of a CSV file of shapes: a head, then lines of a name, or an unknown, and a cell of each mode."""
    cells = _cells(path)
    names = [label.partition("[")[0].strip() for label in cells[:, 0].tolist()]
    rows = {name: row for name, row in zip(names, cells[:, 1:], strict=True) if name in ("f", *ARRAYS_OF_SHAPES[1])}
    found = {name: row if name == "kind" else _numbers(row, float, path) for name, row in rows.items()}
    others = [i for i, name in enumerate(names) if name not in rows]
    return {**found, "phi": _numbers(cells[others, 1:], complex, path), "dofs": [names[i] for i in others]}


def _plain(value: Any) -> str:
    """A number of a table of nodes as text: labels are whole."""
    while isinstance(value, np.ndarray):  # a cell of MATLAB
        value = value.item()
    return str(int(value)) if isinstance(value, float) and float(value).is_integer() else str(value)


def read_matrix(path: Path, name: str) -> Any:
    """One matrix of a file, of several arrays the one of that name; dense, or sparse with the entries that are stored.

    Raises:
        InputError: The file cannot be read, or holds something else.
    """
    from scipy.io import mmread
    from scipy.sparse import coo_array, load_npz

    arrays = _arrays_of(path)
    try:
        if (head := _head(path)).startswith(MARKET):
            if b" pattern " in head:
                raise ValueError("a pattern has no values")
            return mmread(path)
        if arrays is not None:
            return load_npz(path) if "format" in arrays else arrays[name if len(arrays) > 1 else next(iter(arrays))]
    except (ValueError, KeyError, OSError, NotImplementedError) as error:
        raise InputError(f"{path}: cannot be read as a matrix ({error}); {INSTEAD_OF_OTHERS}") from None
    rows = np.zeros((1, 3))
    if _head_of_text(path).strip():
        with suppress(ValueError):
            rows = np.loadtxt(path, ndmin=2)
    if rows.shape[1] != 3 or np.any(rows[:, :2] % 1) or not (1 <= rows[:, :2].min() <= rows[:, :2].max() < MOST_ROWS):
        raise InputError(
            f"{path}: is no Matrix Market file, nor columns `row column value` from 1 on, as CalculiX writes them; "
            f"files that Abaqus calls .mtx are neither: {INSTEAD_OF_OTHERS}"
        )
    i, j = rows[:, :2].T.astype(int) - 1
    size = max(i.max(), j.max()) + 1
    return coo_array((rows[:, 2], (i, j)), shape=(size, size))


def _first_line(error: Exception) -> str:
    return re.split("[\n;]", str(error))[0].rstrip(".")


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(512)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _head_of_text(path: Path) -> bytes:
    head = _head(path)
    if head.startswith(HDF5) or b"\0" in head:
        raise InputError(f"{path}: is in a form that is not read; {INSTEAD_OF_OTHERS}")
    return head


def _arrays_of(path: Path) -> dict[str, Any] | None:
    """The arrays of a file of NumPy or MATLAB by their names; None of any other."""
    from scipy.io import loadmat

    head = _head(path)
    try:
        if head.startswith(ZIP):
            with np.load(path, allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        if head.startswith(MATLAB):
            found = _arrays_of_hdf5(path) if head.startswith(MATLAB + b"7.3") else loadmat(path)
            arrays = {name: a for name, a in found.items() if name[:1] not in "_#"}
            if lost := [name for name, a in arrays.items() if a is None or a.dtype.kind == "V"]:
                raise ValueError(f"{lost[0]} is an object")
            return arrays
    except (ValueError, OSError, NotImplementedError, TypeError, zipfile.BadZipFile) as error:
        why = _first_line(error)
        raise InputError(f"{path}: cannot be read as plain arrays ({why}); {INSTEAD_OF_OTHERS}") from None
    return None


def _arrays_of_hdf5(path: Path) -> dict[str, Any]:
    """The arrays of a file of MATLAB 7.3, which are stored transposed; None for what is no plain array."""
    import h5py

    with h5py.File(path) as file:
        found: Any = file.items()
        return {name: a[()].T if isinstance(a, h5py.Dataset) and len(a.attrs) < 2 else None for name, a in found}


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
    return _nodes((re.split(r"[,;\s]+", line.strip()) for line in lines), path)


def _nodes(rows: Iterable[Sequence[str]], path: Path) -> dict[str, FloatArray]:
    found = {}
    for node, *cells in rows:
        with suppress(ValueError):  # of what is no line of a node
            numbers = np.array(cells[: 9 if len(cells) == 9 else 3], float)
            if len(numbers) >= 3 and np.isfinite(numbers).all():
                found[node] = numbers
    if not found:
        raise InputError(f"{path}: holds no nodes; give lines node, x, y, z")
    return found
