"""Whole drive periods as one pure function, for JAX's own transformations."""

import jax
import jax.numpy as jnp
from jax import lax

from jaxshroud.batch.loop import driven
from jaxshroud.batch.sampled import Schedule, differentiable_samples
from jaxshroud.batch.states import as_arrays
from jaxshroud.batch.tangents import Flow, begun, differentiable, ended, whole_grid
from jaxshroud.batch.xla import alone, plain
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene


def period_map(
    scene: Scene,
    state: State,
    *,
    n_periods: int = 1,
    steps_per_period: int = 400,
    method: Method | Choices = FAST,
    most_trials: int | None = None,
) -> Flow:
    """Run `n_periods` drive periods from drive phase 0, inside `jax.jit`, `vmap`, `jvp`, `jacfwd` or `grad`.

    Derivatives with respect to all numbers of the scene and of the state are those of the computed motion: instants of
    events move with the parameters. They are those of `rollout`, which keeps samples too; smooth contact, which has no
    events, is differentiated by JAX itself, any number of times.

    Args:
        scene: The scene.
        state: Where to start, see `State` and `start`.
        n_periods: Drive periods.
        steps_per_period: Runge-Kutta steps in one period.
        method: Static choices of the march.
        most_trials: Bound on the trial steps of a period, on average: its steps, and some ten more for each event.
            None: as many as it takes; smooth contact then has no reverse mode.

    Returns:
        The state, the mean square displacement of both blades and the status; NaN where the run stopped or
        `most_trials` was too small.

    Raises:
        ValueError: Float64 is not to be had.
        TypeError: It is differentiated twice, and contact has events: their derivatives are of first order only.
    """
    how = choices(method)
    scene, state = (in_precision(tree, how.precision) for tree in (scene, state))
    how = differentiable(how)
    if scene.parts.contact == "smooth":
        return _by_jax(scene, state, n_periods, steps_per_period, how, most_trials)
    most = None if most_trials is None else n_periods * most_trials
    flow = differentiable_samples(scene, state, Schedule(n_periods, steps_per_period, steps_per_period, how, most))
    end, status = jax.tree.map(lambda a: a[-1], (flow.state, flow.status))
    left, right = (jnp.mean(a) for a in flow.power)
    return Flow(State(as_arrays(end.motion), end.u_s, end.mode, end.case), (left, right), status)


def _by_jax(scene: Scene, state: State, n_periods: int, steps_per_period: int, method: Choices, most: int | None):
    """A plain program, which JAX differentiates as it is."""
    lane, model, period = begun(scene, state, method)
    steps = jnp.full((1,), steps_per_period, jnp.int32)
    fixed = whole_grid(*alone((model, period)), steps)

    def one_period(lanes, _):
        return driven(lanes, fixed, steps, method, plain, most_trials=most)

    lanes, arrived = lax.scan(one_period, alone(lane), length=n_periods)
    flow = ended(jax.tree.map(lambda a: a[0], lanes), model, n_periods * period)
    good = jnp.all(arrived) & (flow.status == Status.OK)
    mark = jnp.where(good, 1.0, jnp.nan).astype(period.dtype)  # as a factor, so that derivatives are NaN too
    known = lambda tree: jax.tree.map(lambda a: a * mark, tree)  # noqa: E731
    motion, u_s, power = known((as_arrays(flow.state.motion), flow.state.u_s, flow.power))
    return Flow(State(motion, u_s, flow.state.mode, flow.state.case), power, flow.status)
