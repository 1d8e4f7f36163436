"""Whole drive periods of many lanes in one call to the device, by the kernels of their layout."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.periods import (
    CallLimits,
    Clock,
    Interim,
    begun_pairs,
    ended_pairs,
    lane_models,
    march,
    select_tree,
    whole_tree,
    with_clock_reset,
)
from jaxshroud.batch.xla import compiled
from jaxshroud.march.carry import EachLane, Fixed, PerLane, running
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.scene.scene import Scene


class PeriodKernels(NamedTuple):
    """What whole periods of a layout are made of, inside compiled programs.

    Lanes have a form of the layout there: those of pairs keep their axis first, those of rows have it last.
    """

    inward: Callable[[Any], Any]
    """(lanes, their axis first) -> lanes in the form of the layout."""
    outward: Callable[[Any], Any]
    """The inverse of `inward`, of samples too."""
    constants: Callable[[Scene], tuple[Any, PerLane]]
    """(scenes) -> the models of lanes, and their drive periods [s]."""
    march: Callable[..., Any]
    """(lanes, constants, method, each, passes=None) -> the lanes where they stop, see `march`."""
    begin: Callable[[Any, Any, Choices, EachLane], tuple[Any, PerLane]]
    """(lanes, models, method, each) -> the lanes at the start of a period, and the energies that they store [J]."""
    end: Callable[..., tuple[Any, Any]]
    """(lanes, energies, models, periods, steps, each, ended=True) -> the lanes at its end, and its samples."""


@compiled("method", "block", "each", "kernels")
def run_block(
    scenes: Scene,
    begin: Interim,
    clock: Clock,
    limits: CallLimits,
    method: Choices,
    block: int,
    each: EachLane,
    kernels: PeriodKernels,
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
        kernels: Those of the layout.

    Returns:
        The lanes at the end, how many periods have ended, and the samples of these with axes (period, lane); further
        ones are meaningless.
    """
    models, periods = kernels.constants(scenes)
    grids = clock.grids(periods)

    def one(carry, i):
        (lanes, energies, inside), passes = carry
        on = (i < limits.most) & (passes > 0)
        lanes, energies = select_tree(on & ~inside, kernels.begin(lanes, models, method, each), (lanes, energies))
        stops = jnp.where(on & (lanes.status == Status.OK), clock.steps, 0)
        lanes, passes = kernels.march(lanes, Fixed(models, grids, stops), method, each, passes=passes)
        over = on & ~jnp.any(running(lanes, stops))
        lanes = with_clock_reset(lanes, over & (lanes.step == clock.steps))
        lanes, sample = kernels.end(lanes, energies, models, periods, clock.per_period, each, ended=over)
        return (Interim(lanes, energies, (on | inside) & ~over), passes), (kernels.outward(sample), over)

    first = begin._replace(lanes=kernels.inward(begin.lanes)), limits.passes
    (end, _), (samples, over) = lax.scan(one, first, jnp.arange(block, dtype=jnp.int32))
    return end._replace(lanes=kernels.outward(end.lanes)), jnp.sum(over, dtype=jnp.int32), samples


def period_function(
    scenes: Scene, clock: Clock, method: Choices, each: EachLane, kernels: PeriodKernels
) -> Callable[..., tuple[Any, Any]]:
    """A function of lanes, in the form of their layout, and a flag.

    If the flag is set, it runs a period of the lanes that have not stopped; it returns these with their samples.
    """
    models, periods = kernels.constants(scenes)

    def run(lanes: Any, on: Any) -> tuple[Any, Any]:
        stops = jnp.where(on & (lanes.status == Status.OK), clock.steps, 0)
        lanes, energies = kernels.begin(lanes, models, method, each)
        lanes = kernels.march(lanes, Fixed(models, clock.grids(periods), stops), method, each)
        lanes = with_clock_reset(lanes, lanes.step == clock.steps)
        return kernels.end(lanes, energies, models, periods, clock.per_period, each)

    return run


PAIR_KERNELS = PeriodKernels(whole_tree, whole_tree, lane_models, march, begun_pairs, ended_pairs)
