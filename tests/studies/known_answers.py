"""Exponents of textbook systems, and kinds of constructed signals: what is known before it is computed.

    python tests/studies/known_answers.py

Exponents: the QR accumulation that `lyapunov` uses, fed with the Jacobians of other maps. Logistic map at r = 4 (ln 2
exactly), Henon's map at 1.4 and 0.3 (0.4192; the sum is ln 0.3 exactly), Arnold's cat map (plus and minus the logarithm
of the golden ratio's square exactly), Lorenz's flow at 10, 28 and 8/3 (0.9056, 0 and -14.5723 per unit of time; the sum
is -41/3 exactly), after Sprott, Chaos and Time-Series Analysis (2003). And of the blades without contact, where each
exponent is -zeta omega T of its oscillator.

Signals: 512 samples of six displacements each, all functions of one constructed motion, in classes by their making: a
pattern of q = 1 .. 16 random values that repeats (12 of each q: a third exact, a third with noise of 1e-6 to 1e-4 of
its size, a third with a transient that decays to 1e-9 at least); slow drift (24: a pattern whose mean moves, or whose
transient has a hundredth to a half of its size left); quasi-periodic (32: two frequencies without a common measure,
with harmonics); chaotic (32: the maps above and the standard map, from random starts). A signal is judged by the return
map of its first half, and by the 0-1 test of its second, at whose end a repeating one must still be where it was.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxshroud as js
from jaxshroud.orbits.lyapunov import first_frames, mean_exponents, next_frames
from jaxshroud.orbits.verdict import CHAOTIC_K, REGULAR_K
from jaxshroud.orbits.verdict_evidence import zero_one
from jaxshroud.signals.period import PERIOD_TOLERANCE, closing_tolerances, recurrence

SEED, LENGTH, PERIODS, EACH, DRIFTS, TORI, CHAOTIC = 5, 512, range(1, 17), 12, 24, 32, 32
PUSHES = 5_000  # Jacobians of each system
GOLDEN = float(np.log((3 + np.sqrt(5)) / 2))
Step = Callable[[jax.Array], jax.Array]


def logistic(z: jax.Array) -> jax.Array:
    """At r = 4."""
    return 4 * z * (1 - z)


def henon(z: jax.Array) -> jax.Array:
    """At a = 1.4 and b = 0.3."""
    return jnp.stack([1 - 1.4 * z[0] ** 2 + z[1], 0.3 * z[0]])


def cat(z: jax.Array) -> jax.Array:
    """Arnold's, on the torus."""
    return jnp.stack([2 * z[0] + z[1], z[0] + z[1]]) % 1.0


def lorenz(z: jax.Array) -> jax.Array:
    """Half a unit of time, in 50 Runge-Kutta steps."""

    def rate(z):
        return jnp.stack([10 * (z[1] - z[0]), z[0] * (28 - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]])

    def step(_, z):
        a = rate(z)
        b = rate(z + 0.005 * a)
        c = rate(z + 0.005 * b)
        return z + 0.01 / 6 * (a + 2 * b + 2 * c + rate(z + 0.01 * c))

    return jax.lax.fori_loop(0, 50, step, z)


class System(NamedTuple):
    """A map, where it starts, time of one application, and what is published of its exponents."""

    step: Step
    start: tuple[float, ...]
    time: float
    known: tuple[float, ...]
    digits: float  # half of the last one that is published


SYSTEMS = {
    "logistic map": System(logistic, (0.3,), 1.0, (float(np.log(2)),), 1e-9),
    "Henon map": System(henon, (0.1, 0.1), 1.0, (0.41922, -1.62319), 5e-6),
    "cat map": System(cat, (0.1234, 0.4321), 1.0, (GOLDEN, -GOLDEN), 1e-9),
    "Lorenz flow": System(lorenz, (1.0, 1.0, 20.0), 0.5, (0.9056, 0.0, -14.5723), 5e-5),
}


def exponents_of(system: System, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Exponents per unit of time from `n` applications, and half widths of their intervals."""
    tangent = jax.jacfwd(system.step)
    march = lambda z, _: (system.step(z), tangent(z))
    settled = jax.lax.fori_loop(0, 100, lambda _, z: system.step(z), jnp.array(system.start))
    _, jacobians = jax.jit(lambda z: jax.lax.scan(march, z, None, n))(settled)
    frames, growth = first_frames(len(system.start)), []
    for M in np.asarray(jacobians):
        frames, grown = next_frames(frames, M)
        growth += grown
    mean, ci, _ = mean_exponents(np.array(growth))
    return mean / system.time, ci / system.time


def of_systems(n: int) -> dict[str, Any]:
    """Exponents found and published, and whether the published ones lie within the intervals."""
    out = {}
    for name, system in SYSTEMS.items():
        mean, ci = exponents_of(system, n)
        off = np.abs(mean - np.array(system.known))
        held = off <= 1.5 * ci + system.digits + 1e-3  # of 95 % intervals; a sum of squared steps for the flow
        out[name] = {"found": mean, "ci": ci, "published": system.known, "held": bool(np.all(held))}
    return out


def of_free_blades() -> dict[str, Any]:
    """The exponents of blades that never touch, along x alone, and the exact ones."""
    scene = js.load("table1", ['parts.motion=["x"]', 'shroud.gap="5 mm"', "blades.c_x=[8.0, 3.0]"]).scene
    found = js.lyapunov(scene, n_periods=32, transient=8, method=js.RungeKutta(locate="bisection", steps=400))
    rates = np.asarray(scene.blades.c_x / (2 * scene.blades.m)) * float(scene.drive.period)
    return {"found": found.exponents[:4], "ci": found.ci[:4], "exact": -np.sort(np.repeat(rates, 2))}


class Signal(NamedTuple):
    """A constructed motion (n, 6) and what it is."""

    samples: np.ndarray
    truth: str


def six(base: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Six displacements (n, 6) that are smooth functions of a motion (n, k)."""
    mix = rng.standard_normal((base.shape[1], 6))
    return base @ mix + 0.3 * np.sin(base @ rng.standard_normal((base.shape[1], 6)) + 1) + 0.1


def patterns(rng: np.random.Generator) -> Iterator[Signal]:
    """Periodic signals: exact, noisy, and at the end of a transient."""
    n = np.arange(LENGTH)
    for q in PERIODS:
        for i in range(EACH):
            z = six(rng.standard_normal((q, 1)), rng)[n % q]
            size = np.abs(z).max(axis=0)
            if i % 3 == 1:
                z = z + size * 10 ** rng.uniform(-6, -4) / 3 * rng.standard_normal(z.shape)
            if i % 3 == 2:
                decay = np.exp(-n / rng.uniform(2, 6))  # over by the middle of the first half
                z = z + size * rng.uniform(0.01, 0.5) * np.where(n < 1, 1, decay)[:, None] * 1e-4
            yield Signal(z, f"period {q}")


def drifts(rng: np.random.Generator) -> Iterator[Signal]:
    """Patterns that have not arrived."""
    n = np.arange(LENGTH)
    for i in range(DRIFTS):
        z = six(rng.standard_normal((int(rng.integers(1, 5)), 1)), rng)
        size = np.abs(z).max(axis=0)
        left = rng.uniform(0.01, 0.5) * size
        along = np.exp(-n / rng.uniform(40, 200)) if i % 2 else n / LENGTH
        yield Signal(z[n % len(z)] + left * along[:, None], "transient not over")


def tori(rng: np.random.Generator) -> Iterator[Signal]:
    """Two frequencies: the drive's, and another that has no common measure with it."""
    n = np.arange(LENGTH)
    for _ in range(TORI):
        turn = 2 * np.pi * (rng.integers(1, 5) * (np.sqrt(5) - 1) / 2 + rng.uniform(0, 0.01)) * n + rng.uniform(0, 6)
        base = np.stack([np.cos(turn), np.sin(turn), rng.uniform(0, 0.5) * np.cos(2 * turn + 1)], axis=-1)
        yield Signal(six(base, rng), "quasi-periodic")


def chaos(rng: np.random.Generator) -> Iterator[Signal]:
    """Maps that are known to be chaotic, from random starts."""

    def standard(z):
        p = (z[1] + 7 * np.sin(2 * np.pi * z[0]) / (2 * np.pi)) % 1
        return np.array([(z[0] + p) % 1, p])

    maps = [logistic, henon, cat, standard]
    for i in range(CHAOTIC):
        step = maps[i % 4]
        z, run = rng.uniform(0.05, 0.25, 1 if step is logistic else 2), []
        for _ in range(LENGTH + 50):
            z = np.asarray(step(z))
            run.append(z)
        yield Signal(six(np.array(run[50:]), rng), "chaotic")


def signals(seed: int) -> list[Signal]:
    """All of them."""
    rng = np.random.default_rng(seed)
    return [*patterns(rng), *drifts(rng), *tori(rng), *chaos(rng)]


def kind_of(signal: Signal) -> str:
    """What a signal is called."""
    first, second = signal.samples[: LENGTH // 2], signal.samples[LENGTH // 2 :]
    near = closing_tolerances(np.abs(first).max(axis=0), np.ones(()), PERIOD_TOLERANCE, np.float64)
    told = recurrence(first[None], near[None])
    q = int(told.number[0])
    if q:
        last = np.arange(LENGTH - q, LENGTH)
        stays = np.all(np.abs(signal.samples[last] - first[last % q]) <= near)
        return f"period {q}" if stays else "transient not over"
    if told.one_way[0]:
        return "transient not over"
    K = float(zero_one(second[:, np.ptp(second, axis=0).argmax()]))
    return "chaotic" if K > CHAOTIC_K else "quasi-periodic" if K < REGULAR_K else "undecided"


def confusion(of: list[Signal]) -> dict[str, dict[str, int]]:
    """Truth -> what it was called -> how often."""
    table: dict[str, dict[str, int]] = {}
    for signal in of:
        row, said = table.setdefault(signal.truth, {}), kind_of(signal)
        row[said] = row.get(said, 0) + 1
    return table


def main() -> None:
    """Both."""
    jax.config.update("jax_enable_x64", True)
    of = signals(SEED)
    table = confusion(of)
    right = sum(row.get(truth, 0) for truth, row in table.items())
    about = {"command": "python tests/studies/known_answers.py", "seed": SEED, "version": js.__version__}
    counts = {"signals": len(of), "right": right, "confusion": table}
    out = {**about, "exponents": of_systems(PUSHES), "free blades": of_free_blades(), **counts}
    text = json.dumps(out, indent=1, default=lambda a: a.tolist()) + "\n"
    Path(__file__).with_suffix(".json").write_text(text, "utf-8")
    print(text)


if __name__ == "__main__":
    main()
