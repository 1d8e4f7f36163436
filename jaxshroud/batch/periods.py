"""Whole drive periods of many lanes: one compiled function, called over blocks of lanes and of periods."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshroud.batch.loop import driven
from jaxshroud.batch.states import inside, whole
from jaxshroud.batch.xla import EachLane, compiled
from jaxshroud.march.energy import balance, energy
from jaxshroud.march.lane import Fixed, Grid, Lane, begin, grid
from jaxshroud.march.method import Choices
from jaxshroud.model.absent import Pair, filled
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import Model, model
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Scene

CHUNK = 64  # lanes per call: the loop is long enough to pay for its dispatch, and lanes rarely wait for each other
BLOCK = 32  # periods per call: the grain of progress and of what is held in memory
AT_ONCE = 1 << 23  # stages of lanes per call, or a single period: a fraction of a second; Ctrl-C is heard in between


class Sample(NamedTuple):
    """One period of one lane: the motion at its end, and what was summed over it. NaN once the lane has stopped."""

    motion: Motion
    power: Pair  # mean square displacement over block and period [m^2]
    work: Any = None  # of the drive [J]; None where no ledger is kept, like all that follow
    gross: Any = None  # of the drive, without its sign at each instant [J]
    dropped: Any = None  # energy of the rocking that flat contact ended [J]
    residual: Any = None  # of the energy balance [J]
    largest: Any = None  # magnitudes of x, y [m] and theta [rad], three pairs; None where they were not looked at
    forces: Any = None  # largest of contact [N]; None where they were not asked for
    friction: Any = None  # work of friction [J]; the same


class Clock(NamedTuple):
    """How a run is divided: `steps` steps of `1 / per_period` drive periods from phase `start`."""

    start: Float[Array, ""]  # [turns]
    steps: Int[Array, ""]
    per_period: Float[Array, ""]

    def grids(self, periods: Float[Array, " lanes"]) -> Grid:
        """The time grid of each lane, from its drive period."""
        like = lambda a: jnp.broadcast_to(a.astype(periods.dtype), periods.shape)  # noqa: E731
        return grid(like(self.start), like(self.per_period), periods)


def periods_at_once(lanes: int, steps: int, method: Choices) -> int:
    """How many periods of so many lanes and steps to run in one call at most."""
    stages = 100 * method.taylor.order if method.taylor else steps * len(method.rk.b)  # a trial's work, about
    return max(AT_ONCE // (max(lanes, 32) * stages), 1)


def _one_period(lanes: Lane, active, models: Model, periods, clock: Clock, method: Choices, each: EachLane):
    lanes, held = _with_empty_tally(lanes), _energies(lanes, models)
    grids = clock.grids(periods)
    stops = jnp.where(active, clock.steps, 0)
    lanes, _ = driven(lanes, Fixed(models, grids, stops), clock.steps, method, each)
    gain, jumps = lanes.tally.integrals, lanes.tally.jumps
    kept, energies = (), _energies(lanes, models)
    if gain.ledger is not None and jumps is not None:
        residual = balance(gain.ledger, jumps, energies - held)
        kept = gain.ledger.drive, gain.ledger.gross, filled(jumps.dropped, periods), residual
    power = filled(gain.power, periods)
    log, forces, friction = lanes.tally.log, None, None
    largest = None if log is None else filled(log.largest, periods)
    if log is not None and log.forces is not None and gain.ledger is not None:
        forces, friction = filled((log.forces, gain.ledger.friction), periods)
    power = power[0] / periods, power[1] / periods
    sample = Sample(whole(lanes.state).motion, power, *kept, largest=largest, forces=forces, friction=friction)
    overflowed = (lanes.status == Status.OK) & ~jnp.isfinite(sum(jax.tree.leaves(sample), energies))
    status = jnp.where(overflowed, Status.NOT_FINITE, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(lanes.status == Status.OK, a, jnp.nan), sample)


def _with_empty_tally(lanes: Lane) -> Lane:
    """The lanes with what a sample holds at zero: what a late period adds to a long sum would be lost in float32."""
    log = lambda lane, name: lane.tally.log and getattr(lane.tally.log, name)  # noqa: E731
    places = lambda lane: (lane.tally.integrals, lane.tally.jumps, log(lane, "largest"), log(lane, "forces"))  # noqa: E731
    return eqx.tree_at(places, lanes, jax.tree.map(jnp.zeros_like, places(lanes)), is_leaf=lambda a: a is None)


def _energies(lanes: Lane, models: Model) -> Float[Array, " lanes"]:
    return jax.vmap(lambda lane, m: energy(lane.state, m))(lanes, models)


@compiled("method", "block", "each")
def run_block(
    scenes: Scene, lanes: Lane, clock: Clock, n: Int[Array, ""], method: Choices, block: int, each: EachLane
) -> tuple[Lane, Sample]:
    """Run up to `block` periods of every lane.

    Args:
        scenes: Scenes with a leading lane axis.
        lanes: Lanes to go on from, with the same axis.
        clock: The time grid, common to all lanes.
        n: Periods to run; the samples beyond are meaningless.
        method: Static choices of the march.
        block: Length of the sample axis.
        each: How a function of one lane is run on all.

    Returns:
        The lanes at the end, and samples with axes (period, lane).
    """
    one = one_period(scenes, clock, method, each)
    return jax.lax.scan(lambda lanes, i: one(lanes, i < n), lanes, jnp.arange(block, dtype=jnp.int32))


def one_period(scenes: Scene, clock: Clock, method: Choices, each: EachLane) -> Callable[..., tuple[Lane, Sample]]:
    """A function of lanes, and of whether they go on, that runs a period of those that have not stopped."""
    models, periods = jax.vmap(lambda scene: (model(scene), scene.drive.period))(scenes)
    return lambda lanes, on: _one_period(lanes, on & (lanes.status == Status.OK), models, periods, clock, method, each)


@compiled("method")
def begin_lanes(scenes: Scene, states: State, method: Choices) -> Lane:
    """Lanes about to start from `states`."""
    return jax.vmap(lambda scene, state: _begun(scene, state, method))(scenes, states)


def _begun(scene: Scene, state: State, method: Choices) -> Lane:
    ready = model(scene)
    return begin(inside(state, ready), ready, method)
