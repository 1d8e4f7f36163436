"""The number of operations in one trial step of a lane, counted in its program."""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.batch.periods import begin_lanes
from jaxshroud.batch.rows import row_models, rows_at_start
from jaxshroud.batch.states import initial_states
from jaxshroud.batch.xla import one_lane, vmapped
from jaxshroud.cache.programs import kept
from jaxshroud.march.carry import Fixed, Lane, time_grid
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import row_trial
from jaxshroud.march.stepper import stepper_for
from jaxshroud.model.prepared import initial_state, prepared_model
from jaxshroud.scene.scene import Scene

# Primitives that only serve types and transformations, which no machine executes.
NO_OPERATION = {
    "stop_gradient",
    "convert_element_type",
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "optimization_barrier",
}
# Primitives that only move numbers between blades and interfaces.
MOVES = {"slice", "concatenate", "dynamic_slice", "dynamic_update_slice", "gather", "scatter", "iota", "pad", "copy"}


class TrialSize(NamedTuple):
    """The size of one trial step of one lane; of a row, of all its blades and interfaces together."""

    numbers: int  # that a lane carries through the march
    operations: int  # arithmetic, comparisons and selections, as XLA receives them


def size_of_pair_trial(scene: Scene, method: Choices) -> TrialSize:
    """The size of a trial step of a pair, which is not executed."""
    return TrialSize._make(map(int, _size_of_pair_trial(scene, method)))


def size_of_row_trial(scene: Scene, method: Choices) -> TrialSize:
    """The size of a trial step of a row, which is not executed."""
    return TrialSize._make(map(int, _size_of_row_trial(scene, method)))


# The sizes are constants of programs: those of a kept one are read, not counted.


@kept("method")
def _size_of_pair_trial(scene: Scene, method: Choices) -> TrialSize:
    lanes, fixed = _shapes_of_trial(scene, method)
    traced = jax.make_jaxpr(lambda lanes, fixed: stepper_for(method).trial(lanes, fixed, method, vmapped))(lanes, fixed)
    return TrialSize(len(jax.tree.leaves(lanes)), sum(_counted(traced.jaxpr)))


@kept("method")
def _size_of_row_trial(scene: Scene, method: Choices) -> TrialSize:
    lanes, fixed = jax.eval_shape(partial(_first_row_trial, method=method), scene)
    traced = jax.make_jaxpr(lambda lanes, fixed: row_trial(lanes, fixed, method, vmapped))(lanes, fixed)
    return TrialSize(sum(a.size for a in jax.tree.leaves(lanes)), sum(_counted(traced.jaxpr, of_elements=True)))


def lowered_operations(scene: Scene, method: Choices) -> float:
    """The number of operations from XLA's own cost analysis: a check."""
    trial = jax.jit(lambda lanes, fixed: stepper_for(method).trial(lanes, fixed, method, vmapped))
    lowered = trial.lower(*_shapes_of_trial(scene, method))
    analysis: Any = lowered.cost_analysis()
    return float(analysis["flops"] + analysis.get("transcendentals", 0.0))


def _counted(jaxpr: Any, of_elements: bool = False) -> Iterator[int]:
    """One for each operation whose result is used, or for each element and each pass of a loop."""
    needed = {id(v) for v in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if not any(id(v) in needed for v in eqn.outvars):
            continue
        needed |= {id(v) for v in eqn.invars}
        inner = [getattr(v, "jaxpr", v) for v in eqn.params.values() if hasattr(getattr(v, "jaxpr", v), "eqns")]
        passes = eqn.params.get("length", 1) if of_elements else 1
        for part in inner:
            yield from (passes * n for n in _counted(part, of_elements))
        if not inner and eqn.primitive.name not in NO_OPERATION:
            yield _elements(eqn) if of_elements else 1


def _elements(eqn: Any) -> int:
    """The number of elements on which an operation works; 0 where it only moves them."""
    if eqn.primitive.name in MOVES:
        return 0
    return max(getattr(v.aval, "size", 1) for v in (*eqn.invars, *eqn.outvars))


def _shapes_of_trial(scene: Scene, method: Choices) -> tuple[Any, Any]:
    """The shapes of the arguments of a trial step."""
    return jax.eval_shape(partial(_first_trial, method=method), scene)


def _first_trial(scene: Scene, method: Choices) -> tuple[Lane, Fixed]:
    """The arguments of the first trial step: the lane at its start (leading axis of one), and its constants."""
    scenes, states, period = one_lane((scene, initial_state(scene.initial, scene.points), scene.drive.period))
    stop = jnp.ones((1,), jnp.int32)
    steps = time_grid(jnp.zeros_like(period), stop.astype(period.dtype), period)
    return begin_lanes(scenes, states, method), Fixed(jax.vmap(prepared_model)(scenes), steps, stop)


def _first_row_trial(scene: Scene, method: Choices) -> tuple[Lane, Fixed]:
    """The same of a row, with the leading axis of lanes last."""
    scenes = one_lane(scene)
    models, period = row_models(scenes)
    lanes, stop = rows_at_start(initial_states(scenes), models, method, vmapped), jnp.ones((1,), jnp.int32)
    return lanes, Fixed(models, time_grid(jnp.zeros_like(period), stop.astype(period.dtype), period), stop)
