"""Does the result of a value depend on the values beside it? python tests/studies/neighbours.py

`VALUES` values of a number of each scene are swept one by one, and in batches of 2, 17 and 200, filled up with values
between them: once by an accuracy, which chooses the method for a batch as a whole, and once by one method, which is the
one chosen for all. `neighbours.json` counts, of the values of each scene and batch, those whose P_d

- has other `bits` than in the batch of 200,
- differs by more than `moved` percentage points from it: another motion, or a chaotic one that parts,
- does so although both lanes are `settled` by their own word.

A value alone is marched by another program, which may round otherwise. `--only NAME` prints one scene.
"""

import argparse
import json
import warnings
from pathlib import Path

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.march.method import Method
from jaxshroud.version import __version__

jax.config.update("jax_enable_x64", True)
VALUES, BATCHES, LARGEST = 40, (1, 2, 17), 200
MOVED = 1e-3  # percentage points: more than the rounding of a settled orbit makes
KEPT = {"n_periods": 48, "transient": 48}
SMALL = ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]
# name -> scene, its overrides, the number that is swept and the ends of its range
SCENES = {
    "turning": ("table1", ["drive.M_0=0.1"], "contact.gamma", 0.5, 8.0),
    "turning more": ("table1", ["drive.M_0=1"], "contact.gamma", 0.5, 8.0),
    "over the gap": ("table1", ["drive.M_0=0.1", "contact.gamma=4"], "shroud.gap", 1e-5, 6e-5),
    "x alone": ("table1", SMALL, "contact.gamma", 0.5, 6.0),
    "x alone, light": ("table1", ['parts.motion=["x"]', "blades.c_x=5"], "contact.gamma", 1.5, 6.0),
    "x alone, over the force": ("table1", [*SMALL, "contact.gamma=5.5"], "drive.F_0", 20.0, 90.0),
}


def swept(scene: js.Scene, key: str, values: np.ndarray, method: Method | None) -> js.SweepResult:
    """The sweep of one batch."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of lanes that miss their accuracy
        return js.sweep(scene, {key: values}, method=method, **KEPT)


def compared_first(values: np.ndarray, others: np.ndarray, size: int) -> list[tuple[int, np.ndarray]]:
    """Batches of `size` values: how many of `values` each begins with, and the batch, filled up with others."""
    some = max(size // 2, 1)
    parts = [values[i : i + some] for i in range(0, len(values), some)]
    return [(len(part), np.concatenate([part, others[: size - len(part)]])) for part in parts]


def study_of(name: str, count: int = VALUES) -> dict[str, dict[str, int]]:
    """The counts of a scene, by how the method is given and the size of the batch, of its first `count` values."""
    source, overrides, key, low, high = SCENES[name]
    scene, grid, found = js.load(source, overrides).scene, np.linspace(low, high, LARGEST), {}
    step = LARGEST // VALUES
    values, others = grid[::step][:count], np.delete(grid, np.s_[::step])
    by_accuracy = swept(scene, key, grid, None)
    chosen = by_accuracy.march
    for given, method in (("accuracy", None), ("method", chosen)):
        of_all = by_accuracy if method is None else swept(scene, key, grid, method)
        for size in BATCHES:
            parts = [(n, swept(scene, key, batch, method)) for n, batch in compared_first(values, others, size)]
            P_d, settled = (np.concatenate([getattr(part, a)[:n] for n, part in parts]) for a in ("P_d", "settled"))
            apart, both = np.abs(P_d - of_all.P_d[::step][:count]), settled & of_all.settled[::step][:count]
            moved = apart > MOVED
            found[f"{given}, {size}"] = {
                "bits": int(np.sum(apart != 0)),
                "moved": int(moved.sum()),
                "settled": int(np.sum(moved & both)),
            }
    return found


def main() -> None:
    """Study all scenes, and write the counts after each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="the scenes whose names begin so")
    only = parser.parse_args().only
    results = {}
    for name in SCENES:
        if name.startswith(only):
            results[name] = study_of(name)
            print(name, json.dumps(results[name]), flush=True)
        if not only:
            told = {"version": __version__, "values": VALUES, "scenes": results}
            Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
