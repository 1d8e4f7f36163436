"""Runs of scenes whose model has no contact: in closed form, without any stepping."""

import math
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from jaxshroud.batch.extent import memory_for
from jaxshroud.batch.periods import Sample, begin_lanes
from jaxshroud.batch.states import inside
from jaxshroud.march.method import Choices
from jaxshroud.march.peaks import Peaks
from jaxshroud.march.stability import stiffest
from jaxshroud.model.absent import Scalar
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import amounts, courses, free_motion, steady_amplitudes
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import model
from jaxshroud.model.state import State
from jaxshroud.model.trig import ANGLE_RANGE, sine_versine
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import PerBlade, Scene

NODES = 32  # of the Gauss-Legendre rule over a period, and so many more for each of its fastest oscillation
MOST_CANCELLED = 1e8  # a steady response so many times larger than the motion leaves it no digits
NODE, LEAD = 56, 8  # bytes for each lane, period and node at the peak; the lane's own counts as so many periods
MOST_NODES = 1 << 14  # beyond, the fastest motion is no longer resolved


def nodes_needed(scenes: Scene) -> int:
    """Points at which a period is looked at: exact to rounding, in powers of two so that few programs are compiled."""
    omega_max, period = stiffest(scenes, 1)
    cycles = omega_max * period / (2 * math.pi)
    return min(1 << math.ceil(math.log2(NODES + 8 * cycles)), MOST_NODES)


def free_runs(
    scenes: Scene, states: State, transient: int, kept: int, phase: float, method: Choices, begin: ArrayLike = 0.0
):
    """Samples and final lanes of scenes (leading axis) without contact; see `sweep.Runs`.

    Args:
        scenes: The scenes.
        states: Where they start.
        transient: Drive periods before those that are kept.
        kept: Drive periods kept.
        phase: Drive phase at which samples are taken [rad].
        method: For the precision and shape of the result; there is nothing else to choose.
        begin: Drive phase at which the lanes start [rad], one for all or (lanes,).
    """
    dtype, count, nodes = scenes.drive.omega.dtype, len(scenes.drive.omega), nodes_needed(scenes)
    memory_for("the closed form of this run", count * (kept + LEAD) * nodes * NODE)
    turns = jnp.asarray(phase / (2 * math.pi), dtype)
    begin = jnp.broadcast_to(jnp.asarray(np.asarray(begin) / (2 * math.pi), dtype), count)
    samples, *end = _samples(scenes, states, begin, jnp.full_like(turns, transient), turns, kept, nodes)
    places = lambda lane: [lane.state, lane.status, lane.tally.log.time_apart]  # noqa: E731
    lanes = eqx.tree_at(places, begin_lanes(scenes, states, method), end)
    zeros: Any = np.zeros(np.shape(samples.power[0]))
    samples = samples._replace(work=zeros, gross=zeros, dropped=zeros, residual=zeros)
    if method.forces:
        samples = samples._replace(forces=Peaks(zeros, zeros), friction=zeros)
    return jax.tree.map(np.asarray, (samples, lanes))


@partial(jax.jit, static_argnames=("kept", "nodes"))
def _samples(scenes: Scene, states: State, begin, transient, turns, kept: int, nodes: int):
    def one(scene: Scene, state: State, begin):
        period = scene.drive.period
        ends = (transient + (turns - begin) + jnp.arange(kept + 1, dtype=turns.dtype)) * period
        motion = free_motion(scene, state.motion, begin, ends)
        power, largest = jax.vmap(lambda z: _mean_square(scene, z, turns, nodes))(Motion(*(a[:-1] for a in motion)))
        in_pairs = lambda a: (a[:, 0], a[:, 1])  # noqa: E731
        sizes = tuple(in_pairs(largest[..., i]) for i in range(3))
        sample = Sample(Motion(*(in_pairs(a[1:]) for a in motion)), in_pairs(power), largest=sizes)
        last = State(Motion(*(a[-1] for a in motion)), state.u_s, state.mode, state.case)
        status = free_status(scene, motion, jnp.max(largest[..., 2]))
        sample = jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), sample)
        return sample, inside(last, model(scene)), status, ends[-1] - ends[0]

    return jax.vmap(one)(scenes, states, begin)


def free_status(scene: Scene, motion: Motion, turned: Scalar) -> Int[Array, ""]:
    """How a run ended that came to `motion`, fields (n, 2), and turned its blocks so far at most [rad]."""
    swing, steady = jnp.stack([motion.x, motion.y, motion.theta]), jnp.abs(jnp.stack(steady_amplitudes(scene)))
    lost = steady > MOST_CANCELLED * jnp.max(jnp.abs(swing), axis=1)  # resonance without damping
    finite = jnp.all(jnp.isfinite(swing**2)) & jnp.isfinite(turned) & ~jnp.any(lost)
    status = jnp.where(turned > ANGLE_RANGE, Status.ANGLE_OUT_OF_RANGE, Status.OK)
    return jnp.where(finite, status, Status.NOT_FINITE).astype(jnp.int32)


def _mean_square(scene: Scene, first: Motion, turns: Scalar, nodes: int) -> tuple[PerBlade, Float[Array, "2 3"]]:
    """Square displacement averaged over each block and the period from `first` on, and sizes of x, y and theta in it.

    The squares of x and y are quadratic forms of where the period begins, the same for every period; theta needs a look
    at all points. Its size is the largest it has there, that of x and y the amplitude of a sine of equal mean square.

    Source:
        Eqs. (22), (23), as in `rhs.mean_square`.
    """
    place, weights = np.polynomial.legendre.leggauss(nodes)
    dtype = scene.drive.omega.dtype
    weights, start = jnp.asarray(weights / 2, dtype), amounts(scene, first, turns)
    course, _ = courses(scene, jnp.asarray((place + 1) / 2, dtype) * scene.drive.period)
    form = jnp.einsum("n,nbik,nbil->bikl", weights, course[:, :, :2], course[:, :, :2])
    bending = jnp.einsum("bik,bikl,bil->bi", start[:, :2], form, start[:, :2])
    theta = jnp.einsum("nbk,bk->nb", course[:, :, 2], start[:, 2])
    _, versine = sine_versine(theta)
    sizes = jnp.append(jnp.sqrt(2 * bending), jnp.max(jnp.abs(theta), axis=0)[:, None], axis=1)
    return bending.sum(axis=1) + gyration(scene.shroud) * 2 * (weights @ versine), sizes
