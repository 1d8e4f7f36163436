"""Do marches under several orders, mean loads and speed agree with independent ones? python tests/studies/load_cases.py

Random pairs and rows, every other one of light blocks, feel two to four harmonics, mean loads, stiffnesses that grow
with the speed and a gap that changes with it. They are marched here and by the plain integrator of `row_reference`, to
which the loads are added below and the numbers at speed are given. What is told of each: the largest difference of
states at the ends of periods, over the largest size of each quantity; how far a nudge of 1e-12 of the start moves
the plain integrator; and whether all counts of events are equal. A scene in which the plain integrator gives up, as
where faces lie flat on each other, is set aside. `load_cases.npz` has what that finds, `--anew` lets it find it again;
`load_cases.json` has the comparison. `--pairs` and `--rows` say how many of each.
"""

import argparse
import dataclasses
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
import reference
import row_reference

import jaxshroud as js

PERIODS, STEPS = 2, 6000
ORDER_AND_TOLERANCE = 16, 1e-13  # of the power series that march pairs
SEEDS = {"pairs": 1000, "rows": 2000}
AGREES = 1e-8
NPZ, JSON = (Path(__file__).with_suffix(suffix) for suffix in (".npz", ".json"))


class Load(NamedTuple):
    """One harmonic, of each blade."""

    order: int
    F: np.ndarray
    beta: np.ndarray
    M: np.ndarray
    phase: np.ndarray


class Loads(NamedTuple):
    """What loads a row, and what its speed changes."""

    harmonics: list[Load]
    mean: np.ndarray  # (3, blades) F_x, F_y, M
    B: np.ndarray  # (3, blades) for x, y, theta
    gap_at: np.ndarray
    gap_at_speed: float
    engine_order: int


def drawn(seed: int, is_row: bool) -> tuple[row_reference.RowParameters, Loads]:
    """The numbers of a scene at rest, without loads, and its loads."""
    rng = np.random.default_rng(seed)
    light = seed % 2 == 0
    blades, closed = (int(rng.integers(3, 6)), bool(rng.integers(2))) if is_row else (2, False)
    p = row_reference.random_row(rng, blades, closed, parallel=light)
    orders = sorted(rng.choice(np.arange(1, 6), size=int(rng.integers(2, 5)), replace=False).tolist())
    F_0, M_0 = np.array(p.F_0), np.array(p.M_0)
    each = lambda: rng.uniform(0.2, 1.0, blades)
    angle = lambda: rng.uniform(0.0, 2 * math.pi, blades)
    harmonics = [Load(n, F_0 * each(), rng.uniform(0.1, 1.2, blades), M_0 * each(), angle()) for n in orders]
    mean = np.array(
        [F_0 * rng.normal(0, 0.3, blades), F_0 * rng.normal(0, 0.3, blades), M_0 * rng.normal(0, 0.3, blades)]
    )
    engine_order, gap = int(rng.integers(2, 5)), np.array(p.gap)
    at_speed = p.omega / engine_order * rng.uniform(0.8, 1.6)
    # A gap that one speed changes by some tens of micrometres.
    loads = Loads(
        harmonics, mean, rng.uniform(0, 2.5, (3, blades)), gap + rng.normal(0, 2e-5, len(gap)), at_speed, engine_order
    )
    return dataclasses.replace(p, F_0=(0.0,) * blades, M_0=(0.0,) * blades, phase=(0.0,) * blades), loads


def at_speed(p: row_reference.RowParameters, loads: Loads) -> row_reference.RowParameters:
    """The row with the stiffnesses and the gaps that it has at its speed."""
    square = (p.omega / loads.engine_order) ** 2
    masses = {"k_x": p.m, "k_y": p.m_y, "k_T": p.I}
    grown = {
        name: tuple((p.tuned[name] + B * np.array(mass) * square).tolist())
        for (name, mass), B in zip(masses.items(), loads.B, strict=True)
    }
    gap = np.array(p.gap) + (loads.gap_at - np.array(p.gap)) * square / loads.gap_at_speed**2
    return dataclasses.replace(p, **grown, gap=tuple(gap.tolist()), mistuning=(0.0,) * p.blades)


class LoadedRow(row_reference.RowRun):
    """The plain integrator under loads of several orders; its work of the drive is not theirs."""

    def __init__(self, p: row_reference.RowParameters, loads: Loads, base: np.ndarray):
        super().__init__(p, 1e-12)
        self.mean, self.base = loads.mean, base
        self.orders = np.array([one.order for one in loads.harmonics])[:, None]
        self.inner = np.array([one.phase for one in loads.harmonics])
        of = lambda wave: np.array([wave(one) for one in loads.harmonics])
        self.sizes = [
            of(lambda one: one.F * np.cos(one.beta)),
            of(lambda one: one.F * np.sin(one.beta)),
            of(lambda one: one.M),
        ]
        self.inertia = [np.array(p.m), np.array(p.m_y), np.array(p.I)]

    def rhs(self, t: float, y: np.ndarray) -> list[float]:
        rates, n = super().rhs(t, y), self.n
        swing = np.sin(self.orders * (self.p.omega * t + self.base) + self.inner)
        for place, (size, mean, inertia) in enumerate(zip(self.sizes, self.mean, self.inertia, strict=True)):
            start = (3 + place) * n
            added = (np.sum(size * swing, axis=0) + mean) / inertia
            rates[start : start + n] = (np.array(rates[start : start + n]) + added).tolist()
        return rates


def base_phases(p: row_reference.RowParameters, loads: Loads, is_row: bool) -> np.ndarray:
    """The phases at which the blades meet the first order of the drive."""
    return 2 * math.pi * loads.engine_order * np.arange(p.blades) / p.blades if is_row else np.zeros(p.blades)


def by_reference(seed: int, is_row: bool) -> dict[str, np.ndarray]:
    """What the plain integrator finds: states (periods, 6, blades), counts (kinds,), and how far a nudge moves it."""
    p, loads = drawn(seed, is_row)
    running, base = at_speed(p, loads), base_phases(p, loads, is_row)
    states = []
    for row in (running, row_reference.nudged(running)):
        run, ends = LoadedRow(row, loads, base), []
        for period in range(1, PERIODS + 1):
            run.advance(period * run.period)
            if run.status != "ok":
                return {"status": np.array(run.status)}
            ends.append(run.y[: 6 * run.n].reshape(6, run.n).copy())
        states.append(np.array(ends))
        counts = [sum(one.counts[kind] for one in run.interfaces) for kind in reference.COUNTS]
        if row is running:
            found = np.array(counts)
    size = np.abs(states[0]).max(axis=(0, 2), keepdims=True)
    moved = np.abs((states[1] - states[0]) / size).max()
    return {"status": np.array("ok"), "states": states[0], "counts": found, "moved": moved}


def scene_of(p: row_reference.RowParameters, loads: Loads, is_row: bool) -> js.Scene:
    """The scene, from a file."""
    plain = lambda a: json.dumps(np.asarray(a, float).tolist())
    blades = {name: getattr(p, name) for name in ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T", "m_y")}
    if not is_row:
        blades |= {name: p.tuned[name] for name in ("k_x", "k_y", "k_T")}
    blades |= dict(zip(("B_x", "B_y", "B_T"), loads.B, strict=True))
    one = (lambda a: a) if is_row else (lambda a: np.asarray(a)[0])
    tables: dict[str, dict[str, Any]] = {
        "blades": blades,
        "shroud": {"alpha": p.alpha, "l_oa": p.l_oa, "l_ab": p.l_ab, "gap": one(p.gap), "gap_at": one(loads.gap_at)},
        "contact": {"k": one(p.k)},
        "friction": {"k_d": one(p.k_d), "mu": one(p.mu)},
        "drive": dict(zip(("F_x_mean", "F_y_mean", "M_mean"), loads.mean, strict=True)),
        "initial": dict(zip(("x", "y", "theta", "v_x", "v_y", "v_theta"), np.reshape(p.initial, (6, -1)), strict=True)),
    }
    tables["shroud"]["gap_at_speed"] = loads.gap_at_speed
    tables["drive"] |= {"omega": p.omega} if is_row else {"omega": p.omega, "phase": 0.0}
    if is_row:
        tables["row"] = {"mistuning": p.mistuning}
    text = "".join(
        f"[{name}]\n" + "".join(f"{key} = {plain(value)}\n" for key, value in table.items()) + _words(name, p, loads)
        for name, table in tables.items()
    )
    for harmonic in loads.harmonics:
        numbers = {name: getattr(harmonic, name) for name in ("F", "beta", "M", "phase")}
        text += f"[[drive.harmonic]]\norder = {harmonic.order}\n"
        text += "".join(f"{key} = {plain(value)}\n" for key, value in numbers.items())
    text += f"[run]\nperiods = {PERIODS}\ntransient = 0\nsteps_per_period = {STEPS}\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loads.toml"
        path.write_text(text, encoding="utf-8")
        return js.load(path).scene


def _words(table: str, p: row_reference.RowParameters, loads: Loads) -> str:
    """What a table of a file has beside its numbers."""
    if table == "row":
        return f"blades = {p.blades}\nclosed = {str(p.closed).lower()}\n"
    return f"engine_order = {loads.engine_order}\n" if table == "drive" else ""


def compared(seed: int, is_row: bool, found: dict[str, np.ndarray]) -> dict[str, Any]:
    """What is told of one scene."""
    p, loads = drawn(seed, is_row)
    if str(found["status"]) != "ok":
        return {"seed": seed, "set aside": str(found["status"])}
    method: Any = js.RungeKutta("dopri8", STEPS, locate="bisection")
    if not is_row:
        method = js.Taylor(*ORDER_AND_TOLERANCE)
    run = js.simulate(scene_of(p, loads, is_row), n_periods=PERIODS, method=method)
    states, every = found["states"], (len(run.t) - 1) // PERIODS
    size = np.abs(states).max(axis=(0, 2), keepdims=True)
    ends = np.stack(run.motion, axis=1)[every::every]
    own = [int(np.sum(run.counters[name])) for name in reference.COUNTS]
    return {
        "seed": seed,
        "orders": [one.order for one in loads.harmonics],
        "error": float(np.abs((ends - states) / size).max()),
        "nudged": float(found["moved"]),
        "counts equal": own == found["counts"].tolist(),
        "events": int(found["counts"].sum()),
        "status": str(run.status),
    }


def kept_references() -> dict[str, dict[str, np.ndarray]]:
    """What the file has, by kind and seed."""
    found: dict[str, dict[str, np.ndarray]] = {}
    if NPZ.exists():
        with np.load(NPZ) as file:
            for key in file.files:
                scene, _, name = key.partition(".")
                found.setdefault(scene, {})[name] = file[key]
    return found


def keep(found: dict[str, dict[str, np.ndarray]]) -> None:
    """Write the file."""
    arrays: dict[str, Any] = {f"{scene}.{name}": a for scene, one in found.items() for name, a in one.items()}
    np.savez_compressed(NPZ, **arrays)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--rows", type=int, default=15)
    parser.add_argument("--anew", action="store_true", help="let the plain integrator find everything again")
    asked = parser.parse_args()
    references = {} if asked.anew else kept_references()
    told: dict[str, list[Any]] = {"pairs": [], "rows": []}
    for kind, count in (("pairs", asked.pairs), ("rows", asked.rows)):
        seed = SEEDS[kind]
        while sum("set aside" not in one for one in told[kind]) < count:
            name = f"{kind}{seed}"
            if name not in references:
                references[name] = by_reference(seed, kind == "rows")
                keep(references)
            told[kind].append(compared(seed, kind == "rows", references[name]))
            print(kind, told[kind][-1], flush=True)
            JSON.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
            seed += 1


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    main()
