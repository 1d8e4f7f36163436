"""Verdicts on the kind of motion, each against its own run twenty times as long.

    python tests/studies/verdicts.py [FAMILY ...]

Scenes are drawn from four families with opposite drives on alike blades; gamma and the gap are log-uniform, from 2 to
12 and from 5 to 80 um, F_0 is uniform from 20 to 80 N, the dampers of x and y are log-uniform from 0.5 to 4 % and mu is
uniform from 0.2 to 0.6. Tsit5 at 100 steps a period; scenes whose omega_max h exceeds 1.5 are drawn again.

- `table1`: Table 1 with I = 2.46e-3 kg m^2 and M_0 of 100, 10 or (two in four) 0.1 to 1 N m;
- `eq21`: Eq. (21) literally, every natural frequency equal to the drive's, M_0 of 1 to 8 N m;
- `light`: Table 1 with the blocks' own I = 2.46e-5 kg m^2 and M_0 of 0.1 to 1 N m;
- `realistic`: light blocks of random masses (0.05 to 0.2 kg), sides, lean, stiffnesses and speed, M_0 of 0.01 to 1 N m.

A verdict is asked for after 64 periods from rest. Defined before looking, the truth is that of a run from the same
start, twenty times as long as the verdict's: "period q" where its last 256 samples repeat after at most 64 periods to a
millionth of their size and Newton's method closes a stable orbit there, to 1e-9 and within a thousandth of where the
run is (q is then the orbit's own: one still on its way may seem to have a multiple); else "chaotic" where the largest
exponent of the next 1,000 periods is positive with its interval. Scenes with neither are counted, and belong to no
class. A run that repeats like that, on an orbit like that, after an eighth of its length is not run on: it would stay
there. Where a run looks chaotic, the verdict also asks 32 copies of it, which go on for as long as its last stretch:
together some ten times as long as the run, and not counted in "twenty times". A verdict is right where it names the
truth, period number included, undecided where it says "undecided" or "transient not over", and wrong otherwise.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxshroud as js
from jaxshroud.batch.lanes import final_states, initial_states, to_vector
from jaxshroud.batch.lanes import motion_rows as rows_of
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import choices
from jaxshroud.orbits.batched_algorithms import run_together
from jaxshroud.orbits.lyapunov import largest_exponents
from jaxshroud.orbits.shooting import ShootingOptions, nearby_orbit
from jaxshroud.orbits.verdict import Verdict, verdict_text, verdicts
from jaxshroud.scene.grids import scenes_at
from jaxshroud.signals.averages import closing_tolerances_of, displacements
from jaxshroud.signals.period import recurrence

SEED, PIECE = 13, 160  # scenes that are marched together
TRANSIENT, LONGER, TAIL, CHAOS = 64, 20, 256, 1000
CLOSES, CLOSED, THERE, STIFFEST = 1e-6, 1e-9, 1e-3, 1.5
FAMILIES, STEPS = {"table1": 480, "eq21": 800, "light": 16, "realistic": 8}, 100  # scenes; steps per period
METHOD = choices(js.RungeKutta("tsit5"))
CLASSES, OPEN = ("period 1", "period > 1", "chaotic"), ("undecided", "transient not over")
Numbers = dict[str, float]


def drawn(family: str, rng: np.random.Generator) -> Numbers:
    """The numbers of one scene."""
    log = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))
    zeta, omega = log(0.005, 0.04), 536.0
    m, m_y, I, k_x, k_y, k_T = 0.08, 0.08, 2.46e-3, 1e5, 3e6, 2000.0
    told = {"gap": log(5e-6, 8e-5), "gamma": log(2, 12), "F_0": rng.uniform(20, 80), "mu": rng.uniform(0.2, 0.6)}
    l_oa, l_ab, alpha, c_T = 0.05, 0.035, np.pi / 3, 0.506
    M_0 = (100.0, 10.0, log(0.1, 1), log(0.1, 1))[rng.integers(4)]
    if family == "eq21":
        m, m_y, I, M_0 = k_x / omega**2, k_y / omega**2, k_T / omega**2, log(1, 8)
        c_T = 2 * 0.11406 * k_T / omega
    if family == "light":
        I, M_0 = 2.46e-5, log(0.1, 1)
    if family == "realistic":
        m, l_oa, l_ab, alpha = log(0.05, 0.2), rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.04), rng.uniform(0.6, 1.4)
        m_y, I = m, m * (l_oa**2 + l_ab**2) / 12 * rng.uniform(1, 5)
        k_x, k_y, k_T, omega = log(2e4, 2e5), log(1e6, 5e6), log(500, 5000), rng.uniform(300, 900)
        c_T, M_0 = 2 * log(0.01, 0.5) * np.sqrt(k_T * I), log(0.01, 1)
    blades = {"m": m, "m_y": m_y, "I": I, "k_x": k_x, "k_y": k_y, "k_T": k_T}
    damping = {"c_x": 2 * zeta * np.sqrt(k_x * m), "c_y": 2 * zeta * np.sqrt(k_y * m_y), "c_T": c_T}
    return {
        **{f"blades.{name}": value for name, value in {**blades, **damping}.items()},
        **{"shroud.alpha": alpha, "shroud.l_oa": l_oa, "shroud.l_ab": l_ab, "shroud.gap": told["gap"]},
        **{"contact.gamma": told["gamma"], "friction.mu": told["mu"]},
        **{"drive.omega": omega, "drive.F_0": told["F_0"], "drive.M_0": M_0},
    }


def scenes_of(rows: list[Numbers]) -> js.Scene:
    """Scenes (leading axis) of one structure."""
    base, keys = js.load("eq21").scene, list(rows[0])
    return scenes_at(base, keys, np.array([[row[key] for key in keys] for row in rows]))


def family_of(family: str, n: int, seed: int) -> list[Numbers]:
    """`n` scenes whose step is short enough."""
    rng, rows = np.random.default_rng([seed, list(FAMILIES).index(family)]), []
    while len(rows) < n:
        more = [drawn(family, rng) for _ in range(n)]
        scenes = scenes_of(more)
        step = 2 * np.pi / np.asarray(scenes.drive.omega) / STEPS
        fine = np.asarray(jax.vmap(js.largest_frequency)(scenes)) * step <= STIFFEST
        rows += [row for row, ok in zip(more, fine, strict=True) if ok]
    return rows[:n]


class Truth(NamedTuple):
    """What the long run says of one scene."""

    name: str  # "period q", "chaotic" or "neither"
    why: str


def truths(scenes: js.Scene, periods: int) -> list[Truth]:
    """The truth of scenes (leading axis) after so many periods from rest."""
    early = periods // 8
    out, states = closed_ones(scenes, initial_states(scenes), early)
    rest = np.array([i for i in range(len(out)) if not out[i].name.startswith("period")], int)
    if not len(rest):
        return out
    late, states = closed_ones(taken(scenes, rest), taken(states, rest), periods - early)
    for i, truth in zip(rest.tolist(), late, strict=True):
        out[i] = truth
    open_ones = np.array([i for i, truth in enumerate(late) if truth.name == "open"], int)
    if len(open_ones):
        grown = largest_exponents(taken(scenes, rest[open_ones]), taken(states, open_ones), CHAOS, STEPS, METHOD)
        for i, exponent, ci in zip(rest[open_ones].tolist(), grown.exponent, grown.ci, strict=True):
            out[i] = Truth("chaotic" if exponent - ci > 0 else "neither", f"exponent {exponent:.4f} +- {ci:.4f}")
    return out


def taken(tree: Any, at: Any) -> Any:
    """Some lanes, or one, of a tree of arrays."""
    return jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[at]), tree)


def closed_ones(scenes: js.Scene, states: js.State, periods: int) -> tuple[list[Truth], js.State]:
    """Which scenes are on a stable orbit so many periods later ("open": not), and where all are."""
    runs = run_lanes(scenes, states, Plan(periods - TAIL, TAIL, STEPS, 0.0, METHOD), lambda _: None)
    states, z, last = final_states(runs.last.state), displacements(runs.samples), rows_of(runs.samples.motion)
    number = recurrence(z, closing_tolerances_of(scenes, runs.samples, CLOSES, "float64")).number
    ended = np.asarray(runs.last.status) == js.Status.OK
    out = [Truth("open" if fine else "neither", "stopped") for fine in ended]
    lanes, aim = np.flatnonzero((number > 0) & ended), ShootingOptions(STEPS, 1e-11, METHOD)
    sought = [nearby_orbit(taken(scenes, i), taken(states, i), int(number[i]), last[i], aim) for i in lanes]
    for i, cycle in zip(lanes.tolist(), run_together(sought), strict=True):
        out[i] = _of_orbit(cycle, taken(states, i))
    return out, states


def _of_orbit(cycle: Any, state: js.State) -> Truth:
    """The truth where the run repeats, from the orbit closed there."""
    if isinstance(cycle, Exception):
        return Truth("open", str(cycle))
    here, there = to_vector(state)[:12], to_vector(cycle.start)[:12]
    sizes = np.abs(here).reshape(6, 2).max(axis=1).repeat(2)
    far = float(np.max(np.abs(here - there) / np.where(sizes > 0, sizes, 1)))
    sound = cycle.sound and cycle.residual <= CLOSED and far <= THERE
    why = f"closed to {cycle.residual:.0e}, {far:.0e} away, multiplier {abs(cycle.others[0]):.4f}, {cycle.flags}"
    return Truth(f"period {cycle.q}" if sound else "open", why)


def compared(family: str, rows: list[Numbers]) -> list[dict[str, Any]]:
    """Verdict and truth of scenes of a family."""
    scenes, began = scenes_of(rows), time.process_time()
    told = verdicts(scenes, initial_states(scenes), TRANSIENT, ShootingOptions(STEPS, 1e-11, METHOD))
    print(family, len(rows), f"verdicts: {time.process_time() - began:.0f} s of all threads", flush=True)
    out: list[dict[str, Any]] = [{} for _ in rows]
    for periods in sorted({v.periods for v in told}):
        lanes = [i for i, v in enumerate(told) if v.periods == periods]
        for i, truth in zip(lanes, truths(taken(scenes, lanes), LONGER * periods), strict=True):
            out[i] = _row(family, rows[i], told[i], truth)
    print(family, len(rows), f"and truths: {time.process_time() - began:.0f} s of all threads", flush=True)
    return out


def _row(family: str, numbers: Numbers, verdict: Verdict, truth: Truth) -> dict[str, Any]:
    """One scene."""
    judged = "right" if verdict.words == truth.name else "undecided" if verdict.kind in OPEN else "wrong"
    return {
        "family": family,
        "truth": truth.name,
        "verdict": verdict.words,
        "judged": judged,
        "periods": verdict.periods,
        "evidence": verdict_text(verdict),
        "why": truth.why,
        "numbers": {key: float(f"{value:.6g}") for key, value in numbers.items()},
    }


def class_of(name: str) -> str:
    """The class of a truth."""
    return "period > 1" if name.startswith("period ") and name != "period 1" else name


def counted(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """How often each class was called what."""
    table: dict[str, dict[str, int]] = {kind: {} for kind in (*CLASSES, "neither")}
    for row in rows:
        kind, said = class_of(row["truth"]), class_of(row["verdict"])
        if row["judged"] == "wrong" and said == kind:
            said = f"another {kind}"
        table[kind][said] = table[kind].get(said, 0) + 1
    return table


def figures(families: dict[str, dict[str, dict[str, int]]]) -> dict[str, Any]:
    """All families together, with the shares of what is wrong and undecided."""
    table = {}
    for kind in (*CLASSES, "neither"):
        said: dict[str, int] = {}
        for name, n in (item for family in families.values() for item in family[kind].items()):
            said[name] = said.get(name, 0) + n
        scenes, open_ones = sum(said.values()), sum(said.get(name, 0) for name in OPEN)
        table[kind] = {"scenes": scenes, "verdicts": said}
        if kind != "neither":
            wrong = scenes - said.get(kind, 0) - open_ones
            table[kind] |= {"wrong": wrong / max(scenes, 1), "undecided": open_ones / max(scenes, 1)}
    return table


def main() -> None:
    """The families named, or all; what there is by then is written after each piece, beside the other families."""
    jax.config.update("jax_enable_x64", True)
    path = Path(__file__).with_suffix(".json")
    wanted = sys.argv[1:] or list(FAMILIES)
    before = json.loads(path.read_text("utf-8")) if len(wanted) < len(FAMILIES) and path.exists() else {}
    families = {name: table for name, table in before.get("families", {}).items() if name not in wanted}
    failed = [row for row in before.get("not right", []) if row["family"] not in wanted]
    for family in wanted:
        rows: list[dict[str, Any]] = []
        for i in range(0, FAMILIES[family], PIECE):
            rows += compared(family, family_of(family, FAMILIES[family], SEED)[i : i + PIECE])
            held = families | {family: counted(rows)}
            about = {"command": "python tests/studies/verdicts.py", "seed": SEED, "version": js.__version__}
            more = failed + [row for row in rows if row["judged"] != "right"]
            out = {**about, **figures(held), "families": held, "not right": more}
            text = json.dumps(out, indent=1, default=lambda a: a.item(), ensure_ascii=False)
            path.write_text(text.replace("NaN", "null") + "\n", "utf-8")
        families, failed = held, more
    print(json.dumps(figures(families), indent=1))


if __name__ == "__main__":
    main()
