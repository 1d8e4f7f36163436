"""Design: the numbers of a scene that reduce the vibration most, over a range of operating conditions.

A coarse scan chooses starts; from each of them Adam ascends in variables scaled to the unit cube, see `ascent_paths`.
One number is then looked for between the best value and its neighbours, as far as intervals separate values.
"""

import json
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Plan, Progress, Ticker
from jaxshroud.linear.held_contact import LinearState, is_linear
from jaxshroud.march.method import FOR_P_D, choices
from jaxshroud.model.prepared import State
from jaxshroud.results.tuned import DesignJudgement, Tuned
from jaxshroud.scene.checks import InputError, NumericalError, seed_argument
from jaxshroud.scene.config import parse
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.quantities import Quantity, amplitude_of, check_only_P_d
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of
from jaxshroud.scene.typed import typed
from jaxshroud.signals.amplitudes import counted_reduction
from jaxshroud.verbs.arguments import MarchPlan, MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.design_problem import (
    Goal,
    Problem,
    both_reductions,
    check_comparable,
    design_corners,
    judge_designs,
    judgement_of,
    problem_of,
    scenes_of,
    simulate_designs,
)
from jaxshroud.verbs.gradient_ascent import (
    BETWEEN,
    LIMIT_MARGIN,
    OTHER_STARTS,
    POLISH_SAMPLES,
    POLISH_WIDTHS,
    REFINE_ROUNDS,
    SAME_START_CHECKS,
    TIMES_LONGER,
    Looked,
    SearchOptions,
    ascent_paths,
    checks_agree,
    polish_design,
    refine_design,
    runs_of_checks,
    verify_design,
)
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.robust import RobustnessRequest, robustness, robustness_request
from jaxshroud.verbs.scattering import Scattering, scattering_of
from jaxshroud.verbs.settled import default_state, in_state, require_state


@typed
def tune(
    scene: Scene | SceneFile,
    over: Mapping[str, tuple[float, float]],
    *,
    conditions: Mapping[str, Sequence[float]] | None = None,
    goal: Goal = "mean",
    of: Quantity | None = None,
    linear: LinearState | None = None,
    most_penetration: float = np.inf,
    most_force: float = np.inf,
    scatters: Mapping[str, float | str] | None = None,
    at_least: float | None = None,
    loss: float | None = None,
    draws: int = 16,
    check_draws: int = 1024,
    motions: int = 32,
    search: SearchOptions | None = None,
    seed: int = 0,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Tuned:
    """Find the numbers of a scene that maximise P_d of the left blade, or of a row, or minimise another quantity.

    Where numbers scatter, the robust design is found: every condition is simulated at the same fixed draws, which all
    count like conditions, for the mean, for the worst case and for the limits. A number that scatters may be tuned, a
    condition, or neither. The best design is then judged by `check_draws` independent draws.

    Of a row P_d is that of all blades, "P_d_worst" that of the blade that gains the least, P the sum of all, and
    amplitudes are the largest of all blades. A scatter of `row.mistuning` is one of each blade by itself: its draws are
    patterns.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        over: Keys as for `vary`, each with its bounds in SI units.
        conditions: Operating conditions: keys with their values in SI units; every combination is simulated.
        goal: "mean": the mean of P_d over the conditions; "worst": its least value. Likewise for the reduction of
            another quantity, whose worst value is the largest.
        of: By default P_d, and of a scene with a mean load or interference P_d_vibration, of which no coexisting
            motions are looked for: "P_d", in a row also "P_d_worst", or what is to be small: "P", or an amplitude of
            the left blade, "x_peak" or another of `gradient` (of a mean its magnitude; of a row no mean). It is judged
            by its reduction in percent below `Tuned.free`, a constant: what it is in the scene without contact, of a
            displacement on which no load works the RMS displacement of the block. This reduction is then meant by P_d
            everywhere; `Tuned.level` is the quantity itself.
            Slopes of peaks are taken across a neighbourhood.
        linear: "apart" or "stuck": in closed form, of contact that stays in this state; a design whose
            contact leaves it is not feasible. By default where the contact of all designs of the scan does, see
            `power`.
        most_penetration: Largest allowed penetration in every condition, transients included [m].
        most_force: Largest allowed normal force of the contact, likewise [N].
        scatters: Keys of numbers that scatter uniformly, with half widths: a number in SI units, or a share of the
            number itself such as "20%".
        at_least: P_d [percent] whose probability under the scatter is computed; of P_d only.
        loss: Percentage points of P_d that may be lost in any condition. If it is given, or if numbers scatter (then it
            is 1 by default), the interval of each number that keeps this loss is found, the others fixed.
        draws: Draws of the search, rounded up to a power of 2: each costs as much as a condition.
        check_draws: Independent draws behind the probability.
        motions: Random starts in each condition from which coexisting motions of the best design are found, if
            robustness is computed; 0: none, as for other quantities than P_d, and for rows.
        search: How many designs are simulated, and how far the best of them are improved.
        seed: Seed of the scan, of the draws, and of the initial states from which the winner is checked.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where the best design does not keep the limits, or stops before its end.

    Returns:
        The best design of all that were simulated, with its history and independent checks.

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such goal, a count is too small, a number is not finite, a limit is not positive, bounds
            are not in order, a number scatters out of its range, there are many scenes, JAX has no float64, or in some
            condition the vibration without contact, with which `of` is compared, is 0 or infinite.
        NumericalError: With `throw`: the best design is not feasible.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "drive.M_0=10"]).scene
        >>> small = dict(search=js.SearchOptions(4, 1, 1), n_periods=2, transient=2, method=js.RungeKutta(steps=100))
        >>> found = js.tune(scene, {"shroud.gap": (2e-5, 4e-5)}, **small)
        >>> 2e-5 <= found.design["shroud.gap"] <= 4e-5
        True
    """
    scene = in_state(scene, linear)
    nominal = one_scene("tune", scene)
    check_row(nominal)
    of = of or counted_reduction(nominal)
    seed_argument(seed)
    for name, limit in dict(most_penetration=most_penetration, most_force=most_force).items():
        if not limit > 0:
            raise InputError(f"Argument `{name}` must be positive, but is {limit}.")
    scattering = scattering_of(scatters or {}, draws, seed, nominal.layout)
    check_only_P_d("at_least", at_least, of)
    motions = motions if of == "P_d" and nominal.row is None else 0
    robust_request = robustness_request(scattering is not None, loss, at_least, check_draws, motions, seed)
    problem = problem_of(nominal, over, conditions or {}, scattering, of)
    check_comparable(problem)
    counts = (search or SearchOptions()).of_size(len(over))
    scanned = problem.values(_scanned_cube(len(over), counts[0], seed))
    if linear is None and state is None:
        linear = default_state(scenes_of(problem, scanned), method)
        scene = in_state(scene, linear)
        problem = problem._replace(scene=in_state(problem.scene, linear))
    if is_linear(problem.scene):
        require_state(scenes_of(problem, scanned), problem.runs)
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method)
    march = plan_march(resolved, design_corners(problem), FOR_P_D, tangents=True)
    within = bool(min(most_penetration, most_force) < np.inf)
    choices = march.method._replace(within=within, amplitudes=amplitude_of(of) is not None)
    plan = march._replace(method=choices).plan(resolved.transient, resolved.n_periods)
    limits = {"most_penetration": most_penetration, "most_force": most_force}
    problem = problem._replace(goal=goal, **limits, plan=plan, state=state)
    lanes = _most_lanes(problem, counts) + (robust_request.lanes(problem) if robust_request else 0)
    ticker = Ticker(lanes * (plan.transient + plan.kept), progress)
    tuned = _search(problem, counts, seed, robust_request, ticker)
    if throw and tuned.failed:
        raise NumericalError(f"The best design does not keep the limits, or stops: {tuned!r}")
    tuned.data.attrs |= march.attributes
    return tuned


def _most_lanes(problem: Problem, counts: tuple[int, int, int]) -> int:
    """An upper estimate of the runs of a search.

    Raises:
        InputError: Those that run at the same time, or are checked over longer times, are too many.
    """
    scan, n_starts, updates = counts
    size = len(problem.over)
    at_once = max(scan, n_starts * (1 + 3 * size), 1 + OTHER_STARTS) * problem.runs
    check_size(at_once, TIMES_LONGER * problem.plan.transient, TIMES_LONGER * problem.plan.kept)
    ascents = min(n_starts, scan) * (updates + 1) * (1 + 3 * size) if updates else 0
    rounds = 2 * BETWEEN * REFINE_ROUNDS if size == 1 else len(POLISH_WIDTHS) * POLISH_SAMPLES * size
    return problem.runs * (scan + ascents + rounds + 1) + runs_of_checks(problem)


def _search(
    problem: Problem, counts: tuple[int, int, int], seed: int, robust_request: RobustnessRequest | None, ticker: Ticker
) -> Tuned:
    """Scan, ascend, sample around the best design, and simulate the winner again."""
    scan, n_starts, updates = counts
    size = len(problem.over)
    cube = _scanned_cube(size, scan, seed)
    scanned = judge_designs(problem, problem.values(cube), ticker)
    if is_linear(problem.scene) and not np.isfinite(scanned.score).any():
        state = problem.scene.parts.contact
        raise InputError(f"No design of the scan keeps its contact {state}: the motion takes more than its margins.")
    best_first = np.argsort(-scanned.score, kind="stable")[:n_starts]
    paths = ascent_paths(
        problem, cube[best_first], DesignJudgement._make(a[best_first] for a in scanned), updates, ticker
    )
    best_path = int(np.argmax(paths.scores[-1]))
    end, score = paths.points[-1, best_path], paths.scores[-1, best_path]
    place = None
    if size == 1:
        looked = Looked._make(np.zeros((3, 0))).joined(cube[:, 0], scanned.score, problem.objective_ci(scanned))
        looked = looked.joined(end, score[None], paths.end_ci[best_path : best_path + 1])
        polished, polished_scores, looked = refine_design(problem, looked, ticker)
        place = problem.values(np.array(looked.place)[:, None]).T
    else:
        polished, polished_scores = polish_design(problem, end, score, np.random.default_rng(seed), ticker)
    u = polished[-1]
    design = problem.values(u)
    periods = ticker.done
    simulated = simulate_designs(problem, design[None], ticker)
    judgement = judgement_of(problem, simulated)
    P_d, P_d_vibration = both_reductions(simulated)
    checks = verify_design(problem, design, seed, ticker)
    values = {
        "best": design,
        "bound": [_bound(place) for place in u],
        "best_P_d": P_d,
        "best_P_d_vibration": P_d_vibration,
        "ends": list(problem.over.values()),
        "objective": judgement.objective[0],
        "points": problem.values(paths.points),
        "scores": paths.scores,
        "exact": paths.exact,
        "polished": problem.values(polished),
        "polished_scores": polished_scores,
        "scanned": problem.values(cube),
        "scanned_scores": scanned.score,
        "scanned_ci": problem.objective_ci(scanned),
        "place": place,
        "periods": periods,
        "confirmed": checks_agree(judgement, checks, problem.scale),
        "feasible": judgement.keeps()[0]
        and all(checks[name].keeps(LIMIT_MARGIN * problem.scale)[0] for name in SAME_START_CHECKS),
        **{f"check_{name}": [getattr(c, name)[0] for c in checks.values()] for name in DesignJudgement._fields},
    }
    robust_values, coords = robustness(problem, design, robust_request, ticker) if robust_request else ({}, {})
    coords = {"key": list(problem.over), "check": list(checks), "end": ["lower", "upper"], **coords}
    return _tuned_result(problem, {**values, **robust_values}, coords)


def _scanned_cube(size: int, scan: int, seed: int) -> np.ndarray:
    """The designs of the scan, in the unit cube, (scan, keys)."""
    from scipy.stats import qmc

    return qmc.Sobol(size, rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(scan))))[:scan]


def _tuned_result(problem: Problem, values: dict[str, object], coords: dict[str, object]) -> Tuned:
    """The result, which holds its design problem."""
    plan = problem.plan
    request = {name: getattr(problem, name) for name in ("goal", "of", "free", "most_penetration", "most_force")}
    request |= {
        "conditions_json": json.dumps(problem.conditions),
        "start": "scene" if problem.state is None else "given",
    }
    state = problem.scene.parts.contact if is_linear(problem.scene) else ""
    march = MarchPlan(plan.steps_per_period, plan.method, None, state).attributes
    run = {"periods": plan.kept, "transient": plan.transient, "steps_per_period": plan.steps_per_period}
    attrs = {"title": "", "scene": text_of(problem.scene, run)}
    tuned = Tuned.from_values({**values, **request, **march}, coords=coords, attrs=attrs)
    tuned._problem = problem
    return tuned


def problem_from_result(tuned: Tuned) -> Problem:
    """The design problem of a tuning, rebuilt from its attributes if the result was read from a file.

    Raises:
        InputError: It was read from a file, and its runs started from a given state, which files do not hold.
    """
    if tuned._problem is not None:
        return tuned._problem
    if tuned.start == "given":
        raise InputError("A stored tuning does not hold the `state` from which its runs started; tune again.")
    file = parse(tuned.scene, "the stored scene")
    within = bool(min(tuned.most_penetration, tuned.most_force) < np.inf)
    amplitudes = amplitude_of(tuned.quantity) is not None
    method = choices(tuned.march)._replace(within=within, amplitudes=amplitudes, vibration=True)
    limits = {"most_penetration": tuned.most_penetration, "most_force": tuned.most_force}
    scattering = None
    if tuned.places is not None:
        scattering = Scattering(tuple(tuned.scatters), tuned.half_width, tuned.relative, tuned.places)
    plan = Plan(file.run.transient, file.run.periods, tuned.steps_per_period, 0.0, method)
    problem = problem_of(file.scene, tuned.over, tuned.conditions, scattering, cast(Quantity, tuned.quantity))
    return problem._replace(goal=tuned.goal, **limits, plan=plan)


def _bound(place: float) -> int:
    """The end of its range at which a number of the unit cube is, to the search's resolution: -1 or 1; else 0."""
    near = POLISH_WIDTHS[-1]
    return -1 if place <= near else 1 if place >= 1 - near else 0


@typed
def objective_map(tuned: Tuned, n: int) -> dict[str, np.ndarray]:
    """The objective on a grid of `n` values of each of two tuned numbers, spaced as in the search.

    Returns:
        The values of the two numbers (n,) each, and `objective` (n, n), the first number first.

    Raises:
        ValueError: Not two numbers were tuned, or a stored tuning started from a state, which files do not hold.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "drive.M_0=10"]).scene
        >>> small = dict(search=js.SearchOptions(4, 1, 1), n_periods=2, transient=2, method=js.RungeKutta(steps=100))
        >>> found = js.tune(scene, {"shroud.gap": (2e-5, 4e-5), "contact.gamma": (1, 2)}, **small)
        >>> objective_map(found, 3)["objective"].shape
        (3, 3)
    """
    if len(tuned.keys) != 2:
        raise InputError(f"A map has two tuned numbers, but there are {len(tuned.keys)}.")
    problem = problem_from_result(tuned)
    side = np.linspace(0.0, 1.0, n)
    cube = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    designs = problem.values(cube)
    judged = judge_designs(problem, designs, lambda _: None)
    first, second = designs.reshape(n, n, 2)[:, 0, 0], designs.reshape(n, n, 2)[0, :, 1]
    return {"first": first, "second": second, "objective": judged.objective.reshape(n, n)}
