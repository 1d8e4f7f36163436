"""Rows of blades for the tests: scenes of them, and runs of alike-structured scenes side by side."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.lanes import begin_lanes
from jaxshroud.batch.periods import Clock, Sample, at_start_of_period, one_call, run_block
from jaxshroud.batch.xla import best_mapping
from jaxshroud.march.carry import Lane
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau
from jaxshroud.model.prepared import State
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Contact, Drive, Friction, Row, Scene, Shroud

CHAIN_OF_TWO = ["row.blades=2", "row.closed=false", "drive.engine_order=1"]  # of row_ring12
PAIR = [  # the same two blades, of table1
    *('blades.I="block"', "contact.gamma=2.6", "drive.F_0=60", "drive.M_0=0.3"),
    'drive.phase=["0 deg", "180 deg"]',
]
EXACT_ROW = Choices(tableau("dopri8"), "cubic", True)
BLOCK, LANES = 4, 8  # periods and lanes in one call: one program for any numbers of them


class RowRuns(NamedTuple):
    """Runs of rows, and what a further run of them takes."""

    samples: Sample  # (periods, lanes, ...)
    last: Lane  # as many lanes as the program has
    batch: Scene  # likewise
    method: Choices

    @property
    def motion(self) -> np.ndarray:
        """States at the ends of the periods, (lanes, periods, 6, N): x, y, theta and their rates."""
        return np.stack(self.samples.motion, axis=2).swapaxes(0, 1)

    def counts(self, kind: str) -> np.ndarray:
        """Events of one kind, (lanes, interfaces)."""
        return np.asarray(getattr(self.last.accumulator.log.counters, kind))

    @property
    def residual(self) -> np.ndarray:
        """The summed residual of the energy balance over the summed gross work of the drive, (lanes,)."""
        return np.sum(self.samples.residual, axis=0) / np.sum(self.samples.gross, axis=(0, 2))


def run_rows(scenes: list[Scene], periods: int, steps: int, method: Choices = EXACT_ROW) -> RowRuns:
    """Runs of alike-structured rows from their initial motions, on a multiple of `LANES` lanes."""
    lacking = -len(scenes) % LANES
    batch = jax.tree.map(lambda *a: jnp.stack(a), *scenes, *scenes[-1:] * lacking)
    assert batch.row is not None
    none = jnp.zeros((len(scenes) + lacking, batch.row.interfaces))
    contact = none.astype(jnp.int32)
    lanes = begin_lanes(batch, State(batch.initial, none, contact, contact), method)
    clock = Clock.of_steps(steps)
    kept: list[Any] = []
    for done in range(0, periods, BLOCK):
        n = min(BLOCK, periods - done)
        lanes, block = block_of_periods(batch, lanes, clock, n, method)
        kept.append(jax.tree.map(lambda a, n=n: np.asarray(a)[:n, : len(scenes)], block))
    return RowRuns(jax.tree.map(lambda *a: np.concatenate(a), *kept), lanes, batch, method)


def block_of_periods(batch: Any, lanes: Any, clock: Clock, n: int, method: Choices) -> tuple[Any, Sample]:
    """The rows after `n` periods, in one call, and a block of samples."""
    begin = at_start_of_period(lanes)
    end, _, samples = run_block(batch, begin, clock, one_call(n), method, BLOCK, best_mapping())
    return end.lanes, samples


def part_of_period(runs: RowRuns, steps: int, per_period: int) -> np.ndarray:
    """States (lanes, 6, N) so many steps after the end of the runs."""
    clock = Clock.of_steps(steps)._replace(per_period=jnp.asarray(float(per_period)))
    _, block = block_of_periods(runs.batch, runs.last, clock, 1, runs.method)
    return np.stack(block.motion, axis=2)[0]


def row_scene_of(p: Any) -> Scene:
    """The scene of `RowParameters`."""
    blades = Blades(p.m, p.I, p.k_x, p.k_y, p.k_T, p.c_x, p.c_y, p.c_T, p.m_y)
    shroud = Shroud(p.alpha, p.l_oa, p.l_ab, jnp.array(p.gap))
    drive = Drive(p.omega, p.beta, p.F_0, p.M_0, p.phase)
    initial = Motion(*np.reshape(p.initial, (6, len(p.m))))
    friction = Friction(jnp.array(p.k_d), jnp.array(p.mu))
    row = Row(len(p.m), p.closed, p.mistuning)
    return Scene(blades, shroud, Contact(jnp.array(p.k), None), friction, drive, initial, row=row)
