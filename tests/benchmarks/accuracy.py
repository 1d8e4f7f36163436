"""Measures `jaxshroud/verbs/accuracy.json`: python tests/benchmarks/accuracy.py.

Random scenes around Table 1, with tilted and with nearly parallel faces, in four classes of stiffness each; every
candidate setting's error on each lane, and its cost. The truth is Dormand-Prince 8. Float32 is no candidate: between
nearly parallel faces it errs by some per cent. Another order of power series is another program to compile, so that
order 14 is taken unless another is cheaper by more than a quarter.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud import load
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest, stiffness_ratio
from jaxshroud.orbits.short_runs import HORIZON, end_states, run_from_start, state_errors
from jaxshroud.scene.vary import vary
from jaxshroud.signals.averages import least_tilt
from jaxshroud.verbs.accuracy import LEVELS, Setting, by_series
from jaxshroud.verbs.trade import REFERENCE_SETTING
from jaxshroud.verbs.trials import PARALLEL, PARALLEL_TILT, STIFFNESS_CLASSES, TILTED

MARGIN, SHARE, LANES = 3.0, 0.98, 64
DIGITS = {14: range(4, 15), 18: range(11, 15)}
USUAL_ORDER, WORTH_OF_ANOTHER = 14, 0.75
CANDIDATES = [
    *(Setting("dopri8", "cubic", "float64", p) for p in (1.4, 1.0, 0.5, 0.25, 0.18, 0.12)),
    *(by_series(order, 10.0**-digits) for order, found in DIGITS.items() for digits in found),
]
Families = Sequence[tuple[str, tuple[float, float]]]  # scenes, with ranges of M_0 [N m]
FAMILIES: dict[int, Families] = {
    TILTED: [("table1", (2.0, 100.0)), ("table1_light", (0.1, 1.0))],
    PARALLEL: [("table1", (0.05, 2.0)), ("eq21", (2.0, 100.0))],
}
TARGETS = ((0.01, 10.0), (20.0, 150.0), (200.0, 1500.0), (2000.0, 1e4))  # gamma for each class, log-uniform


def random_scene(rng: np.random.Generator, gamma: tuple[float, float], families: Families):
    """One scene around Table 1, its variant after Eq. (21), or light blocks, with moments in a range."""
    name, moments = families[int(rng.integers(len(families)))]
    scene = load(name).scene
    scene = vary(scene, "blades.m_y", scene.blades.inertia_y)  # all of one structure
    scene = vary(scene, "contact.gamma", float(np.exp(rng.uniform(*np.log(gamma)))))
    for key, low, high in (
        ("shroud.gap", 2e-6, 2e-4),
        ("drive.F_0", 20.0, 90.0),
        ("drive.omega", 400.0, 800.0),
        ("friction.mu", 0.05, 0.8),
        ("friction.k_d", 2e5, 2e6),
        ("drive.M_0", *moments),
    ):
        scene = vary(scene, key, float(np.exp(rng.uniform(np.log(low), np.log(high)))))
    return scene


def in_class(rng: np.random.Generator, tilt: int, index: int, count: int) -> list:
    """Random scenes of that tilt whose stiffness is of that class."""
    low = 0.0 if index == 0 else STIFFNESS_CLASSES[index - 1]
    kept = []
    while len(kept) < count:
        scene = random_scene(rng, TARGETS[index], FAMILIES[tilt])
        parallel = least_tilt(jax.tree.map(lambda a: a[None], scene)) < PARALLEL_TILT
        if parallel == (tilt == PARALLEL) and low < stiffness_ratio(scene, 0) <= STIFFNESS_CLASSES[index]:
            kept.append(scene)
    return kept


def stacked(scenes: list):
    """The scenes with a leading axis."""
    return jax.tree.map(lambda *a: jnp.stack(a), *scenes)


def errors(scenes: list, setting: Setting, truths: list[np.ndarray]) -> np.ndarray:
    """State error of each scene, every one with its own number of steps."""
    found = []
    for scene, truth in zip(scenes, truths, strict=True):
        alone = jax.tree.map(lambda a: a[None], scene)
        found.append(
            state_errors(end_states(alone, setting.steps(*stiffest(scene, 0)), setting.method).motions, truth)[0]
        )
    return np.array(found)


def cpu_time(scenes, setting: Setting) -> float:
    """Seconds of all cores per lane and period."""
    steps = setting.steps(*stiffest(scenes, 1))
    taken = []
    for _ in range(4):  # the first compiles
        begun = time.process_time()
        run_from_start(scenes, HORIZON, steps, setting.method)
        taken.append(time.process_time() - begun)
    return min(taken) / len(scenes.drive.omega) / HORIZON


def exact(scene) -> tuple[int, Choices]:
    """Steps and method that are the truth."""
    return REFERENCE_SETTING._replace(product=0.08).steps(*stiffest(scene, 0)), REFERENCE_SETTING.method


def promised_settings(scenes: list) -> dict[str, list]:
    """The cheapest setting for each level that can be promised for such scenes; prints all candidates."""
    truths = [end_states(jax.tree.map(lambda a: a[None], s), *exact(s)).motions for s in scenes]
    batch, measured = stacked(scenes), []
    for setting in CANDIDATES:
        error = np.nan_to_num(errors(scenes, setting, truths), nan=np.inf)
        bound = float(np.quantile(error, SHARE, method="higher"))
        measured.append((setting, bound, cpu_time(batch, setting)))
        print(setting, f"{bound:.1e}", f"{measured[-1][2] * 1e6:.1f} us", flush=True)
    able = {level: [m for m in measured if m[1] * MARGIN <= level] for level in LEVELS}
    # Where none is able, nothing is promised: errors grow too fast in scenes so stiff.
    weighted = lambda m: m[2] * (WORTH_OF_ANOTHER if m[0].order == USUAL_ORDER else 1.0)
    return {f"{level:.0e}": list(min(some, key=weighted)[0]) for level, some in able.items() if some}


def main() -> None:
    """Measure and write."""
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(11)
    table = [
        [promised_settings(in_class(rng, tilt, index, LANES)) for index in range(len(STIFFNESS_CLASSES))]
        for tilt in (TILTED, PARALLEL)
    ]
    path = Path(__file__).parents[2] / "jaxshroud" / "verbs" / "accuracy.json"
    path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
