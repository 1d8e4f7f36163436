"""The compiled functions by which lanes of a layout are marched over periods, and what leaves them, with axes.

Inside, a pair is two flat arrays of lanes, and a row has its lanes last. Outside, numbers of blades have an axis
`blades`, numbers of contact an axis `interfaces`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.periods import Sample, begin_lanes, run_block
from jaxshroud.batch.rows import begin_rows, row_sample, run_row_block
from jaxshroud.batch.states import by_blade, by_blade_or_interface, by_interface
from jaxshroud.march.tally import Counters
from jaxshroud.model.arithmetic import filled
from jaxshroud.scene.layout import PAIR, Layout


class MarchPrograms(NamedTuple):
    """The functions of a march."""

    begin: Callable[..., Any]  # (scenes, states, method) -> lanes
    block: Callable[..., Any]  # see `run_block`
    sample: Callable[[Any], Sample]  # a sample of these with axes of blades and interfaces


def pair_sample(sample: Sample) -> Sample:
    """Samples of pairs with axes of blades and interfaces."""
    contact = ("friction", "switched", "forces", "loads", "impacts", "times")
    along = {name: by_interface(getattr(sample, name)) for name in contact}
    means = by_interface(sample.means)  # of the left block alone
    return by_blade(sample._replace(**along, means=means, own=by_blade_or_interface(sample.own)))


PAIR_MARCHES = MarchPrograms(begin_lanes, run_block, pair_sample)
ROW_MARCHES = MarchPrograms(begin_rows, run_row_block, row_sample)


def march_programs(layout: Layout) -> MarchPrograms:
    """The functions that march lanes of a layout."""
    return PAIR_MARCHES if layout == PAIR else ROW_MARCHES


class RunLog(NamedTuple):
    """What lanes (leading axis) have logged so far."""

    v_max: np.ndarray  # largest penetration at each interface [m], (lanes, interfaces), as all that follows
    counters: Counters
    within: Any  # `StepExtrema`; None unless they were requested


def run_log(lanes: Any) -> RunLog:
    """The log of lanes of pairs or of rows (leading axis), which counts no events that cannot happen."""
    log, count = lanes.tally.log, len(lanes.status)
    counters = filled(log.counters, np.zeros(np.shape(log.v_max), np.int32))
    kept = log.v_max, counters, log.within
    return RunLog(*jax.tree.map(lambda a: np.reshape(a, (count, -1)), kept))
