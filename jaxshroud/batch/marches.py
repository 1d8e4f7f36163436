"""How lanes are run, by stepping or in closed form, and which of these ways scenes take."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.closed_form import closed_form_runs, free_trajectories, settled_runs
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import stepped_runs, stepped_trajectories
from jaxshroud.batch.stretches import Trajectories
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.prepared import State, law_type
from jaxshroud.model.spring_contact import NoContact
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import COUPLED_WITHOUT_CONTACT, NO_CONTACT, PAIR, require_capability, require_steps
from jaxshroud.scene.scene import Scene


class March(NamedTuple):
    """How lanes are run. Numbers of blades have an axis `blades` in results, numbers of contact one of `interfaces`."""

    run: Callable[[Scene, State, Plan, Tick, np.ndarray], Runs]
    """The whole periods of a plan; see `runs.run_lanes`."""
    trajectories: Callable[[Scene, State, SampleGrid, Choices, Tick], Trajectories]
    """Samples at instants with all quantities of results; see `runs.trajectories`."""
    steps: bool
    """Whether it takes steps, or has a closed form."""

    def stepping(self, method: Choices) -> Tableau | TaylorOptions | None:
        """The method by which it steps; None in closed form."""
        return method.tableau if self.steps else None


STEPPED = March(stepped_runs, stepped_trajectories, steps=True)
# Blades that never touch have a closed form; where tangents or motions alone are wanted, they are marched.
WITHOUT_CONTACT = March(closed_form_runs, free_trajectories, steps=False)
# Contact that is asked to stay in one state has a closed form too, of its settled motion.
LINEAR = March(settled_runs, stepped_trajectories, steps=False)


def march_of(scenes: Scene) -> March:
    """The march of scenes, by their layout and their contact."""
    if is_linear(scenes):
        return LINEAR
    return WITHOUT_CONTACT if scenes.layout == PAIR and scenes.parts.contact == "none" else STEPPED


def require_march(scenes: Scene, method: Choices) -> None:
    """Raise InputError unless the march of scenes and the stepper of the method know their contact and each other."""
    require_steps(scenes.parts.contact)
    stepper = stepper_for(method)
    law = law_type(scenes)
    if law is NoContact:
        if scenes.is_coupled:
            raise InputError(COUPLED_WITHOUT_CONTACT)
        require_capability(NO_CONTACT, scenes.layout)
    if not stepper.knows(law):
        raise InputError(f"The method taylor knows located contact, not {law.called}; take a Runge-Kutta method.")
