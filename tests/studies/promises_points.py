"""What is an accuracy worth by the corner, by two points and in rows?

    python tests/studies/promises_points.py [GROUP ...]

Random pairs with their blocks' own inertia and small moments (`realistic.py`), forty by the corner and a hundred by two
points, and a hundred random rows, chains of five and rings of three, half of them with faces that become flat, of which
half by two points. Each is marched by what an accuracy chooses for it. What is given: how many are promised, that is,
are neither said to miss the accuracy nor marked after the march; how many of these keep it after three periods; and the
quantiles of all errors. Two judges are asked: Dormand-Prince 8 with events by bisection at 3,200 steps, for rows at
800, and Tsitouras 5 with cubics at eight times as many, whichever is further. Where they differ by more than half of
what was asked, they do not judge. Those that stop as they leave the model's range are counted apart.
`promises_points.json` has the table. The seed of all but the corner was not used before.
"""

import json
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

from realistic import at, drawn  # noqa: E402
from row_reference import random_row  # noqa: E402
from row_runs import row_scene_of  # noqa: E402

import jaxshroud as js  # noqa: E402
from jaxshroud.march.method import FAST, choices  # noqa: E402
from jaxshroud.orbits.short_runs import end_states, state_errors  # noqa: E402
from jaxshroud.scene.keys import Motion  # noqa: E402
from jaxshroud.scene.scene import Scene  # noqa: E402
from jaxshroud.verbs.arguments import plan_march, resolve_options  # noqa: E402
from jaxshroud.verbs.trials import missed_lanes  # noqa: E402

SEED, SEED_OF_CORNERS = 62, 33
STEPS, STEPS_OF_ROWS = 3200, 800
SIZES = ((5, False), (3, True))  # of rows, and whether they are closed
QUANTILES = (0.5, 0.95, 1.0)


def by_points(scenes: Scene) -> Scene:
    """The scenes (leading axis) with faces of two points."""
    lanes = len(scenes.drive.omega)
    points = jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), js.ContactPoints(2))
    return eqx.tree_at(lambda s: s.contact.points, scenes, points, is_leaf=lambda a: a is None)


def pairs(count: int, seed: int) -> list[Scene]:
    """Random pairs, each with a leading axis of one."""
    scenes = drawn(count, seed)
    return [at(scenes, np.array([i])) for i in range(count)]


def rows(count: int, seed: int, light: bool) -> list[Scene]:
    """Random rows, each with a leading axis of one."""
    rngs = [np.random.default_rng([seed, light, i]) for i in range(count)]
    found = [random_row(rng, *SIZES[i % 2], light) for i, rng in enumerate(rngs)]
    return [jax.tree.map(lambda a: np.asarray(a)[None], row_scene_of(p)) for p in found]


def judges(scene: Scene) -> list[Motion]:
    """The motion of a scene (leading axis of one) after three periods by two methods with fine steps."""
    steps = STEPS if scene.row is None else STEPS_OF_ROWS
    bisected = js.RungeKutta("dopri8", steps, locate="bisection", flat_return=1 / 614400)
    return [end_states(scene, m.steps, choices(m)).motions for m in (bisected, js.RungeKutta("tsit5", 8 * steps))]


def told(scenes: list[Scene], accuracies: Sequence[float]) -> dict[str, Any]:
    """How scenes, each with a leading axis of one, fare where each of the accuracies is requested."""
    exact = [judges(scene) for scene in scenes]
    return {f"{asked:g}": kept_of(scenes, exact, asked) for asked in accuracies}


def kept_of(scenes: list[Scene], exact: list[list[Motion]], asked: float) -> dict[str, Any]:
    """How many are promised an accuracy, and keep it, as `exact` judges."""
    errors, promised, judged = [], [], []
    for scene, ends in zip(scenes, exact, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            march = plan_march(resolve_options(scene, method=asked), scene, FAST)
        choice = march.choice
        is_promised = bool(choice and choice.promised) and not missed_lanes(scene, choice)[0]
        got = end_states(scene, march.steps, march.method).motions
        errors.append(max(state_errors(got, one)[0] for one in ends))
        promised.append(is_promised)
        judged.append(state_errors(*ends)[0] <= asked / 2)
    stopped = np.isnan(errors)
    kept = (np.array(errors) <= asked) & judged
    promised = ~stopped & promised
    return {
        "scenes": len(scenes),
        "stopped": int(stopped.sum()),
        "judged": int(np.sum(judged)),
        "promised": int(promised.sum()),
        "promised and judged": int(np.sum(promised & judged)),
        "kept of these": int(np.sum(promised & kept)),
        "kept": int(kept.sum()),
        "error": {str(q): float(np.nanquantile(errors, q)) for q in QUANTILES},
    }


GROUPS = {
    "corner": (lambda: pairs(40, SEED_OF_CORNERS), (1e-3, 1e-6, 1e-9)),
    "two points": (lambda: [by_points(scene) for scene in pairs(100, SEED)], (1e-3, 1e-6, 1e-9)),
    "heavy rows": (lambda: rows(50, SEED, light=False), (1e-3, 1e-6)),
    "light rows": (lambda: rows(25, SEED, light=True), (1e-3, 1e-6)),
    "light rows of two points": (lambda: [by_points(row) for row in rows(25, SEED, light=True)], (1e-3, 1e-6)),
}


def main() -> None:
    """The groups that are named, or all, at their accuracies."""
    stored = Path(__file__).with_suffix(".json")
    found: dict[str, Any] = json.loads(stored.read_text("utf-8")) if stored.exists() else {}
    found |= {"command": "python tests/studies/promises_points.py", "seed": SEED}
    for name in sys.argv[1:] or GROUPS:
        scenes, accuracies = GROUPS[name]
        found[name] = told(scenes(), accuracies)
        print(name, json.dumps(found[name], indent=1), flush=True)
        stored.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
