"""Sweeps that are stored block by block, in bounded memory, and can be resumed after any interruption."""

import math
import time
import zlib
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.limits import SAMPLE_BYTES
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.block_records import Record
from jaxshroud.io.store import read
from jaxshroud.io.unfinished_store import NUMBER, Unfinished, join_along, open_unfinished, store_identity
from jaxshroud.io.zarr_arrays import Block, LaneDimension, block_chains, block_shape
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.base import result_from_dataset
from jaxshroud.results.sweep import DIRECTION, SweepResult, compare_directions, in_direction, sweep_coordinates
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.cluster import compute_on_workers, connected_client, machine_identity, worker_identity
from jaxshroud.verbs.sweep_block import (
    BlockTask,
    Chain,
    ComputedBlock,
    compute_in_process,
    handover_from,
    part_of_grid,
    select_block,
)
from jaxshroud.verbs.sweep_run import MAX_LANES_AT_ONCE, Grid, SweepSettings, lane_periods

STRETCH_SECONDS = 2.0  # that a stretch of values takes, if it has more than one: the time that a kill may cost
MIN_BLOCK_LANES, MAX_BLOCKS = 1024, 16  # a larger sweep has about this many blocks, none smaller
MIN_SENT_LANES, MAX_SENT_BLOCKS = 512, 128  # the same where workers compute the blocks
MAX_BLOCK_BYTES = 2**28  # of a block's samples in memory
MAX_BLOCK_STEPS = 2**22  # of one lane in a block of continued values: a few seconds, which a kill may cost
SIZE_SEPARATOR = " x "

KeepRecord = Callable[[Record], None]


@dataclass
class Pace:
    """The time that one continued value took lately."""

    seconds: float = np.inf

    @property
    def values(self) -> int:
        """The number of values in a stretch."""
        return max(int(STRETCH_SECONDS / self.seconds), 1)


def run_in_stretches(
    task: BlockTask, kept: Record | None, keep: KeepRecord, pace: Pace
) -> Generator[BlockTask, ComputedBlock, ComputedBlock]:
    """Compute a block of a forward or backward sweep in stretches of a few values.

    Args:
        task: The task of the whole block.
        kept: The record that an earlier process kept of the block's first values.
        keep: Called with the record of all values so far after every stretch but the last.
        pace: The time per value; updated.

    Returns:
        The block, as if it were computed at once.
    """
    grid = task.grid
    along = len(task.grid.resolved.shape)
    n = grid.shape[along]
    backward = task.direction == "backward"
    record = dict(kept or {"done": np.array(0), "chatter": np.array("")})
    done = int(record["done"])
    handover = handover_from(record, grid) if kept else task.handover
    while True:
        stop = min(done + pace.values, n)
        values = slice(n - stop, n - done) if backward else slice(done, stop)
        at = [values if i == along else slice(0, m) for i, m in enumerate(grid.shape)]
        began = time.perf_counter()
        computed = yield task.part(at, handover)
        pace.seconds = (time.perf_counter() - began) / (stop - done)
        data = join_along(record, computed.result.data, along, backward=backward) if done else computed.result.data
        is_first = _has_first_chatter(data["status"].to_numpy(), along, values, backward=backward)
        record = {**computed.record, "chatter": (computed.record if is_first else record)["chatter"]}
        if stop == n:
            return ComputedBlock(SweepResult(data), record)
        done = stop
        handover = handover_from(record, grid)
        record |= {"done": np.array(done), **{NUMBER + str(name): a.to_numpy() for name, a in data.items()}}
        keep(record)


def _has_first_chatter(status: np.ndarray, along: int, values: slice, *, backward: bool) -> bool:
    """Whether the first lane with TOO_MANY_EVENTS is in the latest stretch, or there is no such lane."""
    places = np.argwhere(status == Status.TOO_MANY_EVENTS)
    latest = slice(values.stop - values.start) if backward else values
    return not len(places) or latest.start <= places[0][along] < latest.stop


class SweepTask(NamedTuple):
    """A sweep in one direction or in all of them."""

    grid: Grid
    states: State | None  # initial states of the lanes; None: those of their scenes
    direction: Direction
    settings: SweepSettings

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The single directions that it consists of."""
        return SINGLE_DIRECTIONS if self.direction == "both" else (self.direction,)

    def tick(self, lanes: int) -> None:
        """Report `lanes` more as done."""
        self.settings.ticker(lanes * lane_periods(self.settings.plan, self.grid.precise is not None))


class StoredRun(NamedTuple):
    """A sweep that is being written to a store."""

    sweep: SweepTask
    store: Unfinished
    sizes: tuple[int, ...]  # of blocks
    on_workers: bool
    chatter: dict[tuple[int, ...], str]  # reports on events that alternate, by the places of blocks
    pace: Pace

    def is_whole(self, direction: Direction) -> bool:
        """Whether blocks are computed as a whole: workers cannot keep records of stretches."""
        return self.on_workers or direction == "independent"


def store_sweep(sweep: SweepTask, path: Path, scheduler: str | None = None) -> SweepResult:
    """Run a sweep into a store, or resume it there.

    Args:
        sweep: The sweep.
        path: The folder of the store, which may exist.
        scheduler: The scheduler of the workers that compute the blocks, see `connected_client`; None: this process.

    Raises:
        StoreError: The store is of something else, or in use.
        WriteError: The store cannot be written.
        MachineError: The scheduler cannot be reached.
        Interrupted: Ctrl-C; `done` is the stored part of the result, None if there is none.
    """
    lanes, precise = jax.tree.map(np.asarray, (sweep.grid.lanes, sweep.grid.precise))
    sweep = sweep._replace(grid=sweep.grid._replace(lanes=lanes, precise=precise))
    grid = sweep.grid
    period = sweep.settings.plan.transient + 1 + np.arange(sweep.settings.plan.kept)
    with nullcontext() if scheduler is None else connected_client(scheduler) as client:
        identity = machine_identity() if client is None else worker_identity(client)
        sizes = _stored_block_sizes(path, len(grid.shape)) or block_sizes(sweep, on_workers=client is not None)
        attributes = _identity(sweep) | identity | {"blocks": SIZE_SEPARATOR.join(map(str, sizes))}
        dimensions = dict(zip(grid.dims, map(LaneDimension, grid.shape, sizes), strict=True))
        coords = sweep_coordinates(grid.axes, period, grid.lanes.layout)
        if len(sweep.directions) > 1:
            dimensions = {DIRECTION: LaneDimension(len(SINGLE_DIRECTIONS), 1), **dimensions}
            coords = {DIRECTION: list(SINGLE_DIRECTIONS), **coords}
        with open_unfinished(path, dimensions, attributes, coords) as store:
            run = StoredRun(sweep, store, sizes, client is not None, {}, Pace())
            try:
                if client is None:
                    compute_in_process(_chains(run))
                else:
                    compute_on_workers(_chains(run), client, identity, sweep.tick)
            except KeyboardInterrupt:
                raise Interrupted(_stored_result(path) if store.has_arrays else None) from None
            chatter = next((run.chatter[place] for place in sorted(run.chatter) if run.chatter[place]), "")
            final = {"complete": 1, **({"chatter": chatter} if chatter else {})}
            store.finish(final, compare_directions(read(path, checked=False)))
    return _stored_result(path)


def block_sizes(sweep: SweepTask, *, on_workers: bool) -> tuple[int, ...]:
    """The lanes of a block along each axis: some thousands in all, or, of continued values, as few as a kill may cost.

    Blocks for workers are smaller, so that any number of workers has something to do.
    """
    plan, shape = sweep.settings.plan, sweep.grid.shape
    min_lanes, max_blocks = (MIN_SENT_LANES, MAX_SENT_BLOCKS) if on_workers else (MIN_BLOCK_LANES, MAX_BLOCKS)
    lanes_in_memory = MAX_BLOCK_BYTES // (plan.kept * SAMPLE_BYTES)
    size = min(MAX_LANES_AT_ONCE, lanes_in_memory, max(min_lanes, math.prod(shape) // max_blocks))
    size = max(size // LANES_PER_CALL, 1) * LANES_PER_CALL
    if sweep.direction == "independent":
        return _block_sizes(shape, size)
    first = len(sweep.grid.resolved.shape)
    other_sizes = _block_sizes((*shape[:first], *shape[first + 1 :]), size)
    lanes_per_value = math.prod(other_sizes)
    periods = plan.transient + plan.kept
    steps_per_value = plan.steps_per_period * periods * max(lanes_per_value / LANES_PER_CALL, 1.0)
    values_in_memory = MAX_BLOCK_BYTES // (plan.kept * SAMPLE_BYTES * lanes_per_value)
    max_values = max(min(LANES_PER_CALL, shape[first], values_in_memory), 1)
    values = int(np.clip(MAX_BLOCK_STEPS / steps_per_value, 1, max_values))
    if sweep.direction == "both":  # its independent lanes are run in whole chunks
        values = next((n for n in range(max_values, 1, -1) if shape[first] % n != 1), max_values)
    return (*other_sizes[:first], values, *other_sizes[first:])


def _block_sizes(shape: Sequence[int], size: int) -> tuple[int, ...]:
    """The lanes of a block along each axis. No block is a single lane, which another program would run and round."""
    sizes = block_shape(shape, size)
    while math.prod(shape) > 1 == math.prod(n % size or size for n, size in zip(shape, sizes, strict=True)):
        size += LANES_PER_CALL
        sizes = block_shape(shape, size)
    return sizes


def _stored_block_sizes(path: Path, axes: int) -> tuple[int, ...] | None:
    """The sizes of the blocks with which a store was begun; None if there is no store."""
    sizes = [int(word) for word in store_identity(path).get("blocks", "").split(SIZE_SEPARATOR) if word.isdigit()]
    return tuple(sizes) if len(sizes) == axes and all(sizes) else None


def _chains(run: StoredRun) -> Iterator[Chain]:
    """The chains of all blocks; blocks that continue each other are in one chain. The longest chains come first."""
    grid = run.sweep.grid
    along = len(grid.resolved.shape) if grid.axes else 0
    for direction in reversed(run.sweep.directions):
        for blocks in block_chains(grid.shape, run.sizes, along, backward=direction == "backward"):
            for chain in [[block] for block in blocks] if direction == "independent" else [blocks]:
                yield _chain(run, direction, chain)


def _chain(run: StoredRun, direction: Direction, blocks: Sequence[Block]) -> Chain:
    """Yield the tasks of blocks that are not stored yet, one after the other, and store their results."""
    handover = SweepHandover()
    sweep = run.sweep
    directional = len(run.sweep.directions) > 1
    settings = sweep.settings._replace(is_part=math.prod(sweep.grid.shape) > 1)
    for block in blocks:
        stored_block = block.within(SINGLE_DIRECTIONS.index(direction)) if directional else block
        record = run.store.record(stored_block)
        if record is None:
            states = select_block(sweep.states, block.at, sweep.grid.shape)
            task = BlockTask(part_of_grid(sweep.grid, block.at), states, direction, settings, handover)
            at_once = run.is_whole(direction)
            result, record = (yield task) if at_once else (yield from _resumed_stretches(run, stored_block, task))
            run.store.write(stored_block, in_direction(result.data, direction) if directional else result.data, record)
        else:
            sweep.tick(block.lanes)
        handover = handover_from(record, sweep.grid)
        run.chatter[stored_block.place] = str(record["chatter"])


def _resumed_stretches(
    run: StoredRun, place: Block, task: BlockTask
) -> Generator[BlockTask, ComputedBlock, ComputedBlock]:
    """Compute a block of continued values, which an earlier process may have begun."""
    kept = run.store.kept(place)
    if kept is not None:
        run.sweep.tick(int(kept["done"]) * math.prod(task.grid.shape) // task.grid.shape[len(task.grid.resolved.shape)])
    return (yield from run_in_stretches(task, kept, lambda record: run.store.keep(place, record), run.pace))


def _identity(sweep: SweepTask) -> dict[str, str]:
    """The text by which a store knows its sweep: everything on which the numbers depend, except the machine."""
    grid, states, direction, settings = sweep
    plan = settings.plan
    attributes, _ = grid.resolved.provenance(plan.transient, plan.steps_per_period)
    march = {name: str(value) for name, value in settings.march.attributes.items() if name != "march"}  # as in words
    return {
        **words_of(attributes["scene"]),
        **{f"the sweep along {key}": _values_text(values) for key, values in grid.axes.items()},
        "run.periods": str(plan.kept),
        **march,
        "direction": direction,
        "phase": repr(plan.phase),
        "period_tol": repr(settings.period_tol),
        "samples": str(settings.keep_samples),
        "ledger": str(plan.method.ledger),
        "forces": str(plan.method.forces),
        **({"amplitudes": "True"} if plan.method.amplitudes else {}),
        **({"confirm": "True"} if settings.confirm else {}),
        "lyapunov": str(grid.precise is not None),
        "scenes": _checksum_text(grid.lanes) if grid.resolved.shape else "one",
        "start": "the scene's own" if states is None else _checksum_text(states),
    }


def _values_text(values: np.ndarray) -> str:
    summary = f"{len(values)} values from {values[0]:g} to {values[-1]:g}"
    return f"{summary} (checksum {zlib.crc32(np.ascontiguousarray(values).tobytes()):08x})"


def _checksum_text(tree: object) -> str:
    return _values_text(np.concatenate([np.ravel(a) for a in jax.tree.leaves(tree)]))


def _stored_result(path: Path) -> SweepResult:
    """The result in a store; its checksums are not tested again, as this process has written or tested every block."""
    result = result_from_dataset(read(path, checked=False), path)
    assert isinstance(result, SweepResult)
    return result
