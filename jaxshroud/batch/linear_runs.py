"""Runs of scenes that are asked to stay in one state of contact: their settled motion in closed form, without steps."""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.linear_motion import LinearMotion, LinearState, held_contact, linear_motions, sprung
from jaxshroud.batch.march_protocol import March
from jaxshroud.batch.periods import Sample
from jaxshroud.batch.plan import Plan, Runs, Tick, run_log
from jaxshroud.batch.states import initial_states
from jaxshroud.march.accumulator import ContactPeaks, ContactTimes, DisplacementRange, Impacts
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import ANGLE_RANGE
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Means, Moments
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene, without_given


def settled_runs(begin: Callable[[Any, Any, Any], Any]) -> Callable[..., Runs]:
    """The runs of a march whose lanes `begin` so."""

    def run(march: March, scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray) -> Runs:
        del march, states, arrived  # a settled motion has no start
        return _settled(begin, scenes, plan, ticker)

    return run


def _settled(begin: Callable[[Any, Any, Any], Any], scenes: Scene, plan: Plan, ticker: Tick) -> Runs:
    state = cast(LinearState, scenes.parts.contact)
    motion = linear_motions(scenes, held_contact(scenes, state))
    status = linear_status(motion)
    own = without_given(sprung(scenes))
    apart = initial_states(eqx.tree_at(lambda s: s.initial, own, jax.tree.map(np.zeros_like, own.initial)))
    lanes = begin(own, apart, plan.method)
    count = len(status)
    v_max = np.where(status[:, None] == Status.OK, motion.v_max, np.nan)
    places = lambda lane: [lane.status, lane.accumulator.log.v_max]
    last = eqx.tree_at(places, lanes, [status, v_max.reshape(np.shape(lanes.accumulator.log.v_max))])
    if plan.method.within:
        last = eqx.tree_at(
            lambda lane: lane.accumulator.log.within.v_max, last, v_max.reshape(np.shape(lanes.accumulator.log.v_max))
        )
    ticker(count * (plan.transient + plan.kept))
    samples = _sample(scenes, motion, state, plan.method)
    samples = jax.tree.map(lambda a: _repeated(a, status, plan.kept), samples)
    log = run_log(last)
    return Runs(samples, jax.tree.map(np.zeros_like, log), log, last)


def linear_amplitude_values(scenes: Scene, of: str) -> np.ndarray:
    """An amplitude, such as "x_peak", of scenes (leading axis), (lanes, blades); NaN where the state is not kept."""
    motion = linear_motions(scenes, held_contact(scenes, cast(LinearState, scenes.parts.contact)))
    name, _, measure = of.partition("_")
    row = COORDINATES.index(name)
    mean, square, high, low = (
        np.asarray(a)[:, row] for a in (motion.first, motion.second, motion.highest, motion.lowest)
    )
    sizes = {
        "mean": mean,
        "rms": np.sqrt(np.maximum(square - mean**2, 0.0)),
        "peak": np.maximum(high - mean, mean - low),
    }
    return np.where((linear_status(motion) == Status.OK)[:, None], sizes[measure], np.nan)


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


def _sample(scenes: Scene, motion: LinearMotion, state: LinearState, method: Choices) -> Sample:
    """One period of each lane."""
    period = 2 * np.pi / np.asarray(scenes.drive.omega, float)[:, None]
    counted = scenes.layout.counting
    first, second, highest, lowest = (
        tuple(np.moveaxis(np.asarray(a), 1, 0)) for a in (motion.first, motion.second, motion.highest, motion.lowest)
    )
    place, speed = np.asarray(motion.displacement)[:, 0], np.asarray(motion.speed)[:, 0]
    in_time = lambda numbers: tuple(a * period for a in numbers)
    still = np.zeros_like(motion.N_max)
    whole = still + period
    sample = Sample(
        Motion(*(part[:, i] for part in (place, speed) for i in range(3))),
        motion.power,
        largest=tuple(np.maximum(np.abs(a), np.abs(b)) for a, b in zip(highest, lowest, strict=True)),
        times=ContactTimes(whole, still, still) if state == "apart" else ContactTimes(still, whole, still),
    )
    if method.vibration:
        sample = sample._replace(means=Means(*(np.asarray(a)[:, counted] for a in motion.means)))
    if method.amplitudes:
        extent = DisplacementRange(highest, lowest)
        sample = sample._replace(moments=Moments(in_time(first), in_time(second)), extent=extent)
    if method.ledger:
        lost = _lost(scenes, motion) * period[:, 0]
        nothing = np.zeros_like(lost)
        works = {"work": lost, "gross": lost, "viscous": lost, "dropped": nothing, "residual": nothing}
        sample = sample._replace(**works, friction=still, switched=still)
    if method.forces:
        loads = ContactLoads(motion.N * period, still, still, still)
        sample = sample._replace(
            forces=ContactPeaks(motion.N_max, motion.F_max), loads=loads, impacts=Impacts(*[still] * 7)
        )
    return sample


def _lost(scenes: Scene, motion: LinearMotion) -> np.ndarray:
    """The mean power that the dampers of all blades take, which the drive gives [W], (lanes,)."""
    b = scenes.blades
    dampers = np.stack([np.asarray(a, float) for a in (b.c_x, b.c_y, b.c_T)], axis=1)
    return np.einsum("lsrb,lrb->l", np.asarray(motion.speed) ** 2, dampers) / np.shape(motion.speed)[1]
