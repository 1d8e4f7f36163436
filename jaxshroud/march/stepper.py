"""The ways to march behind one protocol: pure functions, of which `batch` makes marches of many lanes."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxshroud.march.carry import EachLane, Lane, LaneTree
from jaxshroud.march.method import Choices
from jaxshroud.march.row_trial import begin_runge_kutta, row_trial
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.march.taylor_trial import (
    begin_series,
    motion_in_trial,
    taylor_trials,
    trials_and_series,
    update_after_taylor,
)
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import State
from jaxshroud.model.row import RowModel


class DenseOutput(NamedTuple):
    """The motion inside the trials, where the stepper knows it."""

    trial: Callable[[LaneTree, LaneTree, Choices, EachLane], tuple[Any, Any]]
    """(lanes, constants, method, each) -> the next trials of lanes, and the interpolants there."""
    update: Callable[[LaneTree, LaneTree, LaneTree, Choices, EachLane], LaneTree]
    """(lanes, trials, constants, method, each) -> the lanes after these trials."""
    motion: Callable[[Any, RowModel, Scalar, Scalar, Scalar], Any]
    """(interpolant, model, period [s], steps per period, steps) -> the motion there."""


class Stepper(NamedTuple):
    """One way to march: how a lane begins, and how it tries a step and is updated by the outcome.

    A trial integrates Eq. (1) in the lane's mode and case, over the rest of the step or less. The update accepts it,
    ends it at an event, with the transition there, or rejects it, and sets the next trial. Trees of lanes and of
    constants have a leading lane axis; `each(f, *trees)` applies a function of one lane to all lanes as one kernel.
    The properties of a method are those of its `Tableau` or `TaylorOptions`: name, work, amplification and finer
    variant.
    """

    begin: Callable[[State, RowModel, Choices, EachLane], Lane]
    """Lanes at step 0. The first trial checks every guard: a start in overlap is an onset."""
    trial: Callable[[LaneTree, LaneTree, Choices, EachLane], LaneTree]
    """(lanes, constants, method, each) -> the lanes after a trial; unchanged if they have arrived or failed."""
    dense_output: DenseOutput | None
    """None: the motion is known where trials end, and every step ends a trial."""
    knows: Callable[[type[ContactLaw]], bool]
    """Whether it can march a law of contact of that kind."""
    large_kernels: bool
    """A trial is made by several kernels, and the compiled program serves all tolerances."""


RUNGE_KUTTA = Stepper(begin_runge_kutta, row_trial, None, lambda law: True, large_kernels=False)
POWER_SERIES = Stepper(
    begin_series,
    taylor_trials,
    DenseOutput(trials_and_series, update_after_taylor, motion_in_trial),
    lambda law: law.by_series,
    large_kernels=True,
)


def stepper_for(method: Choices) -> Stepper:
    """The stepper of a method."""
    return POWER_SERIES if isinstance(method.tableau, TaylorOptions) else RUNGE_KUTTA
