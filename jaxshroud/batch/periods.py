"""The loop over trials, and whole drive periods of many lanes in one compiled function."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.batch.lanes import (
    in_all,
    lane_models,
    lanes_first,
    lanes_last,
    ledger_of,
    on_last_axis,
    residual_of_energy,
    stored_energies,
)
from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.xla import compiled, has_several_kernels, repeated_while
from jaxshroud.march.accumulator import Log, mean_position
from jaxshroud.march.carry import EachLane, Fixed, Lane, TimeGrid, running, time_grid
from jaxshroud.march.forces_and_energy import is_unbalanced
from jaxshroud.march.log import accumulator_of_new_period
from jaxshroud.march.method import FLAT_RETURN, Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.arithmetic import filled, is_unrolled
from jaxshroud.model.modes import Status
from jaxshroud.model.row import RowModel, of_blades_that_count, positions_that_count
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import Tree


def march(
    lanes: Any,
    fixed: Fixed[RowModel],
    method: Choices,
    each: EachLane,
    most_trials: int | None = None,
    passes: Int[Array, ""] | None = None,
) -> Any:
    """Run every lane, lanes last, to the start of step `stop`, or until its status is not OK.

    With `most_trials` there are exactly that many trials: a loop of fixed length can be differentiated in reverse mode.
    With `passes` there are so many of the loop at most; what is left of them is a second result.
    """
    stepper = stepper_for(method)
    once = jax.jit(lambda lanes: stepper.trial(lanes, fixed, method, each))  # traced once
    if most_trials is not None:
        return lax.fori_loop(0, most_trials, lambda _, lanes: once(lanes), lanes)
    several = not fixed.model.is_pair or has_several_kernels(method)
    return repeated_while(lambda lanes: jnp.any(running(lanes, fixed.stop)), once, lanes, several, passes)


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
    """One period of one lane: the motion at its end and its integrals; NaN once the lane has stopped."""

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


def sample_of_users(sample: Sample) -> Sample:
    """Samples, lanes first, as arrays with axes of blades and of interfaces last; works are those of all blades."""

    def total(a):
        return None if a is None else a.sum(axis=-1)

    in_all = is_unrolled(sample.power)
    arrays = on_last_axis(jax.tree.map(np.asarray, sample))
    if in_all:
        return arrays
    return arrays._replace(work=total(arrays.work), gross=total(arrays.gross), viscous=total(arrays.viscous))


class Clock(NamedTuple):
    """The time grid of a run: `steps` steps of `1 / per_period` drive periods from the phase `start`."""

    start: Float[Array, ""]  # [turns]
    steps: Int[Array, ""]
    per_period: Float[Array, ""]
    flat_return: Float[Array, ""] | Float[np.ndarray, ""]  # of a period, see `time_grid`

    @classmethod
    def of_steps(
        cls,
        steps: int,
        *,
        start: float = 0.0,
        per_period: float | None = None,
        flat_return: float = FLAT_RETURN,
        dtype: Any = None,
    ) -> "Clock":
        """The grid of so many steps, by default those of a period, in a type of real numbers, or in that of lanes."""
        per_period = float(steps) if per_period is None else per_period
        flat = np.asarray(flat_return, dtype)
        return cls(jnp.asarray(start, dtype), jnp.int32(steps), jnp.asarray(per_period, dtype), flat)

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


def in_calls(
    call: Callable[[Any, CallLimits], tuple[Any, Any, Any]],
    begin: Any,
    count: int,
    most: int,
    pace: CallPace,
    tick: Callable[[float], Any],
    part: Callable[[Any], float] = lambda _: 0.0,
) -> tuple[Any, Any]:
    """March over a `count` of periods or samples in calls to the device that are short.

    Args:
        call: What lies between two calls, how many have ended, and samples (leading axis, then the lanes), of which
            further ones are meaningless.
        begin: What lies before the first call.
        count: Periods or samples.
        most: Of a call at most.
        pace: How much a call does.
        tick: Called after every call with the number that it made, parts of one included.
        part: The part of the next one that has been made.

    Returns:
        What lies after the last call, and the samples (lanes, samples, ...); None if there are none.
    """
    blocks = []
    done, reported = 0, 0.0
    while done < count:
        left = min(count - done, most)

        def paced(passes: np.int32, left: int = left, begin: Any = begin) -> tuple[Any, int, Any]:
            after, ended, samples = call(begin, CallLimits(jnp.int32(left), jnp.asarray(passes)))
            return after, int(ended), samples

        begin, ended, samples = pace.timed(paced, lambda result, left=left: result[1] < left)
        blocks.append(jax.tree.map(lambda a, n=ended: np.asarray(a)[:n].swapaxes(0, 1), samples))
        done += ended
        now = done + (part(begin) if done < count else 0.0)
        tick(now - reported)
        reported = now
    return begin, jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks) if blocks else None


def part_done(lanes: Any, steps: Any) -> float:
    """The part of a period of so many steps that lanes have marched, on average; those that have stopped count as 0."""
    return float(
        np.mean(np.where(np.asarray(lanes.status) == Status.OK, np.asarray(lanes.step) / np.asarray(steps), 0))
    )


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


def begin_period(lanes: Lane, model: RowModel, method: Choices, each: EachLane) -> tuple[Lane, Float[Array, " lanes"]]:
    """The lanes, lanes last, at the start of a period, and the energies that they store [J].

    The sums of a sample start from zero: in float32, late periods would lose digits in a long sum.
    """
    empty = accumulator_of_new_period(lanes.accumulator, model.blades.watched(lanes.state.motion), model, method)
    return eqx.tree_at(lambda lane: lane.accumulator, lanes, empty), stored_energies(lanes.state, model, each)


def end_period(
    lanes: Lane,
    stored_before: Float[Array, " lanes"],
    model: RowModel,
    period: Float[Array, " lanes"],
    steps: Float[Array, ""],
    each: EachLane,
    ended: Any = True,
) -> tuple[Lane, Sample]:
    """The lanes, lanes last, at the end of a period of so many `steps`, if it has `ended`, and its sample.

    Selecting between lanes before and after it would have XLA work out the faults anew for every number of the sample.
    """
    accumulator, log = lanes.accumulator, lanes.accumulator.log
    gain: Any = accumulator.integrals
    z = model.blades.shroud(lanes.state.motion)
    assert log is not None  # only flows with tangents have none
    stored = stored_energies(lanes.state, model, each)
    astray = jnp.zeros_like(period, bool)
    works: dict[str, Any] = {}
    if gain.ledger is not None:
        ledger = ledger_of(accumulator)
        jumps = accumulator.jumps
        assert jumps is not None  # they are kept with it
        residual = residual_of_energy(accumulator, stored - stored_before)
        works = {"work": ledger.drive, "gross": ledger.gross, "viscous": ledger.viscous, "friction": ledger.friction}
        works |= {"switched": jumps.springs, "dropped": jumps.dropped, "residual": residual}
        if model.interfaces.law.may_create_energy:  # the printed reading never balances, and other laws need no check
            astray = is_unbalanced(residual, in_all(ledger.gross, stored), stored_before, stored)
    means = mean_position(accumulator, positions_that_count(z, model), period, steps)
    logged = {name: getattr(log, name) for name in LOGGED_BY_PERIOD}
    of_blades = {"motion": z, "moments": gain.moments, "largest": logged.pop("largest"), "extent": logged.pop("extent")}
    of_faces = {"loads": gain.loads} | logged
    power = jax.tree.map(lambda a: a / period, filled(gain.power, gain.power))
    sample = Sample(power=power, **works, **filled(of_blades, power), **filled(of_faces, log.v_max))
    sample = sample._replace(means=filled(means, of_blades_that_count(power, model)))
    finite = [jnp.sum(jnp.atleast_2d(a), axis=0) for a in jax.tree.leaves(sample._replace(own=None))]
    overflowed = ~jnp.isfinite(sum(finite, stored))
    fault = jnp.where(overflowed, Status.NOT_FINITE, jnp.where(astray, Status.UNBALANCED, Status.OK))
    status = jnp.where(ended & (lanes.status == Status.OK), fault, lanes.status).astype(lanes.status.dtype)
    lanes = eqx.tree_at(lambda lane: lane.status, lanes, status)
    return lanes, jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan), sample)


class Part(NamedTuple):
    """What a march does in each of the parts, periods or stretches from sample to sample, of a block of them."""

    begin: Callable[[Lane], tuple[Lane, Any]]
    """The lanes, lanes last, as a part begins, and what is known of it then, see `Interim`."""
    stop: Callable[[Any], Any]
    """The step at which it ends, from what is known."""
    end: Callable[[Lane, Any, Any], tuple[Lane, Any]]
    """The lanes as it ends, if it has, and its sample."""


def marched_block(
    part: Part,
    begin: Interim,
    constants: tuple[Any, Any],
    limits: CallLimits,
    length: int,
    method: Choices,
    each: EachLane,
) -> tuple[Interim, Int[Array, ""], Any]:
    """Run up to `length` parts of every lane (leading axis): those at the end, how many have ended, and their samples.

    Samples have the axes (part, lane); those after the last part that has ended are meaningless. The `constants` are
    the models of the lanes, lanes last, and their time grids.
    """
    models, grids = constants

    def one(carry, i):
        (lanes, begun, inside), passes = carry
        on = (i < limits.most) & (passes > 0)
        lanes, begun = select_tree(on & ~inside, part.begin(lanes), (lanes, begun))
        stop = jnp.where(on, part.stop(begun), jnp.zeros_like(lanes.step))
        lanes, passes = march(lanes, Fixed(models, grids, stop), method, each, passes=passes)
        over = on & ~jnp.any(running(lanes, stop))
        lanes, sample = part.end(lanes, begun, over)
        return (Interim(lanes, begun, (on | inside) & ~over), passes), (sample, over)

    first = begin._replace(lanes=lanes_last(begin.lanes)), limits.passes
    (end, _), (samples, over) = lax.scan(one, first, jnp.arange(length, dtype=jnp.int32))
    return end._replace(lanes=lanes_first(end.lanes)), jnp.sum(over, dtype=jnp.int32), samples


@compiled("method", "block", "each")
def run_block(
    scenes: Scene, begin: Interim, clock: Clock, limits: CallLimits, method: Choices, block: int, each: EachLane
) -> tuple[Interim, Int[Array, ""], Any]:
    """Run up to `block` periods of every lane.

    Args:
        scenes: Scenes with a leading lane axis.
        begin: The lanes to continue, with the same axis.
        clock: The time grid, common to all lanes.
        limits: What is done at most.
        method: The options of the march.
        block: The length of the sample axis.
        each: How a function of one lane is applied to all.

    Returns:
        The lanes at the end, how many periods have ended, and the samples of these with axes (period, lane); further
        ones are meaningless.
    """
    model, periods = lane_models(scenes)

    def end(lanes, energies, over):
        lanes = with_clock_reset(lanes, over & (lanes.step == clock.steps))
        lanes, sample = end_period(lanes, energies, model, periods, clock.per_period, each, ended=over)
        return lanes, lanes_first(sample)

    period = Part(lambda lanes: begin_period(lanes, model, method, each), lambda _: clock.steps, end)
    return marched_block(period, begin, (model, clock.grids(periods)), limits, block, method, each)
