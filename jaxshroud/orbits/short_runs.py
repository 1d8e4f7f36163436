"""Short runs of scenes from their own starts, by which methods are compared: final states, errors, slopes and costs."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.periods import Sample
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes, trajectories
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.states import initial_states, motion_rows
from jaxshroud.batch.tangents import direction, run_flow, without_direction
from jaxshroud.march.method import Choices
from jaxshroud.model.linear import free_rms_displacement
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision

HORIZON = 3  # periods after which states are compared: chaos has hardly multiplied errors yet


class ShortRuns(NamedTuple):
    """The runs of lanes by some method."""

    samples: Sample  # (lanes, periods)
    status: np.ndarray  # (lanes,)
    steps: int  # per period, on average


def run_from_start(scenes: Scene, periods: int, steps: int, method: Choices) -> ShortRuns:
    """March lanes (leading axis) from the initial states of their scenes."""
    scenes = in_precision(scenes, method.precision)
    runs = run_lanes(scenes, initial_states(scenes), Plan(0, periods, steps, 0.0, method), lambda _: None)
    return ShortRuns(runs.samples, np.asarray(runs.last.status), steps)


def gap_slopes(scenes: Scene, steps: int, method: Choices) -> np.ndarray | None:
    """The derivative of each lane's power over the horizon with respect to the gap; None if the method has none."""
    if method.locate == "none" or method.precision == "float32":
        return None
    dual = Dual(without_given(scenes), direction(scenes, "shroud.gap"))
    flow = run_flow(dual, without_direction(initial_states(scenes)), HORIZON, steps, as_differentiable(method))
    return flow.tangent.power[:, 0]


def softened(scenes: Scene, width: float) -> Scene:
    """Scenes (leading axis) with smooth contact, `width` in units of their `free_rms_displacement`; 0: unchanged."""
    return jax.vmap(lambda scene: _soft(scene, width))(scenes) if width else scenes


def _soft(scene: Scene, width: float) -> Scene:
    return with_parts(scene, scene.parts._replace(contact="smooth"), width * free_rms_displacement(scene))


def end_states(
    scenes: Scene, steps: int, method: Choices, *, ledger: bool = False, vibration: bool = False
) -> np.ndarray:
    """The motions (lanes, 12) at the horizon from the scenes' own starts; NaN where a lane has stopped.

    `ledger` and `vibration` are those of the programs that march them.
    """
    scenes, method = in_precision(scenes, method.precision), method._replace(ledger=ledger, vibration=vibration)
    runs = run_lanes(scenes, initial_states(scenes), Plan(HORIZON - 1, 1, steps, 0.0, method), lambda _: None)
    return motions_at(runs.samples, 0)


def trajectory_ends(scenes: Scene, steps: int, method: Choices) -> np.ndarray:
    """The same by the compiled programs of `trajectories`, with a ledger."""
    scenes, method = in_precision(scenes, method.precision), method._replace(ledger=True)
    grid = SampleGrid(0.0, steps, steps, HORIZON * steps)
    samples = trajectories(scenes, initial_states(scenes), grid, method, lambda _: None).samples
    return np.concatenate(samples["motion"], axis=-1)[:, -1].astype(float)


def motions_at(samples: Sample, period: int) -> np.ndarray:
    """The motions (lanes, 12) at the end of a kept period."""
    return motion_rows(samples.motion)[:, period].astype(float)


def state_errors(computed: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The error of each state, (lanes,): that of positions or of rates, whichever is larger, each over its maximum."""
    error, size = (np.abs(a).reshape(len(a), 2, -1).max(axis=2) for a in (computed - exact, exact))
    return (error / size).max(axis=1)
