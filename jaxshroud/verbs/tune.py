"""Design: the numbers of a scene that reduce the vibration most, over a range of operating conditions.

A coarse scan chooses starts; from each of them Adam climbs in variables scaled to the unit cube. A start's slope is
exact while the motion forgets a push in every operating condition. Where it does not (chaos), or where a limit is
exceeded, it is the slope across a neighbourhood of stated width instead. The best designs often lie where two kinds of
motion meet, and no slope leads along such an edge: the best path ends with a few rounds of samples around it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress, Ticker, run_lanes, starts
from jaxshroud.batch.states import as_precise, to_vector
from jaxshroud.batch.tangents import Dual, differentiable, direction, onward, resting, run_flow
from jaxshroud.batch.xla import repeated
from jaxshroud.march.method import FAST, REFERENCE, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State, start
from jaxshroud.motion.averages import averages
from jaxshroud.scene.checks import count_argument, word_argument
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.gradient import slopes, with_numbers

Goal = Literal["mean", "worst"]
RATE = 0.03  # Adam's first step, in units of the cube's side
PUSH = 100.0  # growth of a relative change of a parameter in the state, beyond which an exact slope says nothing
REACH = 0.03  # half width of the neighbourhood that a slope is taken across then
POLISH = (0.03, 0.02, 0.01, 0.005, 0.003, 0.002, 0.001)  # widths of the last rounds' samples
SAMPLES = 8  # in each of these rounds, for each key
PENALTY = 100.0  # percentage points for exceeding a limit by its own size
KEEPS = 1e-3  # relative, by which a check may exceed a limit: about what the search's step errs by
SAME_START = ("half the step, reference method", "four times as long")  # checks from the scene's own start
AGREES = 0.5  # percentage points by which re-simulations may differ beyond their own intervals


class Problem(NamedTuple):
    """What is to be tuned."""

    scene: Scene
    over: dict[str, tuple[float, float]]  # key -> bounds
    conditions: dict[str, tuple[float, ...]]  # key -> values; every combination counts
    goal: Goal = "mean"
    most_penetration: float = np.inf  # [m]
    most_force: float = np.inf  # normal force of the contact [N]
    plan: Plan = Plan(0, 1, 400, 0.0, FAST)

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

    def rates(self, u: np.ndarray) -> np.ndarray:
        """Derivatives of `values`."""
        low, high = np.array(list(self.over.values())).T
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = self.values(u) * np.log(high / low)
        return np.where(low > 0, scaled, high - low)


class Judged(NamedTuple):
    """What simulations say of some designs."""

    score: np.ndarray  # (n,) objective less the penalties [%]
    objective: np.ndarray  # (n,) mean or least P_d over the conditions [%]
    P_d: np.ndarray  # (n, conditions) [%]
    ci: np.ndarray  # (n, conditions) half widths of 95 % intervals [percentage points]
    v_max: np.ndarray  # (n,) largest penetration in any condition [m]; within steps too where there is a limit
    force: np.ndarray  # (n,) largest normal force, likewise [N]
    period_number: np.ndarray  # (n, conditions); 0: aperiodic

    def keeps(self, margin: float = 0.0) -> np.ndarray:
        """Whether each design ran to its end in every condition, its limits exceeded by `margin` at most, (n,)."""
        return np.isfinite(self.objective) & (self.score >= self.objective - PENALTY * margin)


@dataclass(frozen=True)
class Tuned:
    """A tuned design and how it was found."""

    design: dict[str, float]
    objective: float  # by the search's own short runs [%]
    problem: Problem
    points: np.ndarray  # (updates + 1, starts, keys) designs along each path, the starts first
    scores: np.ndarray  # (updates + 1, starts)
    exact: np.ndarray  # (updates + 1, starts) whether the slope was exact
    scanned: np.ndarray  # (n, keys) designs of the scan
    scanned_scores: np.ndarray  # (n,)
    periods: int  # drive periods simulated in all, each tangent counted as one more run
    checks: dict[str, Judged]  # the winner simulated again in other ways
    confirmed: bool  # all of these agree with the search and with one another, and keep the limits
    feasible: bool  # from the scene's own start it runs to its end in every condition and keeps the limits
    at_bounds: dict[str, str]  # keys whose best value is at its "lower" or "upper" bound: beyond may be better

    def __repr__(self) -> str:
        design = ", ".join(f"{key} = {value:.6g}" for key, value in self.design.items())
        return (
            f"Tuned: {design}; {self.problem.goal} P_d {self.objective:.4g} % over {len(self.problem.rows)} "
            f"conditions, {'' if self.confirmed else 'not '}confirmed; {self.periods} periods simulated"
        )


def tune(
    scene: Scene,
    over: Mapping[str, tuple[float, float]],
    *,
    conditions: Mapping[str, Sequence[float]] | None = None,
    goal: Goal = "mean",
    most_penetration: float = np.inf,
    most_force: float = np.inf,
    scan: int | None = None,
    n_starts: int | None = None,
    updates: int | None = None,
    n_periods: int = 64,
    transient: int = 64,
    steps_per_period: Steps = 200,
    seed: int = 0,
    method: Method | Choices = FAST,
    progress: Progress | None = None,
) -> Tuned:
    """Find the numbers of a scene that make P_d of the left blade largest.

    Args:
        scene: The scene; what is neither tuned nor varied stays as it is.
        over: Keys as for `vary`, each with its bounds in SI units.
        conditions: Operating conditions: keys with their values in SI units; every combination is simulated.
        goal: "mean": the mean of P_d over the conditions; "worst": its least value.
        most_penetration: Limit of the penetration in every condition, transients included [m].
        most_force: Limit of the contact's normal force, likewise [N].
        scan: Designs looked at first; by default 32 for each key.
        n_starts: The best of them, from which paths start; by default 3 for each key.
        updates: Steps of each path; by default 6 for each key.
        n_periods: Drive periods that P_d is averaged over.
        transient: Drive periods run before.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        seed: Of the scan, and of the starting motions that the winner is tried from.
        method: Static choices of the march.
        progress: Called with (lane-periods done, lane-periods at most).

    Returns:
        The best design of all that were simulated, with its history and an independent verdict on it.

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such goal, a count is too small, a number is not finite, a limit is not positive, bounds
            are not in order, or float64 is not to be had.
    """
    from scipy.stats import qmc

    method = choices(method)
    in_precision(scene, method.precision)  # refused now rather than after the search
    word_argument("goal", goal, Goal)
    for name, limit in dict(most_penetration=most_penetration, most_force=most_force).items():
        if not limit > 0:
            raise ValueError(f"Argument `{name}` must be positive, but is {limit}.")
    problem = problem_of(scene, over, conditions or {})
    method = method._replace(within=bool(min(most_penetration, most_force) < np.inf))
    steps = steps_for(corners(problem), 1, steps_per_period, method.tableau)
    plan = Plan(transient, n_periods, steps, 0.0, method)
    problem = problem._replace(goal=goal, most_penetration=most_penetration, most_force=most_force, plan=plan)
    size = len(over)
    scan, n_starts, updates = scan or 32 * size, n_starts or 3 * size, updates or 6 * size
    for name, value in dict(scan=scan, n_starts=n_starts, updates=updates, n_periods=n_periods).items():
        count_argument(name, value, 1)
    climbs, rounds = min(n_starts, scan) * (updates + 1) * (1 + 3 * size), len(POLISH) * SAMPLES * size
    lanes = len(problem.rows) * (scan + climbs + rounds + 1)
    fits(max(scan, n_starts * (1 + 3 * size)) * len(problem.rows), 4 * transient, 4 * n_periods)
    ticker = Ticker(lanes * (transient + n_periods), progress)
    cube = qmc.Sobol(size, rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(scan))))[:scan]
    scanned = judge_designs(problem, problem.values(cube), ticker)
    at = np.argsort(-scanned.score, kind="stable")[:n_starts]
    points, scores, exact = _climb(problem, cube[at], Judged(*(a[at] for a in scanned)), updates, ticker)
    last = int(np.argmax(scores[-1]))
    u = _polished(problem, points[-1, last], scores[-1, last], np.random.default_rng(seed), ticker)
    best, spent = problem.values(u), ticker.done
    found = judge_designs(problem, best[None], ticker)
    checks = _checks(problem, best, seed)
    return Tuned(
        design=dict(zip(over, best.tolist(), strict=True)),
        objective=float(found.objective[0]),
        problem=problem,
        points=problem.values(points),
        scores=scores,
        exact=exact,
        scanned=problem.values(cube),
        scanned_scores=scanned.score,
        periods=spent,
        checks=checks,
        confirmed=_agree(found, checks),
        feasible=bool(found.keeps()[0] and all(checks[name].keeps(KEEPS)[0] for name in SAME_START)),
        at_bounds={key: end for key, place in zip(over, u, strict=True) if (end := _bound(place))},
    )


def _bound(place: float) -> str | None:
    """The end of its range that a number of the unit cube is at, as nearly as the search looks."""
    near = POLISH[-1]
    return "lower" if place <= near else "upper" if place >= 1 - near else None


def problem_of(
    scene: Scene, over: Mapping[str, tuple[float, float]], conditions: Mapping[str, Sequence[float]]
) -> Problem:
    """What is to be tuned, without limits; see `tune`.

    Raises:
        KeyError: The scene has no such number.
        ValueError: Bounds are not in order, or a key is both tuned and a condition.
    """
    if not over:
        raise ValueError("Argument `over` must name at least one number.")
    for key, (low, high) in over.items():
        if not -np.inf < low < high < np.inf:
            raise ValueError(f"The bounds of {key} must be finite and in order, but are {low} and {high}.")
    both = set(over) & set(conditions)
    if both:
        raise ValueError(f"{sorted(both)[0]} is both tuned and an operating condition.")
    known = {key: tuple(float(v) for v in np.ravel(values)) for key, values in conditions.items()}
    fits(math.prod(map(len, known.values())) << min(len(over), 8), 0, 1)  # the corners are looked at first
    whole = with_numbers(scene, [*over, *known])
    return Problem(whole, dict(over), known)


class _Paths(NamedTuple):
    points: np.ndarray
    scores: np.ndarray
    exact: np.ndarray


def scenes_of(problem: Problem, designs: np.ndarray) -> Scene:
    """Scenes of every design in every condition, (designs * conditions,)."""
    rows = problem.rows
    values = np.concatenate([np.repeat(designs, len(rows), axis=0), np.tile(rows, (len(designs), 1))], axis=1)
    return scenes_at(problem.scene, [*problem.over, *problem.conditions], values)


def corners(problem: Problem) -> Scene:
    """The extreme scenes of a problem: every combination of bounds, or bounds one by one where these are many."""
    size = len(problem.over)
    one_by_one = np.vstack([np.zeros(size), np.ones(size), np.eye(size), 1 - np.eye(size)])
    u = np.array(list(product((0.0, 1.0), repeat=size))) if size <= 8 else one_by_one
    return scenes_of(problem, problem.values(u))


def judge_designs(problem: Problem, designs: np.ndarray, tick, states: State | None = None) -> Judged:
    """Simulate designs (n, keys) in every condition, from the scene's start or from one state in all of them."""
    scenes = in_precision(scenes_of(problem, designs), problem.plan.method.precision)
    lanes = len(scenes.drive.omega)
    first = starts(scenes) if states is None else repeated(as_precise(states, scenes), lanes)
    runs = run_lanes(scenes, first, problem.plan, tick)
    with np.errstate(invalid="ignore", over="ignore"):  # of a design that is far out
        motion, got, _ = averages(scenes, runs.samples)
    shape = len(designs), len(problem.rows)
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


def _climb(problem: Problem, u: np.ndarray, judged: Judged, updates: int, tick) -> _Paths:
    """Paths from all starts `u` (starts, keys): a step that does not gain is taken back, and the next is shorter."""
    import optax

    adam = optax.adam(1.0)
    memory = adam.init(jnp.asarray(u))
    rate, score = np.full((len(u), 1), RATE), judged.score
    slope, sound = _slope(problem, u, judged, tick)
    points, scores, exact = [u], [score], [sound]
    for _ in range(updates):
        with jax.numpy_dtype_promotion("standard"):  # as optax assumes
            change, memory = adam.update(jnp.asarray(-slope), memory)
        tried = np.clip(u + rate * np.asarray(change), 0.0, 1.0)
        judged = judge_designs(problem, problem.values(tried), tick)
        gains = np.flatnonzero(judged.score > score)
        rate = np.where(judged.score > score, 1.2 * rate.T, rate.T / 3).T
        if len(gains):
            u, score, slope, sound = u.copy(), score.copy(), slope.copy(), sound.copy()
            u[gains], score[gains] = tried[gains], judged.score[gains]
            slope[gains], sound[gains] = _slope(problem, u[gains], Judged(*(a[gains] for a in judged)), tick)
        points.append(u)
        scores.append(score)
        exact.append(sound)
    return _Paths(np.array(points), np.array(scores), np.array(exact))


def _polished(problem: Problem, u: np.ndarray, score: float, random: np.random.Generator, tick) -> np.ndarray:
    """The best point of the cube found by sampling closer and closer around `u`."""
    for width in POLISH:
        tried = np.clip(u + width * random.standard_normal((SAMPLES * len(u), len(u))), 0.0, 1.0)
        found = judge_designs(problem, problem.values(tried), tick).score
        if found.max() > score:
            u, score = tried[found.argmax()], float(found.max())
    return u


def _slope(problem: Problem, u: np.ndarray, judged: Judged, tick) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the score at points `u` (n, keys) of the cube, and where they are exact."""
    by_condition, growth = exact_slopes(problem, u, tick)
    if problem.goal == "mean":
        slope = by_condition.mean(axis=1)
    else:
        slope = by_condition[np.arange(len(u)), judged.P_d.argmin(axis=1)]
    sound = (growth <= PUSH).all(axis=(1, 2)) & (judged.score == judged.objective) & np.isfinite(slope).all(axis=1)
    rough = np.flatnonzero(~sound)
    if len(rough):
        slope[rough] = _wide_slopes(problem, u[rough], tick)
    return np.where(np.isfinite(slope), slope, 0.0), sound


def exact_slopes(problem: Problem, u: np.ndarray, tick) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of P_d and growth of a push in the state, both (n, conditions, keys), per side of the cube."""
    plan, keys, rows = problem.plan, list(problem.over), len(problem.rows)
    designs, rates = problem.values(u), problem.rates(u)
    scenes = in_precision(scenes_of(problem, designs), problem.plan.method.precision)
    lanes = len(u) * rows * len(keys)
    each = lambda tree: jax.tree.map(lambda a: np.repeat(np.asarray(a), len(keys), axis=0), tree)  # noqa: E731
    unit = [direction(jax.tree.map(lambda a: a[0], scenes), key) for key in keys]
    rate = np.repeat(rates, rows, axis=0).ravel()
    along = jax.tree.map(lambda *a: np.tile(np.stack(a), (len(u) * rows, *[1] * np.ndim(a[0]))), *unit)
    along = jax.tree.map(lambda a: (a * rate.reshape(-1, *[1] * (a.ndim - 1))).astype(a.dtype), along)
    scene, state = Dual(each(scenes), along), resting(each(starts(scenes)))
    method, steps = differentiable(plan.method), plan.steps_per_period
    if plan.transient:
        state = onward(run_flow(scene, state, plan.transient, steps, method))
    end = run_flow(scene, state, plan.kept, steps, method)
    tick(lanes * (plan.transient + plan.kept))
    value, tangent = end
    power, by = np.stack(value.power, axis=-1), np.stack(tangent.power, axis=-1)
    slope = np.asarray(slopes(scene.value, power, along, by, "P_d"), float)
    growth = np.abs(to_vector(tangent.state)).max(axis=1) / np.abs(to_vector(value.state)).max(axis=1)
    shape = len(u), rows, len(keys)
    return slope.reshape(shape), np.where(np.isfinite(growth), growth, np.inf).reshape(shape)


def _wide_slopes(problem: Problem, u: np.ndarray, tick) -> np.ndarray:
    """Slopes of the score across the neighbourhood, one key at a time; one-sided at the cube's faces."""
    n, size = u.shape
    low, high = (np.repeat(u, size, axis=0).reshape(n, size, size) for _ in range(2))
    for i in range(size):
        low[:, i, i] = np.maximum(u[:, i] - REACH, 0.0)
        high[:, i, i] = np.minimum(u[:, i] + REACH, 1.0)
    both = np.concatenate([low, high]).reshape(-1, size)
    score = judge_designs(problem, problem.values(both), tick).score.reshape(2, n, size)
    with np.errstate(invalid="ignore"):  # where a design stops
        return (score[1] - score[0]) / np.einsum("nii->ni", high - low)


def _checks(problem: Problem, design: np.ndarray, seed: int) -> dict[str, Judged]:
    """The design simulated again: with half the step and the reference method, four times as long, from elsewhere.

    The reference method is bisection in float64, with the search's own tableau: no check is coarser than the search.
    """
    plan, quiet = problem.plan, lambda _: None
    reference = plan.method._replace(
        locate=REFERENCE.locate, precision=problem.scene.drive.omega.dtype.name, ledger=False
    )
    fine = Plan(plan.transient, plan.kept, 2 * plan.steps_per_period, 0.0, reference)
    long = Plan(4 * plan.transient, 4 * plan.kept, plan.steps_per_period, 0.0, plan.method)
    checks = {
        SAME_START[0]: judge_designs(problem._replace(plan=fine), design[None], quiet),
        SAME_START[1]: judge_designs(problem._replace(plan=long), design[None], quiet),
    }
    random = np.random.default_rng(seed)
    for i in range(3):
        state = _pushed(problem.scene, random)
        checks[f"another start, {i + 1}"] = judge_designs(problem._replace(plan=long), design[None], quiet, state)
    return checks


def _pushed(scene: Scene, random: np.random.Generator) -> State:
    """A starting state with displacements up to the gap, or a tenth of a millimetre, away from contact."""
    reach = max(abs(float(scene.shroud.gap)), 1e-4)
    x, y = -reach * np.sort(random.random(2))[::-1] * [1, -1], reach * (random.random(2) - 0.5)
    still = np.zeros(2)
    return start(jax.tree.map(jnp.asarray, Motion(x, y, still, still, still, still)))


def _agree(found: Judged, checks: dict[str, Judged]) -> bool:
    """Whether every check comes to the same objective within the intervals, and keeps the limits."""
    width = lambda judged: float(np.sqrt(np.nanmean(judged.ci[0] ** 2))) if np.isfinite(judged.ci).any() else 0.0  # noqa: E731
    for check in checks.values():
        allowed = AGREES + width(found) + width(check)
        if not check.keeps(KEEPS)[0] or not abs(check.objective[0] - found.objective[0]) <= allowed:
            return False
    return bool(found.keeps()[0])


def objective_map(tuned: Tuned, n: int) -> dict[str, np.ndarray]:
    """The objective on a grid of `n` values of each of two tuned numbers, spaced as in the search.

    Returns:
        The values of the two numbers (n,) each, and `objective` (n, n), the first number first.
    """
    side = np.linspace(0.0, 1.0, n)
    cube = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    designs = tuned.problem.values(cube)
    judged = judge_designs(tuned.problem, designs, lambda _: None)
    first, second = designs.reshape(n, n, 2)[:, 0, 0], designs.reshape(n, n, 2)[0, :, 1]
    return {"first": first, "second": second, "objective": judged.objective.reshape(n, n)}
