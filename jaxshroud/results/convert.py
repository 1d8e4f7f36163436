"""Results as other programs read them: tables (CSV) and MATLAB files."""

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxshroud.results.files import write
from jaxshroud.results.store import write_dataset
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

Rows = Literal["lane", "sample"]
NAME = 63  # characters of a name in MATLAB


def convert(data: "xr.Dataset", path: Path, rows: Rows | None = None) -> None:
    """Write a result as the kind of file that the name's ending says.

    Args:
        data: The result.
        path: Ends in .csv, .mat or .nc.
        rows: Of a table: one for each "lane", or one for each "sample" of each lane; by default lanes where there are
            many, else samples.

    Raises:
        ValueError: Of another ending, or the result has no such rows.
        WriteError: The place cannot be written.
    """
    if path.suffix not in WRITERS:
        raise InputError(f"{path}: must end in {', '.join(WRITERS)}, which says what to write")
    if rows is not None and path.suffix != ".csv":
        raise InputError(f"{path}: holds the arrays as they are; rows are those of .csv")
    WRITERS[path.suffix](data, path, rows)


def _csv(data: "xr.Dataset", path: Path, rows: Rows | None) -> None:
    write(path, table(data, rows).encode())


def _mat(data: "xr.Dataset", path: Path, _: Rows | None) -> None:
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, arrays(data), long_field_names=True, oned_as="column")
    write(path, file.getvalue())


def _nc(data: "xr.Dataset", path: Path, _: Rows | None) -> None:
    write_dataset(data, path)


WRITERS: dict[str, Callable[["xr.Dataset", Path, Rows | None], None]] = {".csv": _csv, ".mat": _mat, ".nc": _nc}


def table(data: "xr.Dataset", rows: Rows | None = None) -> str:
    """All that has one value in a row, as comma-separated text: a head with units, then a line for each row.

    Coordinates come first; what each blade has its own value of is two columns, `x[0]` and `x[1]`.
    """
    import xarray as xr

    dims = _rows(data, rows)
    columns = {}
    for name, variable in data.data_vars.items():
        if set(variable.dims) <= {*dims, "blade"}:
            sides = range(variable.sizes["blade"]) if "blade" in variable.dims else (None,)
            for side in sides:
                one = variable if side is None else variable.isel(blade=side)
                columns[_head(str(name), side, one)] = one.variable
    coords = {name: data.coords[name].variable for name in data.coords if set(data.coords[name].dims) <= set(dims)}
    if not dims:
        heads, values = [*columns], [[column.item() for column in columns.values()]]
        return "\n".join(",".join(map(str, row)) for row in (heads, *values)) + "\n"
    frame = xr.Dataset(columns, coords).to_dataframe(dim_order=list(dims))
    frame.index.names = [_head(str(name), None, data[name]) if name in data else name for name in frame.index.names]
    return frame.to_csv()


def _rows(data: "xr.Dataset", rows: Rows | None) -> tuple[str, ...]:
    """The dimensions that rows run over."""
    named = lambda of: tuple(str(dim) for dim in data[of].dims if dim != "blade") if of in data else ()  # noqa: E731
    lanes = named("status")
    samples = named("x") or named("P_d") or max((named(name) for name in data.data_vars), key=len, default=())
    if rows == "lane" and not lanes:
        raise InputError("This result has a single lane; its rows are samples.")
    if rows == "sample" and samples == lanes:
        raise InputError("This result has no samples; its rows are lanes.")
    return lanes if rows == "lane" or (rows is None and lanes) else samples


def _head(name: str, side: int | None, of: Any) -> str:
    units = of.attrs.get("units", "")
    shown = name if side is None else f"{name}[{side}]"
    return f"{shown} [{units}]" if units not in ("", "1") else shown


def arrays(data: "xr.Dataset") -> dict[str, Any]:
    """All arrays by names that MATLAB takes, with `dims`, `units` and `attributes` as structures."""
    names = {str(name): _identifier(str(name)) for name in data.variables}
    told = {
        "dims": {names[str(n)]: " ".join(map(str, v.dims)) for n, v in data.variables.items()},
        "units": {names[str(n)]: v.attrs["units"] for n, v in data.variables.items() if "units" in v.attrs},
        "attributes": {_identifier(str(n)): _plain(v) for n, v in data.attrs.items()},
    }
    return {names[str(n)]: _plain(v.to_numpy()) for n, v in data.variables.items()} | told


def _plain(value: Any) -> Any:
    """`value` as MATLAB holds it: text arrays as cells."""
    array = np.asarray(value)
    return array.astype(object) if array.ndim and array.dtype.kind in "UO" else value


def _identifier(name: str) -> str:
    """A name that MATLAB takes."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return (plain if plain[:1].isalpha() else f"n_{plain}")[:NAME]
