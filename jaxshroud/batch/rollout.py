"""Runs as pure functions, for JAX's own transformations: sampled motions, whole drive periods, and whole sweeps."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, PyTree

from jaxshroud.batch.flows import Flow, as_differentiable, begin_flow, end_flow, flow_constants
from jaxshroud.batch.lanes import given_states, initial_states, lane_models
from jaxshroud.batch.periods import LANES_PER_CALL, march, with_clock_reset
from jaxshroud.batch.pure_functions import (
    Moment,
    SampledMoments,
    Schedule,
    SweepPlan,
    differentiable_samples,
    lane_outcomes,
    sampled_moments,
    trial_counts,
)
from jaxshroud.batch.runs import require_march
from jaxshroud.batch.stopped import (
    Admitted,
    admit,
    distinct_where,
    nan_where,
    replaced_where,
    require_single_scene,
    status_if_admitted,
    where_going,
)
from jaxshroud.batch.xla import compiled, one_lane, vmapped
from jaxshroud.cache.programs import is_traced
from jaxshroud.march.method import EXPLICIT, Choices, Method, explicit
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import area, free_power, means_from_static, power_reduction, vibration_square
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import MAX_COUNT, InputError, count_argument
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import require_points
from jaxshroud.scene.scene import PerBlade, Scene
from jaxshroud.scene.typed import Tree, typed
from jaxshroud.scene.valid import in_precision

TRIAL_MARGIN = 1.25, 64  # factor and offset for the trials of scenes nearby


class Rollout(eqx.Module):
    """The result of `rollout`."""

    saved: PyTree  # the results of `save`, with a leading axis of samples
    state: State  # at the end
    power: PerBlade  # mean square displacement over each block and the whole run [m^2]
    status: Int[Array, ""]  # see `Status`; unless OK, all numbers after the lane stopped are NaN
    events: Int[Array, ""]  # changes of mode and case until the end, or until the lane stopped, as the next two
    slowest_onset: Scalar  # least closing speed as contact began from a gap [m/s]; infinite if it never did
    slowest_switch: Scalar  # least speed of corners passing each other as the case changed [m/s]; infinite likewise
    coarseness: Scalar  # omega_max h over the method's limit of accuracy: inaccurate above 1; 0 of power series


def save_all(moment: Moment) -> Moment:
    """The whole sample."""
    return moment


@typed
def rollout(
    scene: Scene,
    state: State | None = None,
    n_periods: int = 1,
    *,
    save: Callable[[Moment], PyTree] = save_all,
    every: int | None = None,
    method: Method = EXPLICIT,
    most_trials: int | None = None,
) -> Rollout:
    """Run `n_periods` drive periods from drive phase 0, inside `jax.jit`, `vmap`, `jvp`, `jacfwd` or `grad`.

    Derivatives are those of the computed motion, of first order: the times of events move with the parameters. The
    tangents of all numbers on which a loss depends are computed with the motion, forward in time, in reverse mode too.
    Reverse mode thus stores no trajectory, costs two to three times the motion for each such number, and returns the
    numbers of forward mode.

    Args:
        scene: The scene; under `jax.vmap` many, which are marched together.
        state: The initial state; by default that of `scene.initial`, apart.
        n_periods: Drive periods.
        save: What to keep of each sample: a function of a `Moment`, of JAX; by default all of it.
        every: Steps from sample to sample, a divisor of the method's steps; by default the whole period.
        method: How to march: a `RungeKutta` or `Taylor` with its number of steps; `method_for` chooses one for an
            accuracy.
        most_trials: Bound on the trial steps of the whole run, see `most_trials`; beyond it the lane stops with status
            OUT_OF_TRIALS. None: no bound.

    Returns:
        The saved samples, `every` so many steps (without the start), the final state, the mean square displacements,
        the status, and what the march knows of its events and its step, see `Rollout`. Numbers and derivatives are NaN
        after a lane has stopped, and only then; a loss that leaves these numbers out, by `jnp.where` or the like before
        it does anything else with them, has the derivatives of the others, in both modes. Under `jax.jit` the inputs
        are known only while the program runs: where one is out of its range, or the steps of a Runge-Kutta method are
        unstable, the status is BAD_INPUT.

    Raises:
        ValueError: A count is out of range, the scene has leading axes, or float64 is not enabled; a row of blades has
            no contact, or is to be marched by power series.
        TypeError: It is differentiated twice, but contact has events, whose derivatives are of first order only.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> how = dict(n_periods=2, every=50, method=js.RungeKutta(steps=200), save=lambda at: at.N)
        >>> largest = lambda gap: js.rollout(js.vary(scene, "shroud.gap", gap), **how).saved.max()
        >>> value, slope = jax.jit(jax.value_and_grad(largest))(22e-6)
        >>> round(float(value)), slope.shape
        (88, ())
    """
    schedule = _schedule(n_periods, every, method, most_trials)
    require_single_scene("rollout", scene)
    require_points("rollout", scene.contact.points)
    scene, state = _in_method_precision(scene, state, schedule.method)
    require_march(scene, as_differentiable(schedule.method))
    begin = admit(scene, state, schedule.steps, schedule.method)
    return _as_rollout(sampled_moments(begin, schedule), save, begin)


def _as_rollout(sampled: SampledMoments, save: Callable[[Moment], PyTree], begin: Admitted) -> Rollout:
    """The result of sampled moments, with NaN once the lane has stopped."""
    moments = sampled.moments
    stopped = sampled.status != Status.OK
    lost = eqx.tree_at(_of_motion, moments, nan_where(stopped, _of_motion(moments)))
    kept = eqx.tree_at(_of_motion, moments, distinct_where(stopped, _of_motion(moments)))
    saved = where_going(stopped, jax.vmap(save)(kept), jax.vmap(save)(lost))
    mean = nan_where(stopped[-1], jnp.mean(sampled.power, axis=0))
    state, status, margins = jax.tree.map(
        lambda a: a[-1], (lost.state, sampled.status, lax.stop_gradient(sampled.margins))
    )
    status = status_if_admitted(status, begin.good)
    events, onset, switch = margins
    return Rollout(saved, state, mean, status, events, onset, switch, begin.coarseness)


def _of_motion(moment: Moment) -> tuple[Any, ...]:
    """The numbers of a moment that depend on the motion."""
    state = moment.state
    return state.motion, state.u_s, moment.N, moment.F, moment.v, moment.u


@typed
def most_trials(
    scene: Scene,
    n_periods: int = 1,
    *,
    state: State | None = None,
    method: Method = EXPLICIT,
) -> int:
    """A bound of the trial steps of `rollout`, with a margin of a quarter; not inside `jax.jit`.

    Args:
        scene: The scene.
        n_periods: Drive periods.
        state: Where to start; by default from `scene.initial`.
        method: How to march: a `RungeKutta` or `Taylor` with its number of steps; `method_for` chooses one for an
            accuracy.

    Raises:
        ValueError: As for `rollout`; or it is called inside a transformation of JAX.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> 200 < js.most_trials(scene, 1, method=js.RungeKutta(steps=200)) < 600
        True
    """
    require_single_scene("most_trials", scene)
    require_points("most_trials", scene.contact.points)
    schedule = _schedule(n_periods, None, method, MAX_COUNT)
    require_march(scene, as_differentiable(schedule.method))
    schedule = schedule._replace(method=as_differentiable(schedule.method))
    counts = trial_counts(*one_lane(_in_method_precision(scene, state, schedule.method)), schedule)
    if is_traced(counts):
        raise InputError("Call `most_trials` outside jax.jit, and give its number to `rollout`.")
    return math.ceil(int(counts[0]) * TRIAL_MARGIN[0]) + TRIAL_MARGIN[1]


def _schedule(n_periods: int, every: int | None, method: Method, most_trials: int | None) -> Schedule:
    steps, how = explicit(method)
    every = steps if every is None else every
    counts = {"n_periods": n_periods, "every": every}
    for name, count in (counts if most_trials is None else counts | {"most_trials": most_trials}).items():
        count_argument(name, count, 1)
    if steps % every:
        raise InputError(f"Argument `every` = {every} must divide the method's steps = {steps}.")
    return Schedule(n_periods * steps // every, every, steps, how, most_trials)


def _in_method_precision(scene: Scene, state: State | None, method: Choices) -> tuple[Scene, State]:
    """The scene and the initial state in the precision of the method."""
    scene = in_precision(scene, method.precision)
    return scene, initial_states(scene) if state is None else given_states(state, scene, method.precision)


@typed
def period_map(
    scene: Scene,
    state: State,
    *,
    n_periods: int = 1,
    method: Method = EXPLICIT,
    most_trials: int | None = None,
) -> Flow:
    """Run `n_periods` drive periods from drive phase 0, inside `jax.jit`, `vmap`, `jvp`, `jacfwd` or `grad`.

    Derivatives with respect to all numbers of the scene and of the state are those of the computed motion: the times of
    events move with the parameters. They are those of `rollout`, which also keeps samples; smooth contact, which has no
    events, is differentiated by JAX itself, to any order.

    Args:
        scene: The scene.
        state: The initial state, see `State`.
        n_periods: Drive periods.
        method: How to march: a `RungeKutta` or `Taylor` with its number of steps; `method_for` chooses one for an
            accuracy.
        most_trials: Bound on the trial steps of a period, on average: its steps, and some ten more for each event.
            None: no bound; smooth contact then has no reverse mode.

    Returns:
        The state, of blades by modes with their coordinates; the mean square displacement of both blades, the status
        and how coarse the step is. NaN where the run stopped, `most_trials` was too small (OUT_OF_TRIALS), numbers are
        out of their ranges or steps unstable (BAD_INPUT).

    Raises:
        ValueError: A count is too small, the scene has leading axes, or float64 is not enabled.
        TypeError: It is differentiated twice, but contact has events, whose derivatives are of first order only.
    """
    require_single_scene("period_map", scene)
    require_points("period_map", scene.contact.points)
    count_argument("n_periods", n_periods, 1)
    if most_trials is not None:
        count_argument("most_trials", most_trials, 1)
    steps, how = explicit(method)
    scene, state = (in_precision(tree, how.precision) for tree in (scene, state))
    require_march(scene, as_differentiable(how))
    how = as_differentiable(how)
    begin = admit(scene, state, steps, how)
    if scene.parts.contact == "smooth":
        flow = _plain_period_map(begin, n_periods, steps, how, most_trials)
    else:
        most = None if most_trials is None else n_periods * most_trials
        flow = differentiable_samples(begin.scene, begin.start, Schedule(n_periods, steps, steps, how, most))
        last = jax.tree.map(lambda a: a[-1], flow)
        flow = Flow(last.own, jnp.mean(flow.power, axis=0), last.status)
    status = status_if_admitted(flow.status, begin.good)
    state, power = nan_where(status != Status.OK, (flow.state, flow.power))
    return Flow(state, power, status, coarseness=begin.coarseness)


def _plain_period_map(
    begin: Admitted, n_periods: int, steps_per_period: int, method: Choices, most: int | None
) -> Flow:
    """The map as a plain program, which JAX differentiates itself."""
    scenes, states = one_lane((begin.scene, begin.state))
    model, periods = lane_models(scenes)
    steps = jnp.full((1,), steps_per_period, jnp.int32)
    fixed = flow_constants(model, periods, steps, method.flat_return)

    def one_period(lanes, _):
        lanes = march(lanes, fixed, method, vmapped, most)
        arrived = lanes.step == steps
        return with_clock_reset(lanes, arrived), arrived

    lanes, arrived = lax.scan(one_period, begin_flow(scenes, states, method, vmapped), length=n_periods)
    flow = jax.tree.map(lambda a: a[0], end_flow(lanes, model, n_periods * periods, vmapped))
    status = jnp.where((flow.status == Status.OK) & ~jnp.all(arrived), Status.OUT_OF_TRIALS, flow.status)
    return Flow(flow.own, flow.power, status.astype(flow.status.dtype))


class Strobe(eqx.Module):
    """The result of a `sweep_function`; NaN where a lane has stopped."""

    motion: Motion  # at the end of each kept period, fields (lanes, n_periods, blades)
    P: PerBlade  # average power over the kept periods, Eq. (23), (lanes, blades) [m^4]
    P_d: Float[Array, "..."]  # its reduction on the left blade, Eq. (24), of a row that of all, (lanes,) [%]
    P_d_vibration: Float[Array, "..."]  # the same of the displacements about their means over these periods
    status: Int[Array, "..."]  # (lanes,), see `Status`
    coarseness: Float[Array, "..."]  # omega_max h over the method's limit of accuracy: inaccurate above 1, (lanes,)
    P_0: PerBlade  # power without contact, (lanes, blades) [m^4]; see `free_power`


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
    without bound.

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
    plan = SweepPlan(transient, n_periods, steps, choices._replace(vibration=True))

    @typed
    def function(scenes: Scene, states: State | None = None) -> Strobe:
        if scenes.drive.omega.ndim != 1:
            raise InputError(
                "A sweep function takes scenes with one leading axis, as of js.scenes_from; or use js.rollout."
            )
        require_points("sweep_function", scenes.contact.points)
        require_march(scenes, as_differentiable(plan.method))
        scenes = in_precision(scenes, plan.method.precision)
        begin = initial_states(scenes) if states is None else given_states(states, scenes, plan.method.precision)
        lanes = jax.vmap(lambda scene, state: admit(scene, state, plan.steps, plan.method))(scenes, begin)
        strobe = _run_sweep(lanes.scene, lanes.start, plan, plan.method)
        values = status_if_admitted(strobe.status, lanes.good), lanes.coarseness, nan_where(~lanes.good, strobe.P_0)

        def places(strobe):
            return (strobe.status, strobe.coarseness, strobe.P_0)

        return eqx.tree_at(places, strobe, values)

    return function


def _by_chunks(run: Callable[[Any], Tree], lanes: Any, count: int) -> Tree:
    """The results of `run` for chunks of `LANES_PER_CALL` lanes (leading axis), or for one lane alone."""
    width = 1 if count == 1 else LANES_PER_CALL
    chunks = -(-count // width)
    at = jnp.minimum(jnp.arange(chunks * width), count - 1).reshape(chunks, width)
    results = lax.map(run, jax.tree.map(lambda a: a[at], lanes))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], results)


@compiled("plan", "method")
def _run_sweep(scenes: Scene, states: State, plan: SweepPlan, method: Choices) -> Strobe:
    """Run all lanes, chunk by chunk; `method` is that of the plan, passed for the decorator."""
    del method

    def run(chunk):
        return lane_outcomes(chunk[0], chunk[1], plan)

    outcomes = _by_chunks(run, (scenes, states), len(scenes.drive.omega))
    stopped = outcomes.status != Status.OK
    counting = scenes.layout.counting
    within = replaced_where(stopped, scenes, 1.0)  # without numbers out of all bounds
    A, P_0 = jax.vmap(lambda scene: (area(scene.shroud), free_power(scene)))(within)
    square, means = replaced_where(stopped, (outcomes.power, jnp.stack(outcomes.means, axis=1)), 0.0)
    means = jax.vmap(means_from_static)(within, means)
    about_mean = jax.vmap(vibration_square)(square[:, : means.shape[-1]], means, jax.vmap(gyration)(within.shroud))
    P, P_vibration = A[:, None] * square, A[:, None] * about_mean

    def reduction(power: Any) -> Any:
        return power_reduction(*(a[:, counting].sum(axis=-1) for a in (power, P_0)))

    motion = jax.tree.map(lambda a: nan_where(jnp.isnan(a), a), outcomes.motion)
    P, P_d, P_d_vibration, P_0 = nan_where(stopped, (P, reduction(P), reduction(P_vibration), P_0))
    return Strobe(motion, P, P_d, P_d_vibration, outcomes.status, jnp.zeros_like(A), P_0)
