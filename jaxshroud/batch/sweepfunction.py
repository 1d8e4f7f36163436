"""A whole sweep as one pure function, for JAX's own transformations."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.periods import CHUNK, Clock, begin_lanes, one_period
from jaxshroud.batch.runs import starts
from jaxshroud.batch.sampled import Schedule, joining_lanes, no_tangents, perturbed, pushed, skipping
from jaxshroud.batch.tangents import differentiable
from jaxshroud.batch.xla import Tree, best, compiled
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.model.absent import Pair
from jaxshroud.model.linear import area, free_power, power_reduction
from jaxshroud.model.state import State
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import PerBlade, Scene


class Strobe(eqx.Module):
    """What a `sweep_function` gives; NaN where a lane has stopped."""

    motion: Motion  # at the end of each kept period, fields (lanes, n_periods, 2)
    P: PerBlade  # average power over the kept periods, Eq. (23), (lanes, 2) [m^4]
    P_d: Float[Array, "..."]  # its reduction on the left blade, Eq. (24), (lanes,) [%]
    status: Int[Array, "..."]  # (lanes,), see `Status`


class _Plan(NamedTuple):
    """What is run; static."""

    transient: int
    kept: int
    steps: int
    method: Choices

    @property
    def clock(self) -> Clock:
        """Whole periods from drive phase 0."""
        return Clock(jnp.asarray(0.0), jnp.int32(self.steps), jnp.asarray(float(self.steps)))

    @property
    def schedule(self) -> Schedule:
        """The same with derivatives."""
        return Schedule(self.kept, self.steps, self.steps, differentiable(self.method), skipped=self.transient)


class _Kept(NamedTuple):
    """What is kept of lanes (leading axis)."""

    motion: Motion  # pairs (lanes, periods)
    power: Pair  # mean square displacement over block and periods, (lanes,) [m^2]
    status: Any  # (lanes,); None of tangents


def sweep_function(
    n_periods: int = 64,
    transient: int = 64,
    method: Method | Choices = FAST,
    *,
    steps_per_period: int = 400,
) -> Callable[..., Strobe]:
    """A pure function of scenes that runs each for `transient` and then `n_periods` drive periods, as `sweep` does.

    The whole sweep is one compiled program, with the kernels of the verb `sweep` and its samples: a loop over chunks of
    64 lanes on one core. `jax.jit`, `jax.vmap`, `jax.jvp` and `jax.grad` take it; `jax.shard_map` with
    `check_vma=False`, over lanes, runs it on many devices. Derivatives are those of `rollout`; in chaos they grow
    without bound.

    Args:
        n_periods: Drive periods kept.
        transient: Drive periods before these.
        method: How to march.
        steps_per_period: Runge-Kutta steps in one period.

    Returns:
        A function `f(scenes, states=None)` of scenes with one leading axis, and of where they start (by default from
        `scenes.initial`), that returns a `Strobe`: samples at drive phase 0, powers averaged over all kept periods (the
        verb's are over whole orbits), statuses.

    Raises:
        ValueError: A count is too small; or, where it is called: the scenes have no leading axis, or float64 is not to
            be had.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> base = js.load("table1", ['parts.motion=["x"]']).scene
        >>> scenes = jax.vmap(lambda gap: js.vary(base, "shroud.gap", gap))(jax.numpy.linspace(1e-5, 3e-5, 4))
        >>> found = js.sweep_function(n_periods=2, transient=1, steps_per_period=200)(scenes)
        >>> found.motion.x.shape, found.P_d.shape
        ((4, 2, 2), (4,))
    """
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    count_argument("steps_per_period", steps_per_period, 1)
    plan = _Plan(transient, n_periods, steps_per_period, choices(method))

    def function(scenes: Scene, states: State | None = None) -> Strobe:
        if scenes.drive.omega.ndim != 1:
            raise InputError(
                "A sweep function takes scenes with one leading axis, as of js.scenes_from; or use js.rollout."
            )
        scenes = in_precision(scenes, plan.method.precision)
        states = starts(scenes) if states is None else in_precision(states, plan.method.precision)
        return _swept(scenes, states, plan, plan.method)

    return function


@compiled("plan", "method")
def _swept(scenes: Scene, states: State, plan: _Plan, method: Choices) -> Strobe:
    """All lanes, chunk by chunk; `method` is the plan's, seen by what compiles this."""
    del method
    kept = _by_chunks(lambda chunk: _chunk(chunk[0], chunk[1], plan), (scenes, states), len(scenes.drive.omega))
    A, P_0 = jax.vmap(lambda scene: (area(scene.shroud), free_power(scene)))(scenes)
    P = A[:, None] * jnp.stack(kept.power, axis=-1)
    P_d = power_reduction(P[:, 0], P_0[:, 0])
    return Strobe(Motion(*(jnp.stack(pair, axis=-1) for pair in kept.motion)), P, P_d, kept.status)


def _by_chunks(run: Callable[[Any], Tree], lanes: Any, count: int) -> Tree:
    """`run` of `CHUNK` lanes (leading axis) at a time, the last of which is repeated; of one lane alone."""
    width = 1 if count == 1 else CHUNK
    chunks = -(-count // width)
    at = jnp.minimum(jnp.arange(chunks * width), count - 1).reshape(chunks, width)
    found = lax.map(run, jax.tree.map(lambda a: a[at], lanes))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], found)


def _chunk(scenes: Scene, states: State, plan: _Plan) -> _Kept:
    """What a chunk of lanes comes to; its derivatives are those of the lanes' samples."""
    known = jax.custom_jvp(joining_lanes(lambda scenes, states: _kept(scenes, states, plan)))

    def push(primals, tangents):
        _, flow = jax.vmap(partial(pushed, schedule=plan.schedule))(primals, perturbed(tangents))
        slope = _Kept(flow.state.motion, jax.tree.map(lambda a: jnp.mean(a, axis=1), flow.power), None)
        value = known(*primals)
        return value, no_tangents(value, slope)

    known.defjvp(push, symbolic_zeros=True)
    return known(scenes, states)


def _kept(scenes: Scene, states: State, plan: _Plan) -> _Kept:
    """What lanes come to, in the kernels of the verb `sweep`."""
    period = one_period(scenes, plan.clock, plan.method, best())
    begin = begin_lanes(scenes, states, plan.method)
    one = skipping(lambda lanes, _: period(lanes, True), plan.transient)
    last, sample = lax.scan(one, begin, jnp.arange(plan.kept))
    lanes_first = jax.tree.map(lambda a: a.T, sample.motion)
    return _Kept(lanes_first, jax.tree.map(lambda a: jnp.mean(a, axis=0), sample.power), last.status)
