"""The design problem: the numbers to tune, the conditions, and the judgement of designs by simulation."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.batch.lanes import in_scene_precision, initial_states
from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Plan, Runs, Tick
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march.method import FAST
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.results.tuned import PENALTY, DesignJudgement
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.derived_inputs import check_disjoint
from jaxshroud.scene.drive_orders import check_continuous
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.layout import Layout, require_capability
from jaxshroud.scene.quantities import Quantity, amplitude_of, check_quantity, is_reduction
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import asks_for_sector, require_sector
from jaxshroud.scene.valid import check_values, in_precision
from jaxshroud.scene.vary import value_of, with_numbers
from jaxshroud.signals.amplitudes import block_level, check_resonance, check_vibration, free_level, levels_of
from jaxshroud.signals.averages import stiffnesses
from jaxshroud.verbs.scattering import Scattering, check_ends, check_overlap, cube_corners

Goal = Literal["mean", "worst"]


class Problem(NamedTuple):
    """The numbers to tune, the conditions and the limits, and how designs are simulated."""

    scene: Scene
    over: dict[str, tuple[float, float]]  # key -> bounds
    conditions: dict[str, tuple[float, ...]]  # key -> values; every combination counts
    goal: Goal = "mean"
    most_penetration: float = np.inf  # [m]
    most_force: float = np.inf  # normal force of the contact [N]
    plan: Plan = Plan(0, 1, 400, 0.0, FAST)
    state: State | None = None  # initial state of every run; None: its scene's own
    scattering: Scattering | None = None  # scatter about a design; every draw counts like a condition
    of: Quantity = "P_d"
    free: float = np.nan  # what `of` is compared with, see `free_level`
    scale: float = 1.0  # of penalties and tolerances in percentage points: more where `of` hardly moves without contact

    def reduction(self, level: np.ndarray) -> np.ndarray:
        """What a design gains [percentage points]: P_d itself, or how far another quantity is below its free level."""
        return level if is_reduction(self.of) else 100 * (1 - np.abs(level) / self.free)

    def objective_ci(self, judgement: DesignJudgement) -> np.ndarray:
        """Half widths of the intervals of objectives (n,): of the mean of independent runs, or of the least."""
        if self.goal == "mean":
            return np.sqrt(np.sum(judgement.ci**2, axis=1)) / judgement.ci.shape[1]
        return np.take_along_axis(judgement.ci, np.argmin(judgement.P_d, axis=1)[:, None], axis=1)[:, 0]

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the numbers that vary from run to run: tuned ones, conditions, and those that only scatter."""
        return (*self.over, *self.conditions, *(self.scattering.others if self.scattering else ()))

    @property
    def runs(self) -> int:
        """The number of runs of each design: one per condition and draw, the draws varying fastest."""
        return len(self.rows) * (self.scattering.size if self.scattering else 1)

    @property
    def stretch(self) -> np.ndarray:
        """The derivatives of each run's tuned numbers with respect to those of its design, (runs, tuned keys)."""
        if self.scattering is None:
            return np.ones((self.runs, len(self.over)))
        return np.tile(self.scattering.stretch(self.keys)[:, : len(self.over)], (len(self.rows), 1))

    @property
    def rows(self) -> np.ndarray:
        """All combinations of the values of the conditions, (conditions, keys)."""
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
        """The derivatives of `values` with respect to `u`, (n, keys)."""
        low, high = np.array(list(self.over.values())).T
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = self.values(u) * np.log(high / low)
        return np.where(low > 0, scaled, high - low)


def problem_of(
    scene: Scene,
    over: Mapping[str, tuple[float, float]],
    conditions: Mapping[str, Sequence[float]],
    scattering: Scattering | None = None,
    of: Quantity = "P_d",
) -> Problem:
    """The design problem, without limits; see `tune`.

    Raises:
        KeyError: The scene has no such number.
        ValueError: Bounds are not in order, a key is both tuned and a condition, a number scatters out of its range, or
            the sector of a ring is requested and some designs have none.
    """
    check_bounds(over, scene)
    check_objective(of, scene)
    free = free_level(of, scene)
    amplitude = amplitude_of(of)
    scale = max(block_level(amplitude, scene) / free, 1.0) if amplitude is not None and free > 0 else 1.0
    compared = {"of": of, "free": free, "scale": scale}
    shared = set(over) & set(conditions)
    if shared:
        raise InputError(f"{sorted(shared)[0]} is both tuned and an operating condition.")
    check_disjoint([*over, *conditions], scene.layout)
    for key, values in conditions.items():
        check_condition(key, values, scene.layout)
    condition_values = {key: tuple(float(v) for v in np.ravel(values)) for key, values in conditions.items()}
    n_scattering = 0 if scattering is None else min(len(scattering.keys), 4)
    n_corners = math.prod(map(len, condition_values.values())) << (min(len(over), 8) + n_scattering)
    check_size(n_corners, 0, 1)  # the corners are simulated first
    if scattering is None:
        numbered = with_numbers(scene, [*over, *condition_values])
        return _of_sector(Problem(numbered, dict(over), condition_values, **compared))
    check_overlap(scattering, [*over, *condition_values])
    others = [key for key in scattering.keys if key not in over and key not in condition_values]
    numbered = with_numbers(scene, [*over, *condition_values, *others])
    scattering = scattering._replace(others={key: value_of(numbered, key) for key in others})
    problem = Problem(numbered, dict(over), condition_values, scattering=scattering, **compared)
    _check_scattering(problem)
    return _of_sector(problem)


def _of_sector(problem: Problem) -> Problem:
    """The problem; refused where it asks for the sector of a ring and varies what makes blades unlike."""
    if asks_for_sector(problem.scene):
        require_sector(design_corners(problem))
    return problem


def check_comparable(problem: Problem) -> None:
    """Raise an InputError where in some condition there is no vibration without contact, or an infinite one.

    Designs are compared with it. That of the middle of the bounds counts, as a bound itself may be a force of 0.
    """
    middle = scenes_of(problem, problem.values(np.full((1, len(problem.over)), 0.5)))
    middle = middle if is_reduction(problem.of) else problem.scene  # see `free_level`
    check_vibration(problem.of, middle)
    check_resonance(problem.of, middle)


def check_objective(of: Quantity, scene: Scene) -> None:
    """Raise an InputError unless `of` is a quantity of the scene by which motions can be found to be better."""
    check_quantity(of, scene)
    amplitude = amplitude_of(of)
    if amplitude is not None and amplitude.measure == "mean":
        require_capability("a mean displacement as an aim", scene.layout, asked=f"Argument `of` = {of!r}")


def _check_scattering(problem: Problem) -> None:
    """Raise an InputError where a number does not scatter, or leaves its range by it, within the bounds of all."""
    scattering = problem.scattering
    assert scattering is not None
    for key, relative in zip(scattering.keys, scattering.relative, strict=True):
        if relative and scattering.others.get(key) == 0:
            raise InputError(f"{key} is 0, and a share of 0 does not scatter; give its half width.")
    extreme = problem._replace(scattering=scattering.at_ends())
    ends = varied_numbers(extreme, problem.values(cube_corners(len(problem.over))))
    columns = ends[:, [problem.keys.index(key) for key in scattering.keys]]
    check_ends(scattering.keys, columns, problem.scene.layout)


def check_condition(key: str, values: Sequence[float], layout: Layout) -> None:
    """Raise an InputError unless there are values, all in the range of the number."""
    if not np.size(values):
        raise InputError(f"The operating condition {key} has no value.")
    check_values(find_key(key, layout=layout)[0], np.ravel(values).astype(float), f"{key}, as an operating condition,")


def check_bounds(over: Mapping[str, tuple[float, float]], scene: Scene) -> None:
    """Raise an InputError unless there is a number, and the bounds of each are finite, in order and in its range."""
    if not over:
        raise InputError("Argument `over` must name at least one number.")
    for key, (low, high) in over.items():
        if not -np.inf < low < high < np.inf:
            raise InputError(f"The bounds of {key} must be finite and in order, but are {low} and {high}.")
        check_continuous(key, scene)
        check_values(find_key(key, layout=scene.layout)[0], np.array([low, high]), f"{key}, at its bounds,")


def varied_numbers(problem: Problem, designs: np.ndarray) -> np.ndarray:
    """The values of the varying numbers in each run of each design, (designs * runs, keys)."""
    rows, scattering = problem.rows, problem.scattering
    values = np.concatenate([np.repeat(designs, len(rows), axis=0), np.tile(rows, (len(designs), 1))], axis=1)
    if scattering is None:
        return values
    others = np.tile(list(scattering.others.values()), (len(values), 1))
    return scattering.of(problem.keys, np.concatenate([values, others], axis=1))


def scenes_of(problem: Problem, designs: np.ndarray) -> Scene:
    """The scenes of every design in every condition, at every draw, (designs * runs,)."""
    return scenes_at(problem.scene, problem.keys, varied_numbers(problem, designs))


def design_corners(problem: Problem) -> Scene:
    """The extreme scenes of a problem: every combination of bounds, or one bound at a time if there are many."""
    if problem.scattering is not None:
        problem = problem._replace(scattering=problem.scattering.at_ends())
    return scenes_of(problem, problem.values(cube_corners(len(problem.over))))


def start_states(problem: Problem, scenes: Scene) -> State:
    """The initial states of the scenes (leading axis) of a problem."""
    if problem.state is None:
        return initial_states(scenes)
    return in_scene_precision(repeat_lane(problem.state, len(scenes.drive.omega)), scenes)


class SimulatedDesigns(NamedTuple):
    """Designs simulated in every condition, at every draw, (designs * runs,)."""

    scenes: Scene
    runs: Runs


def simulate_designs(
    problem: Problem, designs: np.ndarray, tick: Tick, states: State | None = None
) -> SimulatedDesigns:
    """Simulate designs (n, keys), by default from the start of the problem."""
    scenes = in_precision(without_given(scenes_of(problem, designs)), problem.plan.method.precision)
    states = start_states(problem, scenes) if states is None else states
    return SimulatedDesigns(scenes, run_lanes(scenes, states, problem.plan, tick))


def both_reductions(simulated: SimulatedDesigns) -> tuple[np.ndarray, np.ndarray]:
    """P_d, and that of the vibration alone, of each run [%]."""
    P_d, alone = (levels_of(of, simulated.scenes, simulated.runs.samples).value for of in ("P_d", "P_d_vibration"))
    return P_d, alone


def judge_designs(problem: Problem, designs: np.ndarray, tick: Tick, states: State | None = None) -> DesignJudgement:
    """Simulate designs (n, keys), by default from the start of the problem, and judge them."""
    return judgement_of(problem, simulate_designs(problem, designs, tick, states))


def judgement_of(problem: Problem, simulated: SimulatedDesigns) -> DesignJudgement:
    """The judgement of designs by their runs."""
    scenes, runs = simulated
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # powers of an extreme design overflow
        level, ci, number = levels_of(problem.of, scenes, runs.samples)
        reduction = problem.reduction(level)
    shape = len(level) // problem.runs, problem.runs
    v_max = np.asarray((runs.log.within or runs.log).v_max, float)
    ok = np.asarray(runs.last.status) == Status.OK
    P_d = np.where(ok & np.isfinite(reduction), reduction, -np.inf).reshape(shape)
    objective = P_d.mean(axis=1) if problem.goal == "mean" else P_d.min(axis=1)
    with np.errstate(invalid="ignore", over="ignore"):  # a lane that stopped has no penetration
        N_max = stiffnesses(scenes).reshape(len(v_max), -1) * v_max  # at each interface
        v, force = (a.reshape(shape[0], -1).max(axis=1) for a in (v_max, N_max))
        excess = np.maximum(v / problem.most_penetration - 1, 0) + np.maximum(force / problem.most_force - 1, 0)
    score = np.where(np.isfinite(objective), objective - PENALTY * problem.scale * excess, -np.inf)
    ci = (ci if is_reduction(problem.of) else 100 * ci / problem.free).reshape(shape)
    return DesignJudgement(score, objective, P_d, ci, v, force, number.reshape(shape))


def first_points(problem: Problem, scan: int, seed: int, search: int = 0) -> np.ndarray:
    """Points of the unit cube that are tried first: that of the scene, if it is within the bounds, and Sobol points.

    Further searches have other points than the first, and without that of the scene.
    """
    from scipy.stats import qmc

    own = problem.cube(np.array([[_own_value(problem, key) for key in problem.over]]))
    sequence = qmc.Sobol(len(problem.over), rng=np.random.default_rng([seed, search] if search else seed))
    drawn = sequence.random_base2(math.ceil(math.log2(scan)))[:scan]
    is_within = not search and bool(np.all((own >= 0) & (own <= 1)))
    return np.concatenate([own, drawn]) if is_within else drawn


def _own_value(problem: Problem, key: str) -> float:
    """The scene's number, or NaN where the blades differ."""
    try:
        return value_of(problem.scene, key)
    except InputError:
        return math.nan
