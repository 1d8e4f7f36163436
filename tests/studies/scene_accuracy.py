"""What became of P_d and period numbers as shipped scenes came to say an accuracy instead of 400 steps?

    python tests/studies/scene_accuracy.py

Every shipped scene that says an accuracy, over its own sweep or alone, from rest, with its own transient and periods:
"before" by RK4 at 400 steps, "after" by the method that the accuracy chooses for all of its lanes. Two runs of a lane
agree where their period numbers do and their P_d differ by at most 0.02 percentage points or 1.5 times the interval of
the difference (of 95 % intervals, 0.3 % are further apart by chance). Lanes that change are those that do not agree.

Which is right is judged by Dormand-Prince 8 with cubic location, a method of another kind than either:

- where one of them is periodic, at 6,400 steps over the same span. A run is right that agrees with that, if sixteen
  copies do, with forces larger by 1 to 8 times 2^-50: eight by Dormand-Prince 8 at 400 steps, eight by power series to
  1e-14, as errors of either kind may all lie on one side of a boundary. Else what is reached from rest is decided by
  less than any run can know, and none is right or wrong ("roundings");
- where neither is, by a statistic: P_d of 2,000 periods at 200 steps, and its interval.

Of these lanes it is also told how many of the motions before and after are motions of the scene: Dormand-Prince 8 at
400 steps goes on from their ends, drops 32 periods, and its next 64 agree. Then motions coexist, and the start from
rest leads to either; else a run shows what is not there.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxshroud as js  # noqa: E402
from jaxshroud.batch.lanes import final_states, initial_states  # noqa: E402
from jaxshroud.batch.plan import Plan  # noqa: E402
from jaxshroud.batch.runs import run_lanes  # noqa: E402
from jaxshroud.march.method import FAST, Method, choices  # noqa: E402
from jaxshroud.model.prepared import State  # noqa: E402
from jaxshroud.scene.layout import PAIR  # noqa: E402
from jaxshroud.signals.averages import averages  # noqa: E402
from jaxshroud.verbs.arguments import Asked, plan_march, resolve_options  # noqa: E402

NEAR, DOUBTS, NUDGE = 0.02, 1.5, 2.0**-50
BEFORE, FINE = js.RungeKutta(steps=400), js.RungeKutta("dopri8", steps=6400)
LONG, COARSE = FINE.replace(steps=200), FINE.replace(steps=400)
SERIES = js.Taylor(order=16, tolerance=1e-14, steps=100)
LONG_KEPT, SETTLING, CHECKED, COPIES = 2000, 32, 64, 8
VERDICTS = ("before", "after", "both", "neither", "roundings")
EVERY = 1  # of the lanes of sweeps that list no values; more for a sample


class Found(NamedTuple):
    """What came of lanes."""

    status: np.ndarray
    number: np.ndarray  # of drive periods; 0: aperiodic
    P_d: np.ndarray
    ci: np.ndarray
    end: State

    def at(self, lanes: np.ndarray) -> "Found":
        """Some of the lanes."""
        return jax.tree.map(lambda a: np.asarray(a)[lanes], self)


def shipped() -> list[str]:
    """The scenes that say an accuracy."""
    files = {name: js.load(name) for name in js.shipped()}
    return [name for name, file in files.items() if file.run.accuracy is not None and file.layout == PAIR]


def lanes_of(file: js.SceneFile) -> js.Scene:
    """The scenes of a file's sweep, or its own, with a leading axis."""
    if not file.axes:
        return js.stack_scenes([file.scene])
    (axis,) = file.axes
    return js.scenes_from({axis.key: axis.values}, file.scene)


def some_of(file: js.SceneFile, every: int) -> np.ndarray:
    """The numbers of the lanes that are looked at."""
    count = len(file.axes[0].values) if file.axes else 1
    return np.arange(0, count, every if count > every * 4 else 1)


def marched(scenes: js.Scene, method: Method, transient: int, kept: int, states: State | None = None) -> Found:
    """All lanes, from rest or from states."""
    asked = isinstance(method, Asked)
    steps, chosen = (method.plan.steps, method.plan.method) if asked else (method.steps, choices(method))
    plan = Plan(transient, kept, steps, 0.0, chosen)  # type: ignore[arg-type]  # numbers, here
    runs = run_lanes(scenes, initial_states(scenes) if states is None else states, plan, lambda _: None)
    orbit, power, _ = averages(scenes, runs.samples)
    return Found(np.asarray(runs.last.status), orbit.number, power.P_d, power.ci, final_states(runs.last.state))


def agree(a: Found, b: Found) -> np.ndarray:
    """Whether two runs of each lane agree."""
    near = np.abs(a.P_d - b.P_d) <= np.maximum(NEAR, DOUBTS * np.hypot(a.ci, b.ci))
    return (a.number == b.number) & near


def copies_agree(scenes: js.Scene, told: Found, transient: int, kept: int) -> np.ndarray:
    """Whether all copies of each lane, with forces that are some roundings larger, agree with what is told of it."""
    forces, lanes = lambda s: (s.drive.F_0, s.drive.M_0), np.tile(np.arange(len(told.number)), COPIES)
    larger = 1 + NUDGE * np.repeat(np.arange(1, COPIES + 1), len(told.number))
    copies = jax.tree.map(lambda a: np.asarray(a)[lanes], scenes)
    copies = eqx.tree_at(forces, copies, replace_fn=lambda a: (a.T * larger).T)
    same = [agree(marched(copies, method, transient, kept), told.at(lanes)) for method in (COARSE, SERIES)]
    return np.asarray(np.reshape(same, (2 * COPIES, -1)).all(axis=0))


def told_by_run(scenes: js.Scene, transient: int, kept: int) -> tuple[Found, np.ndarray]:
    """What the same span by small steps tells, and of which lanes it is known."""
    told = marched(scenes, FINE, transient, kept)
    return told, copies_agree(scenes, told, transient, kept)


def told_by_statistic(scenes: js.Scene, transient: int, _: int) -> tuple[Found, np.ndarray]:
    """What a long run tells of aperiodic lanes."""
    told = marched(scenes, LONG, transient, LONG_KEPT)
    return told, np.ones(len(told.number), bool)


def judged(scenes: js.Scene, before: Found, after: Found, transient: int, kept: int) -> list[dict[str, Any]]:
    """The verdict on each of the lanes that change."""
    aperiodic = (before.number == 0) & (after.number == 0)
    rows: list[dict[str, Any]] = [{} for _ in aperiodic]
    for judge, at in ((told_by_run, np.flatnonzero(~aperiodic)), (told_by_statistic, np.flatnonzero(aperiodic))):
        if len(at) == 0:
            continue
        some, pair = jax.tree.map(lambda a, at=at: np.asarray(a)[at], scenes), (before.at(at), after.at(at))
        told, known = judge(some, transient, kept)
        right = np.stack([agree(one, told) for one in pair])
        there = np.stack([agree(one, marched(some, COARSE, SETTLING, CHECKED, one.end)) for one in pair])
        for i, lane in enumerate(at):
            rows[lane] = {
                "by": judge.__name__.removeprefix("told_by_"),
                "right": _verdict(*right[:, i]) if known[i] else "roundings",
                "reference": _numbers(told, i),
                "motions of the scene": dict(zip(("before", "after"), there[:, i].tolist(), strict=True)),
            }
    return rows


def _verdict(before: bool, after: bool) -> str:
    return "both" if before and after else "before" if before else "after" if after else "neither"


def _numbers(found: Found, lane: int | np.integer) -> dict[str, float]:
    values = {"P_d": round(float(found.P_d[lane]), 4), "ci": float(f"{found.ci[lane]:.2g}")}
    return {"period number": int(found.number[lane]), **values}


def compared(name: str, every: int = EVERY) -> dict[str, Any]:
    """One scene before and after, with the lanes that change."""
    file = js.load(name)
    every_lane, numbers = lanes_of(file), some_of(file, every)
    how = plan_march(resolve_options(file, of_sweep=True), every_lane, FAST).again  # as `sweep` does
    scenes = jax.tree.map(lambda a: np.asarray(a)[numbers], every_lane)
    span = file.run.transient, file.sweep_run.periods
    before, after = (marched(scenes, method, *span) for method in (BEFORE, how))
    ok = (before.status == 0) & (after.status == 0)
    change = np.flatnonzero(ok & ~agree(before, after))
    some = jax.tree.map(lambda a: np.asarray(a)[change], scenes)
    rows = judged(some, before.at(change), after.at(change), *span) if len(change) else []
    where = [{axis.key: float(axis.values[numbers[lane]]) for axis in file.axes} for lane in change]
    pairs = [{"before": _numbers(before, lane), "after": _numbers(after, lane)} for lane in change]
    return {
        "method": str(how),
        "lanes": len(numbers),
        "stopped": int((~ok).sum()),
        **_summary(before.at(ok), after.at(ok)),
        "change": len(change),
        "right": {verdict: sum(row["right"] == verdict for row in rows) for verdict in VERDICTS},
        "each": [{**place, **pair, **row} for place, pair, row in zip(where, pairs, rows, strict=True)],
    }


def _summary(before: Found, after: Found) -> dict[str, Any]:
    """Lanes that ended in both, in a few pairs of numbers."""
    both, same = (before, after), agree(before, after) & (before.number > 0)
    apart = np.abs(before.P_d - after.P_d)[same].max(initial=0.0)
    of_P_d = {"least": np.min, "largest": np.max, "mean": np.mean}
    return {
        "periodic": [int((one.number > 0).sum()) for one in both],
        "same orbit, P_d apart by at most": float(f"{apart:.2g}"),
        **{f"{word} P_d": [round(float(of(one.P_d)), 3) for one in both] for word, of in of_P_d.items()},
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    """The scenes as a table of Markdown."""
    heads = ["scene", "lanes", "periodic", "mean P_d", "change", *VERDICTS]
    pairs = lambda one: [f"{one[name][0]}, {one[name][1]}" for name in ("periodic", "mean P_d")]
    rows = [
        [f"`{name}`", one["lanes"], *pairs(one), one["change"], *one["right"].values()] for name, one in found.items()
    ]
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in [heads, ["---"] * len(heads), *rows])


def main() -> None:
    """All scenes."""
    found = {}
    for name in shipped():
        found[name] = compared(name)
        print(name, json.dumps({key: value for key, value in found[name].items() if key != "each"}), flush=True)
    out = {"command": "python tests/studies/scene_accuracy.py", "version": js.__version__, "every": EVERY, **found}
    Path(__file__).with_suffix(".json").write_text(json.dumps(out, indent=1) + "\n", "utf-8")
    print(table(found))


if __name__ == "__main__":
    main()
