"""Whole drive periods of many lanes: one compiled function, called over blocks of lanes and of periods."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata
from jaxtyping import Array, Float, Int

from jaxshroud.integrate import Grid, Lane, Method, begin, energy, march
from jaxshroud.rhs import as_pairs, model
from jaxshroud.scene import Motion, Pair, Scalar, Scene
from jaxshroud.seam import Seam
from jaxshroud.state import State, Status

CHUNK = 64  # lanes per call: kernels are long enough to pay for their dispatch, and lanes rarely wait for each other
BLOCK = 32  # periods per call: the grain of progress and of what is held in memory

# XLA:CPU makes one LLVM function of a call marked so, loops included: no dispatch of hundreds of small kernels per
# trial. An internal of XLA that may vanish: without it the results are the same.
ONE_KERNEL = dict(inlineable="false", xla_cpu_small_call="true")
COMPILER = {"xla_cpu_prefer_vector_width": 512}


class Sample(NamedTuple):
    """One period of one lane: the motion at its end, and what was summed over it. NaN once the lane has stopped."""

    motion: Motion
    power: Pair  # mean square displacement over block and period [m^2]
    work: Scalar  # of the drive [J]
    residual: Scalar  # energy balance: drive + jumps - losses - change of stored energy [J]


class Clock(NamedTuple):
    """How a run is divided: `steps` steps of `1 / per_period` drive periods from phase `start`."""

    start: Float[Array, ""]  # [turns]
    steps: Int[Array, ""]
    per_period: Float[Array, ""]


def _one_period(lane: Lane, active, scene_model, clock: Clock, period, method: Method, seam: Seam):
    before, held = lane.tally.integrals, energy(lane.state, scene_model)
    jumps = lane.tally.jumps
    grid = Grid(clock.start, clock.per_period, period)
    lane = march(lane, jnp.where(active, clock.steps, 0), scene_model, grid, method, seam)
    gain = jax.tree.map(jnp.subtract, lane.tally.integrals, before)
    stored = energy(lane.state, scene_model) - held
    residual = gain.drive + (lane.tally.jumps - jumps) - gain.viscous - gain.friction - stored
    power = tuple(p / period for p in gain.power)
    sample = Sample(lane.state.motion, power, gain.drive, residual)
    sample = jax.tree.map(lambda a: jnp.where(lane.status == Status.OK, a, jnp.nan), sample)
    return eqx.tree_at(lambda lane: lane.step, lane, jnp.where(active, 0, lane.step)), sample


def _lane_periods(scene: Scene, lane: Lane, clock: Clock, n, one, method: Method, block: int):
    scene_model = model(scene)
    body = lambda lane, i: _one_period(  # noqa: E731
        lane, (i < n) & (lane.status == Status.OK), scene_model, clock, scene.drive.period, method, Seam(one)
    )
    return jax.lax.scan(body, lane, jnp.arange(block, dtype=jnp.int32))


@partial(jax.jit, static_argnames=("method", "block"), compiler_options=COMPILER)
def run_block(scenes: Scene, lanes: Lane, clock: Clock, n, method: Method, block: int) -> tuple[Lane, Sample]:
    """Run up to `block` periods of every lane.

    Args:
        scenes: Scenes with a leading lane axis.
        lanes: Lanes to go on from, with the same axis.
        clock: The time grid, common to all lanes.
        n: Periods to run; the samples beyond are meaningless.
        method: Static choices of the march.
        block: Length of the sample axis.

    Returns:
        The lanes at the end, and samples with axes (lane, period).
    """

    @jax.jit
    def chunk(scenes, lanes, clock, n, one):
        return jax.vmap(lambda s, a: _lane_periods(s, a, clock, n, one, method, block))(scenes, lanes)

    with set_xla_metadata(**ONE_KERNEL):
        one = (
            None if lanes.step.size == 1 else (n >= 0).astype(jnp.int32)
        )  # boundaries cost a single lane more than they save
        return chunk(scenes, lanes, clock, n, one)


@jax.jit
def begin_lanes(scenes: Scene, states: State) -> Lane:
    """Lanes about to start from `states`."""
    return jax.vmap(lambda scene, state: begin(as_pairs(state), model(scene)))(scenes, states)
