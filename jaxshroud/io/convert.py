"""Results as tables (CSV) and as MATLAB files, for other programs."""

import io
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxshroud.io.files import write
from jaxshroud.io.store import write_dataset
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.units import in_rpm
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import xarray as xr

Rows = Literal["lane", "sample"]
LONGEST_NAME = 63  # characters, in MATLAB
PLACES = {"blade", "interface"}  # dimensions of what has a value for each place


def convert(data: "xr.Dataset", path: Path, rows: Rows | None = None) -> None:
    """Write a result as a file of the kind that the suffix names.

    Args:
        data: The result.
        path: The file, which ends in .csv, .mat or .nc.
        rows: The rows of a table: one for each "lane", or one for each "sample" of each lane; by default lanes where
            there are many, else samples.

    Raises:
        ValueError: The suffix is none of these, or the result has no such rows.
        WriteError: The path cannot be written.
    """
    if path.suffix not in WRITERS:
        raise InputError(f"{path}: must end in {', '.join(WRITERS)}, which says what to write")
    if rows is not None and path.suffix != ".csv":
        raise InputError(f"{path}: holds the arrays as they are; rows are those of .csv")
    WRITERS[path.suffix](data, path, rows)


def _csv(data: "xr.Dataset", path: Path, rows: Rows | None) -> None:
    text = csv_text(data, rows).encode()
    constants = constants_of(data, rows)
    if constants:
        import tomli_w

        write(constants_path(path), tomli_w.dumps(constants).encode())
    write(path, text)


def constants_path(path: Path) -> Path:
    """The file beside a table that has what all of its rows share."""
    return path.with_suffix(".toml")


def holds_constants(path: Path) -> bool:
    """Whether a file is what an earlier table had beside it."""
    try:
        with open_regular(path) as file:
            return {"values", "units"} <= tomllib.load(file).keys()
    except (OSError, ValueError):
        return False


def constants_of(data: "xr.Dataset", rows: Rows | None = None) -> dict[str, Any]:
    """What all rows of a table share, as TOML holds it: variables without a dimension of the rows, and their units.

    A value for each blade or interface is a list.
    """
    dims = _row_dims(data, rows)
    shared = [v for v in data.data_vars.values() if dims and set(v.dims) <= PLACES - {*dims}]
    if not shared:
        return {}
    units = {str(v.name): v.attrs["units"] for v in shared if v.attrs.get("units", "1") != "1"}
    words = {"title": data.attrs["title"]} if data.attrs.get("title") else {}
    return {**words, "values": {str(v.name): v.to_numpy().tolist() for v in shared}, "units": units}


def _mat(data: "xr.Dataset", path: Path, _: Rows | None) -> None:
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, arrays(data), long_field_names=True, oned_as="column")
    write(path, file.getvalue())


def _nc(data: "xr.Dataset", path: Path, _: Rows | None) -> None:
    write_dataset(data, path)


WRITERS: dict[str, Callable[["xr.Dataset", Path, Rows | None], None]] = {".csv": _csv, ".mat": _mat, ".nc": _nc}


def csv_text(data: "xr.Dataset", rows: Rows | None = None) -> str:
    """All variables with one value per row, as comma-separated text: a header with units, then a line for each row.

    Coordinates come first. A variable with a value for each blade or interface becomes as many columns, `x[0]`, `x[1]`
    and so on. What is the same in all rows is left out, see `constants_of`. Speeds of rotation are in rpm.
    """
    import xarray as xr

    dims = _row_dims(data, rows)
    columns = {}
    data = _with_speeds_in_rpm(data)
    for name, variable in data.data_vars.items():
        if set(variable.dims) <= {*dims, *PLACES} and not (dims and set(variable.dims) <= PLACES - {*dims}):
            columns |= {head: column.variable for head, column in columns_by_place(str(name), variable)}
    coords = {name: data.coords[name].variable for name in data.coords if set(data.coords[name].dims) <= set(dims)}
    if not dims:
        return xr.Dataset(columns).expand_dims("row").to_dataframe().to_csv(index=False, na_rep="nan")
    frame = xr.Dataset(columns, coords).to_dataframe(dim_order=list(dims))
    frame.index.names = [
        column_head(str(name), None, data[name]) if name in data else name for name in frame.index.names
    ]
    return frame.to_csv()


def _with_speeds_in_rpm(data: "xr.Dataset") -> "xr.Dataset":
    """The result with its speeds of rotation in revolutions per minute, with the digits that a double keeps."""
    speeds = [name for name, variable in data.variables.items() if variable.attrs.get("key") == "drive.speed"]
    for name in speeds:
        values = np.vectorize(in_rpm, otypes=[float])(data[name].to_numpy())
        data = data.assign({name: (data[name].dims, values, {**data[name].attrs, "units": "rpm"})})
    return data


def _row_dims(data: "xr.Dataset", rows: Rows | None) -> tuple[str, ...]:
    """The dimensions of the rows."""

    def dims_of(name):
        return tuple(str(dim) for dim in data[name].dims if dim != "blade") if name in data else ()

    lanes = dims_of("status")
    samples = dims_of("x") or dims_of("P_d") or max(map(dims_of, data.data_vars), key=len, default=())
    if rows == "lane" and not lanes:
        raise InputError("This result has a single lane; its rows are samples.")
    if rows == "sample" and samples == lanes:
        raise InputError("This result has no samples; its rows are lanes.")
    return lanes if rows == "lane" or (rows is None and lanes) else samples


def columns_by_place(name: str, variable: "xr.DataArray") -> "Iterator[tuple[str, xr.DataArray]]":
    """The columns of a variable with their heads: one for each blade or interface, where it has values for these."""
    for place in PLACES & {*variable.dims}:
        for i in range(variable.sizes[place]):
            yield column_head(name, i, variable), variable.isel({place: i})
        return
    yield column_head(name, None, variable), variable


def column_head(name: str, place: int | None, column: "xr.DataArray") -> str:
    """The head of a column: the name of a variable, the blade or interface if there are several, and the unit."""
    units = column.attrs.get("units", "")
    head = name if place is None else f"{name}[{place}]"
    return f"{head} [{units}]" if units not in ("", "1") else head


def arrays(data: "xr.Dataset") -> dict[str, object]:
    """All arrays under names that MATLAB takes, with `dims`, `units` and `attributes` as structures."""
    names = {str(name): _identifier(str(name)) for name in data.variables}
    attributes = {
        "dims": {names[str(n)]: " ".join(map(str, v.dims)) for n, v in data.variables.items()},
        "units": {names[str(n)]: v.attrs["units"] for n, v in data.variables.items() if "units" in v.attrs},
        "attributes": {_identifier(str(n)): _matlab_value(v) for n, v in data.attrs.items()},
    }
    return {names[str(n)]: _matlab_value(v.to_numpy()) for n, v in data.variables.items()} | attributes


def _matlab_value(value: object) -> object:
    """`value` as MATLAB holds it: arrays of strings become cells."""
    array = np.asarray(value)
    return array.astype(object) if array.ndim and array.dtype.kind in "UO" else value


def _identifier(name: str) -> str:
    """A name that MATLAB takes."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return (plain if plain[:1].isalpha() else f"n_{plain}")[:LONGEST_NAME]
