"""Random histories with contact, made by the plain reference integrator, whose numbers `fit` is to find again."""

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import reference
from side_by_side import scene_of

from jaxshroud.scene.scene import Scene

NOISE = 0.01  # of each signal's standard deviation
FEWEST_ONSETS = 2
SIGNALS = ("x_left", "x_right", "y_left", "y_right", "theta_left", "theta_right")
KEYS = ("friction.mu", "shroud.gap", "contact.k", "friction.k_d", "blades.c_x", "drive.F_0")


class History(NamedTuple):
    """A noisy record from rest, and what is to be found in it."""

    scene: Scene  # with wrong numbers in the place of those that are sought
    truth: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    table: dict[str, np.ndarray]  # as `fit` takes it
    exact: np.ndarray  # (times, signals) without noise
    sigma: np.ndarray  # of the noise of each signal
    periods: int
    events: dict[str, int]


def drawn(count: int, seed: int) -> Iterator[History]:
    """So many histories of pairs around Table 1 with small moments, half of them with light blocks."""
    rng, found = np.random.default_rng(seed), 0
    while found < count:
        one = _drawn(rng, light=found % 2 == 1)
        if one is not None:
            found += 1
            yield one


def _drawn(rng: np.random.Generator, light: bool) -> History | None:
    """A history, or None where it has too little contact or the reference does not follow it."""
    log = lambda low, high: math.exp(rng.uniform(math.log(low), math.log(high)))
    truth = {
        "friction.mu": log(0.1, 0.8),
        "shroud.gap": log(5e-6, 1e-4),
        "contact.k": log(1e5, 1e6),
        "friction.k_d": log(1e5, 2e6),
        "blades.c_x": log(3, 60),
        "drive.F_0": log(30, 90),
    }
    phase = float(rng.uniform(0, 2 * math.pi))
    p = reference.table1(
        **{key.partition(".")[2]: value for key, value in truth.items()},
        I=2.46e-5 if light else 2.46e-3,
        M_0=log(0.05, 1),
        omega=float(rng.uniform(350, 850)),
        beta=float(rng.uniform(0.1, 0.9)),
        phase=(phase, phase + math.pi * float(rng.uniform(0.8, 1.2))),
    )
    periods, a_period = int(rng.integers(2, 5)), int(rng.integers(24, 65))
    times = np.arange(1, periods * a_period + 1) * (2 * math.pi / p.omega / a_period)
    positions, events = reference.positions_at(p, times)
    if np.isnan(positions).any() or events["onset_slip"] + events["onset_stick"] < FEWEST_ONSETS:
        return None
    keys = sorted(rng.choice(KEYS, int(rng.integers(2, 6)), replace=False).tolist(), key=KEYS.index)
    seen = sorted({0, 1, *rng.choice(6, 2).tolist()})
    exact = positions[:, seen]
    sigma = NOISE * exact.std(axis=0)
    noisy = exact + sigma * rng.standard_normal(exact.shape)
    table = {"t [s]": times}
    for i, place in enumerate(seen):
        unit = "rad" if SIGNALS[place].startswith("theta") else "m"
        table[f"{SIGNALS[place]} [{unit}]"] = noisy[:, i]
    if rng.random() < 0.5:
        for header, size in zip(list(table)[1:], sigma, strict=True):
            name, unit = header.split()
            table[f"{name}_sigma {unit}"] = np.full(len(times), size)
    bounds = {key: (truth[key] / log(1.5, 6), truth[key] * log(1.5, 6)) for key in keys}
    wrong = {key: math.sqrt(bounds[key][0] * bounds[key][1]) for key in keys}
    scene = scene_of(_with(p, wrong))
    return History(scene, {key: truth[key] for key in keys}, bounds, table, exact, sigma, periods, events)


def _with(p: reference.Parameters, numbers: dict[str, float]) -> reference.Parameters:
    """The parameters with other numbers of keys, alike on both blades."""
    changes = {key.partition(".")[2]: (key.startswith(("blades", "drive")), value) for key, value in numbers.items()}
    return replace(p, **{name: (value, value) if per_blade else value for name, (per_blade, value) in changes.items()})
