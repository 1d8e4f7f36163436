"""A whole sweep as one pure function, for JAX's own transformations."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.marches import require_march
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.pure_functions import SweepPlan, lane_outcomes
from jaxshroud.batch.states import given_states, initial_states
from jaxshroud.batch.stopped import admit, nan_where, replaced_where, status_if_admitted
from jaxshroud.batch.xla import compiled
from jaxshroud.march.method import EXPLICIT, Choices, Method, explicit
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import area, free_power, means_from_static, power_reduction, vibration_square
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import require_points
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
