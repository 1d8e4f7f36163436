"""Runs of scenes that are asked to stay in one state of contact: their settled motion in closed form, without steps."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.batch.plan import Plan, RunLog, Runs, Tick
from jaxshroud.batch.states import states_apart
from jaxshroud.linear.linear_motion import LinearMotion
from jaxshroud.linear.linear_sector import settled_linear_motions
from jaxshroud.march.accumulator import ContactPeaks, ContactTimes, Counters, DisplacementRange, Impacts, StepExtrema
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import ANGLE_RANGE
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Means, Moments
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import Quantity, amplitude_of
from jaxshroud.scene.scene import Scene

STILL = 1e-13  # of the mean square, below which the variance of a blade that stands still is rounding


class EndedLane(NamedTuple):
    """What is read of lanes at their end: they were not marched."""

    state: State
    status: Any


def settled_runs(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray) -> Runs:
    """The runs of lanes (leading axis) whose contact stays in one state; a settled motion has no start."""
    del states, arrived
    motion = settled_linear_motions(scenes)
    status = linear_status(motion)
    ticker(len(status) * (plan.transient + plan.kept))
    samples = _sample(scenes, motion, plan.method)
    samples = jax.tree.map(lambda a: _repeated(a, status, plan.kept), samples)
    v_max: Any = np.where(status[:, None] == Status.OK, motion.v_max, np.nan)
    unknown: Any = np.full_like(v_max, np.nan)
    within = StepExtrema(v_max, unknown, unknown, unknown) if plan.method.within else None
    counts: dict[str, Any] = dict.fromkeys(Counters.__annotations__, jnp.zeros(v_max.shape, jnp.int32))
    log = RunLog(v_max, Counters(**counts), within)
    last = jax.tree.map(lambda a: a[:, -1], samples.motion)
    return Runs(samples, jax.tree.map(np.zeros_like, log), log, EndedLane(states_apart(scenes, last), status))


def linear_amplitude_values(scenes: Scene, of: Quantity) -> np.ndarray:
    """An amplitude, such as "x_peak", of scenes (leading axis), (lanes, blades); NaN where the state is not kept."""
    motion = settled_linear_motions(scenes)
    return np.where((linear_status(motion) == Status.OK)[:, None], linear_amplitudes(motion, of), np.nan)


def linear_amplitudes(motion: LinearMotion, of: Quantity) -> Any:
    """An amplitude of linear motions, (lanes, blades); that of a blade that stands still has no derivative."""
    amplitude = amplitude_of(of)
    assert amplitude is not None  # which `of` is
    mean, square, high, low = (
        a[:, amplitude.row] for a in (motion.first, motion.second, motion.highest, motion.lowest)
    )
    xp = mean.__array_namespace__()
    if amplitude.measure == "mean":
        return mean
    if amplitude.measure == "rms":
        variance = square - mean**2
        return xp.sqrt(xp.where(variance > STILL * square, variance, 0.0))
    return xp.where(high - mean >= mean - low, high - mean, mean - low)


def linear_status(motion: LinearMotion) -> np.ndarray:
    """The status of lanes: OK where the state of contact is kept."""
    numbers = np.asarray(motion.power)
    status = np.where(motion.margins.holds, Status.OK, Status.NOT_LINEAR)
    turned = np.maximum(np.abs(motion.highest), np.abs(motion.lowest))[:, 2].max(axis=1)
    status = np.where(turned > ANGLE_RANGE, Status.ANGLE_OUT_OF_RANGE, status)
    return np.where(np.isfinite(numbers).all(axis=1), status, Status.NOT_FINITE).astype(np.int32)


def _repeated(a: Any, status: np.ndarray, kept: int) -> np.ndarray:
    """A number of lanes (lanes, ...) in each of the kept periods; NaN where the state is not kept."""
    ok = (status == Status.OK).reshape(-1, *[1] * (np.ndim(a) - 1))
    return np.repeat(np.where(ok, a, np.nan)[:, None], kept, axis=1)


def _sample(scenes: Scene, motion: LinearMotion, method: Choices) -> Sample:
    """One period of each lane."""
    period = 2 * np.pi / np.asarray(scenes.drive.omega, float)[:, None]
    counted = scenes.layout.counting
    first, second, highest, lowest = (
        tuple(np.moveaxis(np.asarray(a), 1, 0)) for a in (motion.first, motion.second, motion.highest, motion.lowest)
    )

    def in_time(numbers):
        return tuple(a * period for a in numbers)

    still = np.zeros_like(motion.N_max)
    whole = still + period
    sample = Sample(
        Motion._make(np.asarray(part)[:, i] for part in (motion.displacement, motion.speed) for i in range(3)),
        motion.power,
        largest=tuple(np.maximum(np.abs(a), np.abs(b)) for a, b in zip(highest, lowest, strict=True)),
        times=ContactTimes(whole, still, still)
        if scenes.parts.contact == "apart"
        else ContactTimes(still, whole, still),
    )
    if method.vibration:
        sample = sample._replace(means=Means._make(np.asarray(a)[:, counted] for a in motion.means))
    if method.amplitudes:
        extent = DisplacementRange(highest, lowest)
        sample = sample._replace(moments=Moments(in_time(first), in_time(second)), extent=extent)
    if method.ledger:
        lost = _power_lost(scenes, motion) * period[:, 0]
        nothing = np.zeros_like(lost)
        works = {"work": lost, "gross": lost, "viscous": lost, "dropped": nothing, "residual": nothing}
        sample = sample._replace(**works, friction=still, switched=still)
    if method.forces:
        loads = ContactLoads(motion.N * period, still, still, still)
        sample = sample._replace(
            forces=ContactPeaks(motion.N_max, motion.F_max), loads=loads, impacts=Impacts._make([still] * 7)
        )
    return sample


def _power_lost(scenes: Scene, motion: LinearMotion) -> np.ndarray:
    """The mean power that the dampers of all blades take, which the drive gives [W], (lanes,)."""
    b = scenes.blades
    assert isinstance(b, Blades)  # others have no closed forms
    dampers = np.stack([np.asarray(a, float) for a in (b.c_x, b.c_y, b.c_T)], axis=1)
    return np.einsum("lrb,lrb->l", motion.speed_square, dampers)
