"""A sweep whose lanes are stored some at a time, in memory that does not grow, and gone on with after any end."""

import math
import zlib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxshroud.batch.continuation import Relay
from jaxshroud.batch.extent import SAMPLE
from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.runs import starts
from jaxshroud.batch.threads import Interrupted
from jaxshroud.model.state import State
from jaxshroud.results.base import opened
from jaxshroud.results.blocks import Block, chains, spread
from jaxshroud.results.store import read
from jaxshroud.results.sweep import SweepResult, sweep_coordinates
from jaxshroud.results.unfinished import Lanes, Record, Unfinished, unfinished
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import Direction
from jaxshroud.scene.text import words_of
from jaxshroud.verbs.swept import AT_ONCE, Grid, Wanted, lane_periods, swept
from jaxshroud.version import __version__

LEAST, PARTS = 1024, 16  # lanes of a block, and blocks of a sweep that has more lanes than these
HELD = 2**28  # bytes of samples that a block may take in memory
STEPS = 2**22  # of one lane in a block of continued values: what a kill may cost, a few seconds


def stored(grid: Grid, states: State | None, direction: Direction, wanted: Wanted, path: Path) -> SweepResult:
    """All lanes in one direction, in a store.

    Raises:
        StoreError: There is a store of something else, or one in use.
        WriteError: The place cannot be written.
        Interrupted: Ctrl-C; `done` is what is stored, None if nothing is.
    """
    grid = grid._replace(lanes=jax.tree.map(np.asarray, grid.lanes), precise=jax.tree.map(np.asarray, grid.precise))
    period = np.arange(wanted.plan.transient + 1, wanted.plan.transient + wanted.plan.kept + 1)
    coords = sweep_coordinates(grid.axes, period)
    sizes = block_sizes(grid, direction, wanted)
    lanes = dict(zip(grid.dims, map(Lanes, grid.shape, sizes), strict=True))
    about = _words(grid, states, direction, wanted) | {"blocks": " x ".join(map(str, sizes))}
    with unfinished(path, lanes, about, coords) as store:
        try:
            _fill(store, sizes, grid, states, direction, wanted)
        except KeyboardInterrupt:
            raise Interrupted(_opened(path) if store.begun else None) from None
    return _opened(path)


def block_sizes(grid: Grid, direction: Direction, wanted: Wanted) -> tuple[int, ...]:
    """Lanes of a block along each axis: thousands, or so many of continued values that little is lost."""
    plan, shape = wanted.plan, grid.shape
    fit = min(AT_ONCE, HELD // (plan.kept * SAMPLE), max(LEAST, math.prod(shape) // PARTS))
    fit = max(fit // CHUNK, 1) * CHUNK
    if direction == "independent":
        return spread(shape, fit)
    first = len(grid.door.shape)
    beside = spread((*shape[:first], *shape[first + 1 :]), fit)
    each = plan.steps_per_period * (plan.transient + plan.kept) * max(math.prod(beside) / CHUNK, 1.0)
    return (*beside[:first], int(np.clip(STEPS / each, 1, min(CHUNK, shape[first]))), *beside[first:])


def _fill(
    store: Unfinished,
    sizes: tuple[int, ...],
    grid: Grid,
    states: State | None,
    direction: Direction,
    wanted: Wanted,
) -> None:
    """Compute what is not stored yet."""
    told: dict[tuple[int, ...], str] = {}
    along = len(grid.door.shape) if grid.axes else 0
    for chain in chains(grid.shape, sizes, along, backward=direction == "backward"):
        relay = Relay()
        for block in chain:
            record = store.record(block)
            if record is None:
                record = _computed(store, block, grid, states, direction, wanted, relay)
            else:
                _pass_on(record, relay, grid)
                wanted.ticker(block.lanes * lane_periods(wanted.plan, grid.precise is not None))
            told[block.place] = str(record["chatter"])
    first = next((told[place] for place in sorted(told) if told[place]), "")
    store.finish({"complete": 1, **({"chatter": first} if first else {})})


def _computed(
    store: Unfinished,
    block: Block,
    grid: Grid,
    states: State | None,
    direction: Direction,
    wanted: Wanted,
    relay: Relay,
) -> Record:
    """Compute and store a block; what is kept beside its numbers."""
    part, begin = _part(grid, block), _cut(states, block, grid)
    data = swept(part, begin, direction, wanted, relay).data
    if not wanted.samples:
        data = data.drop_vars(Motion._fields)
    record = {"chatter": np.array(data.attrs.get("chatter", ""))}
    if relay.state is not None:
        record |= {str(i): np.asarray(a) for i, a in enumerate(jax.tree.leaves((relay.state, relay.arrived)))}
    data.attrs = {name: value for name, value in data.attrs.items() if name != "chatter"}
    store.write(block, data, record)
    return record


def _pass_on(record: Record, relay: Relay, grid: Grid) -> None:
    """Give a relay what the record of a block has kept of it."""
    if "0" in record:
        like = jax.tree.structure((starts(jax.tree.map(lambda a: a[:1], grid.lanes)), 0))
        relay.state, relay.arrived = jax.tree.unflatten(like, [record[str(i)] for i in range(like.num_leaves)])


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


def _words(grid: Grid, states: State | None, direction: Direction, wanted: Wanted) -> dict[str, str]:
    """All that the numbers of a sweep depend on, by names."""
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
        "version": __version__,
        "jax": jax.__version__,
        "device": jax.devices()[0].device_kind,
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
