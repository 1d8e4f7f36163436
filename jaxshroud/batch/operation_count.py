"""The number of operations in one trial step of a lane, counted in its program."""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.batch.lanes import initial_states, lane_models, lanes_at_start
from jaxshroud.batch.xla import one_lane, vmapped
from jaxshroud.cache.programs import kept
from jaxshroud.march.carry import Fixed, Lane, time_grid
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
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


def size_of_trial(scene: Scene, method: Choices) -> TrialSize:
    """The size of a trial step of a lane, which is not executed."""
    return TrialSize._make(map(int, _size_of_trial(scene, method)))


@kept("method")  # the sizes are constants of programs: those of a kept one are read, not counted
def _size_of_trial(scene: Scene, method: Choices) -> TrialSize:
    lanes, fixed = _shapes_of_trial(scene, method)
    traced = jax.make_jaxpr(lambda lanes, fixed: stepper_for(method).trial(lanes, fixed, method, vmapped))(lanes, fixed)
    return TrialSize(sum(a.size for a in jax.tree.leaves(lanes)), sum(_counted(traced.jaxpr)))


def lowered_operations(scene: Scene, method: Choices) -> float:
    """The number of operations from XLA's own cost analysis: a check."""
    trial = jax.jit(lambda lanes, fixed: stepper_for(method).trial(lanes, fixed, method, vmapped))
    lowered = trial.lower(*_shapes_of_trial(scene, method))
    analysis: Any = lowered.cost_analysis()
    return float(analysis["flops"] + analysis.get("transcendentals", 0.0))


def _counted(jaxpr: Any) -> Iterator[int]:
    """For each operation whose result is used, the number of elements and of passes of a loop."""
    needed = {id(v) for v in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if not any(id(v) in needed for v in eqn.outvars):
            continue
        needed |= {id(v) for v in eqn.invars}
        inner = [getattr(v, "jaxpr", v) for v in eqn.params.values() if hasattr(getattr(v, "jaxpr", v), "eqns")]
        for part in inner:
            yield from (eqn.params.get("length", 1) * n for n in _counted(part))
        if not inner and eqn.primitive.name not in NO_OPERATION:
            yield _elements(eqn)


def _elements(eqn: Any) -> int:
    """The number of elements on which an operation works; 0 where it only moves them."""
    if eqn.primitive.name in MOVES:
        return 0
    return max(getattr(v.aval, "size", 1) for v in (*eqn.invars, *eqn.outvars))


def _shapes_of_trial(scene: Scene, method: Choices) -> tuple[Any, Any]:
    """The shapes of the arguments of a trial step: a lane, and its constants."""
    return jax.eval_shape(partial(_first_trial, method=method), scene)


def _first_trial(scene: Scene, method: Choices) -> tuple[Lane, Fixed]:
    """The arguments of the first trial step, lanes last."""
    scenes = one_lane(scene)
    model, period = lane_models(scenes)
    lanes = lanes_at_start(initial_states(scenes), model, method, vmapped)
    stop = jnp.ones((1,), jnp.int32)
    return lanes, Fixed(model, time_grid(jnp.zeros_like(period), stop.astype(period.dtype), period), stop)
