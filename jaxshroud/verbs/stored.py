"""Sweeps that are stored part by part, in bounded memory, and can be resumed after any interruption."""

import math
import zlib
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import jax
import numpy as np

from jaxshroud.batch.limits import SAMPLE_BYTES, results_size
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.block_records import BlockRecord, ChatterReport, Lanes
from jaxshroud.io.store import read
from jaxshroud.io.unfinished_store import LaneDimension, Unfinished, open_unfinished, store_identity
from jaxshroud.model.modes import Status
from jaxshroud.results.base import result_from_dataset
from jaxshroud.results.sweep import DIRECTION, SweepResult, compare_directions, in_direction, sweep_coordinates
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.cluster import compute_on_workers, connected_client, machine_identity, worker_identity
from jaxshroud.verbs.sweep_block import Chain, SweepTask, compute_in_process
from jaxshroud.verbs.sweep_run import MAX_LANES_AT_ONCE, Grid

STRETCH_SECONDS = 2.0  # that some continued values take, if they are more than one: the time that a kill may cost
MIN_PART_LANES, MAX_PARTS = 1024, 16  # a larger sweep is computed in about this many parts, none smaller
MIN_SENT_LANES, MAX_SENT_PARTS = 512, 128  # the same where workers compute them
MAX_BLOCKS = 9  # of a larger sweep, with a file for each of some fifty variables; those of workers are parts
MAX_BLOCK_BYTES = 2**28  # of a part in memory, and of a block on disk
SIZE_SEPARATOR = " x "


@dataclass
class StoredRun:
    """A sweep that is being written to a store."""

    sweep: SweepTask
    store: Unfinished
    sizes: Sequence[int]  # of blocks
    at_once: int  # lanes
    seconds: float = np.inf  # that one continued value took lately
    reports: list[ChatterReport] = field(default_factory=list)


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
    lanes, precise, states = jax.tree.map(np.asarray, (grid.lanes, grid.precise, sweep.states))
    grid = grid._replace(lanes=lanes, precise=precise)
    sweep = sweep._replace(grid=grid, states=states)
    plan = sweep.settings.plan
    with nullcontext() if scheduler is None else connected_client(scheduler) as client:
        identity = machine_identity() if client is None else worker_identity(client)
        at_once = lanes_at_once(sweep, on_workers=client is not None)
        sizes = _stored_block_sizes(path, len(grid.shape)) or block_sizes(sweep, at_once, on_workers=client is not None)
        about = _identity(sweep) | identity | {"blocks": SIZE_SEPARATOR.join(map(str, sizes))}
        dimensions = dict(zip(grid.dims, map(LaneDimension, grid.shape, sizes), strict=True))
        coords = sweep_coordinates(grid.axes, plan.transient + 1 + np.arange(plan.kept), lanes.layout)
        if len(sweep.directions) > 1:
            dimensions = {DIRECTION: LaneDimension(len(SINGLE_DIRECTIONS), 1), **dimensions}
            coords = {DIRECTION: list(SINGLE_DIRECTIONS), **coords}
        with open_unfinished(path, dimensions, about, coords) as store:
            run = StoredRun(sweep, store, sizes, at_once)
            try:
                if client is None:
                    compute_in_process(_chains(run))
                else:
                    compute_on_workers(_chains(run), client, identity)
            except KeyboardInterrupt:
                raise Interrupted(_stored_result(path) if store.arrays else None) from None
            chatter = {"chatter": min(run.reports)[1]} if run.reports else {}
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


def _stored_block_sizes(path: Path, axes: int) -> tuple[int, ...] | None:
    """The sizes of the blocks with which a store was begun; None if there is no store."""
    sizes = [int(word) for word in store_identity(path).get("blocks", "").split(SIZE_SEPARATOR) if word.isdigit()]
    return tuple(sizes) if len(sizes) == axes and all(sizes) else None


def _chains(run: StoredRun) -> Iterator[Chain]:
    """The chains of all parts; parts that continue each other are in one chain. The longest chains come first."""
    sweep = run.sweep
    along = sweep.along
    for direction in reversed(sweep.directions):
        order = -1 if direction == "backward" else 1
        axes = [
            [slice(i, min(i + size, n)) for i in range(0, n, size)]
            for n, size in zip(sweep.grid.shape, run.sizes, strict=True)
        ]
        inner = axes[along][::order]
        axes[along] = [slice(None)]
        for at in product(*axes):
            blocks = [_with_lanes(at, along, lanes) for lanes in inner]
            for chain in [[block] for block in blocks] if direction == "independent" else [blocks]:
                yield _chain(run, direction, chain)


def _with_lanes(at: Lanes, axis: int, lanes: slice) -> Lanes:
    return (*at[:axis], lanes, *at[axis + 1 :])


def _chain(run: StoredRun, direction: Direction, blocks: Sequence[Lanes]) -> Chain:
    """Yield the parts of blocks that are not stored yet, one after the other, and store their results."""
    sweep = run.sweep
    along = sweep.along
    is_directional = len(sweep.directions) > 1
    way = SINGLE_DIRECTIONS.index(direction)
    prefix = (slice(way, way + 1),) if is_directional else ()
    handover = SweepHandover()
    for block in blocks:
        whole = block[along]
        n = whole.stop - whole.start
        lanes_per_value = math.prod(lanes.stop - lanes.start for lanes in block) // n

        def lanes_between(first: int, last: int, whole: slice = whole) -> slice:  # counted in the direction
            if direction == "backward":
                return slice(whole.stop - last, whole.stop - first)
            return slice(whole.start + first, whole.start + last)

        record = run.store.begun((*prefix, *block))
        done = 0
        report = None
        if record is not None:
            done = record.at[len(prefix) + along].stop - record.at[len(prefix) + along].start
            sweep.tick(done * lanes_per_value)
            handover = _handover(record, sweep.grid)
            report = record.report
        while done < n:
            values = max(run.at_once // lanes_per_value, 1)
            if direction != "independent":
                values = min(values, max(int(STRETCH_SECONDS / run.seconds), 1))
            stop = min(done + values, n)
            if (n - stop) * lanes_per_value == 1:
                stop = n
            at = _with_lanes(block, along, lanes_between(done, stop))
            computed = yield sweep.part(at, direction), handover
            assert computed is not None
            handover = computed.handover
            if direction != "independent":
                run.seconds = computed.seconds / (stop - done)
            done = stop
            at = (*prefix, *at)
            report = min(filter(None, (report, _first_report(computed.result, at))), default=None)
            data = in_direction(computed.result.data, direction) if is_directional else computed.result.data
            finished = (*prefix, *_with_lanes(block, along, lanes_between(0, done)))
            leaves = jax.tree.leaves((handover.state, handover.arrived))
            run.store.write((*prefix, *block), at, data, BlockRecord(finished, report, leaves))
        if report is not None:
            run.reports.append(report)


def _first_report(result: SweepResult, at: Lanes) -> ChatterReport | None:
    """The report that a part has, which is removed from its attributes."""
    text = result.data.attrs.pop("chatter", None)
    if text is None:
        return None
    first = np.argwhere(result.status == Status.TOO_MANY_EVENTS)[0]
    offsets = [0] * (len(at) - len(first)) + first.tolist()  # the direction comes first
    return [[lanes.start + i for lanes, i in zip(at, offsets, strict=True)], text]


def _handover(record: BlockRecord, grid: Grid) -> SweepHandover:
    """The handover to the next lanes."""
    if not record.handover:
        return SweepHandover()
    structure = jax.tree.structure((initial_states(jax.tree.map(lambda a: a[:1], grid.lanes)), 0))
    state, arrived = jax.tree.unflatten(structure, record.handover)
    return SweepHandover(state=state, arrived=arrived)


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
