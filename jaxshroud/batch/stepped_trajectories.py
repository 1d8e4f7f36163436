"""Trajectories of many lanes that are marched step by step, with their energy balance."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.march_protocol import March
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Tick
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import chunk_by_chunk
from jaxshroud.batch.stretches import EnergyBalance, Trajectories
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import is_unbalanced
from jaxshroud.model.arithmetic import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State, law_type
from jaxshroud.scene.scene import Scene


def stepped_trajectories(
    march: March, scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick
) -> Trajectories:
    """The trajectories of lanes (leading axis), in chunks that share one compiled function."""
    run = lambda chunk, tick: march.sampled(chunk[0], chunk[1], grid, method, tick)
    marched = chunk_by_chunk(run, (scenes, states), ticker, lanes_per_call(scenes.layout))
    last, (before, after) = marched.last, marched.energies
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        balance = march.balance(last.tally, after - before)
        integrals = jax.tree.leaves((last.tally.integrals, after - before))
        finite = np.isfinite(sum(np.asarray(a, float).reshape(len(before), -1).sum(axis=-1) for a in integrals))
    status = np.where((last.status == Status.OK) & ~finite, Status.NOT_FINITE, last.status)
    if balance is not None and law_type(scenes).may_create_energy:
        astray = is_unbalanced(*map(jnp.asarray, (balance.residual, balance.works.gross, before, after)))
        status = np.where((status == Status.OK) & np.asarray(astray), Status.UNBALANCED, status)
    counters = filled(last.tally.log.counters, marched.samples["mode"][:, 0])
    return Trajectories(
        samples=marched.samples,
        amplitudes=marched.amplitudes,
        status=status,
        counters={name: np.asarray(a) for name, a in vars(counters).items()},
        energy=_energy_values(balance, len(before)),
        loads=last.tally.integrals.loads,
        times=last.tally.log.times,
        last=last,
        events=marched.events,
    )


def _energy_values(balance: EnergyBalance | None, lanes: int) -> dict[str, np.ndarray]:
    """The works [J] and the energy balance by the names of results, NaN without a ledger."""
    if balance is None:
        missing = np.full(lanes, np.nan)
        return {"energy_residual": missing, "energy_dropped": missing}
    gain = balance.works
    works = {"work_drive": gain.drive, "loss_viscous": gain.viscous, "loss_friction": gain.friction}
    return {
        "energy_residual": (balance.residual / np.where(gain.drive == 0, 1.0, np.abs(gain.drive))).astype(float),
        "energy_dropped": (balance.dropped / np.where(gain.gross > 0, gain.gross, 1.0)).astype(float),
        **{name: np.asarray(a, float) for name, a in {**works, **balance.of_blades}.items()},
    }
