"""Whether what `tune` says of tolerances holds: five designs, each looked at again by what had no part in the search.

    python tests/studies/tolerance.py

- Every interval in which P_d loses at most `loss` percentage points is swept at ten times as many values as the largest
  distance between neighbours that the search looked at makes of it, none of them its own. Told is how many lose more,
  and how much; limits count likewise.
- The next value beyond each end that is no bound is swept: it should lose more.
- The 95 % interval of the probability of a stated P_d is compared with the share of 2,000 other random draws that meet
  it in every condition, and so are those of 9 more seeds of the same draws: a share of 2,000 draws has an error of its
  own, so that somewhat less than 95 % of the intervals are to cover it. Fisher's test takes both errors into account.

Sweeps are `js.sweep` of scenes made from tables, with the periods, steps and method of the search. Two of the designs
have blocks of a realistic small inertia, and moments of 0.1 and 1 N m. The motion of the first is chaotic.
"""

import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.stats import fisher_exact

import jaxshroud as js
from jaxshroud.results.attractors import share_interval
from jaxshroud.verbs.design_problem import judge_designs
from jaxshroud.version import __version__

DRAWS, FINER, SEEDS = 2000, 10, 10
SHORT = {"search": js.SearchOptions(scan=16, n_starts=2, updates=4), "draws": 8, "check_draws": 512}
# Scene with overrides, what is tuned, what scatters, what is stated; chosen for variety, P_d after a first look.
DESIGNS: dict[str, tuple[str, list[str], dict[str, Any]]] = {
    "small moment": (
        "fig09_best",
        [],
        {
            "over": {"shroud.gap": (5e-6, 1e-4), "contact.gamma": (0.5, 6.0)},
            "scatters": {"shroud.gap": 5e-6, "contact.gamma": "3%"},
            "at_least": 50.5,
            "periods": (16, 16, 100),
        },
    ),
    "ten newton metres": (
        "table1",
        ["drive.M_0=10"],
        {
            "over": {"shroud.gap": (5e-6, 2e-4)},
            "scatters": {"shroud.gap": 1e-5, "drive.F_0": "10%", "blades.m[1]": "5%"},
            "goal": "worst",
            "at_least": 41.0,
            "periods": (24, 24, 100),
        },
    ),
    "bending only, two loads, a limit of force": (
        "table1",
        ['parts.motion=["x"]'],
        {
            "over": {"contact.gamma": (0.2, 8.0)},
            "conditions": {"drive.F_0": [50.0, 60.0]},
            "most_force": 120.0,
            "scatters": {"shroud.gap": 5e-6, "contact.gamma": "10%"},
            "at_least": 45.0,
            "periods": (32, 32, 100),
        },
    ),
    "block's own inertia, 0.1 N m": (
        "table1_light",
        ["drive.M_0=0.1"],
        {
            "over": {"shroud.gap": (5e-6, 1e-4)},
            "scatters": {"shroud.gap": 1e-5, "drive.F_0": "10%"},
            "at_least": 41.2,
            "periods": (16, 8, 200),
        },
    ),
    "block's own inertia, 1 N m": (
        "table1_light",
        ["drive.M_0=1"],
        {
            "over": {"contact.gamma": (0.5, 8.0)},
            "scatters": {"contact.gamma": "5%", "friction.mu": "20%"},
            "at_least": 49.5,
            "periods": (16, 8, 200),
        },
    ),
}


def tuned_design(name: str) -> tuple[js.Tuned, js.Scene, dict[str, Any]]:
    """A design with what is known of its robustness, its scene and how it is marched."""
    scene, more, asked = DESIGNS[name]
    transient, kept, steps = asked["periods"]
    how = {"transient": transient, "n_periods": kept, "method": js.RungeKutta(steps=steps)}
    wanted = {key: value for key, value in asked.items() if key != "periods"}
    own = js.load(scene, more).scene
    return js.tune(own, wanted.pop("over"), **wanted, **SHORT, motions=8, **how), own, how


def lanes(tuned: js.Tuned, own: js.Scene, table: dict[str, np.ndarray]) -> js.Scene:
    """Scenes of the design with the numbers of a table, (conditions, rows)."""
    n = len(next(iter(table.values())))
    rows = [{**tuned.design, **dict(zip(tuned.conditions, row, strict=True))} for row in tuned.problem.rows.tolist()]
    parts = [{**{key: np.full(n, value) for key, value in row.items()}, **table} for row in rows]
    columns = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return jax.tree.map(lambda a: a.reshape(len(rows), n, *a.shape[1:]), js.scenes_from(columns, own))


def P_d_of(tuned: js.Tuned, scenes: js.Scene, how: dict[str, Any]) -> np.ndarray:
    """P_d (conditions, rows), -inf of runs that stop."""
    found = js.sweep(scenes, keep_samples=False, **how)
    return np.where(found.status == 0, found.P_d, -np.inf)


def used(tuned: js.Tuned, own: js.Scene, how: dict[str, Any], table: dict[str, np.ndarray]) -> np.ndarray:
    """Share of what is allowed, of loss or of force, that each row uses in its worst condition (rows,)."""
    scenes = lanes(tuned, own, table)
    share = (tuned.nominal_P_d[:, None] - P_d_of(tuned, scenes, how)).max(axis=0) / tuned.loss
    if np.isfinite(tuned.most_force):  # from the first period on
        whole = {**how, "transient": 0, "n_periods": how["transient"] + how["n_periods"]}
        forces = js.sweep(scenes, keep_samples=False, forces=True, **whole).N_max
        share = np.maximum(share, forces.max(axis=0) / tuned.most_force)
    return share


def interval_judged(tuned: js.Tuned, own: js.Scene, how: dict[str, Any], i: int, key: str) -> dict[str, Any]:
    """One interval against a dense sweep of it, and against what lies beyond."""
    within, looked = tuned.intervals[key], tuned.looked[i]
    inside = looked[(looked >= within.low) & (looked <= within.high)]
    n = int(np.ceil(FINER * (within.high - within.low) / within.apart))
    dense = within.low + (within.high - within.low) * (np.arange(n) + 0.5) / n
    share = used(tuned, own, how, {key: dense})
    ends = np.array([value for value in within.beyond if np.isfinite(value)])
    outside = used(tuned, own, how, {key: ends}) if ends.size else np.zeros(0)
    return {
        **{name: getattr(within, name) for name in ("at", "low", "high", "ended_by", "apart")},
        "looked at within": int(inside.size),
        "swept": int(dense.size),
        "lose more": int((share > 1).sum()),
        "most that is used within": float(share.max(initial=0.0)),
        "beyond": ends.tolist(),
        "lose more beyond": int((outside > 1).sum()),
    }


def probability_judged(tuned: js.Tuned, own: js.Scene, how: dict[str, Any], seed: int, seeds: int) -> dict[str, Any]:
    """The stated probability against random draws that the search knows nothing of, and those of other seeds."""
    random, samples = np.random.default_rng(seed), len(tuned.sampled_P_d)
    values = {key: tuned.intervals[key].at for key in tuned.scatters}
    table = {key: random.uniform(*ends, DRAWS) for key, ends in tuned.ends_of_scatter(values).items()}
    met = int((P_d_of(tuned, lanes(tuned, own, table), how).min(axis=0) >= tuned.at_least).sum())
    stated = [met_of(tuned, samples, other) for other in range(seeds)]
    low, high = share_interval(np.array(stated), samples)
    counts = [[met, DRAWS - met], [stated[0], samples - stated[0]]]
    return {
        **{name: getattr(tuned, name) for name in ("at_least", "probability", "probability_low", "probability_high")},
        "samples": samples,
        "draws": DRAWS,
        "share of draws": met / DRAWS,
        "covered": bool(tuned.probability_low <= met / DRAWS <= tuned.probability_high),
        "p of Fisher's test": float(fisher_exact(counts).pvalue),
        "seeds": seeds,
        "seeds whose interval covers": int(np.sum((low <= met / DRAWS) & (met / DRAWS <= high))),
    }


def met_of(tuned: js.Tuned, samples: int, seed: int) -> int:
    """How many draws meet what is asked for, had the tuning had another seed for them."""
    scattering = tuned.problem.scattering.redrawn(samples, np.random.default_rng([seed, 2]))
    judged = judge_designs(tuned.problem._replace(scattering=scattering), tuned.best[None], lambda _: None)
    return int((judged.P_d.reshape(-1, samples).min(axis=0) >= tuned.at_least).sum())


def judged(name: str, seed: int) -> dict[str, Any]:
    """All that is said of one design, judged."""
    tuned, own, how = tuned_design(name)
    return {
        "scene": [DESIGNS[name][0], *DESIGNS[name][1]],
        "design": tuned.design,
        "objective": tuned.objective,
        "confirmed": tuned.confirmed,
        "nominal P_d": tuned.nominal_P_d.tolist(),
        "motions": tuned.motions.tolist(),
        "worst motion": tuned.motions_worst.tolist(),
        "intervals": {k: interval_judged(tuned, own, how, i, k) for i, k in enumerate(tuned.intervals)},
        "probability": probability_judged(tuned, own, how, seed, SEEDS),
    }


def main() -> None:
    """Judge all designs and write."""
    jax.config.update("jax_enable_x64", True)
    told = {"command": "python tests/studies/tolerance.py", "version": __version__, "designs": {}}
    for seed, name in enumerate(DESIGNS, 100):
        told["designs"][name] = judged(name, seed)
        print(name, json.dumps(told["designs"][name], indent=1), flush=True)
        print(f"{time.process_time():.0f} s of CPU", flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
