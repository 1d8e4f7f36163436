"""The protocol of a march, by which lanes of a layout go through drive periods, inside JAX's transformations too."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.batch.blocks import PeriodKernels
from jaxshroud.batch.differentiable_samples import Schedule
from jaxshroud.batch.flows import FlowPrograms, as_differentiable
from jaxshroud.batch.operation_count import TrialSize
from jaxshroud.batch.periods import Clock, Sample
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stopped import Admitted, nan_where
from jaxshroud.batch.stretches import EnergyBalance, SampledLanes, Trajectories
from jaxshroud.march.accumulator import EventMargins
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import Stepper
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import State
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene

OfContact = Float[Array, "..."]  # of a row at each interface


class Moment(NamedTuple):
    """The argument of `save` in a rollout: one sample."""

    t: Scalar  # [s]
    state: State  # fields of `motion` (2,), of a row (blades,), as contact and forces are (interfaces,)
    N: OfContact  # normal force of contact [N]
    F: OfContact  # friction force [N]
    v: OfContact  # penetration [m]; when apart the negative remaining gap
    u: OfContact  # slide of the left block against the right one [m]


class SampledMoments(NamedTuple):
    """The samples (leading axis) of one lane."""

    moments: Moment
    power: Float[Array, "samples blades"]  # mean square displacement since the previous sample [m^2]
    status: Int[Array, " samples"]
    margins: EventMargins | None  # so far


def sample_times(begin: Admitted, schedule: Schedule) -> tuple[Float[Array, " samples"], Float[Array, " samples"]]:
    """The times [s] of samples, and the phases of the drive there [turns]."""
    index, steps = np.arange(1, schedule.samples + 1) * schedule.every, schedule.steps
    period = nan_where(~begin.good, begin.scene.drive.period)
    turns = jnp.asarray(index % steps / steps, period.dtype)
    return period * jnp.asarray(index / steps, turns.dtype), turns


class SweepPlan(NamedTuple):
    """The static arguments of a sweep."""

    transient: int
    kept: int
    steps: int
    method: Choices

    @property
    def clock(self) -> Clock:
        """The grid of whole periods from drive phase 0."""
        return Clock.from_phase_0(self.steps, self.method.flat_return)

    @property
    def schedule(self) -> Schedule:
        """The schedule of the same run with derivatives."""
        return Schedule(self.kept, self.steps, self.steps, as_differentiable(self.method), skipped=self.transient)


class LaneOutcomes(NamedTuple):
    """The results of lanes (leading axis)."""

    motion: Motion  # of each blade, (lanes, periods)
    power: tuple[Any, ...]  # mean square displacement over block and periods, (lanes,) [m^2]
    means: Any  # `Means` over the periods, of each block that counts, (lanes,)
    status: Any  # (lanes,); None of tangents


class PureMarch(NamedTuple):
    """What a march does inside JAX's transformations."""

    moments: Callable[[Admitted, Schedule], SampledMoments]
    """The samples of one lane; the method of the schedule is as the user gave it."""
    outcomes: Callable[[Scene, State, SweepPlan], LaneOutcomes]
    """The results of a chunk of lanes (leading axis)."""
    within_bounds: Callable[[Any, Scene], Scene]
    """(stopped, scenes) -> scenes without numbers out of all bounds."""
    counted: Callable[[Any], Any]
    """The sum of numbers (lanes, blades) of the blades that count."""
    free_power: Callable[[Any], Any]
    """The power without contact as a sweep gives it; None where the sweep gives none."""


class March(NamedTuple):
    """How lanes are marched: whole periods, samples at instants, tangents, and what it knows.

    Inside compiled programs a pair is two flat arrays of lanes, and a row has its lanes last. Outside, numbers of
    blades have an axis `blades`, numbers of contact an axis `interfaces`.
    """

    begin: Callable[[Scene, State, Choices], Any]
    """(scenes, states, method) -> the lanes at their start."""
    kernels: PeriodKernels
    """What its periods are made of inside compiled programs."""
    sample: Callable[[Any], Sample]
    """Samples of whole periods, with axes of blades and interfaces."""
    run: Callable[["March", Scene, State, Plan, Tick, np.ndarray], Runs]
    """The whole periods of a plan; see `runs.run_lanes`."""
    trajectories: Callable[["March", Scene, State, SampleGrid, Choices, Tick], Trajectories]
    """Samples at instants with all quantities of results; see `trajectories.trajectories`."""
    sampled: Callable[[Scene, State, SampleGrid, Choices, Tick], SampledLanes]
    """The samples at instants of one chunk of lanes, step by step."""
    motions: Callable[[Scene, State, SampleGrid, Choices, Tick], Motion]
    """The motion of these alone, which takes fewer compiled programs."""
    balance: Callable[[Any, np.ndarray], EnergyBalance | None]
    """(accumulator, gained energies [J]) -> the energy balance of lanes; None without a ledger."""
    flows: FlowPrograms
    """Whole periods with tangents, step by step."""
    pure: PureMarch
    """What it does inside JAX's transformations."""
    trial_size: Callable[[Scene, Choices], TrialSize]
    """(scene, method) -> the size of a trial step of one lane."""
    stepping: Callable[[Choices], Tableau | TaylorOptions | None]
    """The method by which it steps; None in closed form."""
    knows: Callable[[type[ContactLaw]], bool]
    """Whether it knows a law of contact of that kind."""
    steppers: tuple[Stepper, ...]
    """The steppers that it knows."""
