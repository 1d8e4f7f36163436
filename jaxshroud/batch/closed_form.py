"""Runs in closed form, without steps: of scenes without contact, and of those asked to stay in one state of contact.

Without contact a run begins with its transient. Of a state of contact it is the settled motion.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.batch.lanes import begin_lanes, carried_state, states_apart
from jaxshroud.batch.limits import check_memory
from jaxshroud.batch.periods import Sample, sample_of_users
from jaxshroud.batch.plan import Plan, RunLog, Runs, Tick, run_log
from jaxshroud.batch.sampling import MAX_UNKEPT, SAMPLES_PER_BLOCK, SampleGrid
from jaxshroud.batch.stretches import RunningAmplitudes, SampledAmplitudes, Trajectories
from jaxshroud.cache.programs import kept
from jaxshroud.linear.linear_motion import LinearMotion
from jaxshroud.linear.linear_sector import settled_linear_motions
from jaxshroud.march.accumulator import ContactPeaks, ContactTimes, Counters, DisplacementRange, Impacts, StepExtrema
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest
from jaxshroud.model.arithmetic import ANGLE_RANGE, Scalar, Unrolled, sine_versine, summed
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import free_components, free_motion, free_propagators, steady_amplitudes
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Displacements, Means, Moments, position_of
from jaxshroud.model.row import along_blades, at_interface, prepared_row
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import DISPLACEMENTS, Quantity, amplitude_of
from jaxshroud.scene.scene import PerBlade, Scene

NEWTON_STEPS = 4  # from the node at which a displacement is largest to where its speed vanishes: to rounding


class FreeCourse(NamedTuple):
    """The displacements of free blades and their rates at some times, (times, 2, 3) each: blades; x, y and theta."""

    displacement: Float[Array, "n 2 3"]
    speed: Float[Array, "n 2 3"]
    acceleration: Float[Array, "n 2 3"]


def free_course(scene: Scene, first: Motion, turns: Scalar, t: Float[Array, " n"]) -> FreeCourse:
    """The course of the free blades at times `t` after the motion `first` at a drive phase [turns]."""
    start = free_components(scene, first, turns)

    def course(t: Float[Array, " n"]) -> list[Float[Array, "n 2 3"]]:
        return [jnp.einsum("nbik,bik->nbi", a, start) for a in free_propagators(scene, t)]

    (q, w), (_, acceleration) = jax.jvp(course, (t,), (jnp.ones_like(t),))
    return FreeCourse(q, w, acceleration)


def _gauss_rule(scene: Scene, nodes: int) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """The nodes of the Gauss-Legendre rule over a drive period [s], and their weights, whose sum is 1."""
    place, weights = np.polynomial.legendre.leggauss(nodes)
    dtype = scene.drive.omega.dtype
    return jnp.asarray((place + 1) / 2, dtype) * scene.drive.period, jnp.asarray(weights / 2, dtype)


def free_extent(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> tuple[Moments, DisplacementRange]:
    """The moments and the range over the drive period that begins with the motion `first`.

    Args:
        scene: The scene.
        first: The motion at the start, fields (2,).
        turns: The drive phase there.
        nodes: Of the Gauss-Legendre rule over a period.
    """
    inner, weights = _gauss_rule(scene, nodes)
    period = scene.drive.period[None]
    t = jnp.concatenate([0 * period, inner, period])
    q = free_course(scene, first, turns, t).displacement
    moments = Moments._make(_in_pairs(jnp.einsum("n,nbi->bi", weights * period, a[1:-1])) for a in (q, q**2))
    highest = jnp.maximum(_at_turn(scene, first, turns, t, q, jnp.argmax(q, axis=0)), jnp.max(q, axis=0))
    lowest = jnp.minimum(_at_turn(scene, first, turns, t, q, jnp.argmin(q, axis=0)), jnp.min(q, axis=0))
    return moments, DisplacementRange(_in_pairs(highest), _in_pairs(lowest))


def free_means(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> Means:
    """The mean position of the left block over the drive period that begins with the motion `first`."""
    t, weights = _gauss_rule(scene, nodes)
    place = free_course(scene, first, turns, t).displacement[:, 0].T
    return jax.tree.map(lambda a: weights @ a, position_of(place))


def _at_turn(
    scene: Scene,
    first: Motion,
    turns: Scalar,
    t: Float[Array, " n"],
    q: Float[Array, "n 2 3"],
    node: Int[Array, "2 3"],
) -> Float[Array, "2 3"]:
    """Each displacement where its speed vanishes beside its `node`."""
    low, high = t[jnp.maximum(node - 1, 0)], t[jnp.minimum(node + 1, len(t) - 1)]
    at, value = t[node], jnp.take_along_axis(q, node[None], axis=0)[0]
    own = jnp.arange(6), *np.unravel_index(np.arange(6), (2, 3))
    for _ in range(NEWTON_STEPS + 1):
        course = free_course(scene, first, turns, at.ravel())
        value, speed, bend = (a[own].reshape(2, 3) for a in course)
        at = jnp.clip(at - speed / jnp.where(bend != 0, bend, jnp.inf), low, high)
    return value


def _in_pairs(values: Float[Array, "2 3"]) -> Displacements:
    """Displacements (2, 3) along an unrolled axis of blades for each of x, y and theta."""
    x, y, theta = along_blades(tuple(values.T))
    return x, y, theta


MIN_NODES = 32  # of the Gauss-Legendre rule over a period; there are more for fast oscillations
MAX_CANCELLATION = 1e8  # a steady response larger than this times the motion leaves it no digits
# bytes for each lane, period and node at the peak, and number of periods that the rest of a lane counts as
NODE_BYTES, LANE_PERIODS = 56, 8
MAX_NODES = 1 << 14  # with these, the fastest motion may not be resolved


def nodes_needed(scenes: Scene) -> int:
    """The number of nodes in a period: exact to rounding, and a power of two so that few programs are compiled."""
    omega_max, period = stiffest(scenes, 1)
    cycles = max(omega_max * period / (2 * math.pi), *scenes.drive.harmonics())
    return min(1 << math.ceil(math.log2(MIN_NODES + 8 * cycles)), MAX_NODES)


def closed_form_runs(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray) -> Runs:
    """The runs of lanes (leading axis) without contact, of which the method sets the precision and the fields only."""
    method = plan.method
    dtype = scenes.drive.omega.dtype
    nodes = nodes_needed(scenes)
    check_memory("the closed form of this run", len(arrived) * (plan.kept + LANE_PERIODS) * nodes * NODE_BYTES)
    turns = jnp.asarray(plan.phase / (2 * math.pi), dtype)
    begin = jnp.where(arrived, turns, jnp.zeros_like(turns))
    transient = jnp.full_like(turns, plan.transient)
    samples, *end = _closed_form_samples(
        scenes, states, begin, transient, turns, plan.kept, nodes, method.amplitudes, method.vibration
    )

    def places(lane):
        return [lane.state, lane.status, lane.accumulator.log.times.apart]

    last = jax.tree.map(np.asarray, eqx.tree_at(places, begin_lanes(scenes, states, method), end))
    ticker(len(arrived) * (plan.transient + plan.kept))
    zeros: Any = np.zeros(np.shape(samples.power[0]))
    works = dict.fromkeys(("work", "gross", "dropped", "residual", "viscous"), zeros)
    none = at_interface(zeros)
    samples = samples._replace(**works, friction=none, switched=none)
    if method.forces:
        samples = samples._replace(
            forces=ContactPeaks(none, none), loads=ContactLoads._make([none] * 4), impacts=Impacts._make([none] * 7)
        )
    log = run_log(last)
    return Runs(sample_of_users(samples), jax.tree.map(np.zeros_like, log), log, last)


@kept("periods", "nodes", "amplitudes", "vibration")
def _closed_form_samples(
    scenes: Scene,
    states: State,
    begin,
    transient,
    turns,
    periods: int,
    nodes: int,
    amplitudes: bool,
    vibration: bool,
):
    def one(scene: Scene, state: State, begin):
        period = scene.drive.period
        times = (transient + (turns - begin) + jnp.arange(periods + 1, dtype=turns.dtype)) * period
        motion = free_motion(scene, state.motion, begin, times)
        starts = Motion._make(a[:-1] for a in motion)
        power, largest = jax.vmap(lambda z: _period_mean_square(scene, z, turns, nodes))(starts)
        each_extent = jax.vmap(lambda z: free_extent(scene, z, turns, nodes))
        moments, extent = each_extent(starts) if amplitudes else (None, None)
        means = jax.vmap(lambda z: free_means(scene, z, turns, nodes))(starts) if vibration else None
        apart = jnp.broadcast_to(period, power[:, 0].shape)

        def in_pairs(a):
            return Unrolled(a[:, 0], a[:, 1])

        sizes = tuple(in_pairs(largest[..., i]) for i in range(3))
        ends = Motion._make(in_pairs(a[1:]) for a in motion)
        none = jnp.zeros_like(apart)
        sample = Sample(ends, in_pairs(power), largest=sizes, moments=moments, extent=extent)
        in_contact = at_interface((means, ContactTimes(apart, none, none)))
        sample = sample._replace(means=in_contact[0], times=in_contact[1])
        last = State(Motion._make(a[-1] for a in motion), state.u_s, state.mode, state.case)
        status = free_status(scene, motion, jnp.max(largest[..., 2]))
        sample = jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), sample)
        end = carried_state(last, prepared_row(scene))
        return sample, end, status, at_interface(times[-1] - times[0])

    return jax.vmap(one)(scenes, states, begin)


def free_trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """The trajectories of lanes (leading axis) without contact, which take no steps."""
    del method, ticker
    motion, amplitudes, status = _free_samples(scenes, states.motion, grid)
    shape = motion.x.shape[:2]
    apart, zero = np.zeros(shape, np.int32), np.zeros(shape[0])
    return Trajectories(
        samples={"motion": motion, "u_s": np.full(shape, np.nan), "mode": apart, "case": apart},
        amplitudes=amplitudes,
        status=status,
        counters=dict.fromkeys(Counters.__annotations__, np.zeros(shape[0], int)),
        energy={"energy_residual": zero, "energy_dropped": zero},
    )


def _free_samples(scenes: Scene, first: Motion, grid: SampleGrid) -> tuple[Motion, SampledAmplitudes, np.ndarray]:
    """The samples of scenes (leading axis) without contact, where their displacements lie, and their status.

    Fields of the motion have axes (lanes, samples, 2), those of the `first` one (lanes, 2). The status is that of the
    motion at the ends of all steps.
    """
    block = max(min(MAX_UNKEPT // len(first.x), SAMPLES_PER_BLOCK), 1)
    begin = grid.length - grid.counted
    running = None
    at = partial(_free_motions, scenes, first, grid, block)
    last = at(np.zeros(1, int))
    blocks = [last]
    largest = [np.abs(getattr(last, name)) for name in DISPLACEMENTS]
    for start in [*range(0, begin, block), *range(begin, grid.length, block)]:
        if start == begin:
            running = RunningAmplitudes(Motion._make(a[:, -1] for a in last), grid.step_lengths(scenes))
        steps = np.arange(start, min(start + block, begin if start < begin else grid.length)) + 1
        last = at(steps)
        blocks.append(Motion._make(a[:, steps % grid.every == 0] for a in last))
        sizes = (np.abs(getattr(last, name)).max(axis=1, keepdims=True) for name in DISPLACEMENTS)
        largest = [np.maximum(*pair) for pair in zip(largest, sizes, strict=True)]
        if running is not None:
            running.add(last)
    assert running is not None  # as some steps count
    motion = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    return motion, running.amplitudes, np.asarray(_free_statuses(scenes, Motion._make(2 * largest)))


def _free_motions(scenes: Scene, first: Motion, grid: SampleGrid, block: int, steps: np.ndarray) -> Motion:
    """The motions (lanes, steps, 2) after so many steps, at most `block` numbers."""
    dtype = first.x.dtype
    turns = jnp.asarray(grid.turns, dtype)
    periods = np.resize(steps, block) / grid.steps
    motion = _free_block(scenes, first, turns, jnp.asarray(periods, dtype))
    return jax.tree.map(lambda a: np.asarray(a)[:, : len(steps)], motion)


@kept()
def _free_block(scenes: Scene, first: Motion, turns: Scalar, periods: Array) -> Motion:
    """The motion of scenes (leading axis) so many `periods` after drive phase `turns`."""

    def one(scene, first):
        return free_motion(scene, first, turns, periods * scene.drive.period)

    return jax.vmap(one)(scenes, first)


@kept()
def _free_statuses(scenes: Scene, largest: Motion) -> Int[Array, " lanes"]:
    return jax.vmap(lambda scene, z: free_status(scene, z, jnp.max(z.theta)))(scenes, largest)


def free_status(scene: Scene, motion: Motion, turned: Scalar) -> Int[Array, ""]:
    """The status of a run with the `motion`, fields (n, 2), and the largest angle `turned` of its blocks [rad]."""
    free = steady_amplitudes(scene)
    swing = jnp.stack([motion.x, motion.y, motion.theta])
    steady = summed(jnp.abs(jnp.stack(amplitudes)) for amplitudes in free.values())
    lost = steady > MAX_CANCELLATION * jnp.max(jnp.abs(swing), axis=1)  # resonance without damping
    finite = jnp.all(jnp.isfinite(swing**2)) & jnp.isfinite(turned) & ~jnp.any(lost)
    status = jnp.where(turned > ANGLE_RANGE, Status.ANGLE_OUT_OF_RANGE, Status.OK)
    return jnp.where(finite, status, Status.NOT_FINITE).astype(jnp.int32)


def _period_mean_square(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> tuple[PerBlade, Float[Array, "2 3"]]:
    """The square displacement averaged over each block and the period from `first` on, and the sizes of x, y and theta.

    They are measured from the static position under the mean loads.
    The mean squares of x and y are quadratic forms of the state at the start of the period, the same for every period;
    theta must be evaluated at all nodes. Its size is its maximum there; the size of x and y is the amplitude of a sine
    of equal mean square.

    Source:
        Eqs. (22), (23), as in `rhs.mean_square`.
    """
    t, weights = _gauss_rule(scene, nodes)
    start = free_components(scene, first, turns, from_static=True)
    course, _ = free_propagators(scene, t)
    form = jnp.einsum("n,nbik,nbil->bikl", weights, course[:, :, :2], course[:, :, :2])
    bending = jnp.einsum("bik,bikl,bil->bi", start[:, :2], form, start[:, :2])
    theta = jnp.einsum("nbk,bk->nb", course[:, :, 2], start[:, 2])
    _, versine = sine_versine(theta)
    sizes = jnp.append(jnp.sqrt(2 * bending), jnp.max(jnp.abs(theta), axis=0)[:, None], axis=1)
    return bending.sum(axis=1) + gyration(scene.shroud) * 2 * (weights @ versine), sizes


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
