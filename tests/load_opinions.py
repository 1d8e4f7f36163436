"""What the second opinion makes of amplitudes, loads and impacts: integrated with the motion, kept in a file.

`python tests/load_opinions.py` writes it anew; a test forms some of these opinions again.
"""

import math
from functools import cache
from pathlib import Path

import numpy as np
import reference

FILE = Path(__file__).parent / "load_opinions.npz"
SEED, PERIODS, RANDOM, PARALLEL = 77, 3, 12, 8
MOMENTS, LOADS = 12, 4  # quadratures: the displacements and their squares; N, N and time in slip, path of the slider
IMPACTS = ("number", "approach", "approach_sum", "impulse")
KEYS = ("samples", "first", "second", "highest", "lowest", "loads", "impacts", "friction")


def nearly_parallel(rng: np.random.Generator) -> reference.Parameters:
    """A scene with a small moment: the faces stay nearly parallel, and the case switches under load."""
    log = lambda low, high: math.exp(rng.uniform(math.log(low), math.log(high)))
    phase = (0.0, math.pi) if rng.random() < 0.6 else tuple(rng.uniform(0, math.tau, 2).tolist())
    return reference.table1(
        **{"I": 2.46e-5 * rng.uniform(0.9, 1.1), "gap": log(1e-6, 3e-4), "k": log(3e4, 1e6), "phase": phase},
        **{"F_0": log(5, 80), "M_0": log(0.05, 1), "mu": log(0.05, 0.8), "k_d": log(2e5, 3e6)},
        **{"omega": rng.uniform(300, 900), "beta": rng.uniform(0.1, 1), "alpha": rng.uniform(0.7, 1.3)},
    )


class LoadRun(reference._Run):
    """A run with the quadratures of displacements and loads, their extremes and the impacts of each period."""

    def __init__(self, p: reference.Parameters, rtol: float):
        super().__init__(p, rtol)
        place, speed = self.atol[:6], self.atol[6:7]
        loads = np.array([p.k * place[0], p.k * place[0], 0.1 * rtol, place[0] * p.omega]) / p.omega
        self.y = np.concatenate([self.y, np.zeros(MOMENTS + LOADS)])
        self.atol = np.concatenate([self.atol, place / p.omega, place * speed[0] / p.omega**2, loads])
        self.new_period()
        self.begun = 0.0  # impulse of the normal force before the contact that lasts

    def new_period(self) -> None:
        """Forget the extremes and the impacts."""
        self.highest, self.lowest = self.y[:6].copy(), self.y[:6].copy()
        self.impacts = dict.fromkeys(IMPACTS, 0.0)

    @property
    def quadratures(self) -> np.ndarray:
        return self.y[17:]

    def rhs(self, t: float, y: np.ndarray) -> list[float]:
        z = y[:12].tolist()
        loads = [0.0] * LOADS
        if self.mode != reference.APART:
            r, p = reference.relative(self.p, self.case, z[:6], z[6:]), self.p
            loads[0] = p.k * r.v
            if self.mode in reference.SIGMA:
                lag = reference.SIGMA[self.mode] * p.mu * p.k / p.k_d
                loads[1:] = loads[0], 1.0, abs(r.u_rate - lag * r.v_rate)
        return [*super().rhs(t, y), *z[:6], *(a * a for a in z[:6]), *loads]

    def first_event(self, dense, start: float, end: float):
        """The first event; the extremes until then are read off parabolas through points of the dense output."""
        event = super().first_event(dense, start, end)
        q = dense(np.linspace(start, event[0] if event else end, 33))[:6]
        self.highest = np.maximum(self.highest, [_crest(a) for a in q])
        self.lowest = np.minimum(self.lowest, [-_crest(-a) for a in q])
        return event

    def apply(self, kind: str, probe: np.ndarray) -> None:
        impulse = float(self.quadratures[MOMENTS])
        if kind == "onset":
            speed, self.begun = self.relative().v_rate, impulse
            self.impacts["number"] += 1
            self.impacts["approach_sum"] += speed
            self.impacts["approach"] = max(self.impacts["approach"], speed)
        elif kind == "separation":
            self.impacts["impulse"] = max(self.impacts["impulse"], impulse - self.begun)
        super().apply(kind, probe)


def _crest(a: np.ndarray) -> float:
    """The largest value of a curve, by the parabola through the three largest points."""
    i = int(np.argmax(a))
    if i in (0, len(a) - 1):
        return float(a[i])
    slope, bend = (a[i + 1] - a[i - 1]) / 2, a[i - 1] - 2 * a[i] + a[i + 1]
    return float(a[i] - slope**2 / (2 * bend)) if bend else float(a[i])


def opinion(p: reference.Parameters, rtol: float = 1e-12) -> dict[str, np.ndarray]:
    """What the second opinion finds in each period; empty where it gives up."""
    run, rows, before = LoadRun(p, rtol), [], np.zeros(MOMENTS + LOADS + 1)
    for period in range(1, PERIODS + 1):
        run.new_period()
        run.advance(period * run.period)
        if run.status != "ok":
            return {}
        now = np.append(run.quadratures, run.y[14])
        gain, before = now - before, now
        first, second, loads = gain[:6], gain[6:MOMENTS], gain[MOMENTS:-1]
        impacts = np.array([run.impacts[name] for name in IMPACTS])
        rows.append((run.y[:12].copy(), first, second, run.highest, run.lowest, loads, impacts, gain[-1]))
    return dict(zip(KEYS, map(np.array, zip(*rows, strict=True)), strict=True))


@cache
def scenes() -> list[reference.Parameters]:
    """Random scenes and nearly parallel ones with which the second opinion copes."""
    with np.load(FILE) as file:
        return drawn(file["seeds"].tolist())


def drawn(seeds: list[int]) -> list[reference.Parameters]:
    """The scenes of seeds: nearly parallel ones have odd seeds."""
    draws = reference.random_parameters, nearly_parallel
    return [draws[seed % 2](np.random.default_rng(seed)) for seed in seeds]


def kept() -> dict[str, np.ndarray]:
    """The opinions in the file, (scenes, periods, ...)."""
    with np.load(FILE) as file:
        return {name: file[name] for name in KEYS}


def write() -> None:
    """Form opinions until there are enough in which the second opinion is sure of itself and sees contact."""
    seeds, found = [], []
    for odd, enough in ((0, RANDOM), (1, PARALLEL)):
        seed, count = 2 * SEED + odd, 0
        while count < enough:
            (p,) = drawn([seed])
            tight, loose = opinion(p), opinion(p, 1e-11)
            if tight and loose and tight["loads"][:, 0].any() and _difference(tight, loose) < 1e-8:
                seeds, found, count = [*seeds, seed], [*found, tight], count + 1
                print(seed, _difference(tight, loose), flush=True)
            seed += 2
    np.savez_compressed(FILE, seeds=seeds, **{name: np.stack([one[name] for one in found]) for name in KEYS})


def _difference(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    """The largest difference of two opinions, relative to the size of each number."""
    of = lambda a, b: np.max(np.abs(a - b) / np.maximum(np.abs(a).max(axis=0), 1e-300))
    return max(float(of(one[name], other[name])) for name in KEYS)


if __name__ == "__main__":
    write()
