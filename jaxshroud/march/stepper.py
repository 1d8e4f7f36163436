"""The ways to march behind one protocol: pure functions, of which `batch` makes marches of many lanes."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxshroud.march.carry import EachLane, Fixed, Lane, LaneTree
from jaxshroud.march.method import Choices
from jaxshroud.march.rk_trial import begin_rk, rk_trials, update_after_rk
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.march.taylor_trial import (
    begin_taylor,
    motion_in_trial,
    taylor_trials,
    trial_and_series,
    update_after_taylor,
)
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import Model, State
from jaxshroud.scene.keys import Motion

StageGroups = tuple[int, ...]  # numbers of stages after which a long trial is split into kernels


class DenseOutput(NamedTuple):
    """The motion inside the trials, where the stepper knows it."""

    trial: Callable[
        [Lane, Fixed[Model], Choices], tuple[Any, Any]
    ]  # of one lane: its next trial, and the interpolant there
    motion: Callable[[Any, Scalar, Scalar, Scalar], Motion]  # (interpolant, period [s], steps per period, steps)


class Stepper(NamedTuple):
    """One way to march: how a lane begins, tries a step, and is updated by the outcome.

    A trial integrates Eq. (1) in the lane's mode and case, over the rest of the step or less. The update accepts it,
    ends it at an event, with the transition there, or rejects it, and sets the next trial. Trees of lanes, constants
    and trials have a leading lane axis (and may carry tangents); `each(f, *trees)` applies a function of one lane to
    all lanes as one kernel. With `alone` as `each`, trial and update are functions of one lane. The properties of a
    method are those of its `Tableau` or `TaylorOptions`: name, work, amplification and finer variant.

    Hard-wired to two blades with one interface:

    - `Pair`s: the motion, the drive and its wave, the power, `Mobility.share` and `joint`;
    - one mode, case and slider in `State`, one set of guards, and one event in a trial;
    - flat contact, in which both blocks turn as one, and the torques at its two ends;
    - one `Log` in a `Accumulator`, whose values are those of one interface and of pairs.
    """

    begin: Callable[[State, Model, Choices], Lane]
    """A lane at step 0 from a state as pairs. Its first trial checks every guard: a start in overlap is an onset."""
    trial: Callable[[LaneTree, LaneTree, Choices, EachLane, StageGroups], LaneTree]
    """(lanes, constants, method, each, groups) -> the trials of all lanes."""
    update: Callable[[LaneTree, LaneTree, LaneTree, Choices, EachLane], LaneTree]
    """(lanes, trials, constants, method, each) -> the lanes afterwards; unchanged if they have arrived or failed."""
    dense_output: DenseOutput | None
    """None: the motion is known where trials end, and every step ends a trial."""
    knows: Callable[[type[ContactLaw]], bool]
    """Whether it can march a law of contact of that kind."""
    large_kernels: bool
    """Each half of a trial is one kernel of thousands of operations, for which XLA needs its own options."""


RUNGE_KUTTA = Stepper(begin_rk, rk_trials, update_after_rk, None, lambda law: True, large_kernels=False)
POWER_SERIES = Stepper(
    begin_taylor,
    taylor_trials,
    update_after_taylor,
    DenseOutput(trial_and_series, motion_in_trial),
    lambda law: law.by_series,
    large_kernels=True,
)


def stepper_for(method: Choices) -> Stepper:
    """The stepper of a method."""
    return POWER_SERIES if isinstance(method.tableau, TaylorOptions) else RUNGE_KUTTA


def begin_lane(state: State, model: Model, method: Choices) -> Lane:
    """A lane at step 0 from a state as pairs."""
    return stepper_for(method).begin(state, model, method)


def alone(f: Callable, *args: Any) -> Any:
    """`f` of one lane: an `EachLane`."""
    return f(*args)
