"""Lyapunov exponents: the rates at which neighbouring motions separate, from tangents through every event."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.runs import Plan, Tick
from jaxshroud.batch.states import STATE_SIZE, final_states, from_vector, to_vector
from jaxshroud.batch.tangents import TangentProblem, as_differentiable, end_as_start, run_flow
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.batched_algorithms import Algorithm, Derivatives, Periods
from jaxshroud.motion.statistics import confidence_interval
from jaxshroud.scene.scene import Scene

MAX_ALIGNMENT_PERIODS = 64  # longest alignment of tangents after the transient
ALIGNMENT_TOLERANCE = 1e-4  # difference of the logarithmic growth per period at which two frames count as aligned
ALIGNMENT_PERIODS = 32  # periods in which a tangent turns into the fastest growing direction
RENORMALIZATION_PERIODS = 4  # periods between normalisations of the tangent


class Exponents(NamedTuple):
    """The exponents of one scene per drive period, largest first, including that of the slider."""

    exponents: np.ndarray  # (13,); -inf where a direction is lost altogether
    ci: np.ndarray  # (13,) half width of the 95 % interval
    growth: np.ndarray  # (n, 13) of each period
    status: int
    last: State


def lyapunov_exponents(
    scene: Scene, state: State, n_periods: int, transient: int, steps: int, method: Choices
) -> Algorithm[Exponents]:
    """The exponents of the motion from a state, by QR factors of the product of the Jacobians of the periods.

    After the transient the tangents start in random directions; the average begins when two frames of them grow
    equally, or after 64 periods (where directions grow equally fast, no order emerges). The frames do not start
    earlier: along a transient they may take an order that differs from that of the settled motion, and keep it long.
    """
    state = yield from state_after(scene, state, transient, steps, method)
    units, frames, growth, status = energy_units(scene), first_frames(STATE_SIZE), [], Status.OK
    while len(growth) < n_periods:
        tangents = yield Derivatives(TangentProblem(scene, state), 1, steps, method)
        state, status = tangents.end, Status(tangents.status)
        if status != Status.OK:
            break
        frames, grown = next_frames(frames, tangents.by_state * units / units[:, None])
        growth += grown
    return Exponents(*mean_exponents(np.array(growth).reshape(-1, STATE_SIZE)), int(status), state)


class Frames(NamedTuple):
    """Two frames of directions that are propagated by a product of Jacobians."""

    pair: tuple[np.ndarray, ...]  # (size, size) each, orthonormal
    done: int  # number of Jacobians so far
    aligned: bool  # whether they have aligned with the directions of the motion


def first_frames(size: int) -> Frames:
    """Two random frames with as many directions as the state has numbers."""
    random = np.random.default_rng(0)
    return Frames(tuple(np.linalg.qr(random.standard_normal((size, size)))[0] for _ in range(2)), 0, False)


def next_frames(frames: Frames, M: np.ndarray) -> tuple[Frames, list[np.ndarray]]:
    """The frames after the next Jacobian of any map, and the logarithms of their growth: none until they are aligned.

    The average starts after the first period in which both frames grow equally.
    """
    pair, factors = zip(*(np.linalg.qr(M @ f) for f in frames.pair), strict=True)
    with np.errstate(divide="ignore"):
        grown = np.log(np.abs([np.diag(R) for R in factors]))
    done = frames.done + 1
    aligned = frames.aligned or done >= MAX_ALIGNMENT_PERIODS or _are_aligned(grown)
    return Frames(pair, done, aligned), [grown[0]] if frames.aligned else []


def mean_exponents(rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The exponents, largest first, the half widths of their intervals, and the growth in each period (n, size).

    NaN where there is no period.
    """
    if not len(rates):
        nothing = np.full(rates.shape[1], np.nan)
        return nothing, nothing, rates
    with np.errstate(invalid="ignore"):
        mean, ci = rates.mean(axis=0), confidence_interval(rates.T)
    order = np.argsort(-mean)
    return mean[order], ci[order], rates[:, order]


def energy_units(scene: Scene) -> np.ndarray:
    """Displacements, rates and a slider position (..., 13) of equal energy, in which tangents hardly oscillate."""
    b = scene.blades
    soft = [1 / np.sqrt(np.asarray(a)) for a in (b.k_x, b.k_y, b.k_T, b.m, b.inertia_y, b.I)]
    return np.concatenate([np.asarray(a, float) for a in (*soft, soft[0][..., :1])], axis=-1)


def _are_aligned(grown: np.ndarray) -> bool:
    """Whether two frames span the same directions; two neighbours that rotate into each other count as one."""
    with np.errstate(invalid="ignore"):
        volumes = np.cumsum(np.where(np.isfinite(grown), grown, 0.0), axis=1)
    differs = np.abs(volumes[0] - volumes[1]) > ALIGNMENT_TOLERANCE
    return not np.any(differs[1:] & differs[:-1])


def state_after(scene: Scene, state: State, transient: int, steps: int, method: Choices) -> Algorithm[State]:
    """The state `transient` periods later."""
    if transient == 0:
        return state
    runs = yield Periods(scene, state, Plan(transient - 1, 1, steps, 0.0, method))
    return jax.tree.map(lambda a: a[0], final_states(runs.last.state))


class LargestExponents(NamedTuple):
    """The largest exponents of lanes per drive period."""

    exponent: np.ndarray  # (lanes,); -inf where every perturbation vanishes; NaN once a lane has stopped
    ci: np.ndarray  # (lanes,) half width of the 95 % interval
    growth: np.ndarray  # (lanes, blocks) of each block of periods, per period
    status: np.ndarray  # (lanes,)
    last: State


def with_phase_shift(scenes: Scene, phase: float) -> Scene:
    """The scenes with their drives advanced by the `phase` [rad]."""
    return eqx.tree_at(lambda s: s.drive.phase, scenes, scenes.drive.phase + phase) if phase else scenes


def largest_exponents(
    scenes: Scene,
    states: State,
    n: int,
    steps: int,
    method: Choices,
    ticker: Tick = lambda _: None,
    numbers: np.ndarray | None = None,
) -> LargestExponents:
    """The largest exponent of settled motions from their states at drive phase 0.

    It is the average over `n` periods, a multiple of 4, after 32 periods in which the tangents align. A tangent begins
    in a random direction without a component of the slider: a slider in permanent stick stays where it starts, with an
    exponent of 0 that is not one of the motion. Each lane has its own direction, by the `numbers` of the lanes (lanes,)
    where only some of them are run.
    """
    lanes, unit = len(scenes.drive.omega), energy_units(scenes)
    numbers = np.arange(lanes) if numbers is None else numbers
    tangents = np.random.default_rng(0).standard_normal((numbers.max() + 1, STATE_SIZE))[numbers] * unit
    tangents[:, -1] = 0.0
    no_change, method = jax.tree.map(np.zeros_like, scenes), as_differentiable(method)
    alignment_blocks, blocks = ALIGNMENT_PERIODS // RENORMALIZATION_PERIODS, max(round(n / RENORMALIZATION_PERIODS), 1)
    growth, status = np.empty((lanes, alignment_blocks + blocks)), np.full(lanes, Status.OK, np.int32)
    for i in range(alignment_blocks + blocks):
        with np.errstate(divide="ignore", invalid="ignore"):
            tangents = tangents / np.linalg.norm(tangents / unit, axis=1, keepdims=True)
        tangents = np.where(np.isfinite(tangents), tangents, 0.0).astype(scenes.drive.omega.dtype)
        flows = run_flow(
            Dual(scenes, no_change),
            Dual(states, from_vector(tangents, None, None)),
            RENORMALIZATION_PERIODS,
            steps,
            method,
        )
        status = np.where(status == Status.OK, flows.value.status, status)
        states, tangents = end_as_start(flows).value, to_vector(flows.tangent.state)
        with np.errstate(divide="ignore", invalid="ignore"):
            grown = np.log(np.linalg.norm(tangents / unit, axis=1)) / RENORMALIZATION_PERIODS
        growth[:, i] = np.where(status == Status.OK, grown, np.nan)
        ticker(lanes * RENORMALIZATION_PERIODS)
    growth = growth[:, alignment_blocks:]
    with np.errstate(invalid="ignore"):
        return LargestExponents(growth.mean(axis=1), confidence_interval(growth), growth, status, states)
