"""Design: the numbers of a scene that reduce the vibration most, over a range of operating conditions.

A coarse scan chooses starts; from each of them Adam climbs in variables scaled to the unit cube, see `climb`.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import qmc

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress, Ticker
from jaxshroud.march.method import Choices, Method, named_choices
from jaxshroud.march.stability import Steps
from jaxshroud.model.state import State
from jaxshroud.results.tuned import Judged, Tuned
from jaxshroud.scene.checks import count_argument, word_argument
from jaxshroud.scene.config import parse
from jaxshroud.scene.errors import InputError, NumericalError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of
from jaxshroud.verbs.climb import POLISH, SAMPLES, climb, polished
from jaxshroud.verbs.confirm import KEEPS, SAME_START, agree, checked
from jaxshroud.verbs.design import Goal, Problem, corners, judge_designs, problem_of
from jaxshroud.verbs.door import asked
from jaxshroud.verbs.lanes import one_scene, with_tangents
from jaxshroud.verbs.robust import Wanted, robustness, wanted_of
from jaxshroud.verbs.scattering import Scattering, scattering_of


def tune(
    scene: Scene | SceneFile,
    over: Mapping[str, tuple[float, float]],
    *,
    conditions: Mapping[str, Sequence[float]] | None = None,
    goal: Goal = "mean",
    most_penetration: float = np.inf,
    most_force: float = np.inf,
    scan: int | None = None,
    n_starts: int | None = None,
    updates: int | None = None,
    seed: int = 0,
    tolerance: Mapping[str, float] | None = None,
    spread: Mapping[str, float] | None = None,
    draws: int = 16,
    loss: float | None = None,
    at_least: float | None = None,
    samples: int = 1024,
    motions: int = 32,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Tuned:
    """Find the numbers of a scene that make P_d of the left blade largest.

    Where numbers scatter, the robust design is sought: every condition is simulated at each of some fixed draws, all of
    which count like conditions, for the mean, for the worst and for the limits. A number that scatters may be tuned, a
    condition, or neither. What is found is then judged by `samples` independent draws.

    Args:
        scene: One scene; what is neither tuned nor varied stays as it is.
        over: Keys as for `vary`, each with its bounds in SI units.
        conditions: Operating conditions: keys with their values in SI units; every combination is simulated.
        goal: "mean": the mean of P_d over the conditions; "worst": its least value.
        most_penetration: Limit of the penetration in every condition, transients included [m].
        most_force: Limit of the contact's normal force, likewise [N].
        scan: Designs looked at first; by default 32 for each key.
        n_starts: The best of them, from which paths start; by default 3 for each key.
        updates: Steps of each path; by default 6 for each key.
        seed: Of the scan, of draws, and of the starting motions that the winner is tried from.
        tolerance: Keys of numbers that scatter, with half widths in SI units; uniform.
        spread: The same with half widths as shares of the number itself: 0.2 for 20 %.
        draws: Draws of the search, a power of 2 (or the next): each costs as much as a condition.
        loss: Percentage points of P_d that may be lost in any condition: how far each number may go, the others fixed,
            is looked for where it is given, or where numbers scatter (1 then).
        at_least: P_d [percent] whose probability under the scatter is asked for.
        samples: Independent draws behind the probability.
        motions: Random starts, in each condition, that coexisting motions of the best design are looked for from where
            robustness is asked for; 0: not looked for.
        n_periods: Drive periods that P_d is averaged over; by default 64.
        transient: Drive periods run before; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest design needs, as where only a
            method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, in float64.
        state: Where every run starts, at drive phase 0; by default each scene's `initial`, apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where the best design does not keep the limits, or stops.

    Returns:
        The best design of all that were simulated, with its history and an independent verdict on it.

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such goal, a count is too small, a number is not finite, a limit is not positive, bounds
            are not in order, a number scatters out of its range, there are many scenes, or float64 is not to be had.
        NumericalError: With `throw`: the best design is not feasible.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "drive.M_0=10"]).scene
        >>> small = dict(scan=4, n_starts=1, updates=1, n_periods=2, transient=2, steps_per_period=100)
        >>> found = js.tune(scene, {"shroud.gap": (2e-5, 4e-5)}, **small)
        >>> 2e-5 <= found.design["shroud.gap"] <= 4e-5
        True
    """
    own = one_scene("tune", scene)
    word_argument("goal", goal, Goal)
    for name, limit in dict(most_penetration=most_penetration, most_force=most_force).items():
        if not limit > 0:
            raise InputError(f"Argument `{name}` must be positive, but is {limit}.")
    scattering = scattering_of(tolerance or {}, spread or {}, draws, seed)
    wanted = wanted_of(scattering is not None, loss, at_least, samples, motions, seed)
    problem = problem_of(own, over, conditions or {}, scattering)
    request = asked(
        scene,
        n_periods=n_periods,
        transient=transient,
        steps_per_period=steps_per_period,
        method=method,
        accuracy=accuracy,
    )
    march = with_tangents(request, corners(problem))
    choices = march.method._replace(within=bool(min(most_penetration, most_force) < np.inf))
    plan = Plan(request.transient, request.n_periods, march.steps, 0.0, choices)
    limits = {"most_penetration": most_penetration, "most_force": most_force}
    problem = problem._replace(goal=goal, **limits, plan=plan, state=state)
    size = len(over)
    scan, n_starts, updates = scan or 32 * size, n_starts or 3 * size, updates or 6 * size
    for name, value in dict(scan=scan, n_starts=n_starts, updates=updates).items():
        count_argument(name, value, 1)
    climbs, rounds = min(n_starts, scan) * (updates + 1) * (1 + 3 * size), len(POLISH) * SAMPLES * size
    lanes = problem.runs * (scan + climbs + rounds + 1) + (wanted.lanes(problem) if wanted else 0)
    fits(max(scan, n_starts * (1 + 3 * size)) * problem.runs, 4 * plan.transient, 4 * plan.kept)
    ticker = Ticker(lanes * (plan.transient + plan.kept), progress)
    found = _searched(problem, scan, n_starts, updates, seed, wanted, ticker)
    if throw and found.failed:
        raise NumericalError(f"The best design does not keep the limits, or stops: {found!r}")
    return found


def _searched(
    problem: Problem, scan: int, n_starts: int, updates: int, seed: int, wanted: Wanted | None, ticker: Ticker
) -> Tuned:
    """Scan, climb, sample around the best, and simulate the winner again."""
    size = len(problem.over)
    cube = qmc.Sobol(size, rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(scan))))[:scan]
    scanned = judge_designs(problem, problem.values(cube), ticker)
    at = np.argsort(-scanned.score, kind="stable")[:n_starts]
    paths = climb(problem, cube[at], Judged(*(a[at] for a in scanned)), updates, ticker)
    last = int(np.argmax(paths.scores[-1]))
    random = np.random.default_rng(seed)
    u = polished(problem, paths.points[-1, last], paths.scores[-1, last], random, ticker)
    best, spent = problem.values(u), ticker.done
    found = judge_designs(problem, best[None], ticker)
    checks = checked(problem, best, seed)
    values = {
        "best": best,
        "bound": [_bound(place) for place in u],
        "ends": list(problem.over.values()),
        "objective": found.objective[0],
        "points": problem.values(paths.points),
        "scores": paths.scores,
        "exact": paths.exact,
        "scanned": problem.values(cube),
        "scanned_scores": scanned.score,
        "periods": spent,
        "confirmed": agree(found, checks),
        "feasible": found.keeps()[0] and all(checks[name].keeps(KEEPS)[0] for name in SAME_START),
        **{f"check_{name}": [getattr(c, name)[0] for c in checks.values()] for name in Judged._fields},
    }
    more, coords = robustness(problem, best, wanted, ticker) if wanted else ({}, {})
    coords = {"key": list(problem.over), "check": list(checks), "end": ["lower", "upper"], **coords}
    return _result(problem, {**values, **more}, coords)


def _result(problem: Problem, values: dict[str, Any], coords: dict[str, Any]) -> Tuned:
    plan = problem.plan
    asked = {name: getattr(problem, name) for name in ("goal", "most_penetration", "most_force")}
    asked |= {
        "conditions_asked": json.dumps(problem.conditions),
        "start": "scene" if problem.state is None else "given",
    }
    how = {"method": str(plan.method), "steps_per_period": plan.steps_per_period}
    run = {"periods": plan.kept, "transient": plan.transient, "steps_per_period": plan.steps_per_period}
    attrs = {"title": "", "scene": text_of(problem.scene, run)}
    made = Tuned.from_values({**values, **asked, **how}, coords=coords, attrs=attrs)
    made._problem = problem
    return made


def problem_again(tuned: Tuned) -> Problem:
    """What was tuned, from the result alone where it was read from a file.

    Raises:
        InputError: It was read from a file, which does not hold the state that its runs started from.
    """
    if tuned._problem is not None:
        return tuned._problem
    if tuned.start == "given":
        raise InputError("A stored tuning does not hold the `state` that its runs started from; tune again.")
    file = parse(tuned.scene, "the stored scene")
    within = bool(min(tuned.most_penetration, tuned.most_force) < np.inf)
    method = named_choices(tuned.method)._replace(within=within)
    limits = {"most_penetration": tuned.most_penetration, "most_force": tuned.most_force}
    scattering = None
    if tuned.places is not None:
        scattering = Scattering(tuple(tuned.scatters), tuned.half_width, tuned.relative, tuned.places)
    plan = Plan(file.run.transient, file.run.periods, tuned.steps_per_period, 0.0, method)
    problem = problem_of(file.scene, tuned.over, tuned.conditions, scattering)
    return problem._replace(goal=tuned.goal, **limits, plan=plan)


def _bound(place: float) -> int:
    """The end of its range that a number of the unit cube is at, as nearly as the search looks: -1, 1; else 0."""
    near = POLISH[-1]
    return -1 if place <= near else 1 if place >= 1 - near else 0


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
        >>> small = dict(scan=4, n_starts=1, updates=1, n_periods=2, transient=2, steps_per_period=100)
        >>> found = js.tune(scene, {"shroud.gap": (2e-5, 4e-5), "contact.gamma": (1, 2)}, **small)
        >>> js.objective_map(found, 3)["objective"].shape
        (3, 3)
    """
    if len(tuned.keys) != 2:
        raise InputError(f"A map has two tuned numbers, but there are {len(tuned.keys)}.")
    problem, side = problem_again(tuned), np.linspace(0.0, 1.0, n)
    cube = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    designs = problem.values(cube)
    judged = judge_designs(problem, designs, lambda _: None)
    first, second = designs.reshape(n, n, 2)[:, 0, 0], designs.reshape(n, n, 2)[0, :, 1]
    return {"first": first, "second": second, "objective": judged.objective.reshape(n, n)}
