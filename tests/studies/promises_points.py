"""What is an accuracy worth by the corner and by two points? python tests/studies/promises_points.py

Forty random pairs with their blocks' own inertia and small moments (`realistic.py`), each marched by what an accuracy
chooses for it. By the corner methods are tried, and promised or not; by points there are no trials, and one of two
methods is taken. What is told: how many keep the accuracy after three periods, and the quantiles of the errors, against
Dormand-Prince 8 with events by bisection at 3,200 steps and RK4 with cubics at 25,600, whichever is further.
`promises_points.json` has the table.
"""

import json
import warnings
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from realistic import at, drawn  # noqa: E402

import jaxshroud as js  # noqa: E402
from jaxshroud.march.method import FAST, choices  # noqa: E402
from jaxshroud.orbits.short_runs import end_states, state_errors  # noqa: E402
from jaxshroud.scene.scene import Scene  # noqa: E402
from jaxshroud.verbs.arguments import resolve_options  # noqa: E402
from jaxshroud.verbs.plan import plan_march  # noqa: E402

SCENES, SEED, ASKED = 40, 33, (1e-3, 1e-6, 1e-9)
FINE = (js.RungeKutta("dopri8", 3200, locate="bisection", flat_return=1 / 614400), js.RungeKutta("rk4", 25600))
QUANTILES = (0.5, 0.95, 1.0)


def by_points(scenes: Scene) -> Scene:
    """The scenes (leading axis) with faces of two points."""
    lanes = len(scenes.drive.omega)
    points = jax.tree.map(lambda a: np.broadcast_to(a, (lanes, *np.shape(a))), js.ContactPoints(2))
    return eqx.tree_at(lambda s: s.contact.points, scenes, points, is_leaf=lambda a: a is None)


def told(scenes: Scene, asked: float) -> dict[str, Any]:
    """How scenes (leading axis) fare where an accuracy is asked for."""
    errors, promised = [], 0
    for i in range(len(scenes.drive.omega)):
        scene = at(scenes, np.array([i]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            march = plan_march(resolve_options(scene, method=asked), scene, FAST)
        promised += bool(march.choice and march.choice.promised)
        got = end_states(scene, march.steps, march.method).motions
        exact = (end_states(scene, method.steps, choices(method)).motions for method in FINE)
        errors.append(max(state_errors(got, one)[0] for one in exact))
    quantiles = {str(q): float(np.quantile(errors, q)) for q in QUANTILES}
    return {"promised": promised, "kept": int(np.sum(np.array(errors) <= asked)), "error": quantiles}


def main() -> None:
    """Both models, all accuracies."""
    found: dict[str, Any] = {"command": "python tests/studies/promises_points.py", "scenes": SCENES, "seed": SEED}
    corner = drawn(SCENES, SEED)
    for name, scenes in {"corner": corner, "two points": by_points(corner)}.items():
        found[name] = {f"{asked:g}": told(scenes, asked) for asked in ASKED}
        print(name, json.dumps(found[name], indent=1), flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
