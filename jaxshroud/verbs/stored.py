"""A sweep whose lanes are stored some at a time, in memory that does not grow, and gone on with after any end."""

import math
import zlib
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.continuation import Relay
from jaxshroud.batch.extent import SAMPLE
from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.threads import Interrupted
from jaxshroud.model.state import State
from jaxshroud.results.base import opened
from jaxshroud.results.blocks import Block, chains, spread
from jaxshroud.results.store import read
from jaxshroud.results.sweep import SweepResult, sweep_coordinates
from jaxshroud.results.unfinished import Lanes, Unfinished, told_in, unfinished
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.cluster import client_of, machine, machine_of, on_workers
from jaxshroud.verbs.swept import AT_ONCE, Grid, Wanted, lane_periods
from jaxshroud.verbs.work import Chain, Work, in_turn, passed_on

LEAST, PARTS = 1024, 16  # lanes of a block, and blocks of a sweep that has more lanes than these
LEAST_SENT, PARTS_SENT = 512, 128  # the same where workers compute them
HELD = 2**28  # bytes of samples that a block may take in memory
STEPS = 2**22  # of one lane in a block of continued values: what a kill may cost, a few seconds
BY = " x "


class Ordered(NamedTuple):
    """A sweep."""

    grid: Grid
    states: State | None  # where its lanes start
    direction: Direction
    wanted: Wanted

    def tick(self, lanes: int) -> None:
        """So many lanes more are done."""
        self.wanted.ticker(lanes * lane_periods(self.wanted.plan, self.grid.precise is not None))


def stored(sweep: Ordered, path: Path, scheduler: str | None = None) -> SweepResult:
    """All lanes in one direction, in a store.

    Args:
        sweep: The lanes.
        path: Where the store is, or is to be.
        scheduler: Of workers that compute the blocks, as of `client_of`; by default this process does.

    Raises:
        StoreError: There is a store of something else, or one in use.
        WriteError: The place cannot be written.
        MachineError: The scheduler cannot be reached.
        Interrupted: Ctrl-C; `done` is what is stored, None if nothing is.
    """
    grid = jax.tree.map(np.asarray, (sweep.grid.lanes, sweep.grid.precise))
    sweep = sweep._replace(grid=sweep.grid._replace(lanes=grid[0], precise=grid[1]))
    grid, period = sweep.grid, sweep.wanted.plan.transient + 1 + np.arange(sweep.wanted.plan.kept)
    with nullcontext() if scheduler is None else client_of(scheduler) as client:
        like = machine() if client is None else machine_of(client)
        sizes = _sizes_in(path, len(grid.shape)) or block_sizes(sweep, sent=client is not None)
        about = _words(sweep) | like | {"blocks": BY.join(map(str, sizes))}
        lanes = dict(zip(grid.dims, map(Lanes, grid.shape, sizes), strict=True))
        with unfinished(path, lanes, about, sweep_coordinates(grid.axes, period)) as store:
            try:
                told: dict[tuple[int, ...], str] = {}
                every = _chains(store, sizes, sweep, told)
                if client is None:
                    in_turn(every)
                else:
                    on_workers(every, client, like, sweep.tick)
            except KeyboardInterrupt:
                raise Interrupted(_opened(path) if store.begun else None) from None
            first = next((told[place] for place in sorted(told) if told[place]), "")
            store.finish({"complete": 1, **({"chatter": first} if first else {})})
    return _opened(path)


def block_sizes(sweep: Ordered, *, sent: bool) -> tuple[int, ...]:
    """Lanes of a block along each axis: thousands, or so many of continued values that little is lost.

    Those that are `sent` to workers are smaller: any number of these is to have something to do.
    """
    plan, shape = sweep.wanted.plan, sweep.grid.shape
    least, parts = (LEAST_SENT, PARTS_SENT) if sent else (LEAST, PARTS)
    fit = min(AT_ONCE, HELD // (plan.kept * SAMPLE), max(least, math.prod(shape) // parts))
    fit = max(fit // CHUNK, 1) * CHUNK
    if sweep.direction == "independent":
        return spread(shape, fit)
    first = len(sweep.grid.door.shape)
    beside = spread((*shape[:first], *shape[first + 1 :]), fit)
    each = plan.steps_per_period * (plan.transient + plan.kept) * max(math.prod(beside) / CHUNK, 1.0)
    return (*beside[:first], int(np.clip(STEPS / each, 1, min(CHUNK, shape[first]))), *beside[first:])


def _sizes_in(path: Path, axes: int) -> tuple[int, ...] | None:
    """The sizes of blocks that a store was begun with, whoever computed them; None if there are none."""
    sizes = [int(word) for word in told_in(path).get("blocks", "").split(BY) if word.isdigit()]
    return tuple(sizes) if len(sizes) == axes and all(sizes) else None


def _chains(
    store: Unfinished, sizes: Sequence[int], sweep: Ordered, told: dict[tuple[int, ...], str]
) -> Iterator[Chain]:
    """All blocks; together those that need each other."""
    along = len(sweep.grid.door.shape) if sweep.grid.axes else 0
    for blocks in chains(sweep.grid.shape, sizes, along, backward=sweep.direction == "backward"):
        for chain in [[block] for block in blocks] if sweep.direction == "independent" else [blocks]:
            yield _chain(store, chain, sweep, told)


def _chain(store: Unfinished, blocks: Sequence[Block], sweep: Ordered, told: dict[tuple[int, ...], str]) -> Chain:
    """What has to be computed of blocks, each when the one before is known; stored, with what alternated `told`."""
    relay = Relay()
    for block in blocks:
        record = store.record(block)
        if record is None:
            part, begin = _part(sweep.grid, block), _cut(sweep.states, block, sweep.grid)
            found, record = yield Work(part, begin, sweep.direction, sweep.wanted, relay)
            store.write(block, found.data, record)
        else:
            sweep.tick(block.lanes)
        relay = passed_on(record, sweep.grid)
        told[block.place] = str(record["chatter"])


def _part(grid: Grid, block: Block) -> Grid:
    """The lanes of a block."""
    outer = len(grid.door.shape)
    scene = jax.tree.map(lambda a: a[block.at[:outer]], grid.door.scene) if outer else grid.door.scene
    shape = tuple(part.stop - part.start for part in block.at[:outer])
    axes = {key: values[part] for (key, values), part in zip(grid.axes.items(), block.at[outer:], strict=True)}
    lanes, precise = _cut((grid.lanes, grid.precise), block, grid)
    return Grid(grid.door._replace(scene=scene, shape=shape), lanes, axes, precise)


def _cut(tree: Any, block: Block, grid: Grid) -> Any:
    """The lanes of a block of a tree of arrays with a leading axis of all lanes."""
    return jax.tree.map(
        lambda a: np.asarray(a).reshape(*grid.shape, *a.shape[1:])[block.at].reshape(-1, *a.shape[1:]), tree
    )


def _words(sweep: Ordered) -> dict[str, str]:
    """All that the numbers of a sweep depend on beside the machine, by names."""
    grid, states, direction, wanted = sweep
    plan = wanted.plan
    told, _ = grid.door.about(plan.transient, plan.steps_per_period)
    how = {name: str(value) for name, value in wanted.how.told.items()}
    return {
        **words_of(told["scene"]),
        **{f"the sweep along {key}": _values(values) for key, values in grid.axes.items()},
        "run.periods": str(plan.kept),
        **how,
        "direction": direction,
        "phase": repr(plan.phase),
        "period_tol": repr(wanted.period_tol),
        "samples": str(wanted.samples),
        "lyapunov": str(grid.precise is not None),
        "scenes": _all(grid.lanes) if grid.door.shape else "one",
        "start": "the scene's own" if states is None else _all(states),
    }


def _values(values: np.ndarray) -> str:
    known = f"{len(values)} values from {values[0]:g} to {values[-1]:g}"
    return f"{known} (checksum {zlib.crc32(np.ascontiguousarray(values).tobytes()):08x})"


def _all(tree: Any) -> str:
    return _values(np.concatenate([np.ravel(a) for a in jax.tree.leaves(tree)]))


def _opened(path: Path) -> SweepResult:
    found = opened(read(path), path)
    assert isinstance(found, SweepResult)
    return found
