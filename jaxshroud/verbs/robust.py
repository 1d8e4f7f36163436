"""How robust a tuned design is: tolerances, the probability of a wanted P_d under the scatter, coexisting motions."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Tick
from jaxshroud.results.attractors import share_interval
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.verbs.attractors import attractors
from jaxshroud.verbs.design import Problem, judge_designs, scenes_of
from jaxshroud.verbs.intervals import PLACES, Interval, interval_of

LOSS = 1.0  # percentage points, where numbers scatter and nothing is said


class Wanted(NamedTuple):
    """What is asked of the best design."""

    loss: float  # of P_d, that may be lost [percentage points]
    at_least: float | None  # P_d whose probability is asked for [percent]
    samples: int  # independent draws behind it
    starts: int  # random starts in each condition that coexisting motions are looked for from; 0: not
    seed: int

    def lanes(self, problem: Problem) -> int:
        """Runs that it takes, at least and about."""
        numbers = len(problem.keys) - len(problem.conditions)
        return len(problem.rows) * (3 * PLACES * numbers + (self.samples if problem.scattering else 0))


def wanted_of(
    scatters: bool, loss: float | None, at_least: float | None, samples: int, starts: int, seed: int = 0
) -> Wanted | None:
    """What is asked of the best design; None if nothing is.

    Raises:
        InputError: A count is too small, a loss is not positive, or a probability is asked for where nothing scatters.
    """
    count_argument("samples", samples, 2)
    count_argument("motions", starts, 0)
    if loss is not None and not 0 < loss < np.inf:
        raise InputError(f"Argument `loss` must be positive, but is {loss}.")
    if at_least is not None and not np.isfinite(at_least):
        raise InputError(f"Argument `at_least` must be a number, but is {at_least}.")
    if at_least is not None and not scatters:
        raise InputError("Argument `at_least` asks for a probability; say what scatters by `tolerance` or `spread`.")
    if not scatters and loss is None:
        return None
    return Wanted(LOSS if loss is None else loss, at_least, samples, starts, seed)


def robustness(problem: Problem, best: np.ndarray, wanted: Wanted, tick: Tick) -> tuple[dict[str, Any], dict[str, Any]]:
    """Numbers of a `Tuned` that say how robust the design `best` is, and coordinates of theirs."""
    whole = _without_scatter(problem)
    design = np.array([*best, *(problem.scattering.others.values() if problem.scattering else ())])
    own = judge_designs(whole, design[None], tick)
    ranges = [interval_of(whole, design, i, own, wanted.loss, tick) for i in range(len(design))]
    values: dict[str, Any] = {
        "loss": wanted.loss,
        "nominal_P_d": own.P_d[0],
        "nominal_ci": own.ci[0],
        "nominal_force": own.force[0],
        "nominal_v_max": own.v_max[0],
        "nominal": design,
        **_ranges(ranges),
    }
    coords: dict[str, Any] = {"number": list(whole.over)}
    if problem.scattering is not None:
        values |= _scattered(problem, best, wanted, tick)
        coords |= {"scattered": list(problem.scattering.keys)}
    if wanted.starts:
        values |= _motions(whole, design, wanted)
    return values, coords


def _without_scatter(problem: Problem) -> Problem:
    """The same without draws; numbers that only scatter are tuned ones, between the ends of their scatter."""
    scattering = problem.scattering
    if scattering is None:
        return problem
    ends = {key: scattering.ends(key, value) for key, value in scattering.others.items()}
    return problem._replace(over={**problem.over, **ends}, scattering=None)


def _ranges(ranges: list[Interval]) -> dict[str, Any]:
    """Intervals as arrays; what was looked at is filled up to one length."""
    longest = max(len(one.looked) for one in ranges)
    filled = lambda a: np.pad(a, (0, longest - len(a)), constant_values=np.nan)  # noqa: E731
    return {
        "interval": [one.ends for one in ranges],
        "beyond": [one.beyond for one in ranges],
        "ended_by": [one.ended_by for one in ranges],
        "apart": [one.apart for one in ranges],
        "looked": [filled(one.looked) for one in ranges],
        "looked_loss": [filled(one.loss) for one in ranges],
    }


def _scattered(problem: Problem, best: np.ndarray, wanted: Wanted, tick: Tick) -> dict[str, Any]:
    """What independent draws of the scatter come to, each judged by its worst condition."""
    scattering = problem.scattering
    assert scattering is not None
    draws = scattering.again(wanted.samples, np.random.default_rng([wanted.seed, 2]))
    judged = judge_designs(problem._replace(scattering=draws), best[None], tick)
    P_d = judged.P_d.reshape(len(problem.rows), wanted.samples).min(axis=0)
    values = {
        "half_width": scattering.half_width,
        "relative": scattering.relative,
        "places": scattering.places,
        "sampled": draws.places,
        "sampled_P_d": np.where(np.isfinite(P_d), P_d, np.nan),
        "scattered_force": judged.force[0],
        "scattered_v_max": judged.v_max[0],
    }
    if wanted.at_least is None:
        return values
    met = np.array([np.sum(P_d >= wanted.at_least)])
    low, high = (float(end[0]) for end in share_interval(met, wanted.samples))
    share = {"probability": met[0] / wanted.samples, "probability_low": low, "probability_high": high}
    return {**values, "at_least": wanted.at_least, **share}


def _motions(whole: Problem, design: np.ndarray, wanted: Wanted) -> dict[str, Any]:
    """The motions that coexist in each condition, and the worst of them."""
    scenes = scenes_of(whole, design[None])
    told = []
    for i in range(len(whole.rows)):
        one = jax.tree.map(lambda a: a[i], scenes)  # noqa: B023
        march = {"steps_per_period": whole.plan.steps_per_period, "method": whole.plan.method}
        seen = attractors(one, wanted.starts, seed=wanted.seed, **march)
        worst = np.nan if seen.worst is None else seen.P_d_least[seen.worst]
        told.append((len(seen.share), worst, seen.undecided))
    return dict(zip(("motions", "motions_worst", "motions_undecided"), zip(*told, strict=True), strict=True))
