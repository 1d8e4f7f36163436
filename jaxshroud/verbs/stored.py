"""Sweeps that are stored part by part, in bounded memory, and can be resumed after any interruption."""

import math
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.limits import SAMPLE_BYTES, results_size
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.plan import Ticker
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.block_records import BlockRecord, ChatterReport, Lanes
from jaxshroud.io.store import read
from jaxshroud.io.unfinished_store import Unfinished, open_unfinished
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.sweep import DIRECTION, SweepResult, compare_directions, in_direction
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.text import words_of
from jaxshroud.scene.typed import Tree
from jaxshroud.verbs.cluster import (
    Chain,
    Part,
    compute_on_workers,
    connected_client,
    machine_identity,
    worker_identity,
)
from jaxshroud.verbs.sweep_run import (
    MAX_LANES_AT_ONCE,
    Grid,
    SweepSettings,
    confirmed_run,
    known_values,
    lane_periods,
    run_sweep,
)

STRETCH_SECONDS = 2.0  # that some continued values take, if they are more than one: the time that a kill may cost
MIN_PART_LANES, MAX_PARTS = 1024, 16  # a larger sweep is computed in about this many parts, none smaller
MIN_SENT_LANES, MAX_SENT_PARTS = 512, 128  # the same where workers compute them
MAX_BLOCKS = 9  # of a larger sweep, with a file for each of some fifty variables; those of workers are parts
MAX_BLOCK_BYTES = 2**28  # of a part in memory, and of a block on disk


class SweepTask(NamedTuple):
    """A sweep or a part of it: everything on which its numbers depend."""

    grid: Grid
    states: State | None  # initial states of the lanes; None: those of their scenes
    direction: Direction
    settings: SweepSettings

    @property
    def lanes(self) -> int:
        """The number of lanes in one direction."""
        return math.prod(self.grid.shape)

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The single directions that it consists of."""
        return SINGLE_DIRECTIONS if self.direction == "both" else (self.direction,)

    @property
    def along(self) -> int:
        """The axis along which values continue each other."""
        return len(self.grid.resolved.shape) if self.grid.axes else 0

    def part(self, at: Lanes, direction: Direction) -> "SweepTask":
        """The part with the lanes at those slices of the axes, in one direction, which reports no progress itself."""
        grid = self.grid
        resolved = grid.resolved
        outer = len(resolved.shape)
        numbers = np.arange(self.lanes).reshape(grid.shape)[at]

        def lanes(tree: Tree) -> Tree:  # of arrays whose leading axis holds all lanes
            return jax.tree.map(lambda a: np.asarray(a)[numbers.ravel()], tree)

        scene = jax.tree.map(lambda a: a[at[:outer]], resolved.scene) if outer else resolved.scene
        part = Grid(
            resolved=resolved._replace(scene=scene, shape=numbers.shape[:outer]),
            lanes=lanes(grid.lanes),
            axes={key: grid.axes[key][lanes] for key, lanes in zip(grid.axes, at[outer:], strict=True)},
            precise=lanes(grid.precise),
            numbers=numbers.ravel(),
        )
        return SweepTask(part, lanes(self.states), direction, self.settings._replace(is_part=self.lanes > 1))


class ComputedPart(NamedTuple):
    """The result of a part."""

    result: SweepResult
    handover: SweepHandover
    seconds: float  # that it took


def compute_part(task: SweepTask, handover: SweepHandover) -> ComputedPart:
    """Run lanes; `handover` is from the values before them."""
    began = time.perf_counter()
    data = confirmed_run(
        lambda settings: run_sweep(task.grid, task.states, task.direction, settings, handover), task.settings
    ).data
    if not task.settings.keep_samples:
        data = data.drop_vars(Motion._fields)
    return ComputedPart(SweepResult(data), handover, time.perf_counter() - began)


def store_sweep(sweep: SweepTask, path: Path, scheduler: str | None = None) -> SweepResult:
    """Run a sweep into a store, or resume it there.

    Args:
        sweep: The sweep.
        path: The folder of the store, which may exist.
        scheduler: The scheduler of the workers that compute the parts, see `connected_client`; None: this process.

    Raises:
        StoreError: The store is of something else, or in use.
        WriteError: The store cannot be written.
        MachineError: The scheduler cannot be reached.
        Interrupted: Ctrl-C; `done` is the stored part of the result, None if there is none.
    """
    grid = sweep.grid
    known = known_values(grid, sweep.settings.plan)
    with nullcontext() if scheduler is None else connected_client(scheduler) as client:
        identity = machine_identity() if client is None else worker_identity(client)
        at_once = lanes_at_once(sweep, on_workers=client is not None)
        shape = grid.shape
        sizes = block_sizes(sweep, at_once, on_workers=client is not None)
        if len(sweep.directions) > 1:
            shape = (len(SINGLE_DIRECTIONS), *shape)
            sizes = (1, *sizes)
            known["coords"] = {DIRECTION: list(SINGLE_DIRECTIONS), **known["coords"]}
        about = _identity(sweep, known["attrs"]["scene"]) | identity
        with open_unfinished(path, about, SweepResult.from_values({}, **known).data, shape, sizes) as store:
            run = StoredRun(sweep, store, at_once, on_workers=client is not None)
            try:
                if client is None:
                    for chain in run.chains():
                        for part in chain:
                            part.computed = part.compute()
                else:
                    compute_on_workers(run.chains(), client, identity)
            except KeyboardInterrupt:
                raise Interrupted(_stored_result(path) if store.arrays else None) from None
            chatter = {"chatter": min(run.reports)[-1]} if run.reports else {}
            store.finish({"complete": 1, **chatter}, compare_directions(read(path, checked=False)))
    return _stored_result(path)


def lanes_at_once(sweep: SweepTask, *, on_workers: bool) -> int:
    """The lanes of a part: some thousands, fewer for workers, so that any number of workers has something to do."""
    min_lanes, max_parts = (MIN_SENT_LANES, MAX_SENT_PARTS) if on_workers else (MIN_PART_LANES, MAX_PARTS)
    in_memory = MAX_BLOCK_BYTES // (sweep.settings.plan.kept * SAMPLE_BYTES)
    size = min(MAX_LANES_AT_ONCE, in_memory, max(min_lanes, sweep.lanes // max_parts))
    return max(size // LANES_PER_CALL, 1) * LANES_PER_CALL


def block_sizes(sweep: SweepTask, at_once: int, *, on_workers: bool) -> tuple[int, ...]:
    """The lanes of a block along each axis: a part or, in this process, several parts along the axis of the sweep."""
    others = list(sweep.grid.shape)
    n = others.pop(sweep.along)
    values, *sizes = _part_sizes((n, *others), at_once)
    if not on_workers:
        kept, blades = sweep.settings.plan.kept, sweep.grid.lanes.layout.blades
        lane_bytes = results_size(1, kept, samples=sweep.settings.keep_samples, blades=blades)
        most = min(sweep.lanes * len(sweep.directions) // MAX_BLOCKS + 1, MAX_BLOCK_BYTES // lane_bytes)
        values = min(n, values * max(-(-most // (values * math.prod(sizes))), 1))
    sizes.insert(sweep.along, values)
    return tuple(sizes)


def _part_sizes(shape: Sequence[int], lanes: int) -> list[int]:
    """The sizes of parts of a grid of lanes, which extend as far as possible along the last axes.

    No part is a single lane, which another program would run and round.
    """
    sizes = []
    left = lanes
    for n in reversed(shape):
        sizes.insert(0, min(n, max(left, 1)))
        left //= sizes[0]
    is_single = math.prod(shape) > 1 == math.prod(n % size or size for n, size in zip(shape, sizes, strict=True))
    return _part_sizes(shape, lanes + LANES_PER_CALL) if is_single else sizes


@dataclass
class StoredRun:
    """A sweep that is being written to a store."""

    sweep: SweepTask
    store: Unfinished
    at_once: int  # lanes
    on_workers: bool
    seconds: float = np.inf  # that one continued value took lately
    reports: list[ChatterReport] = field(default_factory=list)

    def chains(self) -> Iterator[Chain]:
        """The chains of all parts; parts that continue each other are in one chain. The longest chains come first."""
        along = self.sweep.along
        shape = self.sweep.grid.shape
        sizes = self.store.block[-len(shape) :]
        axes = [[range(i, min(i + size, n)) for i in range(0, n, size)] for n, size in zip(shape, sizes, strict=True)]
        inner = axes.pop(along)
        for direction in reversed(self.sweep.directions):
            order = -1 if direction == "backward" else 1
            for others in product(*axes):
                blocks = [(*others[:along], values[::order], *others[along:]) for values in inner[::order]]
                for chain in [[block] for block in blocks] if direction == "independent" else [blocks]:
                    yield self._chain(direction, chain)

    def _chain(self, direction: Direction, blocks: Sequence[tuple[range, ...]]) -> Chain:
        """Yield the parts of blocks that are not stored yet, one after the other, and store their results."""
        sweep = self.sweep
        along = sweep.along
        is_directional = len(sweep.directions) > 1
        way = SINGLE_DIRECTIONS.index(direction)
        prefix = (slice(way, way + 1),) if is_directional else ()
        handover = SweepHandover()
        for block in blocks:
            n = len(block[along])
            lanes_per_value = math.prod(map(len, block)) // n
            whole = (*prefix, *_lanes(block, along, 0, n))
            done = 0
            report = None
            record = self.store.begun(whole)
            if record is not None:
                finished = record.at[along - len(block)]
                done = finished.stop - finished.start
                report = record.report
                handover = _handover(record, sweep.grid)
                self._tick(done * lanes_per_value)
            while done < n:
                values = max(self.at_once // lanes_per_value, 1)
                if direction != "independent":
                    values = min(values, max(int(STRETCH_SECONDS / self.seconds), 1))
                stop = min(done + values, n)
                if (n - stop) * lanes_per_value == 1:
                    stop = n
                at = _lanes(block, along, done, stop)
                task = sweep.part(at, direction)
                if self.on_workers:
                    task = task._replace(settings=task.settings._replace(ticker=Ticker(0, None)))
                part = Part(partial(compute_part, task, handover))
                yield part
                if self.on_workers:
                    self._tick(task.lanes)
                result, handover, seconds = part.computed
                if direction != "independent":
                    self.seconds = seconds / (stop - done)
                done = stop
                text = result.data.attrs.pop("chatter", None)
                if text is not None:
                    assert task.grid.numbers is not None
                    first = task.grid.numbers[np.argmax(result.status.ravel() == Status.TOO_MANY_EVENTS)]
                    report = min(filter(None, (report, [way, int(first), text])))
                data = in_direction(result.data, direction) if is_directional else result.data
                leaves = jax.tree.leaves((handover.state, handover.arrived))
                finished = (*prefix, *_lanes(block, along, 0, done))
                self.store.write(whole, (*prefix, *at), data, BlockRecord(finished, report, leaves))
            if report is not None:
                self.reports.append(report)

    def _tick(self, lanes: int) -> None:
        """Report `lanes` more as done."""
        settings = self.sweep.settings
        settings.ticker(lanes * lane_periods(settings.plan, self.sweep.grid.precise is not None))


def _lanes(block: tuple[range, ...], along: int, first: int, last: int) -> Lanes:
    """The lanes of a block from the first value to the one before the last, counted in the direction of the sweep."""
    axes = (*block[:along], block[along][first:last], *block[along + 1 :])
    return tuple(slice(min(axis), max(axis) + 1) for axis in axes)


def _handover(record: BlockRecord, grid: Grid) -> SweepHandover:
    """The handover to the next lanes."""
    if not record.handover:
        return SweepHandover()
    structure = jax.tree.structure((initial_states(jax.tree.map(lambda a: np.asarray(a)[:1], grid.lanes)), 0))
    state, arrived = jax.tree.unflatten(structure, record.handover)
    return SweepHandover(state=state, arrived=arrived)


def _identity(sweep: SweepTask, scene: str) -> dict[str, str]:
    """The text by which a store knows its sweep: everything on which the numbers depend, except the machine."""
    grid, states, direction, settings = sweep
    plan = settings.plan
    march = {name: str(value) for name, value in settings.march.attributes.items() if name != "march"}  # as in words
    return {
        **words_of(scene),
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
    return SweepResult(read(path, checked=False))
