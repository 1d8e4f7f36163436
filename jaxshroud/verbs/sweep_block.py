"""The parts of a sweep: the tasks that compute them, in this process or on a worker."""

import math
import pickle
import time
from collections.abc import Generator, Iterable
from typing import Any, NamedTuple

import jax

from jaxshroud.batch.compilation_cache import cache_compilations, cache_folder
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.batch.threads import jax_settings, single_threaded
from jaxshroud.io.block_records import Lanes
from jaxshroud.model.prepared import State
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.typed import Tree
from jaxshroud.verbs.sweep_run import Grid, SweepSettings, confirmed_run, lane_periods, run_sweep


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

    def tick(self, lanes: int) -> None:
        """Report `lanes` more as done."""
        self.settings.ticker(lanes * lane_periods(self.settings.plan, self.grid.precise is not None))

    def part(self, at: Lanes, direction: Direction) -> "SweepTask":
        """The part with the lanes at those slices of the axes, in one direction."""
        grid = self.grid
        outer = len(grid.resolved.shape)

        def lanes(tree: Tree) -> Tree:  # of arrays whose leading axis holds all lanes
            return jax.tree.map(lambda a: a.reshape(*grid.shape, *a.shape[1:])[at].reshape(-1, *a.shape[1:]), tree)

        scene = jax.tree.map(lambda a: a[at[:outer]], grid.resolved.scene) if outer else grid.resolved.scene
        shape = tuple(part.stop - part.start for part in at[:outer])
        axes = {key: values[part] for (key, values), part in zip(grid.axes.items(), at[outer:], strict=True)}
        part = Grid(
            resolved=grid.resolved._replace(scene=scene, shape=shape),
            lanes=lanes(grid.lanes),
            axes=axes,
            precise=lanes(grid.precise),
            numbers=lanes(grid.numbers),
        )
        settings = self.settings._replace(is_part=self.lanes > 1)
        return SweepTask(part, lanes(self.states), direction, settings)


class ComputedPart(NamedTuple):
    """The result of a part."""

    result: SweepResult
    handover: SweepHandover
    seconds: float  # that it took


Chain = Generator[tuple[SweepTask, SweepHandover], ComputedPart | None, None]  # each part needs the one before it


def compute_part(task: SweepTask, handover: SweepHandover) -> ComputedPart:
    """Run lanes; `handover` is from the values before them."""
    began = time.perf_counter()
    data = confirmed_run(
        lambda settings: run_sweep(task.grid, task.states, task.direction, settings, handover), task.settings
    ).data
    if not task.settings.keep_samples:
        data = data.drop_vars(Motion._fields)
    return ComputedPart(SweepResult(data), handover, time.perf_counter() - began)


def next_part(chain: Chain, done: ComputedPart | None = None) -> tuple[SweepTask, SweepHandover] | None:
    """The next part of a chain, which is sent the one before it; None at its end."""
    try:
        return chain.send(done)
    except StopIteration:
        return None


def compute_in_process(chains: Iterable[Chain]) -> None:
    """Compute all chains in this process, part by part."""
    for chain in chains:
        part = next_part(chain)
        while part is not None:
            part = next_part(chain, compute_part(*part))


def compute_pickled(sent: bytes, settings: dict[str, Any]) -> ComputedPart:
    """Compute a pickled part with one thread of a worker."""
    if not cache_folder():
        cache_compilations()
    with jax_settings(settings), single_threaded():  # unpickled within them: else float64 numbers become float32
        return compute_part(*pickle.loads(sent))
