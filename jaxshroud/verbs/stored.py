"""Sweeps that are stored part by part, in bounded memory, and can be resumed after any interruption."""

import math
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.limits import SAMPLE_BYTES, results_size
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.threads import Interrupted, machine_identity
from jaxshroud.io.store import read
from jaxshroud.io.unfinished_store import BlockRecord, ChatterReport, Lanes, Unfinished, open_unfinished
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.sweep import DIRECTION, SweepResult, compare_directions, in_direction
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.cluster import Chain, compute_on_workers, connected_client, worker_identity
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
        """The part with the lanes at those slices of the axes, in one direction."""
        grid = self.grid
        resolved = grid.resolved
        outer = len(resolved.shape)
        numbers = np.arange(self.lanes).reshape(grid.shape)[at]
        whole = grid.lanes, grid.precise, self.states
        lanes, precise, states = jax.tree.map(lambda a: np.asarray(a)[numbers.ravel()], whole)
        scene = jax.tree.map(lambda a: a[at[:outer]], resolved.scene) if outer else resolved.scene
        part = Grid(
            # workers print nothing
            resolved=resolved._replace(
                scene=scene, shape=numbers.shape[:outer], asked=resolved.asked._replace(told=None)
            ),
            lanes=lanes,
            axes={key: grid.axes[key][values] for key, values in zip(grid.axes, at[outer:], strict=True)},
            precise=precise,
            numbers=numbers.ravel(),
        )
        return SweepTask(part, states, direction, self.settings._replace(is_part=self.lanes > 1))


def compute_part(task: SweepTask, handover: SweepHandover) -> tuple[Any, SweepHandover, float]:
    """The dataset of lanes that go on from the values before them, where these end, and the seconds that it took."""
    began = time.perf_counter()
    data = confirmed_run(
        lambda settings: run_sweep(task.grid, task.states, task.direction, settings, handover), task.settings
    ).data
    if not task.settings.keep_samples:
        data = data.drop_vars(Motion._fields)
    return data, handover, time.perf_counter() - began


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
    known = known_values(sweep.grid, sweep.settings.plan)
    shape = sweep.grid.shape
    on_workers = scheduler is not None
    at_once = lanes_at_once(sweep, on_workers=on_workers)
    sizes = block_sizes(sweep, at_once, on_workers=on_workers)
    if len(sweep.directions) > 1:
        shape = (len(sweep.directions), *shape)
        sizes = (1, *sizes)
        known["coords"] = {DIRECTION: [*sweep.directions], **known["coords"]}
    about = _identity(sweep, known["attrs"]["scene"])
    with nullcontext() if scheduler is None else connected_client(scheduler) as client:
        identity = machine_identity() if client is None else worker_identity(client)
        with open_unfinished(path, about | identity, SweepResult.from_values({}, **known).data, shape, sizes) as store:
            run = StoredRun(sweep, store, at_once, on_workers)
            try:
                if client is None:
                    for chain in run.chains():
                        computed = None
                        with suppress(StopIteration):
                            while True:
                                computed = chain.send(computed)()
                else:
                    compute_on_workers(run.chains(), client, identity)
            except KeyboardInterrupt:
                raise Interrupted(SweepResult(read(path, checked=False)) if store.arrays else None) from None
            chatter = {"chatter": min(run.reports)[-1]} if run.reports else {}
            store.finish({"complete": 1, **chatter}, compare_directions(read(path, checked=False)))
    return SweepResult(read(path, checked=False))  # this process has written every block, or compared its checksum


def lanes_at_once(sweep: SweepTask, *, on_workers: bool) -> int:
    """The lanes of a part: some thousands, fewer for workers, so that any number of workers has something to do."""
    min_lanes, max_parts = (MIN_SENT_LANES, MAX_SENT_PARTS) if on_workers else (MIN_PART_LANES, MAX_PARTS)
    in_memory = MAX_BLOCK_BYTES // (sweep.settings.plan.kept * SAMPLE_BYTES)
    size = min(MAX_LANES_AT_ONCE, in_memory, max(min_lanes, sweep.lanes // max_parts))
    return max(size // LANES_PER_CALL, 1) * LANES_PER_CALL


def block_sizes(sweep: SweepTask, at_once: int, *, on_workers: bool) -> tuple[int, ...]:
    """The lanes of a block along each axis: a part or, in this process, several parts along the axis of the sweep."""
    others = [*sweep.grid.shape]
    n = others.pop(sweep.along)
    values, *sizes = _part_sizes((n, *others), at_once)
    if not on_workers:
        settings = sweep.settings
        blades = sweep.grid.lanes.layout.blades
        lane_bytes = results_size(1, settings.plan.kept, samples=settings.keep_samples, blades=blades)
        most = min(sweep.lanes * len(sweep.directions) // MAX_BLOCKS, MAX_BLOCK_BYTES // lane_bytes)
        values = min(n, values * (1 + most // (values * math.prod(sizes))))
    sizes.insert(sweep.along, values)
    return tuple(sizes)


def _part_sizes(shape: Sequence[int], lanes: int) -> list[int]:
    """The sizes of parts of a grid of lanes, which extend as far as possible along the last axes.

    No part is a single lane, which another program would run and round.
    """
    sizes = [min(max(lanes // math.prod(shape[i + 1 :]), 1), n) for i, n in enumerate(shape)]
    is_single = math.prod(shape) > 1 == math.prod(n % size or size for n, size in zip(shape, sizes, strict=True))
    return _part_sizes(shape, lanes + LANES_PER_CALL) if is_single else sizes


@dataclass
class StoredRun:
    """A sweep that is being written to a store."""

    sweep: SweepTask
    store: Unfinished
    at_once: int  # lanes
    on_workers: bool
    reports: list[ChatterReport] = field(default_factory=list)

    def chains(self) -> Iterator[Chain]:
        """The chains of all parts; parts that continue each other are in one chain. The longest chains come first."""
        sweep = self.sweep
        shape = sweep.grid.shape
        sizes = self.store.block[-len(shape) :]
        axes: list[Any] = [
            [range(n)[i : i + size] for i in range(0, n, size)] for n, size in zip(shape, sizes, strict=True)
        ]
        inner = axes[sweep.along]
        for way, direction in reversed([*enumerate(sweep.directions)]):
            order = -1 if direction == "backward" else 1
            blocks = [values[::order] for values in inner[::order]]
            axes[sweep.along] = [[values] for values in blocks] if direction == "independent" else [blocks]
            ways = [[range(way, way + 1)]] if len(sweep.directions) > 1 else []
            for at in product(*ways, *axes):
                yield self._chain(direction, at)

    def _chain(self, direction: Direction, at: tuple[Any, ...]) -> Chain:
        """Yield what computes the parts that are not stored yet, one after the other, and store what is sent back.

        Args:
            direction: The direction.
            at: The lanes along each dimension; along the axis of the sweep, the values of each block in the direction.
        """
        sweep = self.sweep
        outer = len(at) - len(sweep.grid.shape)  # dimensions before the axes of the grid
        along = sweep.along + outer

        def lanes(values: range) -> Lanes:
            axes = (*at[:along], values, *at[along + 1 :])
            return tuple(slice(min(axis), max(axis) + 1) for axis in axes)

        lanes_per_value = math.prod(map(len, at)) // len(at[along])
        handover = SweepHandover()
        seconds = np.inf  # that a value took lately
        for values in at[along]:
            done = 0
            reports = []
            record = self.store.begun(lanes(values))
            if record is not None:
                finished = record.at[along]
                done = finished.stop - finished.start
                reports = record.reports
                handover = _handover(record, sweep.grid)
                self._tick(done * lanes_per_value)
            while done < len(values):
                count = self.at_once // lanes_per_value
                if direction != "independent":
                    count = min(count, int(STRETCH_SECONDS / seconds))
                count = max(count, 1)
                if (len(values) - done - count) * lanes_per_value == 1:
                    count += 1
                now = values[done : done + count]
                done += count
                here = lanes(now)
                task = sweep.part(here[outer:], direction)
                data, handover, seconds = yield partial(compute_part, task, handover)
                seconds /= len(now)
                if self.on_workers:
                    self._tick(task.lanes)
                text = data.attrs.pop("chatter", None)
                if text is not None:
                    first = np.asarray(task.grid.numbers)[np.argmax(data["status"] == Status.TOO_MANY_EVENTS)]
                    reports = sorted([*reports, [SINGLE_DIRECTIONS.index(direction), int(first), text]])[:1]
                record = BlockRecord(lanes(values[:done]), reports, jax.tree.leaves(handover))
                self.store.write(lanes(values), here, in_direction(data, direction) if outer else data, record)
            self.reports += reports

    def _tick(self, lanes: int) -> None:
        """Report `lanes` more as done."""
        settings = self.sweep.settings
        settings.ticker(lanes * lane_periods(settings.plan, self.sweep.grid.precise is not None))


def _handover(record: BlockRecord, grid: Grid) -> SweepHandover:
    """The handover to the next lanes."""
    if not record.handover:
        return SweepHandover()
    state = initial_states(jax.tree.map(lambda a: a[:1], grid.lanes))
    return jax.tree.unflatten(jax.tree.structure(SweepHandover(state=state, arrived=np.zeros(1))), record.handover)


def _identity(sweep: SweepTask, scene: str) -> dict[str, str]:
    """The text by which a store knows its sweep: everything on which the numbers depend, except the machine."""
    grid, states, direction, settings = sweep
    plan = settings.plan
    method = plan.method
    arrays = {f"the sweep along {key}": values for key, values in grid.axes.items()}
    arrays |= {"scenes": grid.lanes if grid.resolved.shape else None, "start": states}
    numbers = {
        "run.periods": plan.kept,
        **settings.march.attributes,
        "direction": direction,
        "phase": plan.phase,
        "period_tol": settings.period_tol,
        "samples": settings.keep_samples,
        "ledger": method.ledger,
        "forces": method.forces,
        "amplitudes": method.amplitudes,
        "confirm": settings.confirm,
        "lyapunov": grid.precise is not None,
    }
    texts = {name: str(value) for name, value in numbers.items() if name != "march"}  # which the others say
    return words_of(scene) | texts | {name: _summary(tree) for name, tree in arrays.items() if tree is not None}


def _summary(tree: object) -> str:
    """A text that stands for all numbers of a tree of arrays."""
    values = np.concatenate([np.ravel(a) for a in jax.tree.leaves(tree)])
    checksum = zlib.crc32(values.tobytes())
    return f"{len(values)} values from {values[0]:g} to {values[-1]:g} (checksum {checksum:08x})"
