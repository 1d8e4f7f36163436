"""The blocks of a sweep: the tasks that compute them, in this process or on a worker."""

import math
import pickle
from collections.abc import Generator, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.compilation_cache import cache_compilations, cache_folder
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.threads import jax_settings, single_threaded
from jaxshroud.io.block_records import Record
from jaxshroud.model.prepared import State
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Direction
from jaxshroud.scene.typed import Tree
from jaxshroud.verbs.sweep_run import Grid, SweepSettings, confirmed_run, run_sweep


class BlockTask(NamedTuple):
    """Everything on which the numbers of a block depend."""

    grid: Grid
    states: State | None
    direction: Direction
    settings: SweepSettings
    handover: SweepHandover  # from the previous values

    def part(self, at: Sequence[slice], handover: SweepHandover) -> "BlockTask":
        """The task of computing the lanes at those slices of the axes."""
        states = select_block(self.states, at, self.grid.shape)
        return self._replace(grid=part_of_grid(self.grid, at), states=states, handover=handover)

    @property
    def lanes(self) -> int:
        """The number of its lanes."""
        return math.prod(self.grid.shape)


class ComputedBlock(NamedTuple):
    """The result of a block, and the record that is stored beside it."""

    result: SweepResult
    record: Record


Chain = Generator[BlockTask, ComputedBlock, None]  # yields tasks, each of which needs the block before it


def part_of_grid(grid: Grid, at: Sequence[slice]) -> Grid:
    """The part of a grid at those slices of its axes."""
    outer = len(grid.resolved.shape)
    scene = jax.tree.map(lambda a: a[tuple(at[:outer])], grid.resolved.scene) if outer else grid.resolved.scene
    shape = tuple(lanes.stop - lanes.start for lanes in at[:outer])
    axes = {key: values[lanes] for (key, values), lanes in zip(grid.axes.items(), at[outer:], strict=True)}
    lanes, precise, numbers = select_block((grid.lanes, grid.precise, grid.numbers), at, grid.shape)
    return Grid(grid.resolved._replace(scene=scene, shape=shape), lanes, axes, precise, numbers)


def select_block(tree: Tree, at: Sequence[slice], shape: Sequence[int]) -> Tree:
    """The lanes of a block, from a tree of arrays whose leading axis holds all lanes of a grid of that shape."""
    return jax.tree.map(
        lambda a: np.asarray(a).reshape(*shape, *a.shape[1:])[tuple(at)].reshape(-1, *a.shape[1:]), tree
    )


def compute_block(task: BlockTask) -> ComputedBlock:
    """Run the lanes of a block."""
    handover = task.handover

    def run(settings):
        return run_sweep(task.grid, task.states, task.direction, settings, handover)

    data = confirmed_run(run, task.settings).data
    if not task.settings.keep_samples:
        data = data.drop_vars(Motion._fields)
    record = {"chatter": np.array(data.attrs.get("chatter", ""))}
    if handover.state is not None:
        record |= {str(i): np.asarray(a) for i, a in enumerate(jax.tree.leaves((handover.state, handover.arrived)))}
    data.attrs = {name: value for name, value in data.attrs.items() if name != "chatter"}
    return ComputedBlock(SweepResult(data), record)


def handover_from(record: Record, grid: Grid) -> SweepHandover:
    """The handover to the next block that the record of a block holds."""
    if "0" not in record:
        return SweepHandover()
    structure = jax.tree.structure((initial_states(jax.tree.map(lambda a: a[:1], grid.lanes)), 0))
    return SweepHandover(*jax.tree.unflatten(structure, [record[str(i)] for i in range(structure.num_leaves)]))


def compute_in_process(chains: Iterable[Chain]) -> None:
    """Compute all chains in this process, block by block."""
    for chain in chains:
        task = next(chain, None)
        while task is not None:
            task = next_task(chain, compute_block(task))


def next_task(chain: Chain, done: ComputedBlock) -> BlockTask | None:
    """The next task of a chain, which is sent the block before it; None at its end."""
    try:
        return chain.send(done)
    except StopIteration:
        return None


def compute_pickled(sent: bytes, settings: dict[str, Any]) -> ComputedBlock:
    """Compute a pickled task with one thread of a worker."""
    if not cache_folder():
        cache_compilations()
    with jax_settings(settings), single_threaded():  # unpickled within them: else float64 numbers become float32
        return compute_block(pickle.loads(sent))
