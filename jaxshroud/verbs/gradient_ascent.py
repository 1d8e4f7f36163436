"""The search for the best design: paths from the best points of a scan, and independent checks of the winner."""

from itertools import pairwise
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import states_apart, to_vector
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import folded_tangents, unfolded_flow
from jaxshroud.batch.tangents import direction, end_as_start, run_flow, without_direction
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.linear.linear_motion import linear_flow
from jaxshroud.linear.linear_sector import settled_linear_tangents
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.prepared import State
from jaxshroud.orbits.gradient import directional_derivatives
from jaxshroud.results.tuned import DesignJudgement
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import STRESSES, Amplitude, Power, amplitude_of, is_reduction
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import asks_for_sector, sector_blades
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.averages import closed_forms
from jaxshroud.verbs.design_problem import Problem, Tick, judge_designs, scenes_of, start_states

ADAM_STEP = 0.03  # of Adam, in units of the cube's side
MAX_GROWTH = 100.0  # of a relative change of a parameter in the state; beyond it an exact slope means nothing
DIFFERENCE_REACH = 0.03  # half width of the neighbourhood across which a slope is then taken
POLISH_WIDTHS = (0.03, 0.02, 0.01, 0.005, 0.003, 0.002, 0.001)  # standard deviations of the samples of each round
POLISH_SAMPLES = 8  # in each of these rounds, for each key
REFINE_ROUNDS, BETWEEN = 6, 3  # of one number: rounds, and values tried between the best one and each neighbour


class SearchOptions(NamedTuple):
    """How long `tune` searches; None: in proportion to the number of tuned numbers."""

    scan: int | None = None  # designs simulated first; by default 32 for each number
    n_starts: int | None = None  # the best of them, from which paths start; by default 3 for each number
    updates: int | None = None  # steps of each path; by default 6 for each number; 0: no paths

    def of_size(self, size: int) -> tuple[int, int, int]:
        """The three counts of a search with `size` tuned numbers.

        Raises:
            InputError: One of them is less than 1, or the last less than 0.
        """
        usual = (32 * size, 3 * size, 6 * size)
        scan, n_starts, updates = (own if given is None else given for given, own in zip(self, usual, strict=True))
        counts = scan, n_starts, updates
        for name, count in zip(self._fields, counts, strict=True):
            count_argument(name, count, 0 if name == "updates" else 1)
        return counts


class Paths(NamedTuple):
    """Designs along each path, in the unit cube."""

    points: np.ndarray  # (updates + 1, starts, keys)
    scores: np.ndarray  # (updates + 1, starts)
    exact: np.ndarray  # (updates + 1, starts) whether the slopes were exact
    end_ci: np.ndarray  # (starts,) half widths of the intervals of the last objectives


def ascent_paths(problem: Problem, u: np.ndarray, judged: DesignJudgement, updates: int, tick: Tick) -> Paths:
    """Paths from all starts `u` (starts, keys) by Adam; steps without a gain are undone and shortened."""
    import optax

    ci = problem.objective_ci(judged)
    if not updates:
        return Paths(u[None], judged.score[None], np.zeros((1, len(u)), bool), ci)
    adam = optax.adam(1.0)
    optimizer_state = adam.init(jnp.asarray(u))
    rate = np.full((len(u), 1), ADAM_STEP)
    score = judged.score
    slope, is_exact = _slope(problem, u, judged, tick)
    points, scores, exact = [u], [score], [is_exact]
    for _ in range(updates):
        with jax.numpy_dtype_promotion("standard"):  # as optax assumes
            change, optimizer_state = adam.update(jnp.asarray(-slope), optimizer_state)
        trial_u = np.clip(u + rate * np.asarray(change), 0.0, 1.0)
        judged = judge_designs(problem, problem.values(trial_u), tick)
        improved = np.flatnonzero(judged.score > score)
        rate = np.where(judged.score > score, 1.2 * rate.T, rate.T / 3).T
        if len(improved):
            u = u.copy()
            score = score.copy()
            slope = slope.copy()
            is_exact = is_exact.copy()
            u[improved], score[improved] = trial_u[improved], judged.score[improved]
            ci = np.where(judged.score >= score, problem.objective_ci(judged), ci)
            slope[improved], is_exact[improved] = _slope(
                problem, u[improved], DesignJudgement._make(a[improved] for a in judged), tick
            )
        points.append(u)
        scores.append(score)
        exact.append(is_exact)
    return Paths(np.array(points), np.array(scores), np.array(exact), ci)


class Looked(NamedTuple):
    """Values of one number that were looked at, in the unit cube."""

    u: np.ndarray  # (n,), in order
    score: np.ndarray  # (n,)
    ci: np.ndarray  # (n,) half widths of the intervals of the objective

    def joined(self, u: np.ndarray, score: np.ndarray, ci: np.ndarray) -> "Looked":
        """These and more values."""
        every = np.concatenate([self.u, u])
        u, first = np.unique(every, return_index=True)
        return Looked(u, np.concatenate([self.score, score])[first], np.concatenate([self.ci, ci])[first])

    @property
    def best(self) -> int:
        """Where the best of them is."""
        return int(self.score.argmax())

    @property
    def worse(self) -> np.ndarray:
        """Which of them are worse than the best by more than their intervals, (n,)."""
        ci = np.nan_to_num(self.ci)
        best = self.best
        with np.errstate(invalid="ignore"):  # of none that ran
            return self.score[best] - self.score > np.hypot(ci, ci[best])

    @property
    def place(self) -> tuple[float, float]:
        """The nearest values on either side of the best that are worse than it, or the ends of the cube."""
        worse, at = self.u[self.worse], self.u[self.best]
        return float(np.max(worse[worse < at], initial=0.0)), float(np.min(worse[worse > at], initial=1.0))


class Refined(NamedTuple):
    """The search of one number between the best value and its neighbours."""

    points: np.ndarray  # (rounds, 1) the best after each round, in the unit cube
    scores: np.ndarray  # (rounds,)
    looked: Looked


def refine_design(problem: Problem, looked: Looked, tick: Tick) -> Refined:
    """Look between the best value of one number and its neighbours, until these cannot be told from it."""
    points, scores = [[looked.u[looked.best]]], [looked.score[looked.best]]
    for _ in range(REFINE_ROUNDS):
        best = looked.best
        beside = looked.u[max(best - 1, 0) : best + 2]
        if not looked.worse[max(best - 1, 0) : best + 2].any():
            break
        u = np.concatenate([np.linspace(low, high, BETWEEN + 2)[1:-1] for low, high in pairwise(beside)])
        judged = judge_designs(problem, problem.values(u[:, None]), tick)
        looked = looked.joined(u, judged.score, problem.objective_ci(judged))
        points.append([looked.u[looked.best]])
        scores.append(looked.score[looked.best])
    return Refined(np.array(points), np.array(scores), looked)


def polish_design(
    problem: Problem, u: np.ndarray, score: float, random: np.random.Generator, tick: Tick
) -> tuple[np.ndarray, np.ndarray]:
    """The best points (rounds, keys) after each round of random samples around `u`, and their scores (rounds,)."""
    points, scores = [], []
    for width in POLISH_WIDTHS:
        trial_u = np.clip(u + width * random.standard_normal((POLISH_SAMPLES * len(u), len(u))), 0.0, 1.0)
        trial_scores = judge_designs(problem, problem.values(trial_u), tick).score
        if trial_scores.max() > score:
            u = trial_u[trial_scores.argmax()]
            score = float(trial_scores.max())
        points.append(u)
        scores.append(score)
    return np.array(points), np.array(scores)


def _slope(problem: Problem, u: np.ndarray, judged: DesignJudgement, tick: Tick) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the score at points `u` (n, keys) of the cube, (n, keys), and whether they are exact, (n,)."""
    if problem.of.endswith(("_peak", *STRESSES)):  # the time of the peak is not known
        slope = _wide_slopes(problem, u, tick)
        return np.where(np.isfinite(slope), slope, 0.0), np.zeros(len(u), bool)
    by_run, growth = exact_slopes(problem, u, tick)
    slope = by_run.mean(axis=1) if problem.goal == "mean" else by_run[np.arange(len(u)), judged.P_d.argmin(axis=1)]
    is_exact = (
        (growth <= MAX_GROWTH).all(axis=(1, 2)) & (judged.score == judged.objective) & np.isfinite(slope).all(axis=1)
    )
    inexact = np.flatnonzero(~is_exact)
    if len(inexact):
        slope[inexact] = _wide_slopes(problem, u[inexact], tick)
    return np.where(np.isfinite(slope), slope, 0.0), is_exact


def exact_slopes(problem: Problem, u: np.ndarray, tick: Tick) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of P_d, and the growth of a change in the state, both (n, runs, keys), per side of the cube.

    For another quantity than P_d they are those of `Problem.reduction`; peaks have none.
    """
    plan = problem.plan
    keys = list(problem.over)
    rows = problem.runs
    designs = problem.values(u)
    rates = problem.rates(u)
    scenes = in_precision(scenes_of(problem, designs), problem.plan.method.precision)
    n_lanes = len(u) * rows * len(keys)

    def per_key(tree):
        return jax.tree.map(lambda a: np.repeat(np.asarray(a), len(keys), axis=0), tree)

    key_directions = [direction(scenes, key) for key in keys]
    scenes = without_given(scenes)
    rate = (np.repeat(rates, rows, axis=0) * np.tile(problem.stretch, (len(u), 1))).ravel()
    directions = jax.tree.map(lambda *a: np.stack(a, axis=1).reshape(-1, *a[0].shape[1:]), *key_directions)
    directions = jax.tree.map(lambda a: (a * rate.reshape(-1, *[1] * (a.ndim - 1))).astype(a.dtype), directions)
    if is_linear(scenes):
        ends = settled_linear_tangents(scenes, directions, len(keys))
        tick(n_lanes * (plan.transient + plan.kept))
        own = per_key(scenes)
        slope = _reduction_slopes(problem, Dual(own, directions), Dual._make(linear_flow(end, own) for end in ends))
        return slope.reshape(len(u), rows, len(keys)), np.zeros((len(u), rows, len(keys)))
    scene = Dual(per_key(scenes), directions)
    method = as_differentiable(plan.method)._replace(vibration=problem.of == "P_d_vibration")
    steps = plan.steps_per_period
    marched, start, copies = folded_tangents(scene, per_key(start_states(problem, scenes)))
    state = without_direction(start)
    if plan.transient:
        state = end_as_start(run_flow(marched, state, plan.transient, steps, method))
    end = run_flow(marched, state, plan.kept, steps, method)
    tick(n_lanes * (plan.transient + plan.kept))
    value, tangent = end
    slope = _reduction_slopes(problem, scene, unfolded_flow(end, copies))
    growth = np.abs(to_vector(tangent.own)).max(axis=1) / np.abs(to_vector(value.own)).max(axis=1)
    shape = len(u), rows, len(keys)
    return slope.reshape(shape), np.where(np.isfinite(growth), growth, np.inf).reshape(shape)


def _reduction_slopes(problem: Problem, scene: Dual, end: Dual) -> np.ndarray:
    """The derivative of `Problem.reduction` of each lane at the end of its flow; of tied blades that of the first."""
    amplitude = amplitude_of(problem.of)
    slope = _power_slopes(problem, scene, end) if amplitude is None else _amplitude_slopes(amplitude, scene, end)
    return slope if is_reduction(problem.of) else -100 * slope / problem.free


def _power_slopes(problem: Problem, scene: Dual, end: Dual) -> np.ndarray:
    """The derivative of a power of each lane, (lanes,)."""
    of = cast(Power, problem.of)
    power, by_tangent = (flow.power for flow in end)
    squares, by = power, by_tangent
    if of == "P_d_vibration":
        means, means_by = (np.stack(flow.means, axis=1) for flow in end)
        squares, by = (power, means), (by_tangent, means_by)
    slope = np.asarray(directional_derivatives(scene.value, squares, scene.tangent, by, of), float)
    if of != "P_d_worst":
        return slope
    A, P_0, _ = closed_forms(scene.value)
    return _at_blade(slope, power_reduction(A[:, None] * power, P_0).argmin(axis=1))


def _amplitude_slopes(amplitude: Amplitude, scene: Dual, end: Dual) -> np.ndarray:
    """The derivative of the largest magnitude of a mean, or RMS value, of the blades that count, (lanes,)."""
    counts = scene.value.layout.counting
    moments = [[m[amplitude.row][:, counts] for m in flow.moments] for flow in end]
    (mean, square), (mean_by, square_by) = moments
    rms = np.sqrt(np.maximum(square - mean**2, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):  # a blade that stands still
        rms_by = (square_by - 2 * mean * mean_by) / (2 * rms)
    if amplitude.measure == "mean":
        return _at_blade(np.sign(mean) * mean_by, np.abs(mean).argmax(axis=1))
    return _at_blade(rms_by, rms.argmax(axis=1))


def _at_blade(values: np.ndarray, blade: np.ndarray) -> np.ndarray:
    """The value of one blade of each lane, (lanes,), of values (lanes, blades)."""
    return np.take_along_axis(values, blade[:, None], axis=1)[:, 0]


def _wide_slopes(problem: Problem, u: np.ndarray, tick: Tick) -> np.ndarray:
    """Slopes of the score across the neighbourhood, one key at a time; one-sided at the faces of the cube."""
    n, size = u.shape
    low, high = (np.repeat(u, size, axis=0).reshape(n, size, size) for _ in range(2))
    for i in range(size):
        low[:, i, i] = np.maximum(u[:, i] - DIFFERENCE_REACH, 0.0)
        high[:, i, i] = np.minimum(u[:, i] + DIFFERENCE_REACH, 1.0)
    ends = np.concatenate([low, high]).reshape(-1, size)
    score = judge_designs(problem, problem.values(ends), tick).score.reshape(2, n, size)
    with np.errstate(invalid="ignore"):  # where a design stops
        return (score[1] - score[0]) / np.einsum("nii->ni", high - low)


LIMIT_MARGIN = 1e-3  # relative, by which a check may exceed a limit: about the error of the search's step
TIMES_LONGER, OTHER_STARTS = 4, 3  # of the checks: how long they are, and from how many random starts
SAME_START_CHECKS = ("half the step, reference method", "four times as long")  # from the scene's own initial state
MAX_DIFFERENCE = 0.5  # percentage points by which checks may differ beyond their own intervals


def runs_of_checks(problem: Problem) -> int:
    """How many runs of the length of the search's own `verify_design` takes."""
    return problem.runs * (1 + TIMES_LONGER * (1 + OTHER_STARTS))


def verify_design(problem: Problem, design: np.ndarray, seed: int, tick: Tick) -> dict[str, DesignJudgement]:
    """The design simulated again: with half the step and the reference method, four times as long, from other states.

    The reference method is bisection in float64, with the search's own tableau: no check is coarser than the search.
    Power series have a hundredth of the tolerance instead. Rocking faces become flat within a quarter of the share. In
    rows, with hundreds of events in a period, bisection takes twenty times as long: their events are located as in the
    search.
    """
    plan = problem.plan
    reference = plan.method.for_verification._replace(precision=problem.scene.drive.omega.dtype.name, ledger=False)
    if problem.scene.row is not None:
        reference = reference._replace(locate=plan.method.locate)
    finer = Plan(plan.transient, plan.kept, 2 * plan.steps_per_period, 0.0, reference)
    longer = Plan(TIMES_LONGER * plan.transient, TIMES_LONGER * plan.kept, plan.steps_per_period, 0.0, plan.method)
    random = np.random.default_rng(seed)
    scenes = in_precision(without_given(scenes_of(problem, design[None])), plan.method.precision)
    perturbed = [problem._replace(state=_perturbed_start(problem.scene, random)) for _ in range(OTHER_STARTS)]
    states = jax.tree.map(lambda *a: np.concatenate(a), *(start_states(one, scenes) for one in [problem, *perturbed]))
    by_half = judge_designs(problem._replace(plan=finer), design[None], tick)
    for_long = judge_designs(problem._replace(plan=longer), np.tile(design, (1 + OTHER_STARTS, 1)), tick, states)
    each = [DesignJudgement._make(a[i : i + 1] for a in for_long) for i in range(1 + OTHER_STARTS)]
    others = {f"another start, {i}": each[i] for i in range(1, 1 + OTHER_STARTS)}
    return {SAME_START_CHECKS[0]: by_half, SAME_START_CHECKS[1]: each[0]} | others


def _perturbed_start(scene: Scene, random: np.random.Generator) -> State:
    """An initial state with displacements up to the gap, or a tenth of a millimetre, away from contact.

    Blades of a row, which in a ring cannot all move apart, have velocities that reach as far in a period; by a sector
    they repeat after its blades.
    """
    blades = len(scene.initial.x)
    reach = max(float(np.abs(scene.running_shroud.gap).max()), 1e-4)
    at_rest = np.zeros(2)
    if scene.row is None:
        x, y = -reach * np.sort(random.random(2))[::-1] * [1, -1], reach * (random.random(2) - 0.5)
        motion = Motion(x, y, at_rest, at_rest, at_rest, at_rest)
    else:
        drawn = sector_blades(scene) if asks_for_sector(scene) else blades
        rates = 2 * random.random((2, drawn)) - 1
        v_x, v_y = float(scene.drive.omega) * reach * np.tile(rates, blades // drawn)
        at_rest = np.zeros(blades)
        motion = Motion(at_rest, at_rest, at_rest, v_x, v_y, at_rest)
    return states_apart(scene, motion)


def checks_agree(judgement: DesignJudgement, checks: dict[str, DesignJudgement], scale: float = 1.0) -> bool:
    """Whether every check has the same objective within the intervals, and keeps the limits; see `Problem.scale`."""

    def interval(judged):
        return float(np.sqrt(np.nanmean(judged.ci[0] ** 2))) if np.isfinite(judged.ci).any() else 0.0

    for check in checks.values():
        allowed = MAX_DIFFERENCE * scale + interval(judgement) + interval(check)
        kept = check.keeps(LIMIT_MARGIN * scale)[0]
        if not kept or not abs(check.objective[0] - judgement.objective[0]) <= allowed:
            return False
    return bool(judgement.keeps()[0])
