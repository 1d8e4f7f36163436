"""The robustness of a tuned design: intervals of its numbers, probabilities under scatter, coexisting motions."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.plan import Tick
from jaxshroud.march.method import method_of
from jaxshroud.results.tuned import ENDED_BY, DesignJudgement
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.verbs.attractors import attractors
from jaxshroud.verbs.design_problem import Problem, judge_designs, scenes_of
from jaxshroud.verbs.scattering import probability_values

SEARCH_POINTS = 65  # values of a number that are tried each time
MAX_BRACKETINGS = 8  # rounds of bracketing: each finds intervals 32 times narrower
REFINEMENTS, POINTS_BETWEEN, MAX_REFINED_PAIRS = 3, 7, 64  # rounds, values between two neighbours, and such pairs
MAX_AUDITS = 4  # passes over the whole interval with other values
DEFAULT_LOSS = 1.0  # percentage points, where numbers scatter and no loss is given
BOUND, ALLOWED_LOSS, LIMIT, STOP = range(len(ENDED_BY))


class Interval(NamedTuple):
    """The interval of one number in which a design is acceptable, in SI units, and all values that were tried."""

    ends: np.ndarray  # (2,) the outermost acceptable values
    beyond: np.ndarray  # (2,) the next values tried, which are not acceptable; NaN at a bound
    ended_by: np.ndarray  # (2,) indices into `ENDED_BY`
    apart: float  # largest distance between neighbouring values within
    probes: np.ndarray  # (n,) all values tried, sorted
    loss: np.ndarray  # (n,) of P_d, in the condition that loses most [percentage points]


class Probes(NamedTuple):
    """The values of one number that were tried, sorted, all (n,)."""

    u: np.ndarray  # in the unit cube
    loss: np.ndarray  # of P_d, in the condition that loses most [percentage points]
    usage: np.ndarray  # the loss over the allowed loss, or the worst limit ratio if that is larger
    cause: np.ndarray  # why the value is not acceptable; BOUND where it is acceptable

    def around(self, centre: float) -> tuple[int, int]:
        """Indices of the outermost acceptable values that no unacceptable one separates from `centre`."""
        middle = np.searchsorted(self.u, centre)
        failing = np.flatnonzero(self.cause != BOUND)
        below, above = failing[failing <= middle], failing[failing >= middle]
        return int(below.max(initial=-1)) + 1, int(above.min(initial=self.u.size)) - 1


Probe = Callable[[Probes, np.ndarray], Probes]  # adds probes at further values


def interval_of(
    problem: Problem, design: np.ndarray, i: int, reference: DesignJudgement, allowed_loss: float, tick: Tick
) -> Interval:
    """How far number `i` of a design may go before any condition loses more than the allowed loss or exceeds a limit.

    A design that exceeds a limit itself has an interval of zero width.

    Args:
        problem: The design problem, without scatter.
        design: The design (keys,).
        i: The index of the number.
        reference: The judgement of the design itself.
        allowed_loss: Of P_d, in any condition [percentage points].
        tick: Called with the lane-periods done.
    """
    centre = float(np.clip(problem.cube(design)[i], 0.0, 1.0))

    def values(u: np.ndarray) -> np.ndarray:
        return np.where(u == centre, design[i], problem.values(np.tile(u[:, None], len(design)))[:, i])

    def probe(probes: Probes, u: np.ndarray) -> Probes:
        new_u = np.setdiff1d(u, probes.u)
        if not new_u.size:
            return probes
        designs = np.tile(design, (new_u.size, 1))
        designs[:, i] = values(new_u)
        evaluated = _evaluated(problem, judge_designs(problem, designs, tick), reference, allowed_loss)
        columns = [np.concatenate(pair) for pair in zip(probes, (new_u, *evaluated), strict=True)]
        return Probes._make(a[np.argsort(columns[0])] for a in columns)

    probes = probe(Probes._make((np.empty(0),) * 4), np.array([centre]))
    if probes.cause[0] == BOUND:
        probes = _audited(_refined(_bracketed(probes, centre, probe), centre, probe), centre, probe)
    return _interval(probes._replace(u=values(probes.u)), design[i])


def _evaluated(
    problem: Problem, judgement: DesignJudgement, reference: DesignJudgement, allowed_loss: float
) -> tuple[np.ndarray, ...]:
    """The columns `loss`, `usage` and `cause` of `Probes`."""
    with np.errstate(invalid="ignore"):  # a run that stopped has P_d = -inf
        loss = (reference.P_d - judgement.P_d).max(axis=1)
        limits = np.maximum(judgement.v_max / problem.most_penetration, judgement.force / problem.most_force)
    failing = [~np.isfinite(judgement.objective), ~(limits <= 1), ~(loss <= allowed_loss)]
    usage = np.where(failing[0], np.inf, np.maximum(loss / allowed_loss, limits))
    return loss, usage, np.select(failing, [STOP, LIMIT, ALLOWED_LOSS], BOUND)


def _bracketed(probes: Probes, centre: float, probe: Probe) -> Probes:
    """Add values that bracket the interval, until at least half of `SEARCH_POINTS` lie within."""
    low, high = 0.0, 1.0
    for _ in range(MAX_BRACKETINGS):
        probes = probe(probes, np.linspace(low, high, SEARCH_POINTS))
        first, last = probes.around(centre)
        width = high - low
        low, high = probes.u[[max(first - 1, 0), min(last + 1, probes.u.size - 1)]]
        if high - low > width / 2:
            break
    return probes


def _refined(probes: Probes, centre: float, probe: Probe) -> Probes:
    """Add values between each end and the next value beyond it, and where the usage comes near 1."""
    for _ in range(REFINEMENTS):
        pairs = _doubtful_pairs(probes, centre)
        between = [np.linspace(probes.u[i], probes.u[i + 1], POINTS_BETWEEN + 2)[1:-1] for i in pairs]
        probes = probe(probes, np.concatenate([[centre], *between]))
    return probes


def _audited(probes: Probes, centre: float, probe: Probe) -> Probes:
    """Add values all over the interval, until they no longer shorten it."""
    for i in range(MAX_AUDITS):
        ends = probes.u[list(probes.around(centre))]
        n = SEARCH_POINTS << i
        probes = _refined(probe(probes, ends[0] + (ends[1] - ends[0]) * (np.arange(n) + 0.5) / n), centre, probe)
        if np.ptp(ends) - np.ptp(probes.u[list(probes.around(centre))]) < np.ptp(ends) / n:
            break
    return probes


def _doubtful_pairs(probes: Probes, centre: float) -> list[int]:
    """The left of each pair of neighbours between which the usage may exceed 1, the likeliest `MAX_REFINED_PAIRS`.

    It may where the largest usage nearby, plus its variation there, exceeds 1.
    """
    first, last = probes.around(centre)
    usage, size = probes.usage, probes.u.size
    worst = {i: np.inf for i in (first - 1, last) if 0 <= i < size - 1}
    for i in range(first, last):
        near = usage[max(i - 1, first) : min(i + 3, last + 1)]
        worst[i] = 2 * near.max() - near.min()
    return sorted(worst, key=lambda i: -worst[i])[: sum(w > 1 for w in worst.values())][:MAX_REFINED_PAIRS]


def _interval(probes: Probes, centre: float) -> Interval:
    """The interval around the design's own value, from probes in SI units."""
    first, last = probes.around(centre)
    if last < first:  # the design itself is not acceptable, and no other value was tried
        return Interval(probes.u[[0, 0]], probes.u[[0, 0]], probes.cause[[0, 0]], 0.0, probes.u, probes.loss)
    outside = [(first - 1, first > 0), (last + 1, last < probes.u.size - 1)]
    beyond = np.array([probes.u[i] if exists else np.nan for i, exists in outside])
    cause = np.array([probes.cause[i] if exists else BOUND for i, exists in outside], int)
    apart = float(np.diff(probes.u[first : last + 1]).max(initial=0.0))
    return Interval(probes.u[[first, last]], beyond, cause, apart, probes.u, probes.loss)


class RobustnessRequest(NamedTuple):
    """Which numbers of the best design's robustness are computed."""

    loss: float  # allowed loss of P_d [percentage points]
    at_least: float | None  # P_d whose probability is computed [percent]
    draws: int  # independent draws behind it
    starts: int  # random starts in each condition from which coexisting motions are found; 0: none
    seed: int

    def lanes(self, problem: Problem) -> int:
        """A lower estimate of the number of runs."""
        numbers = len(problem.keys) - len(problem.conditions)
        return len(problem.rows) * (3 * SEARCH_POINTS * numbers + (self.draws if problem.scattering else 0))


def robustness_request(
    scatters: bool, loss: float | None, at_least: float | None, draws: int, starts: int, seed: int = 0
) -> RobustnessRequest | None:
    """The request from the arguments of `tune`; None if it asks for nothing.

    Raises:
        InputError: A count is too small, a loss is not positive, or a probability is requested where nothing scatters.
    """
    count_argument("check_draws", draws, 2)
    count_argument("motions", starts, 0)
    if loss is not None and not 0 < loss < np.inf:
        raise InputError(f"Argument `loss` must be positive, but is {loss}.")
    if at_least is not None and not np.isfinite(at_least):
        raise InputError(f"Argument `at_least` must be a number, but is {at_least}.")
    if at_least is not None and not scatters:
        raise InputError("Argument `at_least` asks for a probability; say what scatters.")
    if not scatters and loss is None:
        return None
    return RobustnessRequest(DEFAULT_LOSS if loss is None else loss, at_least, draws, starts, seed)


def robustness(
    problem: Problem, best: np.ndarray, request: RobustnessRequest, tick: Tick
) -> tuple[dict[str, object], dict[str, object]]:
    """The values of a `Tuned` that say how robust the design `best` is, and their coordinates."""
    fixed_problem = _without_scatter(problem)
    design = np.array([*best, *(problem.scattering.others.values() if problem.scattering else ())])
    nominal = judge_designs(fixed_problem, design[None], tick)
    intervals = [interval_of(fixed_problem, design, i, nominal, request.loss, tick) for i in range(len(design))]
    values: dict[str, object] = {
        "loss": request.loss,
        "nominal_P_d": nominal.P_d[0],
        "nominal_ci": nominal.ci[0],
        "nominal_force": nominal.force[0],
        "nominal_v_max": nominal.v_max[0],
        "nominal": design,
        **_interval_values(intervals),
    }
    coords: dict[str, object] = {"number": list(fixed_problem.over)}
    if problem.scattering is not None:
        values |= _scattered(problem, best, request, tick)
        coords |= {"scattered": list(problem.scattering.keys)}
    if request.starts:
        values |= _coexisting_motions(fixed_problem, design, request)
    return values, coords


def _without_scatter(problem: Problem) -> Problem:
    """The problem without draws: numbers that only scatter become tuned ones, between the ends of their scatter."""
    scattering = problem.scattering
    if scattering is None:
        return problem
    ends = {key: scattering.ends(key, value) for key, value in scattering.others.items()}
    return problem._replace(over={**problem.over, **ends}, scattering=None)


def _interval_values(intervals: list[Interval]) -> dict[str, object]:
    """The intervals as arrays; the values tried are padded with NaN to one length."""
    longest = max(len(interval.probes) for interval in intervals)

    def filled(a):
        return np.pad(a, (0, longest - len(a)), constant_values=np.nan)

    return {
        "interval": [interval.ends for interval in intervals],
        "beyond": [interval.beyond for interval in intervals],
        "ended_by": [interval.ended_by for interval in intervals],
        "apart": [interval.apart for interval in intervals],
        "looked": [filled(interval.probes) for interval in intervals],
        "looked_loss": [filled(interval.loss) for interval in intervals],
    }


def _scattered(problem: Problem, best: np.ndarray, request: RobustnessRequest, tick: Tick) -> dict[str, object]:
    """P_d and the largest forces under independent draws of the scatter, each judged by its worst condition."""
    scattering = problem.scattering
    assert scattering is not None
    draws = scattering.redrawn(request.draws, np.random.default_rng([request.seed, 2]))
    judged = judge_designs(problem._replace(scattering=draws), best[None], tick)
    P_d = judged.P_d.reshape(len(problem.rows), request.draws).min(axis=0)
    values = {
        "half_width": scattering.half_width,
        "relative": scattering.relative,
        "places": scattering.places,
        "sampled": draws.places,
        "sampled_P_d": np.where(np.isfinite(P_d), P_d, np.nan),
        "scattered_force": judged.force[0],
        "scattered_v_max": judged.v_max[0],
    }
    if request.at_least is None:
        return values
    return {**values, **probability_values(P_d, request.at_least)}


def _coexisting_motions(fixed_problem: Problem, design: np.ndarray, request: RobustnessRequest) -> dict[str, object]:
    """The number of coexisting motions in each condition, their least P_d, and the share of undecided starts."""
    scenes = scenes_of(fixed_problem, design[None])
    plan = fixed_problem.plan
    method = method_of(plan.steps_per_period, plan.method)
    counts = []
    for i in range(len(fixed_problem.rows)):
        scene = jax.tree.map(lambda a: a[i], scenes)  # noqa: B023  called at once
        found = attractors(scene, request.starts, seed=request.seed, method=method)
        worst = np.nan if found.worst is None else found.P_d_least[found.worst]
        counts.append((len(found.share), worst, found.undecided))
    return dict(zip(("motions", "motions_worst", "motions_undecided"), zip(*counts, strict=True), strict=True))
