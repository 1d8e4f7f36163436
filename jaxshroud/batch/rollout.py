"""Sampled motions and contact forces as one pure function, for JAX's own transformations."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxshroud.batch.sampled import Schedule, differentiable_samples, trials
from jaxshroud.batch.states import as_arrays, inside
from jaxshroud.batch.tangents import differentiable
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.resultant import resultant
from jaxshroud.model.absent import Scalar, filled
from jaxshroud.model.ready import Model, model
from jaxshroud.model.rhs import wave
from jaxshroud.model.state import State, start
from jaxshroud.model.trig import sincos_turns
from jaxshroud.scene.checks import MOST_COUNT, count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import PerBlade, Scene

MARGIN = 1.25, 64  # trials that scenes nearby may take more: a share, and so many


class Moment(NamedTuple):
    """What `save` of a rollout is given."""

    t: Scalar  # [s]
    state: State  # fields of `motion` (2,)
    N: Scalar  # normal force of contact [N]
    F: Scalar  # friction force [N]
    v: Scalar  # penetration [m]; apart, what is left of the gap, negative
    u: Scalar  # slide of the left block against the right one [m]


class Rollout(eqx.Module):
    """What `rollout` gives."""

    saved: Any  # what `save` returned, with a leading axis of samples
    state: State  # at the end
    power: PerBlade  # mean square displacement over each block and the whole run [m^2]
    status: Int[Array, ""]  # see `Status`; unless OK, all numbers after the lane stopped are NaN


def whole_moment(moment: Moment) -> Moment:
    """All of it."""
    return moment


def rollout(
    scene: Scene,
    state: State | None = None,
    n_periods: int = 1,
    *,
    save: Callable[[Moment], Any] = whole_moment,
    every: int | None = None,
    steps_per_period: int = 400,
    method: Method | Choices = FAST,
    most_trials: int | None = None,
) -> Rollout:
    """Run `n_periods` drive periods from drive phase 0, inside `jax.jit`, `vmap`, `jvp`, `jacfwd` or `grad`.

    Derivatives are those of the computed motion, of first order: instants of events move with the parameters. Those of
    all numbers that a loss depends on travel with the motion, forward in time, in reverse mode too: it takes no memory
    for the trajectory, costs two to three times the motion for each such number, and gives what forward mode gives.

    Args:
        scene: The scene; under `jax.vmap` many, which are marched together.
        state: Where to start; by default from `scene.initial`, apart.
        n_periods: Drive periods.
        save: What to keep of each sample: a function of a `Moment`, of JAX; by default all of it.
        every: Steps from sample to sample, a divisor of `steps_per_period`; by default the whole period.
        steps_per_period: Runge-Kutta steps in one period.
        method: Static choices of the march; see `Method`.
        most_trials: Bound on the trial steps of the whole run, see `most_trials`; beyond it the lane stops with status
            OUT_OF_TRIALS. None: as many as it takes.

    Returns:
        What was saved, at the ends of every so many steps (without the start), the final state, the mean square
        displacements and the status. NaN, as well as its derivatives, after a lane has stopped, and only then.

    Raises:
        ValueError: A count is out of range, or float64 is not to be had.
        TypeError: It is differentiated twice, and contact has events: their derivatives are of first order only.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> largest = lambda gap: js.rollout(
        ...     js.vary(scene, "shroud.gap", gap), n_periods=2, every=50, steps_per_period=200, save=lambda at: at.N
        ... ).saved.max()
        >>> value, slope = jax.jit(jax.value_and_grad(largest))(22e-6)
        >>> round(float(value)), slope.shape
        (88, ())
    """
    schedule = _schedule(n_periods, every, steps_per_period, method, most_trials)
    scene, state = _prepared(scene, state, schedule.method)
    flow = differentiable_samples(scene, state, schedule)
    ready, index = model(scene), np.arange(1, schedule.samples + 1) * schedule.every
    turns = jnp.asarray(index % steps_per_period / steps_per_period, scene.drive.omega.dtype)
    times = scene.drive.period * jnp.asarray(index / steps_per_period, turns.dtype)
    states = eqx.tree_at(lambda s: s.motion, flow.state, jax.vmap(as_arrays)(flow.state.motion))
    moments = jax.vmap(lambda t, turns, state: _moment(t, turns, state, ready))(times, turns, states)
    last = jax.tree.map(lambda a: a[-1], (states, flow.status))
    return Rollout(jax.vmap(save)(moments), last[0], jnp.mean(jnp.stack(flow.power, -1), axis=0), last[1])


def most_trials(
    scene: Scene,
    n_periods: int = 1,
    *,
    state: State | None = None,
    steps_per_period: int = 400,
    method: Method | Choices = FAST,
) -> int:
    """A bound for `rollout`: a quarter more trial steps than this scene takes, and some; not inside `jax.jit`.

    Args:
        scene: The scene.
        n_periods: Drive periods.
        state: Where to start; by default from `scene.initial`.
        steps_per_period: As of the rollout.
        method: As of the rollout.

    Raises:
        ValueError: As of `rollout`; or it is called inside a transformation of JAX.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> 200 < js.most_trials(scene, 1, steps_per_period=200) < 600
        True
    """
    schedule = _schedule(n_periods, None, steps_per_period, method, MOST_COUNT)
    found = trials(*alone(_prepared(scene, state, schedule.method)), schedule)
    if isinstance(found, Tracer):
        raise InputError("Call `most_trials` outside jax.jit, and give its number to `rollout`.")
    return math.ceil(int(found[0]) * MARGIN[0]) + MARGIN[1]


def _schedule(
    n_periods: int, every: int | None, steps: int, method: Method | Choices, most_trials: int | None
) -> Schedule:
    every = steps if every is None else every
    counts = {"n_periods": n_periods, "steps_per_period": steps, "every": every}
    for name, count in (counts if most_trials is None else counts | {"most_trials": most_trials}).items():
        count_argument(name, count, 1)
    if steps % every:
        raise InputError(f"Argument `every` = {every} must divide `steps_per_period` = {steps}.")
    return Schedule(n_periods * steps // every, every, steps, differentiable(choices(method)), most_trials)


def _prepared(scene: Scene, state: State | None, method: Choices) -> tuple[Scene, State]:
    """Scene and start in the precision of the method."""
    scene = in_precision(scene, method.precision)
    return scene, start(scene.initial) if state is None else in_precision(state, method.precision)


def _moment(t: Scalar, turns: Float[Array, ""], state: State, ready: Model) -> Moment:
    held = inside(state, ready)
    at = resultant(wave(*sincos_turns(turns), ready.drive), held, ready)
    N, F = (jnp.where(jnp.isnan(at.v), at.v, force) for force in filled((at.N, at.F), at.v))  # a lane that has stopped
    return Moment(t, state, N, F, at.v, at.u)
