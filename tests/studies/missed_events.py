"""Do power series miss events? python tests/studies/missed_events.py

Two thousand pairs of blades with their blocks' own inertia and small moments, three periods from rest, by power series
of several orders and tolerances, against Dormand-Prince 8 at 6,400 steps with cubic location: a method of another kind.
Series have 6,400 steps too, as flat contact is told by the step. A lane is a suspect where its state after some period
differs by more than a hundred times what a change of all forces by 1e-12 makes (or by the tolerance, where that is
larger), or where it has met another number of events of some kind. `missed_events.json` has all, with reasons:

- "references": Dormand-Prince 8 with cubic location and with bisection differ by a tenth of it or more, or in the
  number of events. Between faces that rock thousands of times theta_1 - theta_2 has few digits left, by which
  Runge-Kutta methods find a switch;
- "tolerance": it falls at least thirty-fold with the next tolerance, which is a thousand times finer, and no event is
  missed;
- "count": the state agrees within these bounds all the same, an event more or less is a graze;
- "flat": the only other counts are of flat contact, whose threshold a small difference decides;
- "unexplained": none of these.
"""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from jaxshroud.batch.lanes import initial_states  # noqa: E402
from jaxshroud.batch.plan import Plan  # noqa: E402
from jaxshroud.batch.runs import run_lanes  # noqa: E402
from jaxshroud.march.method import Choices  # noqa: E402
from jaxshroud.march.tableau import TaylorOptions, tableau  # noqa: E402
from jaxshroud.scene.blades import Blades  # noqa: E402
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud  # noqa: E402
from jaxshroud.version import __version__  # noqa: E402

SCENES, SEED, PERIODS, NUDGE, FACTOR = 2000, 31, 3, 1e-12, 100
ORDERS, TOLERANCES = (8, 12, 16, 20), (1e-8, 1e-11, 1e-14)
STEPS, FLOOR = 6400, 1e-14
FINE, OTHER = (Choices(tableau("dopri8"), locate, False) for locate in ("cubic", "bisection"))
KINDS = ("onset_slip", "onset_stick", "separation", "stick_slip", "slip_stick")
SWITCHES = ("switch_14", "switch_23", "switch_12", "switch_34", "flat", "flat_corner")


class Met(NamedTuple):
    """What came of lanes."""

    states: np.ndarray  # (lanes, periods, 12)
    events: np.ndarray  # (lanes, kinds)
    status: np.ndarray  # (lanes,)


def nearly_parallel(rng: np.random.Generator) -> Scene:
    """A random pair of blades whose blocks have their own inertia and small moments; the rest is Table 1's."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    I = (2.46e-5, 2.5e-4)[rng.integers(2)] * rng.uniform(0.9, 1.1)
    phase = (0.0, math.pi) if rng.random() < 0.6 else tuple(rng.uniform(0, 2 * math.pi, 2))
    return Scene(
        Blades(0.08, I, 1e5, 3e6, 2000.0, 3.57, 19.6, 0.506),
        Shroud(rng.uniform(0.7, 1.3), 0.05, 0.035, log(1e-6, 3e-4)),
        Contact(log(3e4, 1e6), None),
        Friction(log(2e5, 3e6), log(0.05, 0.8)),
        Drive(rng.uniform(300, 900), rng.uniform(0.1, 1.0), log(5, 80), log(0.05, 1.0), phase),
    )


def drawn(count: int, seed: int) -> Scene:
    """Random scenes with a leading axis."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda *a: np.stack(a), *(nearly_parallel(rng) for _ in range(count)))


def marched(scenes: Scene, method: Choices) -> Met:
    """All lanes from rest."""
    runs = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, STEPS, 0.0, method), lambda _: None)
    states = np.concatenate(runs.samples.motion, axis=-1)
    counters = runs.log.counters
    events = np.stack([getattr(counters, kind)[:, 0] for kind in KINDS + SWITCHES], axis=-1)
    return Met(states, events, np.asarray(runs.last.status))


def nudged(scenes: Scene) -> Scene:
    """The same with other forces by a rounding."""
    forces = lambda s: (s.drive.F_0, s.drive.M_0)
    return eqx.tree_at(forces, scenes, tuple(a * (1 + NUDGE) for a in forces(scenes)))


def differences(a: Met, b: Met) -> np.ndarray:
    """Largest difference of the states so far over the largest of each quantity, (lanes, periods)."""
    size = np.repeat(np.abs(a.states).reshape(*a.states.shape[:2], 6, 2).max(axis=(1, 3)), 2, axis=-1)
    apart = np.abs(a.states - b.states) / np.where(size > 0, size, 1.0)[:, None]
    return np.maximum.accumulate(apart.max(axis=-1), axis=-1)


def other_counts(a: Met, b: Met) -> np.ndarray:
    """Lanes that have met another number of events of some kind."""
    return (a.events != b.events).any(axis=-1)


def suspects(scenes: Scene, fine: Met, orders=ORDERS, tolerances=TOLERANCES) -> list[dict[str, Any]]:
    """The suspects of each order and tolerance, and why they differ."""
    moved, other = differences(fine, marched(nudged(scenes), FINE)), None
    found = []
    for order in orders:
        runs = [marched(scenes, Choices(TaylorOptions(order, tolerance), "series", False)) for tolerance in tolerances]
        apart = [differences(fine, run) for run in runs]
        for k, tolerance in enumerate(tolerances):
            bound = FACTOR * np.maximum(moved, FLOOR) * max(tolerance / NUDGE, 1.0)
            lanes = np.flatnonzero((apart[k] > bound).any(axis=-1) | other_counts(fine, runs[k]))
            if len(lanes) and other is None:
                other = marched(scenes, OTHER)
            for n in lanes:
                counts = (runs[k].events[n] - fine.events[n]).tolist()
                names = {name: c for name, c in zip(KINDS + SWITCHES, counts, strict=True) if c}
                own = differences(fine, other)[n, -1]
                if own >= apart[k][n, -1] / 10 or other_counts(fine, other)[n]:
                    reason = "references"
                elif not (apart[k][n] > bound[n]).any():
                    reason = "count"
                elif names and set(names) <= {"flat", "flat_corner"}:
                    reason = "flat"
                elif not names and k + 1 < len(runs) and apart[k + 1][n, -1] <= apart[k][n, -1] / 30:
                    reason = "tolerance"
                else:
                    reason = "unexplained"
                numbers = {"difference": apart[k][n, -1], "of a nudge": moved[n, -1], "of the references": own}
                numbers = {name: float(f"{number:.2g}") for name, number in numbers.items()}
                events = int(fine.events[n].sum())
                one = {"order": order, "tolerance": tolerance, "scene": int(n), "reason": reason, **numbers}
                found.append(one | {"events": events, "more events": names, "status": int(runs[k].status[n])})
    return found


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """How many suspects of each reason every method has."""
    reasons = "references", "tolerance", "count", "flat", "unexplained"
    table: dict[str, Any] = {}
    for one in found:
        row = table.setdefault(f"taylor {one['order']} {one['tolerance']:g}", dict.fromkeys(reasons, 0))
        row[one["reason"]] += 1
    return table


def main() -> None:
    """Measure and write."""
    scenes = drawn(SCENES, SEED)
    found = suspects(scenes, marched(scenes, FINE))
    about = {"command": "python tests/studies/missed_events.py", "version": __version__}
    about |= {"scenes": SCENES, "seed": SEED, "periods": PERIODS, "suspects": summary(found)}
    text = json.dumps(about, indent=1)[:-2] + ',\n "each": [\n  '
    text += ",\n  ".join(json.dumps(one) for one in found) + "\n ]\n}\n"
    Path(__file__).with_suffix(".json").write_text(text, "utf-8")
    print(json.dumps(about, indent=1))


if __name__ == "__main__":
    main()
