"""A block of continued values computed some seconds at a time: what is done is kept, and gone on with after any end."""

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.unfinished import NUMBER, Record, joined
from jaxshroud.verbs.work import Computed, Work, passed_on

SECONDS = 2.0  # that a stretch takes, or a single value: what a kill may cost

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
        data = joined(record, found.result.data, along, backward=backward) if done else found.result.data
        chatter = found.record if _newest(data["status"].to_numpy(), along, values, backward=backward) else record
        record = {**found.record, "chatter": chatter["chatter"]}
        if stop == n:
            return Computed(SweepResult(data), record)
        done, relay = stop, passed_on(record, grid)
        record |= {"done": np.array(done), **{NUMBER + str(name): a.to_numpy() for name, a in data.items()}}
        keep(record)


def _newest(status: np.ndarray, along: int, values: slice, *, backward: bool) -> bool:
    """Whether the first lane that alternated, if any has, is of the latest stretch."""
    places = np.argwhere(status == Status.TOO_MANY_EVENTS)
    latest = slice(values.stop - values.start) if backward else values
    return not len(places) or latest.start <= places[0][along] < latest.stop
