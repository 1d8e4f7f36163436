"""Many lanes over many periods, by the march of their scenes."""

import numpy as np

from jaxshroud.batch.marches import march_of, require_march
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.prepared import State
from jaxshroud.scene.scene import Scene, without_given


def stepping_method(scene: Scene, method: Choices) -> Tableau | TaylorOptions | None:
    """The method that steps through a scene; None where there is a closed form.

    Raises:
        InputError: The march of the scene, or the stepper of the method, does not know its contact.
    """
    require_march(scene, method)
    return march_of(scene).stepping(method)


def run_lanes(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray | None = None) -> Runs:
    """Run all lanes (leading axis) over their periods.

    Args:
        scenes: The scenes.
        states: Their states at drive phase 0.
        plan: The plan of the run.
        ticker: Called with numbers of lane-periods as they are done.
        arrived: Which lanes start at the phase of the plan instead (lanes,); by default none.

    Raises:
        Interrupted: On Ctrl-C; `done` has the lanes that had ended, and the others with status NOT_RUN.
    """
    march, scenes = march_of(scenes), without_given(scenes)
    arrived = np.zeros(len(scenes.drive.omega), bool) if arrived is None else arrived
    return march.run(march, scenes, states, plan, ticker, arrived)
