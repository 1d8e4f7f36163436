"""Rings marched by their sector: a smaller ring in the place of scenes, and its results as those of the whole ring.

A smaller ring stays in motions that repeat from sector to sector. Whatever does not start so is marched whole, and so
are tangents, by which stability is told.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.held_contact import is_linear
from jaxshroud.batch.plan import Runs
from jaxshroud.batch.stretches import Trajectories
from jaxshroud.model.prepared import State
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import asks_for_sector, sector_blades, smaller_ring, whole_ring
from jaxshroud.scene.typed import Tree

SAME_STATE = 1e-12  # of the largest number of its kind: by which states of equal blades may differ
TOTALS_OF_PERIODS = ("work", "gross", "viscous", "dropped", "residual")  # of a `Sample`, summed over the row
TOTALS_OF_RUNS = ("work_drive", "loss_viscous")  # of the energies of `Trajectories`


class Folded(NamedTuple):
    """Lanes (leading axis) as they are marched."""

    scenes: Scene
    states: State
    copies: int  # of their rings that make the ring of the scenes; 1: it is whole


def folded(scenes: Scene, states: State) -> Folded:
    """Lanes (leading axis) as they are marched: by their sector, where that is asked for and the states repeat so."""
    if not asks_for_sector(scenes):
        return Folded(scenes, states, 1)
    if is_linear(scenes):  # closed forms are folded themselves
        return Folded(scenes, states, 1)
    blades, n = scenes.layout.blades, sector_blades(scenes)
    if n == blades or not _repeat_after(n, states):
        return Folded(whole_ring(scenes), states, 1)
    return Folded(smaller_ring(scenes, n), jax.tree.map(lambda a: a[:, :n], states), blades // n)


def _repeat_after(blades: int, states: State) -> bool:
    """Whether states, whose second axis is that of blades or interfaces, repeat after so many of them."""

    def repeats(a):
        real = np.asarray(a, float)
        return np.all(np.abs(np.roll(real, -blades, axis=1) - real) <= SAME_STATE * np.max(np.abs(real), initial=0.0))

    return all(map(repeats, jax.tree.leaves(states)))


def unfolded_runs(runs: Runs, copies: int) -> Runs:
    """The runs of so many copies of a ring as one."""
    if copies == 1:
        return runs
    samples, log = _tiled(runs.samples, copies, 2), (_tiled(part, copies, 1) for part in (runs.before, runs.log))
    totals = {name: getattr(samples, name) for name in TOTALS_OF_PERIODS}
    samples = samples._replace(**{name: None if a is None else copies * a for name, a in totals.items()})
    before, after = log
    return replace(runs, samples=samples, before=before, log=after, last=_unfolded_lanes(runs.last, copies))


def unfolded_trajectories(found: Trajectories, copies: int) -> Trajectories:
    """The trajectories of so many copies of a ring as one."""
    if copies == 1:
        return found
    energy = _tiled(found.energy, copies, 1)
    return found._replace(
        samples=_tiled(found.samples, copies, 2),
        amplitudes=_tiled(found.amplitudes, copies, 1),
        counters=_tiled(found.counters, copies, 1),
        energy=energy | {name: copies * energy[name] for name in TOTALS_OF_RUNS if name in energy},
        loads=_tiled(found.loads, copies, 1),
        times=_tiled(found.times, copies, 1),
        last=_unfolded_lanes(found.last, copies),
    )


def _unfolded_lanes(lanes: Any, copies: int) -> Any:
    """The lanes at the end of a march, as compiled loops carry them: blades and interfaces are their last axis."""
    tiled = _tiled(lanes, copies, -1)
    return eqx.tree_at(lambda lane: lane.accumulator.jumps.dropped, tiled, copies * lanes.accumulator.jumps.dropped)


def _tiled(tree: Tree, copies: int, axis: int) -> Tree:
    """A tree of arrays with that axis repeated; those without it, of whole rings, stay as they are."""
    least = axis + 1 if axis > 0 else 2

    def tiled(a):
        return a if np.ndim(a) < least else np.concatenate([a] * copies, axis=axis)

    return jax.tree.map(tiled, tree)
