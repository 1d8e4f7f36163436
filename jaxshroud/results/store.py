"""Results on disk: NetCDF through xarray, JSON for summaries. Files appear whole or not at all."""

import json
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.batch.extent import memory_for
from jaxshroud.results.files import write
from jaxshroud.scene.errors import StoreError

if TYPE_CHECKING:
    import xarray as xr

LARGE = 2**30  # bytes


def read(path: str | os.PathLike[str]) -> "xr.Dataset":
    """A stored dataset: loaded whole, but for Zarr stores that are `LARGE`, of which what is looked at is loaded.

    Raises:
        StoreError: The file is missing, truncated or not a result.
    """
    import xarray as xr

    if Path(path).suffix == ".zarr":
        return _read_zarr(Path(path))
    if Path(path).is_dir():
        raise StoreError(f"{Path(path)}: is a folder; give the result in it, such as {Path(path) / 'sweep.nc'}")
    if Path(path).exists() and not Path(path).is_file():
        raise StoreError(f"{path}: is no regular file; give a result written by jaxshroud")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as ds:
            memory_for("it", ds.nbytes)
            return ds.load()
    except FileNotFoundError:
        raise StoreError(f"{path}: no such file; give a result written by jaxshroud") from None
    except Exception as error:  # h5py raises many types on damaged files
        what = " ".join(str(error).split())[:120]
        raise StoreError(f"{path}: not a complete result file ({what}); run the command again") from None


def _read_zarr(path: Path) -> "xr.Dataset":
    import xarray as xr

    if not (path / "zarr.json").exists():
        raise StoreError(f"{path}: no such store, or one in which nothing is finished; run the command again")
    try:
        with warnings.catch_warnings(action="ignore"):  # of what else lies there
            ds = xr.open_zarr(path, chunks=None, consolidated=False, zarr_format=3)
        ds = ds.assign({name: a.astype(object).astype(str) for name, a in ds.variables.items() if a.dtype.kind == "T"})
        return ds.load() if ds.nbytes < LARGE else ds
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        what = " ".join(str(error).split())[:120]
        raise StoreError(f"{path}: damaged ({what}); --resume of the same sweep computes it anew") from None


def write_dataset(ds: "xr.Dataset", path: Path) -> None:
    """Write a dataset, whole or not at all; in memory first, as HDF5 does not bear a full disk."""
    write(path, ds.to_netcdf(engine="h5netcdf"))


def write_json(data: dict[str, Any], path: Path) -> None:
    """Write JSON, whole or not at all. NaN becomes null."""
    write(path, (json.dumps(plain(data), indent=1) + "\n").encode())


def read_json(path: Path) -> Any:
    """A stored summary.

    Raises:
        StoreError: The file is missing or not complete JSON.
    """
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); run the command again") from None


def plain(value: Any) -> Any:
    """`value` as JSON holds it: lists, and None for what is not finite."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
