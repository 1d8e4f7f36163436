"""Do runs still give the numbers that are stored? python tests/studies/unchanged.py

`--store` runs `reference_runs` with the code at hand and writes them to `unchanged.npz`. Without it they are run again
and compared; `unchanged.json` tells what was found, and the exit status is 1 if a run breaks its rule. Numbers that are
the same bit by bit are counted in any case: elsewhere than where they were stored, rounding may differ.

| rule | held to |
|---|---|
| one period | 1e-12 of the size of each quantity (float32: 1e-4), equal event counts |
| few periods | 1e-10 of that size (1e-3), equal event counts |
| settled | P_d to 1e-8 percentage points (1e-2), other numbers to 1e-9 (1e-3), equal period numbers |
| derivative | P_d likewise, other numbers to 1e-7 (1e-2), equal period numbers and flags |
| errors | the tiny differences between two ways to march, to 1e-3 |
| chaotic | intervals overlap |

A run that breaks its rule when the bending stiffness is changed by some units of rounding, or comes within a quarter of
it, cannot be held to it: its motion is chaotic or grazes. It is named, its events may differ in number, and it may move
by a hundred times what that change moved it. Those whose faces rock hundreds of times in a period may graze without
being named: where only the events of one of them differ, look at it.

`--only PREFIX` runs, compares and stores the groups whose names begin so, or stores single runs, "group/run"; what the
files hold of others stays.
`--moved 1e-9` changes the stiffness before the comparison, which must then fail: a control.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from reference_row_runs import row_runs
from reference_runs import Given, Run, Values, on_attractors, runs

import jaxshroud as js

FILE = Path(__file__).parent / "unchanged.npz"
# Units of rounding by which the stiffness is changed to see which runs graze.
ULPS = {"float64": (-20, -8, -5, -3, 3, 5, 8, 20), "float32": (-8, 8)}
NEAR = 0.25  # of what its rule allows, that such a change may move a run
LOOSE = 100.0  # times what such a change moved it, that a run may move if it was more
SIZE, INTERVAL, FREE, ABSOLUTE = " size", "interval", " free", " absolute"  # how names of quantities end
POINTS = {"float64": 1e-8, "float32": 1e-2}  # of P_d [percentage points]
RULES = {
    "one period": {"float64": 1e-12, "float32": 1e-4},
    "few periods": {"float64": 1e-10, "float32": 1e-3},
    "settled": {"float64": 1e-9, "float32": 1e-3},
    "derivative": {"float64": 1e-7, "float32": 1e-2},
    "errors": {"float64": 1e-3},
    "chaotic": {"float64": 0.0, "float32": 0.0},
}


def all_runs() -> list[Run]:
    """The runs of pairs and of rows, by groups."""
    return sorted([*runs(), *row_runs()], key=lambda run: run.group)


class Compared(NamedTuple):
    """A run against what is stored of it."""

    identical: bool  # bit by bit
    difference: float  # the one that is worst by its rule: relative, P_d in percentage points
    share: float  # of what the rule allows
    quantity: str


def difference(name: str, now: np.ndarray, then: np.ndarray, size: np.ndarray | None) -> float:
    """How far a quantity has moved: relative to its size, or the half widths of intervals; inf where it may not."""
    if now.shape != then.shape or now.dtype != then.dtype:
        return np.inf
    if now.dtype.kind != "f":
        return 0.0 if np.array_equal(now, then) else np.inf
    now, then = now.astype(float), then.astype(float)
    if not np.array_equal(np.isnan(now), np.isnan(then)):
        return np.inf
    with np.errstate(invalid="ignore"):
        moved = np.where((now == then) | np.isnan(now), 0.0, np.abs(now - then))
    if name.endswith(INTERVAL):
        unit = np.maximum(now[1] + then[1], np.finfo(float).tiny)
        return float(np.max(np.where(moved[0] > 0, moved[0] / unit, 0.0), initial=0.0))
    if name != "P_d" and not name.endswith(ABSOLUTE):
        own = np.max(np.abs(then), axis=-1, keepdims=True, initial=0.0, where=np.isfinite(then))
        size = own if size is None else np.maximum(size, own)
        moved = moved / np.where(size > 0, size, 1.0)
    return float(np.max(moved, initial=0.0))


def allowed(run: Run, name: str) -> float:
    """The difference that a quantity of a run may have."""
    if name.endswith(INTERVAL):
        return 1.0
    return POINTS[run.precision] if name == "P_d" else RULES[run.rule][run.precision]


def compared(run: Run, now: Values, then: Values, events: bool = True) -> Compared:
    """A run's numbers against others; sizes, what is free and uncounted `events` are looked at for being identical."""
    same = now.keys() == then.keys() and all(now[name].tobytes() == then[name].tobytes() for name in then)
    if now.keys() != then.keys():
        told = now["message free"].tobytes().decode() if "raised" in now else "other quantities"
        return Compared(False, np.inf, np.inf, told)
    worst = Compared(same, 0.0, 0.0, "")
    for name in then:
        if name.endswith((SIZE, FREE)) or (name == "events" and not events):
            continue
        moved, most = difference(name, now[name], then[name], then.get(name + SIZE)), allowed(run, name)
        share = 0.0 if moved == 0 else moved / most if most else np.inf
        if share > worst.share:
            worst = Compared(same, moved, share, name)
    return worst


def ulp(run: Run) -> float:
    """The unit of rounding of a run's numbers."""
    return float(np.finfo(run.precision).eps)


def by_rounding(run: Run, given: Given, then: Values) -> float | None:
    """What rounding moves a run by, over what its rule allows, without events; None if it can be held to its rule."""
    if run.rule == "chaotic":
        return None
    moved = [run.values(given._replace(moved=n * ulp(run))) for n in ULPS[run.precision]]
    if max(compared(run, now, then).share for now in moved) <= NEAR:
        return None
    return max(compared(run, now, then, events=False).share for now in moved)


# The file


def packed(arrays: Values) -> dict[str, np.ndarray]:
    """All arrays one after the other, by their types, with an index."""
    index, flat = [], {}
    for name, array in arrays.items():
        index.append([name, array.dtype.str, array.shape])
        flat.setdefault(array.dtype.str, []).append(np.ravel(array))
    by_type = {f"values {kind}": np.concatenate(parts) for kind, parts in flat.items()}
    return {"index": np.frombuffer(json.dumps(index).encode(), np.uint8), **by_type}


def unpacked(file: Any) -> Values:
    """The arrays by their names, "group/run/quantity"."""
    flat, begun, arrays = {name: file[name] for name in file.files}, {}, {}
    for name, kind, shape in json.loads(flat["index"].tobytes()):
        first = begun.get(kind, 0)
        begun[kind] = first + int(np.prod(shape))
        arrays[name] = flat[f"values {kind}"][first : begun[kind]].reshape(shape)
    return arrays


class Stored(NamedTuple):
    """What the file holds."""

    starts: Values
    runs: dict[str, Values]
    grazing: dict[str, float]  # by paths of runs: what rounding moves them by, over what their rules allow


def stored() -> Stored:
    """The file."""
    with np.load(FILE) as file:
        arrays = unpacked(file)
    grazing = json.loads(arrays.pop("grazing").tobytes())
    starts, by_run = {}, {}
    for name, array in arrays.items():
        path, quantity = name.rsplit("/", 1)
        if path == "starts":
            starts[quantity] = array
        else:
            by_run.setdefault(path, {})[quantity] = array
    return Stored(starts, by_run, grazing)


def store(path: str) -> None:
    """Run those whose paths begin so, and write the file; which runs graze is asked anew of those that moved."""
    kept = stored() if FILE.exists() else Stored(on_attractors(), {}, {})
    given = Given(kept.starts)
    for run in timed(run for run in all_runs() if run.path.startswith(path)):
        then, before = run.values(given), kept.runs.get(run.path, {})
        kept.runs[run.path] = then
        if "raised" in then:
            print(f"raised: {run.path}: {then['message free'].tobytes().decode()}", flush=True)
        if before and compared(run, then, before).share <= NEAR:
            continue
        kept.grazing.pop(run.path, None)
        if (share := by_rounding(run, given, then)) is not None:
            kept.grazing[run.path] = share
    write(kept)


def write(kept: Stored) -> None:
    """Write the file."""
    arrays = {f"starts/{name}": a for name, a in kept.starts.items()}
    for run in all_runs():
        arrays |= {f"{run.path}/{name}": np.array(a) for name, a in kept.runs.get(run.path, {}).items()}
    arrays["grazing"] = np.frombuffer(json.dumps(kept.grazing).encode(), np.uint8)
    np.savez_compressed(FILE, **packed(arrays))


# The comparison


def timed(chosen: Iterable[Run]) -> Iterator[Run]:
    """The runs; after every group it is said how long that took."""
    for group, members in groupby(chosen, key=lambda run: run.group):
        began = time.perf_counter()
        yield from members
        print(f"{group}: {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)


def summary(group: str, found: dict[str, tuple[Run, Compared]], grazing: dict[str, float]) -> dict[str, Any]:
    """What is told of a group."""
    held = {path: told for path, (_, told) in found.items() if path not in grazing}
    worst = max(held.values(), key=lambda told: told.share, default=Compared(True, 0.0, 0.0, ""))
    failed = {
        path: f"{told.quantity}: {told.difference:.2g}"
        for path, (_, told) in found.items()
        if told.share > max(1.0, LOOSE * grazing.get(path, 0.0))
    }
    return {
        "group": group,
        "rule": ", ".join(sorted({run.rule for run, _ in found.values()})),
        "runs": len(found),
        "bit-identical": sum(told.identical for _, told in found.values()),
        "largest difference": worst.difference,
        "of": worst.quantity,
        "share of what is allowed": worst.share,
        "passed": not failed,
        "failed": failed,
        "grazing": {path: f"{told.difference:.2g}" for path, (_, told) in found.items() if path in grazing},
    }


def compare(chosen: Iterable[Run], moved: float) -> list[dict[str, Any]]:
    """All groups."""
    kept = stored()
    given, by_group = Given(kept.starts, moved), {}
    for run in timed(chosen):
        then, events = kept.runs.get(run.path, {}), run.path not in kept.grazing
        by_group.setdefault(run.group, {})[run.path] = run, compared(run, run.values(given), then, events)
    return [summary(group, found, kept.grazing) for group, found in by_group.items()]


def table(groups: list[dict[str, Any]]) -> str:
    """The groups as lines."""
    line = "{:<34}{:>5}{:>11}{:>9}{:>10}  {:<20}{:<12}{}"
    lines = [line.format("group", "runs", "identical", "grazing", "largest", "of", "rule", "")]
    for g in groups:
        counts = g["runs"], g["bit-identical"], len(g["grazing"]), f"{g['largest difference']:.1e}"
        lines.append(line.format(g["group"], *counts, g["of"][:19], g["rule"], "passed" if g["passed"] else "FAILED"))
    return "\n".join(lines)


def main() -> int:
    """Store, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", action="store_true", help="write what the code at hand gives")
    parser.add_argument("--moved", type=float, default=0.0, help="relative change of a stiffness: a control")
    parser.add_argument("--only", default="", metavar="PREFIX", help="groups whose names begin so")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.store:
        store(options.only)
        return 0
    groups = compare([run for run in all_runs() if run.group.startswith(options.only)], options.moved)
    print(table(groups))
    for g in groups:
        for path, told in g["failed"].items():
            print(f"failed: {path}: {told}")
    if not options.moved:
        file = FILE.with_suffix(".json")
        kept = [g for g in json.loads(file.read_text("utf-8"))["groups"] if not g["group"].startswith(options.only)]
        told = {"command": "python tests/studies/unchanged.py", "version": js.__version__, "jax": jax.__version__}
        text = json.dumps({**told, "groups": sorted(kept + groups, key=lambda g: g["group"])}, indent=1)
        file.write_text(text + "\n", "utf-8")
    return 0 if all(g["passed"] for g in groups) else 1


if __name__ == "__main__":
    sys.exit(main())
