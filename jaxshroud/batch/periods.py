"""The loop over trials, and whole drive periods of many lanes in one compiled function."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.batch.states import by_blade, by_blade_or_interface, by_interface, carried_state, with_zeros
from jaxshroud.batch.xla import compiled, has_several_kernels, repeated_while
from jaxshroud.march.accumulator import Accumulator, Log, left_position_at, mean_position
from jaxshroud.march.carry import EachLane, Lane, TimeGrid, running, time_grid
from jaxshroud.march.forces_and_energy import energy_residual, is_unbalanced, total_energy
from jaxshroud.march.log import log_of_new_period
from jaxshroud.march.method import FLAT_RETURN, Choices
from jaxshroud.march.stepper import begin_lane, stepper_for
from jaxshroud.model.arithmetic import filled, traced_once
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def whole_tree(lanes: Tree) -> Tree:
    """The tree itself."""
    return lanes


def march(
    lanes: Any,
    fixed: Any,
    method: Choices,
    each: EachLane,
    most_trials: int | None = None,
    passes: Int[Array, ""] | None = None,
) -> Any:
    """Run every lane (leading axis of all arguments) to the start of step `stop`, or until its status is not OK.

    With `most_trials` there are exactly that many trials: a loop of fixed length can be differentiated in reverse mode.
    With `passes` there are so many of the loop at most; what is left of them is a second result.
    """
    stepper = stepper_for(method)
    once = jax.jit(lambda lanes: stepper.trial(lanes, fixed, method, each))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    return repeated_trials(once, lanes, fixed.stop, has_several_kernels(method), passes)


def repeated_trials(
    once: Callable[[Lane], Lane],
    lanes: Lane,
    stops: Int[Array, " lanes"],
    several: bool,
    passes: Int[Array, ""] | None = None,
) -> Any:
    """Lanes, or rows, after trials by `once` until all are at the start of step `stops` or not OK; see `march`."""
    return repeated_while(lambda lanes: jnp.any(running(lanes, stops)), once, lanes, several, passes)


def march_steps(
    lanes: Lane,
    fixed: Any,
    steps: Int[Array, "..."],
    method: Choices,
    each: EachLane,
    most_trials: int | None = None,
) -> tuple[Lane, Bool[Array, " lanes"]]:
    """The lanes after at most `steps` steps, and which of them have completed these; their clock is reset."""
    lanes = march(lanes, fixed, method, each, most_trials)
    arrived = lanes.step == steps
    return with_clock_reset(lanes, arrived), arrived


def with_clock_reset(lanes: Lane, where: Bool[Array, "..."]) -> Lane:
    """The lanes at step 0 `where` they have arrived at the end of their steps."""
    return eqx.tree_at(lambda lanes: lanes.step, lanes, jnp.where(where, 0, lanes.step))


LANES_PER_CALL = 64  # long enough to amortise the dispatch of the loop; lanes rarely wait for each other
BLADES_PER_CALL = 192  # of all lanes of a chunk: the numbers of more do not stay in the cache
ANY_PASSES = np.iinfo(np.int32).max  # without a bound
BLADE_TRIALS_OF_FIRST_CALL = 1 << 16  # some 0.1 s, see `CallPace`
PERIODS_PER_CALL = 32  # the grain of progress reports and of memory, see also `CallPace`


def lanes_per_call(layout: Layout) -> int:
    """The lanes of a chunk, which share a compiled program; a power of two."""
    return 2 ** min(max(BLADES_PER_CALL // layout.blades, 4).bit_length() - 1, LANES_PER_CALL.bit_length() - 1)


class Sample(NamedTuple):
    """One period of one lane: the motion at its end and its integrals; NaN once the lane has stopped.

    In compiled functions numbers of blades are pairs, and those of contact have no axis; see `batch.march_protocol`.
    """

    motion: Motion
    power: Any  # mean square displacement over block and period [m^2]
    work: Any = None  # of the drive [J]; None without a ledger, as are the next three
    gross: Any = None  # integral of the magnitude of the drive's power [J]
    dropped: Any = None  # energy of the rocking motion that flat contact ended [J]
    residual: Any = None  # of the energy balance [J]
    largest: Any = None  # magnitudes of x, y [m] and theta [rad] of each blade; None if not logged
    friction: Any = None  # lost in the sliding contact [J]; None without a ledger, as is the next
    viscous: Any = None  # lost in the dampers [J]
    switched: Any = None  # gained by the contact springs at events: at loaded case switches [J]
    forces: Any = None  # largest contact forces [N]; None unless requested, as are all that follow
    loads: Any = None  # `ContactLoads` of the period
    impacts: Any = None  # `Impacts` of the period
    moments: Any = None  # `Moments` over the period
    extent: Any = None  # `DisplacementRange` of the period
    means: Any = None  # `Means` over the period, each number for the left block or for every block of a row
    times: Any = None  # `ContactTimes` of the period
    own: Any = None  # values of the method's own observables at its end, by their names


LOGGED_BY_PERIOD = tuple(name for name in Log._fields if name in Sample._fields)


def pair_sample(sample: Sample) -> Sample:
    """Samples of pairs with axes of blades and interfaces."""
    contact = ("friction", "switched", "forces", "loads", "impacts", "times")
    along = {name: by_interface(getattr(sample, name)) for name in contact}
    means = by_interface(sample.means)  # of the left block alone
    return by_blade(sample._replace(**along, means=means, own=by_blade_or_interface(sample.own)))


class Clock(NamedTuple):
    """The time grid of a run: `steps` steps of `1 / per_period` drive periods from the phase `start`."""

    start: Float[Array, ""]  # [turns]
    steps: Int[Array, ""]
    per_period: Float[Array, ""]
    flat_return: Float[Array, ""] | Float[np.ndarray, ""]  # of a period, see `time_grid`

    @classmethod
    def from_phase_0(cls, steps: int, flat_return: float = FLAT_RETURN) -> "Clock":
        """The grid of whole periods of so many steps from drive phase 0."""
        return cls(jnp.asarray(0.0), jnp.int32(steps), jnp.asarray(float(steps)), np.asarray(flat_return))

    def grids(self, periods: Float[Array, " lanes"]) -> TimeGrid:
        """The time grid of each lane from its drive period."""

        def like(a):
            return jnp.broadcast_to(a.astype(periods.dtype), periods.shape)

        return time_grid(like(self.start), like(self.per_period), periods, like(self.flat_return))


class Interim(NamedTuple):
    """Lanes, or rows, between two calls to the device: at the start of a period or a sample, or inside one."""

    lanes: Any
    begun: Any  # (lanes,) of a period the energy stored at its start [J], of a sample the step at its end
    inside: Any  # whether they are


def at_start_of_period(lanes: Any) -> Interim:
    """Lanes, or rows, of which none is inside a period."""
    real = jax.tree.leaves(lanes.state.motion)[0].dtype
    return Interim(lanes, np.zeros(lanes.status.shape, real), np.bool_(False))


class CallLimits(NamedTuple):
    """What one call to the device does at most. Results do not depend on how a run is divided into calls."""

    most: Int[Array, ""]  # periods or samples
    passes: Int[Array, ""]  # of the loop over trials


def one_call(most: int) -> CallLimits:
    """So many periods or samples in one call, however long it takes."""
    return CallLimits(jnp.int32(most), jnp.int32(ANY_PASSES))


def first_passes(lanes: int, layout: Layout) -> int:
    """The passes of the first call to the device, whose time is not known: some milliseconds for so many lanes."""
    return max(BLADE_TRIALS_OF_FIRST_CALL // (lanes * layout.blades), 1)


def periods_within(
    limits: CallLimits,
    run: Callable[[Lane, Int[Array, ""]], tuple[Lane, Int[Array, ""]]],
    lanes: Lane,
    stop: Int[Array, " lanes"],
) -> tuple[Lane, Int[Array, ""]]:
    """Lanes after periods that end at step `stop`, by `run(lanes, passes)`, and how many of these have ended."""

    def one(carry: Any) -> Any:
        lanes, passes, ended = carry
        lanes, passes = run(lanes, passes)
        over = ~jnp.any(running(lanes, stop))
        lanes = with_clock_reset(lanes, over & (lanes.step == stop))
        return lanes, passes, ended + over.astype(ended.dtype)

    def on(carry):
        return (carry[1] > 0) & (carry[2] < limits.most)

    lanes, _, ended = lax.while_loop(on, one, (lanes, limits.passes, jnp.int32(0)))
    return lanes, ended


def select_tree(which: Bool[Array, ""], a: Tree, b: Tree) -> Tree:
    """One of two trees of arrays."""
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), a, b)


def ended_pairs(
    lanes: Lane, stored_before: Any, models: Model, periods: Any, steps: Any, each: EachLane, ended: Any = True
) -> tuple[Lane, Sample]:
    """Pairs at the end of a period of so many `steps`, if it has `ended`, and its sample.

    Selecting between lanes before and after it would have XLA work out the faults anew for every number of the sample.
    """
    del each
    gain, jumps = lanes.accumulator.integrals, lanes.accumulator.jumps
    logged: dict[str, Any] = {}
    works: dict[str, Any] = {}
    energies = _total_energies(lanes, models)
    astray = jnp.zeros_like(periods, bool)
    if gain.ledger is not None and jumps is not None:
        residual = energy_residual(gain.ledger, jumps, energies - stored_before)
        dropped = filled(jumps.dropped, periods)
        works = {"work": gain.ledger.drive, "gross": gain.ledger.gross, "dropped": dropped, "residual": residual}
        logged["switched"] = jumps.springs
        if models.law.may_create_energy:  # the printed reading never balances, and other laws need no such check
            astray = is_unbalanced(residual, gain.ledger.gross, stored_before, energies)
    power = filled(gain.power, periods)
    log = lanes.accumulator.log
    if log is not None:
        logged |= {name: getattr(log, name) for name in LOGGED_BY_PERIOD}
    if gain.ledger is not None:
        logged |= {"friction": gain.ledger.friction, "viscous": gain.ledger.viscous}
    means = mean_position(lanes.accumulator, lanes.state.motion, periods, steps, left_position_at)
    integrated = {"loads": gain.loads, "moments": gain.moments, "means": means}
    power = power[0] / periods, power[1] / periods
    sample = Sample(with_zeros(lanes.state).motion, power, **works, **filled(logged | integrated, periods))
    overflowed = ~jnp.isfinite(sum(jax.tree.leaves(sample._replace(own=None)), energies))
    fault = jnp.where(overflowed, Status.NOT_FINITE, jnp.where(astray, Status.UNBALANCED, Status.OK))
    status = jnp.where(ended & (lanes.status == Status.OK), fault, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(lanes.status == Status.OK, a, jnp.nan), sample)


def _with_empty_accumulator(lanes: Lane, method: Choices) -> Lane:
    """The lanes with the sums of a sample reset: in float32, late periods would lose digits in a long sum."""
    accumulator = lanes.accumulator
    integrals, jumps = jax.tree.map(jnp.zeros_like, (accumulator.integrals, accumulator.jumps))
    log = None if accumulator.log is None else log_of_new_period(accumulator.log, lanes.state.motion, method)
    return eqx.tree_at(lambda lane: lane.accumulator, lanes, Accumulator(integrals, jumps, log, accumulator.margins))


@traced_once
def _total_energies(lanes: Lane, models: Model) -> Float[Array, " lanes"]:
    return jax.vmap(lambda lane, m: total_energy(lane.state, m))(lanes, models)


@compiled("method")
def begin_lanes(scenes: Scene, states: State, method: Choices) -> Lane:
    """The lanes at their start from `states`."""
    return jax.vmap(lambda scene, state: _begin_lane(scene, state, method))(scenes, states)


def _begin_lane(scene: Scene, state: State, method: Choices) -> Lane:
    model = prepared_model(scene)
    return begin_lane(carried_state(state, model), model, method)


def lane_models(scenes: Scene) -> tuple[Model, Float[Array, " lanes"]]:
    """The constants of lanes, and their drive periods [s]."""
    return jax.vmap(lambda scene: (prepared_model(scene), scene.drive.period))(scenes)


def begun_pairs(lanes: Lane, models: Model, method: Choices, each: EachLane) -> tuple[Lane, Float[Array, " lanes"]]:
    """Pairs at the start of a period, and the energies that they store [J]."""
    del each
    return _with_empty_accumulator(lanes, method), _total_energies(lanes, models)
