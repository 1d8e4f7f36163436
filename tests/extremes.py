"""Every number of Table 1 at its extremes, alone and in pairs: what each run must come to, and how that is checked.

`python tests/extremes.py` writes docs/extremes.md.
"""

import itertools
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import FAST_WITH_LEDGER
from jaxshroud.march.stability import steps_for
from jaxshroud.model.linear import free_motion
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import StepTooLongError
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import vary

PERIODS = 2
TOLERANCE = 2e-5  # of either check: what the march errs by at automatic steps
TABLE = Path(__file__).parent.parent / "docs" / "extremes.md"
HEAD = """# Extremes

Table 1 with Fig. 10b's gap, force and stiffness (`table1`), one or two of its numbers at an extreme; two periods from
rest, RK4 at automatic steps. `OK` is checked by the energy balance (residual over the work done), or by the closed
form where the blades never touched (state over its largest number). Any other end is a status that names the cause:
refused means that the steps a period would take are more than 10^7. Alone, the numbers are also compared with the
independent second opinion (`tests/test_extremes.py`). Units are SI. Written by `python tests/extremes.py`.

| changed | steps | ends | checked by | error |
|---|---|---|---|---|
"""
SINGLES = {
    "contact.gamma": (0.0, 1e-8, 1e-4, 1e-2, 1.0, 1e2, 1e3, 1e4),
    "shroud.gap": (-2e-4, -1e-6, 0.0, 1e-12, 1e-6, 1e-3, 1.0),
    "friction.mu": (0.0, 1e-9, 1e-3, 10.0, 1e3, 1e9),
    "friction.k_d": (0.0, 1e-6, 1.0, 1e4, 1e8, 1e10, 1e12),
    "drive.F_0": (0.0, 1e-9, 1.0, 1e3, 1e5),
    "drive.M_0": (0.0, 1e-9, 1e-3, 1.0, 1e3, 1e5),
    "drive.omega": (1e-3, 1.0, 30.0, 5e3, 1e5),
    "blades.c_x": (0.0, 178.9, 1e3, 1e5),
    "blades.c_T": (0.0, 4.436, 50.0),
    "shroud.alpha": (1e-3, 0.05, 1.5, np.pi / 2),
    "blades.m": (1e-6, 1e-3, 1.0, 1e3),
    "blades.m[0]": (8e-5, 80.0),
    "blades.I": (1e-7, 1e-5, 1.0, 1e3),
    "shroud.l_ab": (1e-6, 1e-3, 1.0),
}
PAIRED = {
    "contact.gamma": (0.0, 1e3),
    "shroud.gap": (-1e-4, 0.0, 1.0),
    "friction.mu": (0.0, 1e9),
    "friction.k_d": (0.0, 1e9),
    "drive.F_0": (0.0, 1e4),
    "drive.M_0": (0.0, 1e5),
    "blades.c_x": (0.0, 1e3),
    "shroud.alpha": (0.05, np.pi / 2),
    "blades.m[0]": (8e-4, 80.0),
}


class Case(NamedTuple):
    """Changes of Table 1."""

    changes: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return ", ".join(f"{key} = {value:.4g}" for key, value in self.changes)

    def scene(self, table1: Scene) -> Scene:
        """Table 1 so changed."""
        for key, value in self.changes:
            table1 = vary(table1, key, value)
        return table1

    @property
    def expected(self) -> str:
        """How the run must end: as the change asks for, whatever else is changed."""
        value = dict(self.changes)
        if value.get("drive.omega", 1.0) < 0.1:
            return "refused"  # a period of hours, followed in steps of tens of microseconds
        if value.get("drive.M_0", 0.0) >= 1e3 or value.get("drive.F_0", 0.0) >= 1e5:
            return "ANGLE_OUT_OF_RANGE"
        return "OK"


class Result(NamedTuple):
    """What a case came to."""

    case: Case
    steps: int  # per period; 0: refused
    status: str
    check: str
    error: float


def cases() -> list[Case]:
    """All of them."""
    alone = [Case(((key, value),)) for key, values in SINGLES.items() for value in values]
    pairs = itertools.combinations(PAIRED.items(), 2)
    together = [Case(((a, x), (b, y))) for (a, xs), (b, ys) in pairs for x in xs for y in ys]
    return alone + together


def results(table1: Scene) -> list[Result]:
    """Run them all, those with as many steps side by side."""
    scenes = {case: case.scene(table1) for case in cases()}
    steps = {case: automatic_steps(scene) for case, scene in scenes.items()}
    done = [Result(case, 0, "refused", "at the door", 0.0) for case in scenes if steps[case] is None]
    for n in sorted({n for n in steps.values() if n is not None}):
        group = [case for case in scenes if steps[case] == n]
        batch = jax.tree.map(lambda *a: np.stack(a), *(scenes[case] for case in group))
        runs = run_lanes(batch, initial_states(batch), Plan(0, PERIODS, n, 0.0, FAST_WITH_LEDGER), lambda _: None)
        done += [
            _result(case, scenes[case], n, jax.tree.map(lambda a, i=i: a[i], runs)) for i, case in enumerate(group)
        ]
    order = list(scenes)
    return sorted(done, key=lambda r: order.index(r.case))


def automatic_steps(scene: Scene) -> int | None:
    """Automatic steps in powers of two; None where they are refused, or more than these tests can run."""
    try:
        n = steps_for(scene, 0, "auto", FAST_WITH_LEDGER.tableau)
    except StepTooLongError:
        return None
    return 1 << (n - 1).bit_length()


def _result(case: Case, scene: Scene, steps: int, runs) -> Result:
    status = Status(int(runs.last.status)).name
    end = np.concatenate([a[-1] for a in runs.samples.motion])
    if status != "OK":
        return Result(case, steps, status, "the cause", 0.0 if np.all(np.isnan(end)) else 1.0)
    if not int(runs.log.counters.onset_slip[0]) + int(runs.log.counters.onset_stick[0]):
        exact = free_motion(scene, scene.initial, jnp.zeros(()), PERIODS * scene.drive.period[None])
        exact = np.concatenate([np.asarray(a)[0] for a in exact])
        error = np.max(np.abs(end - exact)) / max(np.abs(exact).max(), 1e-300)
        return Result(case, steps, status, "closed form", float(error))
    work = np.abs(runs.samples.work).sum()
    spent = runs.last.accumulator.integrals.ledger  # of the last period
    scale = max(work, PERIODS * float(abs(spent.viscous) + abs(spent.friction)), 1e-300)
    return Result(case, steps, status, "energy balance", float(np.abs(runs.samples.residual.sum()) / scale))


def rows(found: list[Result]) -> list[tuple[str, ...]]:
    """The table's rows; the error as the power of ten above it."""
    power = lambda error: f"< 1e{int(np.ceil(np.log10(max(error, 1e-15))))}"
    return [(str(r.case), str(r.steps), r.status, r.check, power(r.error)) for r in found]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    from jaxshroud.scene.config import load

    lines = (f"| {' | '.join(row)} |\n" for row in rows(results(load("table1").scene)))
    TABLE.parent.mkdir(exist_ok=True)
    TABLE.write_text(HEAD + "".join(lines), encoding="utf-8")
