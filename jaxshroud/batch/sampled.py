"""Lanes marched from sample to sample, with derivatives, in fused kernels inside JAX's own transformations.

A lane's samples depend on some fifty numbers, so that their whole derivative is some fifty tangents, forward in time.
`differentiable_samples` computes those of the numbers that are in fact perturbed. What is left is a product with what
JAX asks for, which it transposes and batches by itself: reverse mode costs what forward mode does and keeps no history.
"""

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Int

from jaxshroud.batch.loop import Where, advance, itself, march
from jaxshroud.batch.tangents import Dual, Flow, begun, dual, dual_grid, ended, whole_grid
from jaxshroud.batch.xla import (
    FOR_SERIES,
    EachLane,
    Tree,
    accepted,
    alone,
    best,
    in_parts,
    inside_another,
    plain,
    repeated_while,
)
from jaxshroud.march.implicit import first_order_only
from jaxshroud.march.lane import Lane, running
from jaxshroud.march.method import Choices
from jaxshroud.model.absent import Scalar
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import Model
from jaxshroud.model.state import State
from jaxshroud.scene.scene import Scene


class Schedule(NamedTuple):
    """How far lanes go, and what is kept; from drive phase 0."""

    samples: int
    every: int  # steps from sample to sample; a divisor of the next
    steps: int  # in a period
    method: Choices  # `differentiable`
    most_trials: int | None = None  # of a lane; None: as many as it takes
    skipped: int = 0  # samples before the first that is kept


class _Way(NamedTuple):
    """How lanes are marched: by themselves, or with tangents."""

    run: Callable[[Any], EachLane]
    where: Where  # the values are
    parts: Callable[[Any], Any]  # of a tuple that a function of lanes returned
    on_grid: Callable[..., Any]


def _duals(pair: Dual) -> tuple[Dual, ...]:
    return tuple(Dual(*each) for each in zip(*pair, strict=True))


ALONE, WITH_TANGENTS = _Way(itself, itself, itself, whole_grid), _Way(dual, attrgetter("value"), _duals, dual_grid)


def samples(scenes: Any, states: Any, schedule: Schedule) -> tuple[Any, Int[Array, " lanes"]]:
    """What lanes come to at each sample, and how many trials each took; these are counted where they are bounded.

    Args:
        scenes: Scenes with a leading lane axis, or a `Dual` of these.
        states: Where they start, likewise.
        schedule: How far they go.

    Returns:
        A `Flow`, or a `Dual` of one, with axes (lane, sample): states there, mean square displacements since the sample
        before, and statuses.
    """
    way = WITH_TANGENTS if isinstance(scenes, Dual) else ALONE
    first = way.run(plain)(partial(begun, method=schedule.method), scenes, states)
    lanes, models, periods = way.parts(first)
    steps = jnp.full(way.where(periods).shape, schedule.steps, jnp.int32)
    fixed = way.on_grid(models, periods, steps)

    def one(carry, _):
        lanes, trials = _next_sample(carry[0], carry[1], fixed, schedule, way)
        lanes, flow = way.parts(way.run(plain)(partial(_kept, schedule=schedule), lanes, models, periods))
        return (lanes, trials), flow

    last_of = skipping(one, schedule.skipped)
    (_, trials), flows = lax.scan(last_of, (lanes, jnp.zeros_like(steps)), jnp.arange(schedule.samples))
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), flows), trials


def skipping(one: Callable, skipped: int) -> Callable:
    """A step of a `lax.scan` over a count from 0, which at first does so many more of which nothing is kept."""
    if not skipped:
        return one

    def last_of(carry, i):
        empty = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(one, carry, i)[1])
        return lax.fori_loop(0, jnp.where(i == 0, skipped + 1, 1), lambda _, pair: one(pair[0], i), (carry, empty))

    return last_of


def _next_sample(lanes: Tree, trials: Int[Array, " lanes"], fixed: Tree, schedule: Schedule, way: _Way):
    """The lanes at their next sample, and the trials that they have made."""
    where, each, method, most = way.where, way.run(best()), schedule.method, schedule.most_trials
    stop = where(lanes).step + schedule.every
    fixed = eqx.tree_at(lambda fixed: where(fixed).stop, fixed, stop)
    if most is None:
        return march(lanes, fixed, method, each, where), trials

    def once(pair):
        lanes, trials = pair
        spent = running(where(lanes), stop) & (trials >= most)
        status = jnp.where(spent, Status.OUT_OF_TRIALS, where(lanes).status).astype(jnp.int32)
        lanes = eqx.tree_at(lambda lanes: where(lanes).status, lanes, status)
        trials = trials + running(where(lanes), stop).astype(jnp.int32)
        return advance(lanes, fixed, method, each, where), trials

    parts = in_parts(method, where(fixed).model.spring.smooth)
    return repeated_while(lambda pair: jnp.any(running(where(pair[0]), stop)), once, (lanes, trials), parts)


def _kept(lane: Lane, model: Model, period: Scalar, schedule: Schedule) -> tuple[Lane, Flow]:
    """The lane at a sample as it goes on, and what is kept of it."""
    flow = ended(lane, model, period * (schedule.every / schedule.steps))
    places = lambda lane: (lane.tally.integrals, lane.step, lane.status)  # noqa: E731
    empty = jax.tree.map(jnp.zeros_like, lane.tally.integrals)
    step = jnp.where(lane.step == schedule.steps, 0, lane.step)
    return eqx.tree_at(places, lane, (empty, step, flow.status)), flow


def joining_lanes(f: Callable[..., Tree]) -> Callable[..., Tree]:
    """`f` of trees with a leading lane axis, with another batching: the axis of `jax.vmap` joins that of the lanes."""

    @custom_vmap
    def call(*args):
        return f(*args)

    @call.def_vmap
    def _(size, batched, *args):
        every = jax.tree.map(lambda a, own: a if own else jnp.broadcast_to(a, (size, *a.shape)), args, tuple(batched))
        out = call(*jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), every))
        return jax.tree.map(lambda a: a.reshape(size, -1, *a.shape[1:]), out), jax.tree.map(lambda _: True, out)

    return call


def _run(scenes: Any, states: Any, schedule: Schedule) -> tuple[Any, Int[Array, " lanes"]]:
    large = schedule.method.taylor and not inside_another((scenes, states)) and accepted(series=True)
    return (_run_large if large else _run_plain)(scenes, states, schedule)


def _marched(scenes: Any, states: Any, schedule: Schedule) -> tuple[Any, Int[Array, " lanes"]]:
    return joining_lanes(lambda scenes, states: samples(scenes, states, schedule))(scenes, states)


def trials(scenes: Scene, states: State, schedule: Schedule) -> Int[Array, " lanes"]:
    """How many trials each lane takes; the schedule's bound counts."""
    return _run(scenes, states, schedule)[1]


def differentiable_samples(scene: Scene, state: State, schedule: Schedule) -> Flow:
    """What one lane comes to at each sample (leading axis); NaN, and so its derivatives, once it has stopped."""
    known = jax.custom_jvp(lambda scene, state: _first(_run(alone(scene), alone(state), schedule)[0]))
    known.defjvp(lambda primals, tangents: pushed(primals, perturbed(tangents), schedule), symbolic_zeros=True)
    return known(scene, state)


def perturbed(tangents: Tree) -> Tree:
    """Tangents with None for those that are known to be zero."""
    zero = lambda a: isinstance(a, SymbolicZero)  # noqa: E731
    return jax.tree.map(lambda a: None if zero(a) else a, tangents, is_leaf=zero)


def pushed(primals: tuple[Scene, State], tangents: Any, schedule: Schedule) -> tuple[Flow, Flow]:
    """The samples of one lane, and what `perturbed` tangents of scene and state lead to."""
    leaves, tree = jax.tree.flatten(first_order_only(primals))
    moving = [a is not None for a in tree.flatten_up_to(tangents)]
    along = jnp.concatenate([jnp.ravel(a) for a in jax.tree.leaves(tangents)])
    lanes = jax.tree.map(lambda a: jnp.broadcast_to(a, (len(along), *jnp.shape(a))), tree.unflatten(leaves))
    units = tree.unflatten(_units(leaves, moving, len(along)))
    flows, _ = _run(*(Dual(*pair) for pair in zip(lanes, units, strict=True)), schedule=schedule)
    flow, slopes = _first(flows.value), _where_ok(flows.value.status[0], flows.tangent)
    slope = lambda a, by: None if by is None else jnp.tensordot(along, by, 1)  # noqa: E731
    return flow, no_tangents(flow, jax.tree.map(slope, flow, slopes))


def no_tangents(values: Tree, tangents: Tree) -> Tree:
    """Tangents as JAX wants them of integers, for which they are None."""
    return jax.tree.map(lambda a, by: np.zeros(a.shape, jax.dtypes.float0) if by is None else by, values, tangents)


def _first(flow: Flow) -> Flow:
    """The first of the lanes, with NaN where it had stopped."""
    return _where_ok(flow.status[0], jax.tree.map(lambda a: a[0], flow))


def _where_ok(status: Int[Array, " samples"], tree: Tree) -> Tree:
    """Numbers (..., samples), NaN where the status is not OK."""
    real = lambda a: jnp.issubdtype(a.dtype, jnp.floating)  # noqa: E731
    return jax.tree.map(lambda a: jnp.where(status == Status.OK, a, jnp.nan) if real(a) else a, tree)


def _units(leaves: list[Any], moving: list[bool], count: int) -> list[Any]:
    """For each leaf its part of `count` unit directions (leading axis), which go through those that move."""
    units, done = [], 0
    for leaf, moves in zip(leaves, moving, strict=True):
        if not jnp.issubdtype(jnp.result_type(leaf), jnp.floating):
            units.append(None)
            continue
        unit = np.zeros((count, jnp.size(leaf)), jnp.result_type(leaf))
        if moves:
            unit[done : done + jnp.size(leaf)] = np.eye(jnp.size(leaf))
            done += jnp.size(leaf)
        units.append(jnp.asarray(unit.reshape(count, *jnp.shape(leaf))))
    return units


_run_plain = jax.jit(_marched, static_argnames="schedule")
_run_large = jax.jit(_marched, static_argnames="schedule", compiler_options=FOR_SERIES)
