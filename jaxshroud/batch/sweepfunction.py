"""A whole sweep as one pure function, for JAX's own transformations."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.blocks import PAIR_KERNELS, period_function
from jaxshroud.batch.differentiable_samples import (
    Schedule,
    batching_by_lanes,
    no_tangents,
    perturbed_only,
    samples_and_tangents,
    skip_samples,
)
from jaxshroud.batch.input_status import admit, status_if_admitted
from jaxshroud.batch.periods import LANES_PER_CALL, Clock, begin_lanes
from jaxshroud.batch.row_flow import row_strobe
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.stopped import lost_tangents, nan_where, replaced_where
from jaxshroud.batch.tangents import as_differentiable
from jaxshroud.batch.xla import best_mapping, compiled
from jaxshroud.march.method import EXPLICIT, Choices, Method, explicit
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import area, free_power, power_reduction, vibration_square
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Means
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import PerBlade, Scene
from jaxshroud.scene.typed import Tree, typed
from jaxshroud.scene.valid import in_precision


class Strobe(eqx.Module):
    """The result of a `sweep_function`; NaN where a lane has stopped."""

    motion: Motion  # at the end of each kept period, fields (lanes, n_periods, blades)
    P: PerBlade  # average power over the kept periods, Eq. (23), (lanes, blades) [m^4]
    P_d: Float[Array, "..."]  # its reduction on the left blade, Eq. (24), of a row that of all, (lanes,) [%]
    P_d_vibration: Float[Array, "..."]  # the same of the displacements about their means over these periods
    status: Int[Array, "..."]  # (lanes,), see `Status`
    coarseness: Float[Array, "..."]  # omega_max h over the method's limit of accuracy: inaccurate above 1, (lanes,)
    P_0: PerBlade | None = None  # power without contact, of rows alone, (lanes, blades) [m^4]; see `free_power`


class _SweepPlan(NamedTuple):
    """The static arguments of a sweep."""

    transient: int
    kept: int
    steps: int
    method: Choices

    @property
    def clock(self) -> Clock:
        """The grid of whole periods from drive phase 0."""
        return Clock.from_phase_0(self.steps)

    @property
    def schedule(self) -> Schedule:
        """The schedule of the same run with derivatives."""
        return Schedule(self.kept, self.steps, self.steps, as_differentiable(self.method), skipped=self.transient)


class _LaneOutcomes(NamedTuple):
    """The results of lanes (leading axis)."""

    motion: Motion  # of each blade, (lanes, periods)
    power: tuple[Any, ...]  # mean square displacement over block and periods, (lanes,) [m^2]
    means: Any  # `Means` over the periods, of each block that counts, (lanes,)
    status: Any  # (lanes,); None of tangents


@typed
def sweep_function(
    n_periods: int = 64,
    transient: int = 64,
    method: Method = EXPLICIT,
) -> Callable[..., Strobe]:
    """A pure function of scenes that runs each for `transient` and then `n_periods` drive periods, as `sweep` does.

    The whole sweep is one compiled program, a loop over chunks of 64 lanes on one core, with the kernels and the
    samples of the verb `sweep`. `jax.jit`, `jax.vmap`, `jax.jvp` and `jax.grad` accept it; `jax.shard_map` with
    `check_vma=False`, over lanes, runs it on many devices. Derivatives are those of `rollout`; in chaos they grow
    without bound. Rows of blades have none yet: that raises a TypeError.

    Args:
        n_periods: Drive periods kept.
        transient: Drive periods before these.
        method: How to march: a `RungeKutta` or `Taylor` with its number of steps; `method_for` chooses one for an
            accuracy.

    Returns:
        A function `f(scenes, states=None)` of scenes with one leading axis and of their initial states (by default
        those of `scenes.initial`), that returns a `Strobe`: samples at drive phase 0, powers averaged over all
        kept periods (the verb's are over whole orbits), statuses (BAD_INPUT for a lane with a number out of its range,
        or unstable steps), and how coarse the steps are.

    Raises:
        ValueError: A count is too small; or, when it is called, the scenes have no leading axis, or float64 is not
            enabled.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> base = js.load("table1", ['parts.motion=["x"]']).scene
        >>> scenes = jax.vmap(lambda gap: js.vary(base, "shroud.gap", gap))(jax.numpy.linspace(1e-5, 3e-5, 4))
        >>> found = js.sweep_function(n_periods=2, transient=1, method=js.RungeKutta(steps=200))(scenes)
        >>> found.motion.x.shape, found.P_d.shape
        ((4, 2, 2), (4,))
    """
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    steps, choices = explicit(method)
    plan = _SweepPlan(transient, n_periods, steps, choices._replace(vibration=True))

    @typed
    def function(scenes: Scene, states: State | None = None) -> Strobe:
        if scenes.drive.omega.ndim != 1:
            raise InputError(
                "A sweep function takes scenes with one leading axis, as of js.scenes_from; or use js.rollout."
            )
        scenes = in_precision(scenes, plan.method.precision)
        begin = initial_states(scenes) if states is None else in_precision(states, plan.method.precision)
        lanes = jax.vmap(lambda scene, state: admit(scene, state, plan.steps, plan.method))(scenes, begin)
        strobe = _run_sweep(lanes.scene, lanes.start, plan, plan.method)
        told = status_if_admitted(strobe.status, lanes.good), lanes.coarseness, nan_where(~lanes.good, strobe.P_0)
        places = lambda strobe: (strobe.status, strobe.coarseness, strobe.P_0)
        return eqx.tree_at(places, strobe, told, is_leaf=lambda a: a is None)

    return function


def _by_chunks(run: Callable[[Any], Tree], lanes: Any, count: int) -> Tree:
    """The results of `run` for chunks of `LANES_PER_CALL` lanes (leading axis), or for one lane alone."""
    width = 1 if count == 1 else LANES_PER_CALL
    chunks = -(-count // width)
    at = jnp.minimum(jnp.arange(chunks * width), count - 1).reshape(chunks, width)
    results = lax.map(run, jax.tree.map(lambda a: a[at], lanes))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], results)


def _differentiable_chunk(scenes: Scene, states: State, plan: _SweepPlan) -> _LaneOutcomes:
    """The results of a chunk of pairs; their derivatives are those of the samples of the lanes."""
    outcomes_of = jax.custom_jvp(batching_by_lanes(lambda scenes, states: _lane_outcomes(scenes, states, plan)))

    def push(primals, tangents):
        run, flow = jax.vmap(partial(samples_and_tangents, schedule=plan.schedule))(primals, perturbed_only(tangents))
        told = flow.state.motion, flow.power, flow.means
        motion, power, means = lost_tangents(run.status != Status.OK, told)
        power, means = jax.tree.map(lambda a: jnp.mean(a, axis=1), (power, means))
        slope = _LaneOutcomes(motion, power, means, None)
        value = outcomes_of(*primals)
        return value, no_tangents(value, slope)

    outcomes_of.defjvp(push, symbolic_zeros=True)
    found = outcomes_of(scenes, states)
    return found._replace(means=Means(*((left,) for left in found.means)))


def _chunk_of_rows(rows: Scene, states: State, plan: _SweepPlan) -> _LaneOutcomes:
    """The results of a chunk of rows, by the kernels of the verb `sweep`."""
    strobe = row_strobe(rows, states, *plan)
    told = strobe.motion, strobe.power, strobe.means
    motion, power, means = jax.tree.map(lambda a: tuple(jnp.moveaxis(a, -1, 0)), told)
    return _LaneOutcomes(motion, power, means, strobe.status)


def _lane_outcomes(scenes: Scene, states: State, plan: _SweepPlan) -> _LaneOutcomes:
    """The results of lanes, by the kernels of the verb `sweep`."""
    period = period_function(scenes, plan.clock, plan.method, best_mapping(), PAIR_KERNELS)
    begin = begin_lanes(scenes, states, plan.method)
    one = skip_samples(lambda lanes, _: period(lanes, True), plan.transient)
    last, sample = lax.scan(one, begin, jnp.arange(plan.kept))
    lanes_first = jax.tree.map(lambda a: a.T, sample.motion)
    power, means = jax.tree.map(lambda a: jnp.mean(a, axis=0), (sample.power, sample.means))
    return _LaneOutcomes(lanes_first, power, means, last.status)


class _Kernel(NamedTuple):
    """What a sweep of pairs or of rows is made of."""

    run: Callable[[Scene, State, _SweepPlan], _LaneOutcomes]  # the results of a chunk of lanes
    within_bounds: Callable[[Any, Scene], Scene]  # (stopped, scenes) -> scenes without numbers out of all bounds
    counted: Callable[[Any], Any]  # the sum of numbers (lanes, blades) of the blades that count
    told: Callable[[Any], Any]  # P_0 of the result


PAIR_SWEEPS = _Kernel(
    _differentiable_chunk,
    lambda stopped, scenes: replaced_where(stopped, scenes, 1.0),
    lambda a: a[:, 0],
    lambda _: None,
)
ROW_SWEEPS = _Kernel(_chunk_of_rows, lambda _, scenes: scenes, lambda a: a.sum(axis=-1), lambda P_0: P_0)


@compiled("plan", "method")
def _run_sweep(scenes: Scene, states: State, plan: _SweepPlan, method: Choices) -> Strobe:
    """Run all lanes, chunk by chunk; `method` is that of the plan, passed for the decorator."""
    del method
    kernel = PAIR_SWEEPS if scenes.layout == PAIR else ROW_SWEEPS
    run = lambda chunk: kernel.run(chunk[0], chunk[1], plan)
    outcomes = _by_chunks(run, (scenes, states), len(scenes.drive.omega))
    stopped = outcomes.status != Status.OK
    told = kernel.within_bounds(stopped, scenes)
    A, P_0 = jax.vmap(lambda scene: (area(scene.shroud), free_power(scene)))(told)
    motion = Motion(*(jnp.stack(blades, axis=-1) for blades in outcomes.motion))
    power = jnp.stack(outcomes.power, axis=-1)
    means = jnp.stack([jnp.stack(blades, axis=-1) for blades in outcomes.means], axis=1)
    square, means = replaced_where(stopped, (power, means), 0.0)
    about_mean = jax.vmap(vibration_square)(square[:, : means.shape[-1]], means, jax.vmap(gyration)(told.shroud))
    P, P_vibration = A[:, None] * square, A[:, None] * about_mean
    P_d, P_d_vibration = (power_reduction(kernel.counted(a), kernel.counted(P_0)) for a in (P, P_vibration))
    motion = jax.tree.map(lambda a: nan_where(jnp.isnan(a), a), motion)
    P, P_d, P_d_vibration = nan_where(stopped, (P, P_d, P_d_vibration))
    return Strobe(motion, P, P_d, P_d_vibration, outcomes.status, jnp.zeros_like(A), kernel.told(P_0))
