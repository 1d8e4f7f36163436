"""Rows of blades against what is known: python tests/studies/rows.py [opinions pairs identities energy faces].

- opinions: random rows of 3 to 8 blades, in chains and rings, against the second opinion (`row_opinions`).
- pairs: chains of two blades against the pair, by the same method.
- identities: rings of other sizes under the same interblade phase, mirrored and rotated random rings.
- energy: the balance of random rows, over the gross work of the drive.
- faces: rows with faces that are flat on each other, against stiff springs between the faces in the second opinion.
"""

import dataclasses
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import reference
import row_opinions
import side_by_side
from load_opinions import nearly_parallel
from row_reference import BLADE, INTERFACE, RowParameters, RowRun, random_row, table1_row
from row_runs import EXACT_ROW, row_scene_of, run_rows

from jaxshroud.model.modes import Status
from jaxshroud.version import __version__

SEED, PERIODS, STEPS, FINE = 7, 3, 400, 6400
NEAR = {"opinions": 1e-8, "pairs": 1e-12, "identities": 1e-11, "energy": 1e-9}  # each in its own measure
STEADY = 1e-13  # what a relative change of 1e-15 of the gap may move a pair by
SPRINGS = (1e3, 1e4, 1e5)  # between faces [N m/rad]


def deviation(got: np.ndarray, want: np.ndarray) -> float:
    """The largest difference of states (..., 6, N), over the largest of its kind."""
    size = np.abs(want).max(axis=tuple(a for a in range(want.ndim) if a != want.ndim - 2), keepdims=True)
    return float(np.max(np.abs(got - want) / np.where(size > 0, size, 1.0)))


def spread(values: list[float], near: float) -> dict[str, Any]:
    """The number of deviations, their median and largest, and how many are beyond `near`."""
    a = np.array(values)
    of = {"median": float(np.median(a)), "largest": float(a.max()), "tolerance": near}
    return {"rows": len(a), **of, "beyond": int(np.sum(~(a <= near)))}


def opinions(places: range = range(len(row_opinions.SIZES)), steps: int = FINE) -> dict[str, Any]:
    """All kept rows of these sizes."""
    off, moved, unequal, flat, late = [], [], 0, 0, []
    for place in places:
        rows = row_opinions.kept_rows(place)
        runs = run_rows([row_scene_of(row.parameters) for row in rows], row_opinions.PERIODS, steps)
        for lane, row in enumerate(rows):
            off.append(deviation(runs.motion[lane], row.samples))
            moved.append(row.moved)
            counted = np.array([runs.counts(kind)[lane] for kind in reference.COUNTS])
            flat += int(runs.counts("flat")[lane].any())
            unequal += int(not np.array_equal(counted, row.counts))
        late.extend(np.abs(runs.residual).tolist())
    told = {"events counted otherwise": unequal, "of these flat at times": flat, "largest residual": max(late)}
    return {**spread(off, NEAR["opinions"]), **told, "largest move by a nudge": max(moved), "deviations": off}


def chain_of(p: reference.Parameters) -> RowParameters:
    """A pair as a chain of two."""
    numbers = {name: getattr(p, name) for name in (*BLADE, "omega", "alpha", "l_oa", "l_ab")}
    contact = {name: (getattr(p, name),) for name in INTERFACE}
    return RowParameters(**numbers, **contact, closed=False, mistuning=(0.0, 0.0), initial=p.initial)


def pairs(count: int = 200, steps: int = STEPS) -> dict[str, Any]:
    """Random pairs, half with nearly parallel faces: those that count hardly move if a number changes by 1e-15.

    Both sum in another order. Where rounding is multiplied so much that such a change of the gap, to either side, or of
    the contact stiffness moves the pair itself by more than `STEADY`, nothing can be asked.
    """
    draws = reference.random_parameters, nearly_parallel
    drawn = [draws[seed % 2](np.random.default_rng([SEED, seed])) for seed in range(count)]
    changes = ("gap", 1e-15), ("gap", -1e-15), ("k", 1e-15)
    changed = [[dataclasses.replace(p, **{name: getattr(p, name) * (1 + by)}) for p in drawn] for name, by in changes]
    of_pairs = lambda pairs: side_by_side.run([side_by_side.scene_of(p) for p in pairs], PERIODS, steps, EXACT_ROW)
    pair, row = of_pairs(drawn), run_rows([row_scene_of(chain_of(p)) for p in drawn], PERIODS, steps)
    ok = np.asarray(pair.last.status) == Status.OK
    alike = np.array_equal(pair.last.status, row.last.status[:count])
    want, *moved = (side_by_side.ends(runs).reshape(count, 6, 2) for runs in (pair, *map(of_pairs, changed)))
    off, *by = [np.array([deviation(a[i], want[i]) for i in np.flatnonzero(ok)]) for a in (row.motion[:, -1], *moved)]
    all_pairs = {"rows": len(off), "beyond": int(np.sum(off > NEAR["pairs"])), "alike statuses": alike}
    steady = off[np.max(by, axis=0) < STEADY].tolist()
    return {**spread(steady, NEAR["pairs"]), "all": all_pairs, "deviations": off.tolist()}


def identities(sizes: tuple[int, ...] = (12, 24), periods: int = 5) -> dict[str, Any]:
    """Waves of a quarter turn and of half a turn from blade to blade, in rings of several sizes."""
    ring = lambda blades, order, **numbers: table1_row(blades, True, order, **numbers)
    end = lambda p: run_rows([row_scene_of(p)], periods, STEPS).motion[0, -1]
    found = {}
    quarter, opposite = end(ring(4, 1)), end(ring(4, 2))
    for blades in sizes:
        many = blades // 4
        found[f"engine order {many} of {blades}"] = deviation(end(ring(blades, many)), np.tile(quarter, many))
        wrong = ring(blades, many)
        wrong = dataclasses.replace(wrong, gap=(wrong.gap[0] + 1e-9, *wrong.gap[1:]))
        found[f"engine order {many} of {blades}, a gap wider by 1 nm"] = deviation(end(wrong), np.tile(quarter, many))
    for blades in (2, 6, *sizes):
        found[f"opposite, {blades}"] = deviation(end(ring(blades, blades // 2))[:, :2], opposite[:, :2])
    same = {name: value for name, value in found.items() if "nm" not in name}
    return {**spread(list(same.values()), NEAR["identities"]), "deviations": found}


def energy(
    count: int = 216, sizes: tuple[tuple[int, bool], ...] = row_opinions.SIZES, periods: int = 10
) -> dict[str, Any]:
    """Random rows, a third with nearly parallel faces."""
    residuals, ended, flat, each = [], 0, 0, math.ceil(count / len(sizes))
    for size in sizes:
        rngs = [np.random.default_rng([SEED, *size, i]) for i in range(each)]
        drawn = [random_row(rng, *size, i % 3 == 0) for i, rng in enumerate(rngs)]
        runs = run_rows([row_scene_of(p) for p in drawn], periods, 4 * STEPS)
        ok = np.asarray(runs.last.status)[:each] == Status.OK
        residuals.extend(np.abs(runs.residual[ok]).tolist())
        ended += int(np.sum(~ok))
        flat += int(np.sum(runs.counts("flat")[:each].any(axis=1)))
    return {**spread(residuals, NEAR["energy"]), "ended early": ended, "with flat faces": flat}


def faces(count: int = 12, steps: int = 20_000) -> dict[str, Any]:
    """Nearly parallel rows of three that become flat: the difference falls as the compliance of the springs does."""
    drawn = [random_row(np.random.default_rng([SEED, 99, i]), 3, False, True) for i in range(8 * count)]
    coarse = run_rows([row_scene_of(p) for p in drawn], PERIODS, 1600)
    flat = coarse.counts("flat")[: len(drawn)].all(axis=1) & (np.asarray(coarse.last.status)[: len(drawn)] == 0)
    chosen = [drawn[i] for i in np.flatnonzero(flat)[:count]]
    exact = run_rows([row_scene_of(p) for p in chosen], PERIODS, steps).motion[:, -1]
    found = np.array([[against_spring(p, want, k) for k in SPRINGS] for p, want in zip(chosen, exact, strict=True)])
    known = found[np.isfinite(found).all(axis=1)]
    slope = np.log10(known[:, 0] / known[:, -1]) / (len(SPRINGS) - 1)
    return {
        "springs [N m/rad]": SPRINGS,
        "rows": len(known),
        "given up": len(found) - len(known),
        "median difference": np.median(known, axis=0).tolist(),
        "share that falls at least threefold a decade": float(np.mean(slope > np.log10(3))),
        "order, quartiles": np.quantile(slope, (0.25, 0.5, 0.75)).tolist(),
        "differences": found.tolist(),
    }


def against_spring(p: RowParameters, want: np.ndarray, k_face: float) -> float:
    """The difference of the second opinion with springs between faces; NaN where it gives up."""
    run = RowRun(dataclasses.replace(p, k_face=k_face), 1e-9)
    run.advance(PERIODS * 2 * math.pi / p.omega)
    return deviation(run.y[: 6 * run.n].reshape(6, run.n), want) if run.status == "ok" else math.nan


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "opinions": opinions,
    "pairs": pairs,
    "identities": identities,
    "energy": energy,
    "faces": faces,
}


def main() -> None:
    """Measure the parts that were asked for, or all, and write."""
    jax.config.update("jax_enable_x64", True)
    path = Path(__file__).with_suffix(".json")
    told: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    told |= {"command": "python tests/studies/rows.py", "version": __version__, "periods": PERIODS, "steps": STEPS}
    for name in sys.argv[1:] or PARTS:
        told[name] = PARTS[name]()
        print(name, json.dumps({k: v for k, v in told[name].items() if not k.endswith(("deviations", "differences"))}))
        path.write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
