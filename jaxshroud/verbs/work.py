"""What it takes to compute a block of a sweep, wherever that is."""

import math
from collections.abc import Generator, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.continuation import Relay
from jaxshroud.batch.runs import starts
from jaxshroud.model.state import State
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.unfinished import Record
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import Direction
from jaxshroud.verbs.swept import Grid, Wanted, swept


class Work(NamedTuple):
    """All that the numbers of a block depend on."""

    part: Grid
    begin: State | None
    direction: Direction
    wanted: Wanted
    relay: Relay  # from the values before

    def some(self, at: Sequence[slice], relay: Relay) -> "Work":
        """The work on some of the lanes."""
        part, whole = some(self.part, at), self.part.shape
        return self._replace(part=part, begin=cut(self.begin, at, whole), relay=relay)

    @property
    def lanes(self) -> int:
        """How many it has."""
        return math.prod(self.part.shape)


class Computed(NamedTuple):
    """The numbers of a block, and what is kept beside them."""

    result: SweepResult
    record: Record


Chain = Generator[Work, Computed, None]  # blocks of which each needs what the one before has come to


def some(grid: Grid, at: Sequence[slice]) -> Grid:
    """Some of the lanes of a grid."""
    outer = len(grid.door.shape)
    scene = jax.tree.map(lambda a: a[tuple(at[:outer])], grid.door.scene) if outer else grid.door.scene
    shape = tuple(part.stop - part.start for part in at[:outer])
    axes = {key: values[part] for (key, values), part in zip(grid.axes.items(), at[outer:], strict=True)}
    lanes, precise, numbers = cut((grid.lanes, grid.precise, grid.numbers), at, grid.shape)
    return Grid(grid.door._replace(scene=scene, shape=shape), lanes, axes, precise, numbers)


def cut(tree: Any, at: Sequence[slice], shape: Sequence[int]) -> Any:
    """Some of the lanes of a tree of arrays, with a leading axis of all lanes, which are a grid of that shape."""
    return jax.tree.map(
        lambda a: np.asarray(a).reshape(*shape, *a.shape[1:])[tuple(at)].reshape(-1, *a.shape[1:]), tree
    )


def computed(work: Work) -> Computed:
    """A block."""
    relay = work.relay
    data = swept(work.part, work.begin, work.direction, work.wanted, relay).data
    if not work.wanted.samples:
        data = data.drop_vars(Motion._fields)
    record = {"chatter": np.array(data.attrs.get("chatter", ""))}
    if relay.state is not None:
        record |= {str(i): np.asarray(a) for i, a in enumerate(jax.tree.leaves((relay.state, relay.arrived)))}
    data.attrs = {name: value for name, value in data.attrs.items() if name != "chatter"}
    return Computed(SweepResult(data), record)


def passed_on(record: Record, grid: Grid) -> Relay:
    """What the record of a block has kept for the next."""
    if "0" not in record:
        return Relay()
    like = jax.tree.structure((starts(jax.tree.map(lambda a: a[:1], grid.lanes)), 0))
    return Relay(*jax.tree.unflatten(like, [record[str(i)] for i in range(like.num_leaves)]))


def in_turn(chains: Iterable[Chain]) -> None:
    """Everything computed here, block by block."""
    for chain in chains:
        work = next(chain, None)
        while work is not None:
            work = answered(chain, computed(work))


def answered(chain: Chain, done: Computed) -> Work | None:
    """What a chain needs next; None at its end."""
    try:
        return chain.send(done)
    except StopIteration:
        return None
