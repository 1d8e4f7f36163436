"""A block of continued values computed some seconds at a time: what is done is kept, and gone on with after any end."""

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.unfinished import Record
from jaxshroud.verbs.work import Computed, Work, passed_on

if TYPE_CHECKING:
    import xarray as xr

SECONDS = 2.0  # that a stretch takes, or a single value: what a kill may cost
NUMBER = "number "  # before the names of numbers in a record

Keep = Callable[[Record], None]


@dataclass
class Pace:
    """How long a value has taken lately."""

    seconds: float = np.inf

    @property
    def values(self) -> int:
        """So many at a time."""
        return max(int(SECONDS / self.seconds), 1)


def in_stretches(work: Work, kept: Record | None, keep: Keep, pace: Pace) -> Generator[Work, Computed, Computed]:
    """A block of a sweep forward or backward.

    Args:
        work: All of it.
        kept: What another process had come to.
        keep: Told what is known after every stretch but the last.
        pace: Of the values; brought up to date.

    Returns:
        The same as of the work at once.
    """
    grid, along = work.part, len(work.part.door.shape)
    n, backward = grid.shape[along], work.direction == "backward"
    record = dict(kept or {"done": np.array(0), "chatter": np.array("")})
    done, relay = int(record["done"]), passed_on(record, grid) if kept else work.relay
    while True:
        stop = min(done + pace.values, n)
        values = slice(n - stop, n - done) if backward else slice(done, stop)
        at = [values if i == along else slice(0, m) for i, m in enumerate(grid.shape)]
        began = time.perf_counter()
        found = yield work.some(at, relay)
        pace.seconds = (time.perf_counter() - began) / (stop - done)
        data = _joined(record, found.result.data, along, done, backward=backward)
        chatter = found.record if _newest(data["status"], along, values, backward=backward) else record
        record = {**found.record, "chatter": chatter["chatter"]}
        if stop == n:
            return Computed(SweepResult(data), record)
        done, relay = stop, passed_on(record, grid)
        record |= {"done": np.array(done), **{NUMBER + str(name): a.to_numpy() for name, a in data.items()}}
        keep(record)


def _joined(record: Record, data: "xr.Dataset", along: int, done: int, *, backward: bool) -> "xr.Dataset":
    """The numbers of a stretch after those that the record has of the values before it."""
    import xarray as xr

    if not done:
        return data
    dim = data["status"].dims[along]

    def whole(name: str, variable: "xr.DataArray") -> "xr.Variable":
        if dim not in variable.dims:
            return variable.variable
        parts = [record[NUMBER + name], variable.to_numpy()]
        values = np.concatenate(parts[::-1] if backward else parts, axis=variable.dims.index(dim))
        return xr.Variable(variable.dims, values, variable.attrs)

    return xr.Dataset({str(name): whole(str(name), v) for name, v in data.data_vars.items()}, attrs=data.attrs)


def _newest(status: "xr.DataArray", along: int, values: slice, *, backward: bool) -> bool:
    """Whether the first lane that alternated, if any has, is of the latest stretch."""
    places = np.argwhere(status.to_numpy() == Status.TOO_MANY_EVENTS)
    latest = slice(values.stop - values.start) if backward else values
    return not len(places) or latest.start <= places[0][along] < latest.stop
