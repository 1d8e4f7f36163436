"""Flat contact against a stiff rotational spring between the faces: python tests/studies/faces.py.

A hundred of the scenes of `realistic.py` that reach flat contact within three periods. The spring is in the plain
Python of the second opinion; the difference of the states after three periods falls as its compliance does.
"""

import dataclasses
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from realistic import SEED, at, drawn, marched

sys.path.insert(0, str(Path(__file__).parents[1]))
import reference

from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.tableau import tableau
from jaxshroud.orbits.short_runs import motions_at
from jaxshroud.scene.scene import Scene
from jaxshroud.version import __version__

SCENES, DRAWN, PERIODS, STEPS = 100, 1000, 3, 20_000
SPRINGS = (1e3, 1e4, 1e5)  # [N m/rad]


def parameters(scene: Scene) -> reference.Parameters:
    """One scene as the second opinion takes it."""
    b, s, d = scene.blades, scene.shroud, scene.drive
    pair = lambda a: tuple(float(v) for v in np.broadcast_to(a, (2,)))
    blades = {name: pair(getattr(b, name)) for name in ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T")}
    drive = {name: pair(getattr(d, name)) for name in ("beta", "F_0", "M_0", "phase")}
    lengths = {name: float(getattr(s, name)) for name in ("alpha", "l_oa", "l_ab", "gap")}
    springs = {"k": float(scene.k), "k_d": float(scene.friction.k_d), "mu": float(scene.friction.mu)}
    return reference.Parameters(**blades, **drive, **lengths, **springs, m_y=pair(b.m), omega=float(d.omega))


def flat_scenes(count: int, seed: int, periods: int = PERIODS) -> tuple[list[reference.Parameters], np.ndarray]:
    """The first scenes of so many draws that reach flat contact, and their states (lanes, 12) at the end."""
    scenes = drawn(count, seed)
    coarse = marched(scenes, periods, 1600, FAST)
    lanes = np.flatnonzero(coarse.last.accumulator.log.counters.flat > 0)[:SCENES]
    chosen = at(scenes, lanes)
    fine = marched(chosen, periods, STEPS, Choices(tableau("dopri8"), "cubic", False))
    return [parameters(jax.tree.map(jnp.asarray, at(scenes, i))) for i in lanes], motions_at(fine.samples, periods - 1)


def differences(p: reference.Parameters, exact: np.ndarray, periods: int = PERIODS) -> list[float]:
    """Difference of the state for each of `SPRINGS`, over the largest of its kind; NaN where the opinion gives up."""
    pairs = np.abs(exact).reshape(6, 2).max(axis=1)
    size, found = np.repeat(np.where(pairs > 0, pairs, 1.0), 2), []
    for k_face in SPRINGS:
        run = reference._Run(dataclasses.replace(p, k_face=k_face), 1e-9)
        run.advance(periods * run.period)
        found.append(float(np.max(np.abs(run.y[:12] - exact) / size)) if run.status == "ok" else np.nan)
    return found


def figures(found: np.ndarray) -> dict[str, Any]:
    """Medians of the differences and of what each decade of stiffness divides them by."""
    known = found[np.isfinite(found).all(axis=1)]
    ratio = known[:, :-1] / known[:, 1:]
    slope = np.log10(known[:, 0] / known[:, -1]) / (len(SPRINGS) - 1)
    return {
        "springs [N m/rad]": SPRINGS,
        "scenes": len(known),
        "given up": len(found) - len(known),
        "median difference": np.median(known, axis=0).tolist(),
        "median ratio a decade": np.median(ratio, axis=0).tolist(),
        "share that falls at least threefold a decade": float(np.mean(slope > np.log10(3))),
        "order, quartiles": np.quantile(slope, (0.25, 0.5, 0.75)).tolist(),
    }


def main() -> None:
    """Measure and write."""
    jax.config.update("jax_enable_x64", True)
    scenes, exact = flat_scenes(DRAWN, SEED)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        found = np.array(list(pool.map(differences, scenes, exact)))
    told = {"command": "python tests/studies/faces.py", "version": __version__, "seed": SEED, "periods": PERIODS}
    path = Path(__file__).with_suffix(".json")
    path.write_text(json.dumps({**told, **figures(found), "differences": found.tolist()}, indent=1) + "\n", "utf-8")
    print(json.dumps(figures(found), indent=1))


if __name__ == "__main__":
    main()
