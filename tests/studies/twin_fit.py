"""Twin experiments of `fit` with time histories: python tests/studies/twin_fit.py [--histories N] [--seeds N]

Two to five numbers are to be found in 20 noisy histories (1 %) of two to four periods with contact, half of them of
light blocks, made by the plain reference integrator (`twin_histories.py`); half of them do not tell their noise. Each
is fitted with three seeds of the search. A fit counts as *found* where chi^2, with the true noise, is at most 5 % above
that at the truth. A number is *claimed* where it has an interval, and *held* where that holds the truth; its width is
compared with that of the linear interval at the truth. Seeds are *alike* where all their numbers agree to a tenth of
these intervals. `twin_fit.json` has every fit.
"""

import argparse
import json
import math
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.stats import norm
from twin_histories import History, drawn

import jaxshroud as js
from jaxshroud.io.measurements import measurements_from
from jaxshroud.verbs.arguments import resolve_options
from jaxshroud.verbs.fit import fit_corners, fit_problem, model_of
from jaxshroud.verbs.lanes import with_tangents

HISTORIES, SEEDS, SEED = 20, 3, 7
METHOD = js.RungeKutta(steps=200)
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
    march = with_tangents(resolve_options(history.scene, method=METHOD), fit_corners(problem))
    _, slopes = model_of(problem, data, march, 1)(problem.cube(np.array([[*history.truth.values()]])))
    slopes = (slopes[0] / history.sigma[:, None]).reshape(-1, len(history.truth))
    half = norm.ppf(0.975) * np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)))
    return Truth(float(np.sum(((history.exact - data.values) / history.sigma) ** 2)), half)


def cube(history: History, values: Any) -> np.ndarray:
    """Numbers in the unit cube: the logarithms of positive bounds."""
    low, high = np.log(np.array([*history.bounds.values()])).T
    return (np.log(np.asarray(values, float)) - low) / (high - low)


def told(history: History, truth: Truth, seed: int) -> dict[str, Any]:
    """What became of one fit."""
    start = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = js.fit(history.scene, history.table, history.bounds, seed=seed, method=METHOD)
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
        "evaluations": found.evaluations,
        "seconds": round(time.monotonic() - start, 1),
    }


def of_history(history: History, seeds: int) -> dict[str, Any]:
    """What became of the fits of a history."""
    truth = truth_of(history)
    fits = [told(history, truth, seed) for seed in range(seeds)]
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
        "claimed though seeds are unlike": sum(claim for fit in unlike for claim in fit["claimed"]),
        "widest claimed over linear": round(max(widths, default=math.nan), 2),
        "longest fit [s]": max(fit["seconds"] for fit in fits),
    }


def figures(histories: list[History], seeds: int) -> dict[str, Any]:
    """The counts, and every fit."""
    each = []
    for history in histories:
        each.append(of_history(history, seeds))
        print(json.dumps(each[-1]), flush=True)
    return {**counts(each), "each": each}


def main() -> None:
    """All histories."""
    parser = argparse.ArgumentParser()
    for name, default in {"histories": HISTORIES, "seeds": SEEDS, "seed": SEED}.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    js.cache_compilations()
    words = f"--histories {asked.histories} --seeds {asked.seeds} --seed {asked.seed}"
    result = {"command": f"python tests/studies/twin_fit.py {words}", "version": js.__version__}
    result |= figures(drawn(asked.histories, asked.seed), asked.seeds)
    print(json.dumps(result | {"each": ...}, default=str))
    Path(__file__).with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
