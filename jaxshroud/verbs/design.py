"""What is to be tuned, and what simulations say of designs."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Literal, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Tick, run_lanes, starts
from jaxshroud.batch.states import as_precise
from jaxshroud.batch.xla import repeated
from jaxshroud.march.method import FAST
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import averages
from jaxshroud.motion.gradient import with_numbers
from jaxshroud.results.tuned import PENALTY, Judged
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of
from jaxshroud.verbs.scattering import Scattering, check_ends, check_told_apart, cube_corners

Goal = Literal["mean", "worst"]


class Problem(NamedTuple):
    """What is to be tuned."""

    scene: Scene
    over: dict[str, tuple[float, float]]  # key -> bounds
    conditions: dict[str, tuple[float, ...]]  # key -> values; every combination counts
    goal: Goal = "mean"
    most_penetration: float = np.inf  # [m]
    most_force: float = np.inf  # normal force of the contact [N]
    plan: Plan = Plan(0, 1, 400, 0.0, FAST)
    state: State | None = None  # where every run starts; None: from its scene's own initial motion
    scattering: Scattering | None = None  # what scatters about a design; every draw counts like a condition

    @property
    def keys(self) -> tuple[str, ...]:
        """Numbers that a run may have its own of: tuned, conditions, and those that only scatter."""
        return (*self.over, *self.conditions, *(self.scattering.others if self.scattering else ()))

    @property
    def runs(self) -> int:
        """Runs of each design: in every condition, at every draw; the draws of a condition follow each other."""
        return len(self.rows) * (self.scattering.size if self.scattering else 1)

    @property
    def stretch(self) -> np.ndarray:
        """Derivatives of each run's tuned numbers by those of its design, (runs, tuned keys)."""
        if self.scattering is None:
            return np.ones((self.runs, len(self.over)))
        return np.tile(self.scattering.stretch(self.keys)[:, : len(self.over)], (len(self.rows), 1))

    @property
    def rows(self) -> np.ndarray:
        """All combinations of the conditions' values, (conditions, keys)."""
        return np.array(list(product(*self.conditions.values())))

    def values(self, u: np.ndarray) -> np.ndarray:
        """Designs (n, keys) from points of the unit cube: logarithmic between positive bounds, else linear."""
        low, high = np.array(list(self.over.values())).T
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = low * (high / low) ** u
        return np.where(low > 0, scaled, low + (high - low) * u)

    def cube(self, designs: np.ndarray) -> np.ndarray:
        """Points of the unit cube from designs: the inverse of `values`."""
        low, high = np.array(list(self.over.values())).T
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = np.log(designs / low) / np.log(high / low)
        return np.where(low > 0, scaled, (designs - low) / (high - low))

    def rates(self, u: np.ndarray) -> np.ndarray:
        """Derivatives of `values`."""
        low, high = np.array(list(self.over.values())).T
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = self.values(u) * np.log(high / low)
        return np.where(low > 0, scaled, high - low)


def problem_of(
    scene: Scene,
    over: Mapping[str, tuple[float, float]],
    conditions: Mapping[str, Sequence[float]],
    scattering: Scattering | None = None,
) -> Problem:
    """What is to be tuned, without limits; see `tune`.

    Raises:
        KeyError: The scene has no such number.
        ValueError: Bounds are not in order, a key is both tuned and a condition, or a number scatters out of its range.
    """
    check_bounds(over)
    both = set(over) & set(conditions)
    if both:
        raise InputError(f"{sorted(both)[0]} is both tuned and an operating condition.")
    known = {key: tuple(float(v) for v in np.ravel(values)) for key, values in conditions.items()}
    ends = 0 if scattering is None else min(len(scattering.keys), 4)
    fits(math.prod(map(len, known.values())) << (min(len(over), 8) + ends), 0, 1)  # the corners are looked at first
    if scattering is None:
        return Problem(with_numbers(scene, [*over, *known]), dict(over), known)
    check_told_apart(scattering, [*over, *known])
    others = [key for key in scattering.keys if key not in over and key not in known]
    whole = with_numbers(scene, [*over, *known, *others])
    scattering = scattering._replace(others={key: value_of(whole, key) for key in others})
    problem = Problem(whole, dict(over), known, scattering=scattering)
    _check_scatter(problem)
    return problem


def _check_scatter(problem: Problem) -> None:
    """Raise an InputError where a number does not scatter, or out of its range, between the bounds of all that is."""
    scattering = problem.scattering
    assert scattering is not None
    for key, relative in zip(scattering.keys, scattering.relative, strict=True):
        if relative and scattering.others.get(key) == 0:
            raise InputError(f"{key} is 0, of which no share scatters; give its tolerance.")
    extreme = problem._replace(scattering=scattering.at_ends())
    ends = numbers_of(extreme, problem.values(cube_corners(len(problem.over))))
    check_ends(scattering.keys, ends[:, [problem.keys.index(key) for key in scattering.keys]])


def check_bounds(over: Mapping[str, tuple[float, float]]) -> None:
    """Raise InputError unless there is a number, and the bounds of each are finite and in order."""
    if not over:
        raise InputError("Argument `over` must name at least one number.")
    for key, (low, high) in over.items():
        if not -np.inf < low < high < np.inf:
            raise InputError(f"The bounds of {key} must be finite and in order, but are {low} and {high}.")


def numbers_of(problem: Problem, designs: np.ndarray) -> np.ndarray:
    """The numbers that each run of each design has its own of, (designs * runs, keys)."""
    rows, scattering = problem.rows, problem.scattering
    values = np.concatenate([np.repeat(designs, len(rows), axis=0), np.tile(rows, (len(designs), 1))], axis=1)
    if scattering is None:
        return values
    others = np.tile(list(scattering.others.values()), (len(values), 1))
    return scattering.of(problem.keys, np.concatenate([values, others], axis=1))


def scenes_of(problem: Problem, designs: np.ndarray) -> Scene:
    """Scenes of every design in every condition, at every draw, (designs * runs,)."""
    return scenes_at(problem.scene, problem.keys, numbers_of(problem, designs))


def corners(problem: Problem) -> Scene:
    """The extreme scenes of a problem: every combination of bounds, or bounds one by one where these are many."""
    if problem.scattering is not None:
        problem = problem._replace(scattering=problem.scattering.at_ends())
    return scenes_of(problem, problem.values(cube_corners(len(problem.over))))


def begun(problem: Problem, scenes: Scene) -> State:
    """Where scenes (leading axis) of a problem start."""
    if problem.state is None:
        return starts(scenes)
    return repeated(as_precise(problem.state, scenes), len(scenes.drive.omega))


def judge_designs(problem: Problem, designs: np.ndarray, tick: Tick) -> Judged:
    """Simulate designs (n, keys) in every condition, at every draw."""
    scenes = in_precision(scenes_of(problem, designs), problem.plan.method.precision)
    runs = run_lanes(scenes, begun(problem, scenes), problem.plan, tick)
    with np.errstate(invalid="ignore", over="ignore"):  # of a design that is far out
        motion, got, _ = averages(scenes, runs.samples)
    shape = len(designs), problem.runs
    log = runs.last.tally.log
    v_max = np.asarray((log if log.within is None else log.within).v_max, float)
    ok = np.asarray(runs.last.status) == Status.OK
    P_d = np.where(ok & np.isfinite(got.P_d), got.P_d, -np.inf).reshape(shape)
    objective = P_d.mean(axis=1) if problem.goal == "mean" else P_d.min(axis=1)
    with np.errstate(invalid="ignore", over="ignore"):  # what stopped has no penetration
        N_max = np.asarray(_stiffnesses(scenes), float) * v_max
        v, force = (a.reshape(shape).max(axis=1) for a in (v_max, N_max))
        beyond = np.maximum(v / problem.most_penetration - 1, 0) + np.maximum(force / problem.most_force - 1, 0)
    score = np.where(np.isfinite(objective), objective - PENALTY * beyond, -np.inf)
    return Judged(score, objective, P_d, got.ci.reshape(shape), v, force, motion.number.reshape(shape))


@jax.jit
def _stiffnesses(scenes: Scene):
    return jax.vmap(lambda scene: scene.k)(scenes)
