"""Running a list of scenes side by side, for the tests of the march."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxshroud.scene.other_parts
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan, Runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import REFERENCE, Choices
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.march.tableau import tableau
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import AT_REST, Motion
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud
from jaxshroud.scene.valid import in_precision

# Every method that claims to be of its tableau's order, and steps per period from which on it is.
EXACT = {f"{name}-{how}": Choices(tableau(name), how) for name in TABLEAUS for how in ("bisection", "cubic")}
STEPS = {"rk4": 1000, "tsit5": 300, "dopri8": 75}


def run(scenes: list[Scene], periods: int, steps: int, method: Choices = REFERENCE) -> Runs:
    """Runs of alike-structured scenes from their initial motions, all periods kept."""
    batch = jax.tree.map(lambda *a: jnp.stack(a), *scenes)
    batch = in_precision(batch, method.precision)
    return run_lanes(batch, initial_states(batch), Plan(0, periods, steps, 0.0, method), lambda _: None)


def ends(runs: Runs) -> np.ndarray:
    """Final motions (lanes, 12): x, y, theta and their rates, left blade before right."""
    return np.concatenate([a[:, -1] for a in runs.samples.motion], axis=-1)


def sizes(runs: Runs) -> np.ndarray:
    """Largest value of each quantity over both blades and all period ends, (lanes, 12)."""
    largest = [np.abs(a).max(axis=(1, 2)) for a in runs.samples.motion]
    return np.repeat(np.stack(largest, axis=-1), 2, axis=-1)


def relative_error(got: np.ndarray, exact: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Largest error of each lane, relative to the size of the quantity."""
    return np.max(np.abs(got - exact) / size, axis=-1)


def counts(runs: Runs, name: str) -> np.ndarray:
    """Events of one kind, (lanes,)."""
    return getattr(runs.log.counters, name)[:, 0]


def energy_residual(runs: Runs) -> np.ndarray:
    """Summed energy residual over the drive's summed work, (lanes,)."""
    return runs.samples.residual.sum(axis=-1) / runs.samples.work.sum(axis=-1)


def scene_of(p) -> Scene:
    """The scene of a reference `Parameters`."""
    blades = Blades(p.m, p.I, p.k_x, p.k_y, p.k_T, p.c_x, p.c_y, p.c_T, p.m_y)
    shroud = Shroud(p.alpha, p.l_oa, p.l_ab, p.gap)
    drive = Drive(p.omega, p.beta, p.F_0, p.M_0, p.phase)
    initial = Motion(*(p.initial[i : i + 2] for i in range(0, 12, 2))) if any(p.initial) else AT_REST
    return Scene(blades, shroud, Contact(p.k, None, p.reading), Friction(p.k_d, p.mu), drive, initial)


def with_parts(scene: Scene, width: float | None = None, **parts) -> Scene:
    """A scene whose model is made of other parts."""
    return jaxshroud.scene.other_parts.with_parts(scene, Parts(**parts), width)
