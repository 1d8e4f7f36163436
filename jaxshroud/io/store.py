"""Results on disk: NetCDF through xarray, and JSON for summaries. Files appear completely or not at all."""

import gc
import json
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from jaxshroud.batch.limits import check_memory
from jaxshroud.io.files import write
from jaxshroud.io.left_out import packages_left_out
from jaxshroud.io.unfinished_store import BLOCKED, DESCRIPTION_FILE, OTHERS, RESUME, group_attributes, store_damage
from jaxshroud.scene.checks import StoreError
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    import xarray as xr


LARGE = 2**30  # bytes
LONGEST_REASON = 120  # characters of another library's message that an error quotes
JSONValue: TypeAlias = bool | int | float | str | list["JSONValue"] | dict[str, "JSONValue"] | None


def read(path: str | os.PathLike[str], *, checked: bool = True) -> "xr.Dataset":
    """A stored dataset, loaded completely; of a Zarr store that is `LARGE` arrays are loaded when they are used.

    Args:
        path: The file or the store.
        checked: Whether Zarr stores are first compared with their records, which reads every chunk once.

    Raises:
        StoreError: The file is missing, truncated, damaged or not a result.
    """
    path = Path(path)
    if path.suffix == ".zarr":
        return _read_zarr(path, checked)
    if path.is_dir():
        raise StoreError(f"{path}: is a folder; give the result in it, such as {path / 'sweep.nc'}")
    if not path.is_file():
        kind = "is no regular file" if path.exists() else "no such file"
        raise StoreError(f"{path}: {kind}; give a result written by jaxshroud")
    return _read_netcdf(path)


def _read_netcdf(path: Path) -> "xr.Dataset":
    import xarray as xr

    with _half_opened_files_silent():
        try:
            with xr.open_dataset(path, engine="h5netcdf", phony_dims="access") as ds:
                check_memory("it", ds.nbytes)
                _check_sizes(ds, path)
                return _checked_texts(ds.load())
        except Exception as error:  # h5py raises many types on damaged files
            reason = _reason(error)
        gc.collect()  # here, and not when nobody listens
    raise StoreError(f"{path}: not a complete result file ({reason}); run the command again")


@contextmanager
def _half_opened_files_silent() -> Iterator[None]:
    """Within, h5netcdf's files that failed to open end without a word: their `__del__` fails too."""
    outer = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if not str(getattr(unraisable.object, "__module__", "")).startswith("h5netcdf"):
            outer(unraisable)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = outer


def _read_zarr(path: Path, checked: bool) -> "xr.Dataset":
    import xarray as xr

    if not (path / DESCRIPTION_FILE).exists():
        raise StoreError(f"{path}: no such store, or one in which nothing is finished; run the command again")
    try:
        if checked and (damage := store_damage(path)):
            raise ValueError(damage)
        with warnings.catch_warnings(action="ignore"):  # about other files in the folder
            ds = xr.open_zarr(path, chunks=None, consolidated=False, zarr_format=3)
        stored = group_attributes(path / RESUME)
        ds = ds[[*stored[BLOCKED], *stored[OTHERS]]]
        ds = ds.assign({name: a.astype(object).astype(str) for name, a in ds.variables.items() if a.dtype.kind == "T"})
        return _checked_texts(ds.load() if ds.nbytes < LARGE else ds)
    except Exception as error:  # of any type: it depends on where it is damaged
        raise StoreError(f"{path}: damaged ({_reason(error)}); --resume of the same sweep computes it anew") from None


def _reason(error: Exception) -> str:
    """The beginning of an error's message, in one line."""
    return " ".join(str(error).split())[:LONGEST_REASON]


def _check_sizes(ds: "xr.Dataset", path: Path) -> None:
    """Raise ValueError unless each variable has the size of its dimensions, as missing values would be read as 0."""
    import h5py

    with h5py.File(path) as file:
        for name, variable in ds.variables.items():
            stored = getattr(file.get(str(name)), "shape", variable.shape)
            if "phony_dim" in str(variable.dims) or stored != variable.shape:
                raise ValueError(f"{name} has not the size of its dimensions")


def _checked_texts(ds: "xr.Dataset") -> "xr.Dataset":
    """The dataset itself, after a check that its texts can be shown and written.

    Raises:
        ValueError: A text is not UTF-8.
    """
    values = [a.to_numpy().tolist() for a in ds.variables.values() if a.dtype.kind in "OU"]
    try:
        json.dumps([ds.to_dict(data=False), values], ensure_ascii=False, default=str).encode()
    except UnicodeEncodeError:
        raise ValueError("a text is not UTF-8") from None
    return ds


def write_dataset(ds: "xr.Dataset", path: Path) -> None:
    """Write a dataset, completely or not at all; in memory first, as HDF5 does not survive a full disk."""
    write(path, dataset_content(ds))


def dataset_content(ds: "xr.Dataset") -> bytes | memoryview:
    """A dataset as the content of a NetCDF file."""
    with packages_left_out():
        return ds.to_netcdf(engine="h5netcdf")


def write_json(data: Mapping[str, object], path: Path) -> None:
    """Write JSON, completely or not at all. NaN becomes null."""
    write(path, (json.dumps(json_values(data), indent=1) + "\n").encode())


def read_json(path: Path) -> Any:
    """A stored summary, as `json.loads` gives it.

    Raises:
        StoreError: The file is missing or not complete JSON.
    """
    try:
        with open_regular(path) as file:
            return json.load(file)
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); run the command again") from None


def json_values(value: object) -> Any:
    """`value` as JSON holds it: arrays and tuples as lists, and None for numbers that are not finite."""
    text = json.dumps(value, default=lambda array: array.tolist())
    return json.loads(text, parse_constant=lambda _: None)
