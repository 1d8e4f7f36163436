"""The protocol of a march, by which lanes of a layout go through drive periods."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.batch.blocks import PeriodKernels
from jaxshroud.batch.flows import FlowPrograms
from jaxshroud.batch.operation_count import TrialSize
from jaxshroud.batch.periods import Sample
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.pure_march import PureMarch
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stretches import EnergyBalance, SampledLanes, Trajectories
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import Stepper
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import State
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


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
    """Samples at instants with all that is told of them; see `trajectories.trajectories`."""
    sampled: Callable[[Scene, State, SampleGrid, Choices, Tick], SampledLanes]
    """The samples at instants of one chunk of lanes, step by step."""
    motions: Callable[[Scene, State, SampleGrid, Choices, Tick], Motion]
    """The motion of these alone, which takes fewer compiled programs."""
    balance: Callable[[Any, np.ndarray], EnergyBalance | None]
    """(tally, gained energies [J]) -> the energy balance of lanes; None without a ledger."""
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
