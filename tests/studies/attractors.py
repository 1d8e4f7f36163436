"""Shares of coexisting motions from 256 starts against those of 4,096 others: python tests/studies/attractors.py.

Scenes are drawn as those of `branches.py`; one in ten is of the whole model. The first 22 in which
64 starts find at least two motions are studied: 4,352 starts are assigned to motions; the 95 % intervals of the shares
among the first 256 are to hold the shares among the other 4,096. Motions of equal period number that are told apart are
counted, and how far they are from each other.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from branches import ALL, METHOD, STEPS, X_RIGID, Drawn, X, drawn, kept

import jaxshroud as js
from jaxshroud.march.method import FAST, choices
from jaxshroud.orbits.attractors import FoundAttractors, attractors_of
from jaxshroud.orbits.shooting import ShootingOptions
from jaxshroud.orbits.starts import START_SPREAD, random_starts
from jaxshroud.results.attractors import share_interval
from jaxshroud.signals.orbit_distance import set_distance

SEED, DRAWN, SCENES, FEW, SAMPLE, MANY, MOST = 1, 400, 22, 64, 256, 4096, 768
COARSE = 80  # RK4 steps a period of bending in x alone
MODELS = [*([X_RIGID, X] * 5)[:-1], ALL]


def found_in(one: Drawn, starts: int, seed: int) -> FoundAttractors:
    """What a scene ends on from random starts."""
    scene = one.scene
    states = jax.tree.map(np.asarray, random_starts(scene, starts, seed, START_SPREAD))
    how = (
        ShootingOptions(STEPS, 1e-11, choices(METHOD)) if one.model == ALL[0] else ShootingOptions(COARSE, 1e-11, FAST)
    )
    return attractors_of(scene, states, MOST, how, lambda _: None)  # type: ignore[arg-type]


def row(one: Drawn, sample: int, many: int, seed: int) -> dict[str, Any]:
    """One scene: intervals from a sample of starts, and shares among many others."""
    found = found_in(one, sample + many, seed)
    number = len(found.attractors)
    first, others = (
        np.bincount(part[part >= 0], minlength=number) for part in (found.label[:sample], found.label[sample:])
    )
    low, high = share_interval(first, sample)
    truth = others / many
    alike = [
        (a, b)
        for i, a in enumerate(found.attractors)
        for b in found.attractors[:i]
        if a.q == b.q and a.kind == b.kind == "periodic"
    ]
    return {
        "model": one.model,
        "overrides": one.overrides,
        "motions": [f"period {a.q}" if a.kind == "periodic" else a.kind for a in found.attractors],
        "P_d": [None if a.cycle is None else a.cycle.P_d for a in found.attractors],
        "shares of the sample": (first / sample).tolist(),
        "intervals": np.stack([low, high], axis=-1).tolist(),
        "shares of the others": truth.tolist(),
        "covered": [bool(a <= s <= b) for a, s, b in zip(low, truth, high, strict=True)],
        "undecided or stopped": float(np.mean(found.label < 0)),
        "pairs of equal period number": len(alike),
        "least distance of such a pair": min((set_distance(a.points, b.points) for a, b in alike), default=None),
    }


def studied(scenes: list[Drawn], wanted: int, sample: int, many: int, few: int = FEW) -> Iterator[dict[str, Any]]:
    """What is known after each scene in which several motions are found."""
    rows: list[dict[str, Any]] = []
    for i, one in enumerate(scenes):
        if len(found_in(one, few, 1000 + i).attractors) < 2:
            continue
        rows.append(row(one, sample, many, i))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        covered = [c for r in rows for c in r["covered"]]
        yield {
            "scenes tried": i + 1,
            "scenes with several motions": len(rows),
            "by model": Counter(r["model"] for r in rows),
            "shares": len(covered),
            "covered": float(np.mean(covered)),
            "scenes with motions of equal period number": sum(r["pairs of equal period number"] > 0 for r in rows),
            "undecided or stopped, most": max(r["undecided or stopped"] for r in rows),
            "rows": rows,
        }
        if len(rows) == wanted:
            return


def main() -> None:
    """Measure and write."""
    jax.config.update("jax_enable_x64", True)
    told = {"command": "python tests/studies/attractors.py", "version": js.__version__, "seed": SEED}
    found = studied(drawn(DRAWN, SEED, MODELS), SCENES, SAMPLE, MANY)
    kept(found, told | {"starts": [SAMPLE, MANY]}, Path(__file__).with_suffix(".json"))


if __name__ == "__main__":
    main()
