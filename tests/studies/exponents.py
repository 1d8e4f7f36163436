"""How often the 95 % intervals of Lyapunov exponents hold: 40 runs.

    python tests/studies/exponents.py

Twenty periodic motions (Table 1 with gamma and M_0 drawn at random, those kept whose orbit closes and is stable): the
largest exponent of 64 periods after 64 of transient, or after none from a start on the orbit, against the logarithm of
the largest Floquet multiplier, to a millionth per period at best.

Twenty chaotic runs, five starts of each of four scenes: the largest exponent of 96 periods after 64 of transient
against that of 1,200 periods; the interval of the difference counts.
"""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxshroud as js

METHOD, STEPS = js.RungeKutta("tsit5"), 100
PERIODIC, KEPT, ROUNDING = 20, 64, 1e-6
CHAOTIC = ((4.8, 100.0), (5.5, 100.0), (10.0, 100.0), (6.5, 1.0))  # gamma, M_0
STARTS, STRETCH, LONG = 5, 96, 1200


def scene_at(gamma: float, moment: float) -> js.Scene:
    """Table 1 at F_0 = 60 N."""
    return js.load("table1", [f"contact.gamma={gamma}", f"drive.M_0={moment}", "drive.F_0=60"]).scene


def drawn(seed: int) -> Iterator[tuple[float, float]]:
    """Values of gamma and M_0."""
    rng = np.random.default_rng(seed)
    while True:
        yield round(float(np.exp(rng.uniform(np.log(0.3), np.log(8)))), 3), float(rng.choice([1.0, 10.0, 100.0]))


def exponent(scene: js.Scene, n: int, transient: int) -> tuple[float, float]:
    """The largest exponent and its half width."""
    found = js.lyapunov(scene, n_periods=n, transient=transient, method=METHOD.replace(steps=STEPS))
    assert found.status == js.Status.OK
    return float(found.exponents[0]), float(found.ci[0])


def row(where: dict[str, Any], got: tuple[float, float], truth: float, doubt: float) -> dict[str, Any]:
    """One run; `doubt` is the half width of the truth."""
    held = abs(got[0] - truth) <= np.hypot(got[1], doubt)
    return {**where, "exponent": got[0], "ci": got[1], "truth": truth, "held": bool(held)}


def periodic(n: int, seed: int) -> list[dict[str, Any]]:
    """Exponents of `n` orbits, with a transient and without in turns."""
    rows, places = [], drawn(seed)
    while len(rows) < n:
        gamma, moment = next(places)
        scene = scene_at(gamma, moment)
        orbit = js.orbit(scene, method=METHOD.replace(steps=STEPS), most_periods=256)
        if not orbit.found or orbit.flags:
            continue
        transient = 64 * (len(rows) % 2)
        begun = scene if transient else eqx.tree_at(lambda s: s.initial, scene, orbit.start.motion)
        truth = float(np.log(np.abs(orbit.multipliers[0])) / orbit.q)
        where = {"gamma": gamma, "M_0": moment, "period number": orbit.q, "transient": transient}
        rows.append(row(where, exponent(begun, KEPT, transient), truth, ROUNDING))
    return rows


def chaotic(place: tuple[float, float], starts: int, long: int) -> list[dict[str, Any]]:
    """Exponents of some starts of one scene."""
    scene, rows = scene_at(*place), []
    truth, doubt = exponent(scene, long, 64)
    for i in range(starts):
        x = scene.initial.x + 1e-6 * (i + 1)
        got = exponent(eqx.tree_at(lambda s: s.initial.x, scene, x), STRETCH, 64)
        rows.append(row({"gamma": place[0], "M_0": place[1], "start": i}, got, truth, doubt))
    return rows


def main() -> None:
    """All runs."""
    jax.config.update("jax_enable_x64", True)
    with ThreadPoolExecutor(2) as pool:
        regular = pool.submit(periodic, PERIODIC, 1)
        irregular = [r for rows in pool.map(lambda place: chaotic(place, STARTS, LONG), CHAOTIC) for r in rows]
        rows = regular.result() + irregular
    about = {"command": "python tests/studies/exponents.py", "seed": 1, "version": js.__version__}
    counts = {"runs": len(rows), "held": sum(r["held"] for r in rows)}
    text = json.dumps({**about, **counts, "rows": rows}, indent=1) + "\n"
    Path(__file__).with_suffix(".json").write_text(text, "utf-8")
    print(counts)


if __name__ == "__main__":
    main()
