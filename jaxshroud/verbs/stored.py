"""A sweep whose lanes are stored some at a time, in memory that does not grow, and gone on with after any end."""

import math
import zlib
from collections.abc import Generator, Iterator, Sequence
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
from jaxshroud.results.directions import compared, in_direction
from jaxshroud.results.store import read
from jaxshroud.results.sweep import DIRECTION, SweepResult, sweep_coordinates
from jaxshroud.results.unfinished import Lanes, Unfinished, told_in, unfinished
from jaxshroud.scene.parts import WAYS, Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.cluster import client_of, machine, machine_of, on_workers
from jaxshroud.verbs.stretches import Pace, in_stretches
from jaxshroud.verbs.swept import AT_ONCE, Grid, Wanted, lane_periods
from jaxshroud.verbs.work import Chain, Computed, Work, cut, in_turn, passed_on, some

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

    @property
    def ways(self) -> tuple[Direction, ...]:
        """One direction, or all."""
        return WAYS if self.direction == "both" else (self.direction,)

    def tick(self, lanes: int) -> None:
        """So many lanes more are done."""
        self.wanted.ticker(lanes * lane_periods(self.wanted.plan, self.grid.precise is not None))


class Run(NamedTuple):
    """A sweep on its way into a store."""

    sweep: Ordered
    store: Unfinished
    sizes: tuple[int, ...]  # of blocks
    sent: bool  # to workers
    told: dict[tuple[int, ...], str]  # what alternated, by the places of blocks
    pace: Pace

    def at_once(self, way: Direction) -> bool:
        """Whether blocks are computed whole: workers keep nothing."""
        return self.sent or way == "independent"


def stored(sweep: Ordered, path: Path, scheduler: str | None = None) -> SweepResult:
    """All lanes in one direction or in all of them, in a store.

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
        coords = sweep_coordinates(grid.axes, period)
        if len(sweep.ways) > 1:
            lanes, coords = {DIRECTION: Lanes(len(WAYS), 1), **lanes}, {DIRECTION: list(WAYS), **coords}
        with unfinished(path, lanes, about, coords) as store:
            run = Run(sweep, store, sizes, client is not None, {}, Pace())
            try:
                if client is None:
                    in_turn(_chains(run))
                else:
                    on_workers(_chains(run), client, like, sweep.tick)
            except KeyboardInterrupt:
                raise Interrupted(_opened(path) if store.begun else None) from None
            first = next((run.told[place] for place in sorted(run.told) if run.told[place]), "")
            store.finish({"complete": 1, **({"chatter": first} if first else {})}, compared(read(path)))
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
        return _sizes(shape, fit)
    first = len(sweep.grid.door.shape)
    beside = _sizes((*shape[:first], *shape[first + 1 :]), fit)
    each = plan.steps_per_period * (plan.transient + plan.kept) * max(math.prod(beside) / CHUNK, 1.0)
    most = max(min(CHUNK, shape[first], HELD // (plan.kept * SAMPLE * math.prod(beside))), 1)
    values = int(np.clip(STEPS / each, 1, most))
    if sweep.direction == "both":  # lanes from rest are run in whole chunks
        values = next((n for n in range(most, 1, -1) if shape[first] % n != 1), most)
    return (*beside[:first], values, *beside[first:])


def _sizes(shape: Sequence[int], fit: int) -> tuple[int, ...]:
    """Lanes of a block along each axis. None has a single one, which would be run, and rounded, by another program."""
    sizes = spread(shape, fit)
    while math.prod(shape) > 1 == math.prod(n % size or size for n, size in zip(shape, sizes, strict=True)):
        fit += CHUNK
        sizes = spread(shape, fit)
    return sizes


def _sizes_in(path: Path, axes: int) -> tuple[int, ...] | None:
    """The sizes of blocks that a store was begun with, whoever computed them; None if there are none."""
    sizes = [int(word) for word in told_in(path).get("blocks", "").split(BY) if word.isdigit()]
    return tuple(sizes) if len(sizes) == axes and all(sizes) else None


def _chains(run: Run) -> Iterator[Chain]:
    """All blocks; together those that need each other: the longest first."""
    grid = run.sweep.grid
    along = len(grid.door.shape) if grid.axes else 0
    for way in reversed(run.sweep.ways):
        for blocks in chains(grid.shape, run.sizes, along, backward=way == "backward"):
            for chain in [[block] for block in blocks] if way == "independent" else [blocks]:
                yield _chain(run, way, chain)


def _chain(run: Run, way: Direction, blocks: Sequence[Block]) -> Chain:
    """What has to be computed of blocks, each when the one before is known; stored, with what alternated `told`."""
    relay, sweep, both = Relay(), run.sweep, len(run.sweep.ways) > 1
    of_many = sweep.wanted._replace(of_many=math.prod(sweep.grid.shape) > 1)
    for block in blocks:
        place = block.within(WAYS.index(way)) if both else block
        record = run.store.record(place)
        if record is None:
            begin = cut(sweep.states, block.at, sweep.grid.shape)
            work = Work(some(sweep.grid, block.at), begin, way, of_many, relay)
            found, record = (yield work) if run.at_once(way) else (yield from _stretches(run, place, work))
            run.store.write(place, in_direction(found.data, way) if both else found.data, record)
        else:
            sweep.tick(block.lanes)
        relay = passed_on(record, sweep.grid)
        run.told[place.place] = str(record["chatter"])


def _stretches(run: Run, place: Block, work: Work) -> Generator[Work, Computed, Computed]:
    """A block of continued values, which another process may have begun."""
    kept = run.store.kept(place)
    if kept is not None:
        run.sweep.tick(int(kept["done"]) * math.prod(work.part.shape) // work.part.shape[len(work.part.door.shape)])
    return (yield from in_stretches(work, kept, lambda record: run.store.keep(place, record), run.pace))


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
        "ledger": str(plan.method.ledger),
        "forces": str(plan.method.forces),
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
