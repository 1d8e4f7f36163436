"""The winner of a search simulated again in other ways."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import Plan
from jaxshroud.march.method import REFERENCE, Choices
from jaxshroud.march.taylor import TOLERANCES
from jaxshroud.model.state import State, start
from jaxshroud.results.tuned import Judged
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.design import Problem, judge_designs

KEEPS = 1e-3  # relative, by which a check may exceed a limit: about what the search's step errs by
SAME_START = ("half the step, reference method", "four times as long")  # checks from the scene's own start
AGREES = 0.5  # percentage points by which re-simulations may differ beyond their own intervals


def checked(problem: Problem, design: np.ndarray, seed: int) -> dict[str, Judged]:
    """The design simulated again: with half the step and the reference method, four times as long, from elsewhere.

    The reference method is bisection in float64, with the search's own tableau: no check is coarser than the search.
    Power series have a hundredth of the tolerance instead.
    """
    plan, quiet = problem.plan, lambda _: None
    reference = _finest(plan.method)._replace(precision=problem.scene.drive.omega.dtype.name, ledger=False)
    fine = Plan(plan.transient, plan.kept, 2 * plan.steps_per_period, 0.0, reference)
    long = Plan(4 * plan.transient, 4 * plan.kept, plan.steps_per_period, 0.0, plan.method)
    found = {
        SAME_START[0]: judge_designs(problem._replace(plan=fine), design[None], quiet),
        SAME_START[1]: judge_designs(problem._replace(plan=long), design[None], quiet),
    }
    random = np.random.default_rng(seed)
    for i in range(3):
        state = _pushed(problem.scene, random)
        found[f"another start, {i + 1}"] = judge_designs(problem._replace(plan=long, state=state), design[None], quiet)
    return found


def _finest(method: Choices) -> Choices:
    """The same tableau by bisection, or power series that are finer."""
    if method.taylor is None:
        return method._replace(locate=REFERENCE.locate)
    return method._replace(tableau=method.taylor._replace(tolerance=max(method.taylor.tolerance / 100, TOLERANCES[0])))


def _pushed(scene: Scene, random: np.random.Generator) -> State:
    """A starting state with displacements up to the gap, or a tenth of a millimetre, away from contact."""
    reach = max(abs(float(scene.shroud.gap)), 1e-4)
    x, y = -reach * np.sort(random.random(2))[::-1] * [1, -1], reach * (random.random(2) - 0.5)
    still = np.zeros(2)
    return start(jax.tree.map(jnp.asarray, Motion(x, y, still, still, still, still)))


def agree(found: Judged, checks: dict[str, Judged]) -> bool:
    """Whether every check comes to the same objective within the intervals, and keeps the limits."""
    width = lambda judged: float(np.sqrt(np.nanmean(judged.ci[0] ** 2))) if np.isfinite(judged.ci).any() else 0.0  # noqa: E731
    for check in checks.values():
        allowed = AGREES + width(found) + width(check)
        if not check.keeps(KEEPS)[0] or not abs(check.objective[0] - found.objective[0]) <= allowed:
            return False
    return bool(found.keeps()[0])
