"""Two thousand blades with their blocks' own inertia and small moments: python tests/studies/realistic.py.

Such faces stay nearly parallel: dozens of loaded case switches in a period, and flat contact. Every scene that is
marched with a stable step must end OK, whatever the step, the method and the locator, unless its blocks truly turn
beyond the model's range. What flat contact drops when it begins, and the residual of the energy balance with that,
are both over the gross work of the drive, largest of any period.
"""

import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan, Runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.stability import step_limits, stiffest
from jaxshroud.march.tableau import tableau
from jaxshroud.model.modes import Status
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud
from jaxshroud.version import __version__

SCENES, SEED, PERIODS = 2000, 11, 50
STEPS = (200, 400, 1600)
METHODS = tuple((name, how) for name in ("rk4", "dopri8") for how in ("cubic", "bisection"))
COARSE = 0.5  # omega_max h that a scene may have at the fewest steps


def realistic(rng: np.random.Generator) -> Scene:
    """A random blade pair; both blades alike and driven in opposite phases, a tenth of the pairs without a moment."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    m, l_oa, l_ab = log(0.05, 0.2), rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.04)
    I = m * (l_oa**2 + l_ab**2) / 12 * rng.uniform(1, 5)
    k_x, k_y, k_T, zeta = log(2e4, 2e5), log(1e6, 5e6), log(500, 5000), log(0.005, 0.05)
    damping = 2 * zeta * math.sqrt(k_x * m), 2 * zeta * math.sqrt(k_y * m), 2 * log(0.01, 2.0) * math.sqrt(k_T * I)
    phase = rng.uniform(0, 2 * math.pi)
    M_0 = (0.0, log(0.01, 5.0), rng.uniform(0, 5))[rng.choice(3, p=(0.1, 0.45, 0.45))]
    return Scene(
        Blades(m, I, k_x, k_y, k_T, *damping),
        Shroud(rng.uniform(0.6, 1.4), l_oa, l_ab, rng.uniform(0, 2e-4)),
        Contact(None, log(0.1, 20)),
        Friction(log(1e5, 1e7), rng.uniform(0, 1)),
        Drive(rng.uniform(300, 900), rng.uniform(0.1, 1.0), log(10, 100), M_0, (phase, phase + math.pi)),
    )


def drawn(count: int, seed: int) -> Scene:
    """Random scenes with a leading axis."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda *a: np.stack(a), *(realistic(rng) for _ in range(count)))


def at(scenes: Scene, lanes: np.ndarray) -> Scene:
    """Some of the scenes."""
    return jax.tree.map(lambda a: np.asarray(a)[lanes], scenes)


def marched(scenes: Scene, periods: int, steps: int, method: Choices) -> Runs:
    """All lanes from their starts, every period kept."""
    return run_lanes(scenes, initial_states(scenes), Plan(0, periods, steps, 0.0, method), lambda _: None)


def stable(scenes: Scene, steps: int, method: Choices) -> np.ndarray:
    """Scenes that may be marched with so many steps a period."""
    lanes = range(len(scenes.drive.omega))
    product = np.array([np.prod(stiffest(at(scenes, np.array([i])), 1)) for i in lanes]) / steps
    return np.flatnonzero(product <= (COARSE if steps == min(STEPS) else step_limits(method.tableau)[0]))


def figures(scenes: Scene, periods: int, steps: int, method: Choices) -> dict[str, Any]:
    """How the lanes ended, and the largest energies of any of their periods over the drive's gross work."""
    lanes = stable(scenes, steps, method)
    runs = marched(at(scenes, lanes), periods, steps, method)
    status, samples = np.asarray(runs.last.status), runs.samples
    gross = np.asarray(samples.gross)
    share = lambda a: np.max(np.abs(np.asarray(a)) / gross, axis=1)[status == Status.OK]
    quantiles = lambda a: {str(q): float(np.quantile(a, q)) for q in (0.5, 0.99, 1.0)}
    counters = jax.tree.map(lambda a: a[:, 0], runs.log.counters)
    return {
        "method": str(method),
        "steps": steps,
        "scenes": len(lanes),
        "status": {s.name: int((status == s).sum()) for s in Status if (status == s).any()},
        "not OK": lanes[status != Status.OK].tolist(),
        "in flat contact": int((counters.flat > 0).sum()),
        "switches a period": quantiles((counters.switch_14 + counters.switch_23) / periods),
        "dropped": quantiles(share(samples.dropped)),
        "residual": quantiles(share(samples.residual)),
    }


def by_events(scenes: Scene) -> Scene:
    """The scenes, those with the most case switches last: lanes that run together then wait little for each other."""
    counters = marched(scenes, 5, STEPS[1], FAST).log.counters
    return at(scenes, np.argsort((counters.switch_14 + counters.switch_23)[:, 0], kind="stable"))


def main() -> None:
    """Measure and write."""
    jax.config.update("jax_enable_x64", True)
    scenes, found = by_events(drawn(SCENES, SEED)), []
    for name, how in METHODS:
        for steps in STEPS:
            found.append(figures(scenes, PERIODS, steps, Choices(tableau(name), how)))
            print(json.dumps(found[-1]), flush=True)
    told = {"command": "python tests/studies/realistic.py", "version": __version__, "seed": SEED, "periods": PERIODS}
    Path(__file__).with_suffix(".json").write_text(json.dumps({**told, "runs": found}, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
