"""Trajectories of rows of blades."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.row_samples import march_row_samples
from jaxshroud.batch.rows import row_energy_residual, row_ledger
from jaxshroud.batch.runs import Ticker, chunk_by_chunk
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.march.method import Choices
from jaxshroud.march.tally import times_of
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import ContactLoads
from jaxshroud.motion.amplitudes import sampled_amplitude_values
from jaxshroud.motion.averages import contact_shares
from jaxshroud.scene.scene import Scene


def marched_row_values(
    scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Ticker
) -> dict[str, Any]:
    """The values of rows (leading axis) that are marched, by the names of `RowTrajectory`."""
    method = method._replace(forces=True)

    def run(chunk: Any, tick: Any) -> Any:
        rows, begin = chunk
        return march_row_samples(rows, begin, grid, method, tick)

    samples, amplitudes, last, (before, after) = chunk_by_chunk(
        run, (scenes, states), ticker, lanes_per_call(scenes.row_size)
    )
    state, forces, log, tally = samples.state, samples.forces._asdict(), last.tally.log, last.tally
    return {
        "motion": state.motion,
        "u_s": np.where(state.mode == Mode.APART, np.nan, state.u_s),
        "mode": state.mode,
        "case": state.case,
        **{name: a for name, a in forces.items() if isinstance(a, np.ndarray)},
        "counters": {name: np.asarray(n) for name, n in vars(filled(log.counters, state.mode[:, 0])).items()},
        **contact_shares(times_of(log)),
        **sampled_amplitude_values(scenes, amplitudes),
        **_loads(scenes, tally.integrals.loads, state.mode[:, 0], grid),
        **_energies(tally, before, after, last.status),
    }


def _loads(scenes: Scene, loads: ContactLoads, like: np.ndarray, grid: SampleGrid) -> dict[str, Any]:
    """What wears the faces of each interface (lanes, interfaces) over the whole run."""
    zero = np.zeros(like.shape, np.asarray(scenes.drive.omega).dtype)
    N, N_slip, time_slip, slip = (np.asarray(a, float) for a in filled(loads, zero))
    duration = np.asarray(scenes.drive.period, float)[:, None] * (grid.length / grid.steps)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"slip": slip, "N_mean": N / duration, "N_slip": N_slip / time_slip}


def _energies(tally: Any, before: np.ndarray, after: np.ndarray, status: np.ndarray) -> dict[str, Any]:
    """The works, the energy balance, and the status of rows (leading axis) with what the balance shows."""
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        gained = after - before
    finite = np.isfinite(gained)
    status = np.where((status == Status.OK) & ~finite, Status.NOT_FINITE, status)
    if tally.integrals.ledger is None:
        missing = np.full(len(gained), np.nan)
        return {"status": status, "energy_residual": missing, "energy_dropped": missing}
    works = row_ledger(tally)
    drive, gross = works.drive.sum(axis=-1), works.gross.sum(axis=-1)
    tally, gained = jax.tree.map(jnp.asarray, (tally, gained))
    residual = np.asarray(row_energy_residual(tally, gained, -1))
    return {
        "status": status,
        "energy_residual": residual / np.where(drive == 0, 1.0, np.abs(drive)),
        "energy_dropped": np.asarray(tally.dropped, float) / np.where(gross > 0, gross, 1.0),
        "work_drive": np.asarray(works.drive, float),
        "loss_viscous": np.asarray(works.viscous, float),
        "loss_friction": np.asarray(works.friction, float),
    }
