"""Are accuracies kept on realistic blades? python tests/studies/promises.py

Random blades with their blocks' own inertia and small moments (`realistic.py`), each alone: what `accuracy` chooses for
it, whether it promises that, and the error of the state after three periods against two references of unlike kinds, by
sixteen times the steps, which tell flat contact: power series of order 16 to 1e-14, and Dormand-Prince 8 with events
located by the guard's cubic. The larger error counts. `promises.json` has it for four accuracies, with how far the
references differ, and every scene that is not promised.
"""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from realistic import at, drawn  # noqa: E402

from jaxshroud.march.method import Choices  # noqa: E402
from jaxshroud.march.tableau import TaylorOptions, tableau  # noqa: E402
from jaxshroud.orbits.short_runs import end_states, state_errors  # noqa: E402
from jaxshroud.scene.scene import Scene  # noqa: E402
from jaxshroud.verbs.trials import choose  # noqa: E402

SCENES, SEED, ASKED, FINER = 100, 21, (1e-2, 1e-3, 1e-6, 1e-9), 16
FINE = (Choices(TaylorOptions(16, 1e-14), "series", False), Choices(tableau("dopri8"), "cubic", False))


def told(scenes: Scene, asked: float) -> dict[str, Any]:
    """How scenes (leading axis) fare where an accuracy is asked for."""
    kept, broken, open_ = 0, [], []
    for i in range(len(scenes.drive.omega)):
        scene = at(scenes, np.array([i]))
        choice = choose(scene, 1, asked)
        got = end_states(scene, choice.steps, choice.method).motions
        series, runge_kutta = (end_states(scene, FINER * choice.steps, fine).motions for fine in FINE)
        error = float(max(state_errors(got, exact)[0] for exact in (series, runge_kutta)))
        apart = float(state_errors(series, runge_kutta)[0])
        one = {"scene": i, "error": error, "estimated": choice.reached, "setting": str(choice.setting)}
        one["references differ by"] = apart
        if not choice.promised:
            open_.append(one)
        elif error <= asked:
            kept += 1
        else:
            broken.append(one)
    return {"kept": kept, "broken": broken, "not promised": open_}


def main() -> None:
    """All accuracies."""
    found: dict[str, Any] = {"command": "python tests/studies/promises.py", "scenes": SCENES, "seed": SEED}
    for asked in ASKED:
        found[f"{asked:g}"] = told(drawn(SCENES, SEED), asked)
        print(asked, json.dumps(found[f"{asked:g}"], indent=1), flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
