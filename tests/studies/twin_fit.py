"""Twin experiments of `fit` with time histories: python tests/studies/twin_fit.py [--histories N] [--seed S ...]

Two to five numbers are to be found in noisy histories (1 %) of two to four periods with contact, half of them of light
blocks, made by the plain reference integrator (`twin_histories.py`); half of them do not tell their noise. So many are
drawn of each seed, and each is fitted with `--seeds` seeds of the search. A fit counts as *found* where chi^2, with the
true noise, is at most 5 % above that at the truth. A number is *claimed* where it has an interval, and *held* where
that holds the truth; its width is compared with that of the linear interval at the truth. Seeds are *alike* where all
their numbers agree to a tenth of these intervals. `twin_fit.json` has every fit. With `--valley` the fits begin in the
valley of the truth, which costs a sixth and tells of intervals alone (`twin_fit_valley.json`).
"""

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import jax
import numpy as np
from scipy.stats import norm
from twin_histories import History, drawn

import jaxshroud as js
from jaxshroud.fitting.least_squares import Estimate, Minimum, Misfit, estimate_at
from jaxshroud.fitting.searches import remarched
from jaxshroud.io.measurements import measurements_from
from jaxshroud.march.method import FAST
from jaxshroud.verbs import fit as verb
from jaxshroud.verbs.arguments import plan_march, resolve_options
from jaxshroud.verbs.fit import fit_problem
from jaxshroud.verbs.fit_models import HistoryModel, fit_corners, model_of

HISTORIES, SEEDS, DRAWN = 40, 1, (101, 102, 103)
METHOD = js.Taylor(order=14, tolerance=1e-10)  # that of accuracy 1e-6
FOUND = 1.05  # chi^2 over that at the truth
WIDEST = 3.0  # intervals over the linear ones at the truth
SAME = 0.1  # of the linear interval's half width


class Truth(NamedTuple):
    """What the truth says of the data."""

    chi2: float
    half: np.ndarray  # half widths of the linear intervals, in the unit cube (keys,)


def truth_of(history: History) -> Truth:
    """chi^2 and the linear intervals at the truth, with the true noise."""
    data = measurements_from(history.table)
    problem = fit_problem(history.scene, data, history.bounds)
    march = plan_march(resolve_options(history.scene, method=METHOD), fit_corners(problem), FAST, tangents=True)
    model = model_of(problem, data, march, 1)
    assert isinstance(model, HistoryModel)
    _, slopes = model.refined()(problem.cube(np.array([[*history.truth.values()]])))
    slopes = (slopes[0] / history.sigma[:, None]).reshape(-1, len(history.truth))
    half = norm.ppf(0.975) * np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)))
    return Truth(float(np.sum(((history.exact - data.values) / history.sigma) ** 2)), half)


def cube(history: History, values: Any) -> np.ndarray:
    """Numbers in the unit cube: the logarithms of positive bounds."""
    low, high = np.log(np.array([*history.bounds.values()])).T
    return (np.log(np.asarray(values, float)) - low) / (high - low)


def fitted(history: History, seed: int) -> js.Fit:
    """The fit by the verb."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return js.fit(history.scene, history.table, history.bounds, seed=seed, method=METHOD)


def fitted_in_valley(history: History, seed: int) -> js.Fit:
    """The fit that a search ends with where it finds the valley of the truth."""

    def in_valley(misfit: Misfit, at: np.ndarray, *_: Any) -> Estimate:
        u = cube(history, [*history.truth.values()])
        return remarched(estimate_at(misfit, [Minimum(u, misfit.chi2(u))]), at)

    with mock.patch.object(verb, "estimate_of_history", in_valley):
        return fitted(history, seed)


def told(history: History, truth: Truth, seed: int, fit: Callable[[History, int], js.Fit]) -> dict[str, Any]:
    """What became of one fit."""
    start = time.process_time()
    found = fit(history, seed)
    numbers, noise = found.numbers, history.sigma
    low, high = (cube(history, [getattr(n, end) for n in numbers.values()]) for end in ("low", "high"))
    error = cube(history, found.best) - cube(history, [*history.truth.values()])
    return {
        "chi2 over that at the truth": float(np.sum(((found.fitted - found.measured) / noise) ** 2)) / truth.chi2,
        "error over the half width": (error / truth.half).tolist(),
        "claimed": [n.is_determined for n in numbers.values()],
        "held": [n.holds(history.truth[key]) for key, n in numbers.items()],
        "width": ((high - low) / 2 / truth.half).tolist(),
        "cube": cube(history, found.best).tolist(),
        "notes": list(found.notes),
        "steps a period": found.steps_per_period,
        "evaluations": found.evaluations,
        "processor seconds": round(time.process_time() - start, 1),
    }


def of_history(history: History, seeds: int, fit: Callable[[History, int], js.Fit] = fitted) -> dict[str, Any]:
    """What became of the fits of a history."""
    truth = truth_of(history)
    fits = [told(history, truth, seed, fit) for seed in range(seeds)]
    places = np.array([fit["cube"] for fit in fits])
    return {
        "numbers": list(history.truth),
        "periods": history.periods,
        "values": int(np.size(history.exact)),
        "chi2 at the truth": truth.chi2,
        "half width at the truth": truth.half.tolist(),
        "seeds alike": bool(np.all(np.ptp(places, axis=0) <= SAME * truth.half)),
        "fits": fits,
    }


def counts(histories: list[dict[str, Any]]) -> dict[str, Any]:
    """How many are found, claimed and held."""
    fits = [fit for one in histories for fit in one["fits"]]
    of_all = lambda name: [value for fit in fits for value in fit[name]]
    claimed = of_all("claimed")
    widths = [w for w, claim in zip(of_all("width"), claimed, strict=True) if claim]
    unlike = [fit for one in histories if not one["seeds alike"] for fit in one["fits"]]
    return {
        "histories": len(histories),
        "found by all seeds, alike": sum(
            one["seeds alike"] and all(fit["chi2 over that at the truth"] <= FOUND for fit in one["fits"])
            for one in histories
        ),
        "numbers": len(claimed),
        "claimed": sum(claimed),
        "claimed and held": sum(of_all("held")),
        "fits all of whose intervals miss": sum(any(fit["claimed"]) and not any(fit["held"]) for fit in fits),
        "fits without an interval": sum(not any(fit["claimed"]) for fit in fits),
        "claimed though seeds are unlike": sum(claim for fit in unlike for claim in fit["claimed"]),
        "widest claimed over linear": round(max(widths, default=math.nan), 2),
        "processor seconds": round(sum(fit["processor seconds"] for fit in fits)),
    }


def figures(
    histories: Iterable[tuple[int, History]], seeds: int, fit: Callable[[History, int], js.Fit] = fitted
) -> Iterator[dict[str, Any]]:
    """The counts and every fit so far, after each of the histories, which come with the seeds that drew them."""
    each = []
    for seed, history in histories:
        each.append({"seed": seed, **of_history(history, seeds, fit)})
        print(json.dumps(each[-1]), flush=True)
        by_seed = {n: counts([one for one in each if one["seed"] == n]) for n in sorted({one["seed"] for one in each})}
        yield {**counts(each), "by seed": by_seed, "each": each}


def in_turn(count: int, seeds: Sequence[int]) -> Iterator[tuple[int, History]]:
    """So many histories of each seed, one of each in turn."""
    for histories in zip(*(drawn(count, seed) for seed in seeds), strict=True):
        yield from zip(seeds, histories, strict=True)


def main() -> None:
    """All histories; what is known is written after each of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--histories", type=int, default=HISTORIES)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--seed", type=int, nargs="+", default=DRAWN)
    parser.add_argument("--valley", action="store_true", help="in the valley of the truth, without a search")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    js.cache_compilations()
    fit, name = (fitted_in_valley, "twin_fit_valley.json") if asked.valley else (fitted, "twin_fit.json")
    drawn_by = " ".join(map(str, asked.seed))
    words = f"{'--valley ' * asked.valley}--histories {asked.histories} --seeds {asked.seeds} --seed {drawn_by}"
    head = {"command": f"python tests/studies/twin_fit.py {words}", "version": js.__version__}
    for result in figures(in_turn(asked.histories, asked.seed), asked.seeds, fit):
        Path(__file__).with_name(name).write_text(json.dumps(head | result, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
