"""States on both sides of every contact event, stored beside a run's samples, and both in one."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

BEFORE = "event_"  # names of what is stored at events begin so
AFTER = "event_after"  # the sample that an event comes after; both sides of an event follow each other


def with_events(ds: "xr.Dataset", of: Sequence[str] | None = None) -> "xr.Dataset":
    """A run's samples and the states on both sides of every event, in their order; time stands still at an event.

    Args:
        ds: A run of a single scene; without stored events it is given back as it is.
        of: Variables to keep; by default all that vary in time.
    """
    names = [str(name) for name, a in ds.data_vars.items() if "time" in a.dims] if of is None else [*of]
    kept = ds[names]
    if AFTER not in ds.variables:
        return kept
    import xarray as xr

    at = ds[[BEFORE + name for name in names]].rename({BEFORE + name: name for name in names})
    times = np.concatenate([ds["time"].to_numpy(), ds[f"{BEFORE}t"].to_numpy()])
    order = np.argsort(np.concatenate([np.arange(ds.sizes["time"]), ds[AFTER].to_numpy() + 0.5]), kind="stable")
    both = xr.concat([kept.drop_vars("time"), at.rename(event="time")], "time", combine_attrs="override")
    return both.assign_coords(time=("time", times, ds["time"].attrs)).isel(time=order)
