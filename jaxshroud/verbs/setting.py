"""One way to march, as data, and how far it errs over a short horizon."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.batch.states import rows
from jaxshroud.batch.tangents import Dual, differentiable, direction, resting, run_flow
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest
from jaxshroud.march.tableau import LEAST_STEPS, tableau
from jaxshroud.march.taylor import TOLERANCES, Taylor
from jaxshroud.march.words import Locate
from jaxshroud.model.absent import Scalar
from jaxshroud.model.linear import area, free_power
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene, with_parts

HORIZON = 3  # periods over which states are compared: chaos has not grown errors much yet
SHORT = 16  # periods that no way is too slow for
LEVELS = tuple(10.0**-n for n in range(2, 11))


class Ran(NamedTuple):
    """What came of lanes marched in some way."""

    samples: Sample  # (lanes, periods)
    status: np.ndarray  # (lanes,)
    steps: int  # per period, on average


class Setting(NamedTuple):
    """One way to march: static choices of the one engine, and the steps; those of power series only count time."""

    tableau: str
    locate: Locate
    precision: str
    product: float  # omega_max h
    width: float = 0.0  # of smooth contact in the spring's place, over `free_size`; 0: the contact of the scene
    order: int = 0  # of power series
    tolerance: float = 0.0  # of these

    @property
    def method(self) -> Choices:
        """The choices but the step."""
        how = Taylor(self.order, self.tolerance) if self.order else tableau(self.tableau)
        return Choices(how, self.locate, False, self.precision)  # type: ignore[arg-type]

    def finer(self, n: int) -> "Setting":
        """With the step halved `n` times, and a tolerance that has as many more digits, if that is a tolerance."""
        tolerance = max(self.tolerance / 10**n, TOLERANCES[0]) if self.order else 0.0
        return self._replace(product=self.product / 2**n, tolerance=tolerance)

    @property
    def exact(self) -> "Setting":
        """The same by the best locator, in float64."""
        return self._replace(locate="series" if self.order else "cubic", precision="float64")

    @property
    def kind(self) -> str:
        """The choices that are no numbers, in words."""
        located = {"cubic": "", "bisection": ", bisection", "none": ", not located", "series": ""}[self.locate]
        single = ", float32" if self.precision == "float32" else ""
        return f"{self.tableau}{single}{located}{', smooth' if self.width else ''}"

    def steps(self, omega_max: float, period: float) -> int:
        """Steps per period for a scene of that largest frequency."""
        return max(int(np.ceil(omega_max * period / self.product)), LEAST_STEPS)

    def run(self, scenes: Scene, periods: int) -> Ran:
        """March lanes (leading axis) from their starts."""
        scenes = softened(scenes, self.width)
        steps = self.steps(*stiffest(scenes, 1))
        scenes = in_precision(scenes, self.method.precision)
        runs = run_lanes(scenes, starts(scenes), Plan(0, periods, steps, 0.0, self.method), lambda _: None)
        return Ran(runs.samples, np.asarray(runs.last.status), steps)

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """Derivative of each lane's power over the horizon with respect to the gap; None where there is none."""
        if self.locate == "none" or self.precision == "float32":
            return None
        scenes = softened(scenes, self.width)
        steps, along = self.steps(*stiffest(scenes, 1)), direction(scenes, "shroud.gap")
        flow = run_flow(Dual(scenes, along), resting(starts(scenes)), HORIZON, steps, differentiable(self.method))
        return np.asarray(flow.tangent.power[0])

    def __str__(self) -> str:
        if self.order:
            return f"{self.kind}, order {self.order} to {self.tolerance:.0e}"
        width = f", width {self.width:.3g}" if self.width else ""
        return f"{self.kind}{width}, {self.product:.3g}"


def by_series(order: int, tolerance: float, product: float = 1.0) -> Setting:
    """A march by power series; the steps are those that events and flat contact are counted by."""
    return Setting("taylor", "series", "float64", product, order=order, tolerance=tolerance)


def softened(scenes: Scene, width: float) -> Scene:
    """Scenes (leading axis) with smooth contact of so many times their free motion's size; 0: as they are."""
    return jax.vmap(lambda scene: _soft(scene, width))(scenes) if width else scenes


def _soft(scene: Scene, width: float) -> Scene:
    return with_parts(scene, scene.parts._replace(contact="smooth"), width * free_size(scene))


def free_size(scene: Scene) -> Scalar:
    """Root mean square displacement of the left block were there no contact [m]."""
    return jnp.sqrt(free_power(scene)[0] / area(scene.shroud))


def end_states(scenes: Scene, steps: int, method: Choices) -> np.ndarray:
    """Motions (lanes, 12) at the horizon from the scenes' starts; NaN where a lane has stopped."""
    scenes = in_precision(scenes, method.precision)
    runs = run_lanes(scenes, starts(scenes), Plan(HORIZON - 1, 1, steps, 0.0, method), lambda _: None)
    return states(runs.samples, 0)


def states(samples: Sample, period: int) -> np.ndarray:
    """Motions (lanes, 12) at the end of a kept period."""
    return rows(samples.motion)[:, period].astype(float)


def state_errors(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Largest error of each state over its largest number, (lanes,)."""
    return np.abs(got - exact).max(axis=1) / np.abs(exact).max(axis=1)
