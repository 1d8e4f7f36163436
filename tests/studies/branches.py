"""Folds and flips of branches against sweeps on either side: python tests/studies/branches.py.

Scenes are drawn with a stated seed and distribution: bending in x alone against a rigid or a moving neighbour, and the
whole model; stiffness ratio, damping, force, moment, frequency, gap and friction about those of Table 1.
Each is followed along its stiffness ratio. Every fold and flip of a stable orbit is then compared with sweeps that
start on the branch's stable orbit, at 1e-3 of the number on either side, with a transient of at least
10 / (1 - |multiplier|) periods there:

- at a fold, on the side where the branch has orbits the sweep stays on the stable one (to 1e-4 of the motion's
  size, from a start beside it), and on the other it ends elsewhere;
- at a flip, on the stable side the sweep has the branch's period number and stays on it, and on the other it has not.

Unstable orbits are those that no sweep shows: their closing errors are given.
"""

import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

import jaxshroud as js
from jaxshroud.results.branch import BIFURCATION_KINDS
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.orbit_distance import set_distance

SEED, SCENES, WANTED = 0, 64, 48
ASIDE, PUSH, LEFT, NEAR = 1e-3, 1e-2, 0.02, 1e-4
KEY, RANGE, STEPS, MOST_POINTS, MOST_TRANSIENT = "contact.gamma", (0.3, 8.0), 128, 200, 10_000
METHOD = js.RungeKutta("tsit5")  # of the whole model
COARSE: dict[str, Any] = {"method": js.RungeKutta(steps=100)}  # of x alone
X, X_RIGID, ALL = (
    ("x", ['parts.motion=["x"]']),
    ("x, rigid", ['parts.motion=["x"]', "parts.neighbour=rigid"]),
    ("all", []),
)
MODELS = (X_RIGID, X, X_RIGID, X, X_RIGID, X, X_RIGID, ALL)


class Drawn(NamedTuple):
    """One scene of the study."""

    model: str
    overrides: list[str]

    @property
    def scene(self) -> Scene:
        """The scene."""
        return js.load("table1", self.overrides).scene

    @property
    def how(self) -> dict[str, Any]:
        """How it is marched."""
        return {"method": METHOD.replace(steps=STEPS)} if self.model == ALL[0] else COARSE


def drawn(
    count: int, seed: int, models: Sequence[Any] = MODELS, damping: tuple[float, float] = (1.0, 6.0)
) -> list[Drawn]:
    """Scenes of models in turn, with a damping c_x [N s/m] in a range."""
    draw, found = np.random.default_rng(seed), []
    for i in range(count):
        name, parts = models[i % len(models)]
        numbers = {
            "contact.gamma": draw.uniform(0.5, 7.5),
            "blades.c_x": draw.uniform(*damping),
            "drive.F_0": draw.uniform(30.0, 80.0),
            "drive.M_0": 10 ** draw.uniform(-1, 0.5),
            "drive.omega": draw.uniform(480.0, 620.0),
            "shroud.gap": 10 ** draw.uniform(-5.0, -4.3),
            "friction.mu": draw.uniform(0.1, 0.5),
        }
        found.append(Drawn(name, [*parts, *(f"{key}={value:.6g}" for key, value in numbers.items())]))
    return found


def followed(one: Drawn) -> js.Branch | None:
    """The branch of a scene; None where it settles on no orbit."""
    try:
        return js.branch(one.scene, KEY, *RANGE, most_points=MOST_POINTS, doublings=0, **one.how)
    except js.NumericalError:
        return None


def neighbours(branch: js.Branch, point: int) -> list[int]:
    """The stable regular points beside a special one."""
    beside = [
        i for i in (point - 1, point + 1) if 0 <= i < len(branch.value) and branch.branch[i] == branch.branch[point]
    ]
    return [i for i in beside if branch.stable[i]]


def run_from(one: Drawn, state: js.State, gamma: float, transient: int) -> Any:
    """A sweep of one value from a state."""
    scenes = js.scenes_from({KEY: [gamma]}, one.scene)
    begin = jax.tree.map(lambda a: np.asarray(a)[None], state)
    return js.sweep(scenes, state=begin, n_periods=64, transient=transient, **one.how)


def strobes(run: Any) -> np.ndarray:
    """Samples (periods, 12) of the only lane."""
    return np.concatenate([np.asarray(field)[0] for field in run.motion], axis=-1)


def compared(one: Drawn, branch: js.Branch, special: Any) -> dict[str, Any] | None:
    """What sweeps do on either side of one fold or flip; None where no stable orbit is beside it."""
    stable = neighbours(branch, special.point)
    if not stable:
        return None
    beside, q = stable[0], special.q
    sign = np.sign(branch.value[beside] - special.value)
    inside, outside = (special.value * (1 + side * ASIDE) for side in (sign, -sign))
    begin = branch.start(_nearest(branch, special, inside, beside))
    here = js.orbit(js.vary(one.scene, KEY, inside), state=begin, most_periods=4096, **one.how)
    multiplier = float(np.abs(here.others[0])) if here.found else float("nan")
    if not multiplier < 1:
        return {"kind": special.kind, "value": special.value, "q": q, "agrees": False, "why": "no stable orbit inside"}
    transient = int(min(max(256, np.ceil(10 / (1 - multiplier))), MOST_TRANSIENT))
    start = here.start
    size = np.concatenate([np.maximum(np.abs(np.asarray(f)).max(axis=0), 1e-30) for f in branch.motion])
    pushed = eqx.tree_at(lambda s: s.motion.x, start, np.asarray(start.motion.x) * (1 + PUSH * ASIDE))
    stays, leaves = run_from(one, pushed, inside, transient), run_from(one, start, outside, transient)
    orbit = run_from(one, start, inside, 0)
    near = set_distance(strobes(stays)[-q:] / size, strobes(orbit)[:q] / size)
    away = set_distance(strobes(leaves)[-q:] / size, strobes(orbit)[:q] / size)
    numbers = int(stays.period_number[0]), int(leaves.period_number[0])
    agrees = near <= NEAR and (numbers[1] != q if special.kind == "flip" else away >= LEFT)
    return {
        "kind": special.kind,
        "value": special.value,
        "q": q,
        "multiplier at 1e-3": multiplier,
        "transient": transient,
        "distance inside": near,
        "distance outside": away,
        "period numbers": numbers,
        "agrees": bool(agrees and numbers[0] == q),
    }


def _nearest(branch: js.Branch, special: Any, value: float, beside: int) -> int:
    """The stable point on the side of `beside` whose number is nearest to a value."""
    step, i, best = int(np.sign(beside - special.point)), beside, beside
    while 0 <= i < len(branch.value) and branch.stable[i] and branch.branch[i] == branch.branch[beside]:
        best = i if abs(branch.value[i] - value) < abs(branch.value[best] - value) else best
        i += step
    return best


def studied(scenes: list[Drawn], wanted: int) -> Iterator[dict[str, Any]]:
    """What is known after each scene, until so many folds and flips are compared."""
    rows, closing, ends = [], [0.0], Counter()
    counts = {"scenes": 0, "without a periodic orbit to begin with": 0, "stable points": 0, "unstable points": 0}
    kinds = dict.fromkeys(BIFURCATION_KINDS[1:], 0)
    for one in scenes:
        branch, counts["scenes"] = followed(one), counts["scenes"] + 1
        if branch is None:
            counts["without a periodic orbit to begin with"] += 1
            continue
        counts["stable points"] += int(branch.stable.sum())
        counts["unstable points"] += int((~branch.stable).sum())
        closing.append(float(branch.residual[~branch.stable].max(initial=0.0)))
        ends.update(end for pair in branch.ends for end in pair)
        for special in branch.special:
            kinds[special.kind] += 1
            told = compared(one, branch, special) if special.kind in ("fold", "flip") else None
            if told is not None:
                rows.append({"model": one.model, "overrides": one.overrides, **told})
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        yield {
            **counts,
            "ends of branches": ends,
            "special points": kinds,
            "largest closing error of unstable orbits": max(closing),
            "compared": {kind: sum(r["kind"] == kind for r in rows) for kind in ("fold", "flip")},
            "agree": {kind: sum(r["kind"] == kind and r["agrees"] for r in rows) for kind in ("fold", "flip")},
            "rows": rows,
        }
        if len(rows) >= wanted:
            return


def kept(states: Iterator[dict[str, Any]], told: dict[str, Any], path: Path) -> None:
    """Write what is known after each scene, and print the last of it."""
    began, found = time.perf_counter(), {}
    for state in states:
        found = {**told, **state, "seconds": round(time.perf_counter() - began)}
        path.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(json.dumps({name: value for name, value in found.items() if name != "rows"}, indent=1))


def main() -> None:
    """Measure and write."""
    jax.config.update("jax_enable_x64", True)
    told = {"command": "python tests/studies/branches.py", "version": js.__version__, "seed": SEED}
    kept(studied(drawn(SCENES, SEED), WANTED), told, Path(__file__).with_suffix(".json"))


if __name__ == "__main__":
    main()
