"""The loop over trials, and whole drive periods of many lanes in one compiled function."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.batch.states import carried_state, with_zeros
from jaxshroud.batch.xla import compiled, repeated_while, stage_groups
from jaxshroud.march.carry import EachLane, Fixed, Lane, LaneTree, TimeGrid, running, time_grid
from jaxshroud.march.method import Choices
from jaxshroud.march.observables import energy_residual, is_unbalanced, total_energy
from jaxshroud.march.stepper import StageGroups, alone, begin_lane, stepper_for
from jaxshroud.march.tally import Tally, log_of_new_period
from jaxshroud.model.arithmetic import Pair, filled, is_absent, traced_once
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.scene.keys import Motion, RowSize
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree

LaneSelector = Callable[[Any], Any]  # selects the plain values in the tree that is marched


def whole_tree(lanes: Tree) -> Tree:
    """The tree itself."""
    return lanes


def advance(lanes: LaneTree, fixed: LaneTree, method: Choices, each: EachLane, lane_of: LaneSelector = whole_tree):
    """Make one trial step of every running lane: by one kernel, or by several for the trial and for the update."""
    stepper, groups = stepper_for(method), stage_groups(method, lane_of(fixed).model.spring.smooth)

    def whole(lanes: LaneTree, fixed: LaneTree, each: EachLane, groups: StageGroups) -> LaneTree:
        trials = stepper.trial(lanes, fixed, method, each, groups)
        return stepper.update(lanes, trials, fixed, method, each)

    if groups is None:
        return each(lambda lane, fixed: whole(lane, fixed, alone, ()), lanes, fixed)
    return whole(lanes, fixed, each, groups)


def march(
    lanes: Tree,
    fixed: Any,
    method: Choices,
    each: EachLane,
    lane_of: LaneSelector = whole_tree,
    most_trials: int | None = None,
) -> Tree:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK.

    With `most_trials` there are exactly that many trials: a loop of fixed length can be differentiated in reverse mode.
    """
    once = jax.jit(lambda lanes: advance(lanes, fixed, method, each, lane_of))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    stops = lane_of(fixed).stop
    several = stage_groups(method, lane_of(fixed).model.spring.smooth) is not None
    return repeated_while(lambda lanes: jnp.any(running(lane_of(lanes), stops)), once, lanes, several)


def march_steps(
    lanes: Tree,
    fixed: Any,
    steps: Int[Array, "..."],
    method: Choices,
    each: EachLane,
    lane_of: LaneSelector = whole_tree,
    most_trials: int | None = None,
) -> tuple[Tree, Bool[Array, " lanes"]]:
    """The lanes after at most `steps` steps, and which of them have completed these; their clock is reset."""
    lanes = march(lanes, fixed, method, each, lane_of, most_trials)
    clock = lane_of(lanes).step
    arrived = clock == steps
    return eqx.tree_at(lambda lanes: lane_of(lanes).step, lanes, jnp.where(arrived, 0, clock)), arrived


LANES_PER_CALL = 64  # long enough to amortise the dispatch of the loop; lanes rarely wait for each other
ROW_BLADES_PER_CALL = 192  # of all lanes of a chunk of rows: the numbers of more do not stay in the cache
PERIODS_PER_CALL = 32  # the grain of progress reports and of memory
MAX_STAGES_PER_CALL = 1 << 23  # or a single period: a fraction of a second, after which Ctrl-C is heard


def lanes_per_call(row: RowSize | None) -> int:
    """The lanes of a chunk, which share a compiled program: of pairs, or of rows of so many blades; a power of two."""
    if row is None:
        return LANES_PER_CALL
    return 2 ** min(max(ROW_BLADES_PER_CALL // row.blades, 4).bit_length() - 1, LANES_PER_CALL.bit_length() - 1)


class Sample(NamedTuple):
    """One period of one lane: the motion at its end and its integrals; NaN once the lane has stopped."""

    motion: Motion
    power: Pair  # mean square displacement over block and period [m^2]
    work: Any = None  # of the drive [J]; None without a ledger, as are the next three
    gross: Any = None  # integral of the magnitude of the drive's power [J]
    dropped: Any = None  # energy of the rocking motion that flat contact ended [J]
    residual: Any = None  # of the energy balance [J]
    largest: Any = None  # magnitudes of x, y [m] and theta [rad], three pairs; None if not logged
    friction: Any = None  # lost in the sliding contact [J]; None without a ledger, as is the next
    viscous: Any = None  # lost in the dampers [J]
    forces: Any = None  # largest contact forces [N]; None unless requested, as are all that follow
    loads: Any = None  # `ContactLoads` of the period
    impacts: Any = None  # `Impacts` of the period
    moments: Any = None  # `Moments` over the period
    extent: Any = None  # `DisplacementRange` of the period


class Clock(NamedTuple):
    """The time grid of a run: `steps` steps of `1 / per_period` drive periods from the phase `start`."""

    start: Float[Array, ""]  # [turns]
    steps: Int[Array, ""]
    per_period: Float[Array, ""]

    @classmethod
    def from_phase_0(cls, steps: int) -> "Clock":
        """The grid of whole periods of so many steps from drive phase 0."""
        return cls(jnp.asarray(0.0), jnp.int32(steps), jnp.asarray(float(steps)))

    def grids(self, periods: Float[Array, " lanes"]) -> TimeGrid:
        """The time grid of each lane from its drive period."""
        like = lambda a: jnp.broadcast_to(a.astype(periods.dtype), periods.shape)
        return time_grid(like(self.start), like(self.per_period), periods)


def periods_at_once(lanes: int, steps: int, method: Choices) -> int:
    """The largest number of periods to run in one call, for so many lanes and steps."""
    return max(MAX_STAGES_PER_CALL // (max(lanes, 32) * method.tableau.work(steps)), 1)


def _run_period(lanes: Lane, active, models: Model, periods, clock: Clock, method: Choices, each: EachLane):
    lanes, stored_before = _with_empty_tally(lanes), _total_energies(lanes, models)
    grids = clock.grids(periods)
    stops = jnp.where(active, clock.steps, 0)
    lanes, _ = march_steps(lanes, Fixed(models, grids, stops), clock.steps, method, each)
    gain, jumps = lanes.tally.integrals, lanes.tally.jumps
    works, energies, astray = (), _total_energies(lanes, models), jnp.zeros_like(periods, bool)
    if gain.ledger is not None and jumps is not None:
        residual = energy_residual(gain.ledger, jumps, energies - stored_before)
        works = gain.ledger.drive, gain.ledger.gross, filled(jumps.dropped, periods), residual
        if not is_absent(models.spring.laws):  # the printed reading never balances, and other laws need no such check
            astray = is_unbalanced(residual, gain.ledger.gross, stored_before, energies)
    power = filled(gain.power, periods)
    log, logged = lanes.tally.log, {}
    if log is not None:
        logged = {"largest": log.largest, "forces": log.forces, "impacts": log.impacts, "extent": log.extent}
    if gain.ledger is not None:
        logged |= {"friction": gain.ledger.friction, "viscous": gain.ledger.viscous}
    integrated = {"loads": gain.loads, "moments": gain.moments}
    power = power[0] / periods, power[1] / periods
    sample = Sample(with_zeros(lanes.state).motion, power, *works, **filled(logged | integrated, periods))
    overflowed = ~jnp.isfinite(sum(jax.tree.leaves(sample), energies))
    fault = jnp.where(overflowed, Status.NOT_FINITE, jnp.where(astray, Status.UNBALANCED, Status.OK))
    status = jnp.where(lanes.status == Status.OK, fault, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(lanes.status == Status.OK, a, jnp.nan), sample)


def _with_empty_tally(lanes: Lane) -> Lane:
    """The lanes with the sums of a sample reset: in float32, late periods would lose digits in a long sum."""
    tally = lanes.tally
    integrals, jumps = jax.tree.map(jnp.zeros_like, (tally.integrals, tally.jumps))
    log = None if tally.log is None else jax.vmap(log_of_new_period)(tally.log, lanes.state.motion)
    return eqx.tree_at(lambda lane: lane.tally, lanes, Tally(integrals, jumps, log))


@traced_once
def _total_energies(lanes: Lane, models: Model) -> Float[Array, " lanes"]:
    return jax.vmap(lambda lane, m: total_energy(lane.state, m))(lanes, models)


@compiled("method", "block", "each")
def run_block(
    scenes: Scene, lanes: Lane, clock: Clock, n: Int[Array, ""], method: Choices, block: int, each: EachLane
) -> tuple[Lane, Sample]:
    """Run up to `block` periods of every lane.

    Args:
        scenes: Scenes with a leading lane axis.
        lanes: The lanes to continue, with the same axis.
        clock: The time grid, common to all lanes.
        n: Periods to run; further samples are meaningless.
        method: The options of the march.
        block: The length of the sample axis.
        each: How a function of one lane is applied to all.

    Returns:
        The lanes at the end, and samples with axes (period, lane).
    """
    one = period_function(scenes, clock, method, each)
    return jax.lax.scan(lambda lanes, i: one(lanes, i < n), lanes, jnp.arange(block, dtype=jnp.int32))


def period_function(scenes: Scene, clock: Clock, method: Choices, each: EachLane) -> Callable[..., tuple[Lane, Sample]]:
    """A function of lanes and a flag that, if the flag is set, runs a period of the lanes that have not stopped."""
    models, periods = jax.vmap(lambda scene: (prepared_model(scene), scene.drive.period))(scenes)
    return lambda lanes, on: _run_period(lanes, on & (lanes.status == Status.OK), models, periods, clock, method, each)


@compiled("method")
def begin_lanes(scenes: Scene, states: State, method: Choices) -> Lane:
    """The lanes at their start from `states`."""
    return jax.vmap(lambda scene, state: _begin_lane(scene, state, method))(scenes, states)


def _begin_lane(scene: Scene, state: State, method: Choices) -> Lane:
    model = prepared_model(scene)
    return begin_lane(carried_state(state, model), model, method)
