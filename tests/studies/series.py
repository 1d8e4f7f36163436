"""Power series against a second opinion and other gradients: python tests/studies/series.py

Scene number n is the draw of `reference.random_parameters` by seed n, run for three periods from rest. The second
opinions are kept in `series.npz`; `--opinions` forms them anew, in some twenty minutes of plain Python. `series.json`
tells, of the scenes that have come to their end in both:

- the difference of the last states over the largest of each quantity, and of the scenes beyond 1e-9 the numbers, with
  what the second opinion itself moves by between its tolerances of 1e-11 and 1e-12, and how far it and the series are
  from a fine march by Dormand-Prince 8: who is at fault;
- the residual of the energy balance over the gross work of the drive;
- for the ten orbits of `tests/orbits/test_orbit.py`, how far the gradients of P_d by all parameters are from those by
  Dormand-Prince 8, over the largest component, each by a relative change of its parameter.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "orbits"))
import opinions
import reference
from side_by_side import ends, relative_error, run, scene_of
from test_orbit import PARAMETERS, SCENES, scaled
from test_orbit import scene_of as orbit_scene

import jaxshroud as js
from jaxshroud.batch.plan import Runs
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.model.modes import Status

FILE = Path(__file__).with_suffix(".npz")
COUNT, STEPS = 1000, 3000
TIGHT = Choices(TaylorOptions(16, 1e-14), "series")
FINE = Choices(tableau("dopri8"), "cubic")
NEAR = 1e-9  # a difference that is none
QUANTILES = (0.5, 0.9, 0.99, 1.0)


class Opinions(NamedTuple):
    """What the second opinion makes of the scenes, numbered from 0."""

    status: np.ndarray  # (scenes,)
    end: np.ndarray  # (scenes, 12) states after the last period
    size: np.ndarray  # (scenes, 12) the largest of each quantity at the ends of periods, over both blades
    moved: np.ndarray  # (scenes,) of the last state between tolerances of 1e-11 and 1e-12, over the largest


def parameters(seed: int) -> reference.Parameters:
    """The scene of that number."""
    return reference.random_parameters(np.random.default_rng(seed))


def told(seeds: list[int]) -> Opinions:
    """The second opinion of these scenes."""
    status, samples, moved = zip(*(opinions.opinion(parameters(seed)) for seed in seeds), strict=True)
    whole = np.array(samples)
    size = np.repeat(np.abs(whole).reshape(len(seeds), -1, 6, 2).max(axis=(1, 3)), 2, axis=-1)
    return Opinions(np.array(status), whole[:, -1], size, np.array(moved))


def kept() -> Opinions:
    """The opinions in the file."""
    with np.load(FILE) as file:
        return Opinions(*(file[name] for name in Opinions._fields))


def marched(seeds: list[int], method: Choices = TIGHT) -> Runs:
    """These scenes, three periods from rest."""
    return run([scene_of(parameters(seed)) for seed in seeds], opinions.PERIODS, STEPS, method)


def differences(runs: Runs, end: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Of the last states from others, over the size of each quantity; NaN where a run has stopped (lanes,)."""
    return np.where(runs.last.status == Status.OK, relative_error(ends(runs), end, size), np.nan)


def residuals(runs: Runs) -> np.ndarray:
    """Of the energy balance over the gross work of the drive (lanes,)."""
    return np.abs(runs.samples.residual.sum(axis=-1)) / runs.samples.gross.sum(axis=-1)


def scenes() -> dict[str, Any]:
    """The figures of the random scenes."""
    seeds, by_reference = list(range(COUNT)), kept()
    runs = marched(seeds)
    difference, residual = differences(runs, by_reference.end, by_reference.size), residuals(runs)
    both = (by_reference.status == "ok") & np.isfinite(difference)
    spread = lambda a: {f"{q:g}": float(np.quantile(a[both], q)) for q in QUANTILES}
    beyond = [int(n) for n in np.flatnonzero(both & (difference > NEAR))]
    suspects = []
    if beyond:
        fine, opinion = marched(beyond, FINE), Opinions(*(a[beyond] for a in by_reference))
        of_series = relative_error(ends(fine), ends(runs)[beyond], opinion.size)
        of_reference = relative_error(ends(fine), opinion.end, opinion.size)
        rows = zip(beyond, difference[beyond], opinion.moved, of_series, of_reference, strict=True)
        names = "seed", "difference", "second opinion moved", "series from fine", "second opinion from fine"
        suspects = [dict(zip(names, (row[0], *map(float, row[1:])), strict=True)) for row in rows]
    return {
        "scenes": COUNT,
        "ended in both": int(both.sum()),
        "stopped in one only": [
            int(n) for n in np.flatnonzero((by_reference.status == "ok") != np.isfinite(difference))
        ],
        "difference of the last states": spread(difference),
        "beyond 1e-9": suspects,
        "energy residual": spread(residual),
    }


def slopes(overrides: tuple[str, ...], method: Method, steps: int) -> np.ndarray:
    """The gradient on an orbit, by relative changes of all parameters."""
    scene = orbit_scene(overrides)
    orbit = js.orbit(scene, method=method.replace(steps=steps))
    found = js.gradient(scene, PARAMETERS, orbit=orbit, method=method.replace(steps=steps))
    return scaled(found.value, scene)


def gradients() -> dict[str, float]:
    """Of each orbit the difference of gradients."""
    by_series, fine = js.Taylor(), js.RungeKutta("dopri8")
    found = {}
    for name, (overrides, _, _) in SCENES.items():
        mine, right = slopes(overrides, by_series, 400), slopes(overrides, fine, 600)
        found[name] = float(np.abs(mine - right).max() / np.abs(right).max())
    return found


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opinions", action="store_true", help="form the second opinions anew")
    jax.config.update("jax_enable_x64", True)
    if parser.parse_args().opinions:
        np.savez_compressed(FILE, **told(list(range(COUNT)))._asdict())
    about = {"command": "python tests/studies/series.py", "version": js.__version__, "method": str(TIGHT)}
    found = about | {"random scenes": scenes(), "gradients, taylor 12 1e-09": gradients()}
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
