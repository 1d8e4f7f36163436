"""How often the 95 % interval of P_d holds the mean, and how wide it is: 1,000 replications a case.

    python tests/studies/coverage.py

- AR(1) series with rho = 0, 0.5, 0.8, 0.9 and n = 512 and 2,048; n = 64 for what is flagged as too short.
- The same series stopped by the rule of `power` (64, 128, ... up to 16,384 periods) at two tolerances: the ideal half
  widths of 64 and of 256 independent samples. A run that does not become stable counts with the interval it ends with.
- Quasi-periodic series (a sine with the golden mean as its frequency and its half) and orbits of period 3 with AR(1)
  noise of rho = 0.5, stopped and not.
- Three chaotic scenes of the model, two of them with a small moment, each against the mean of its own 2e5 periods (64
  motions that begin a millionth apart, 200 periods discarded); stretches of 512 and 1,024 periods, and stopped runs.

"ideal" is the half width of one who knows the spectrum: 1.96 standard deviations of the mean. The three scenes are
compared with the scatter of their own stretches.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from scipy.signal import lfilter

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march.method import choices
from jaxshroud.model.linear import area, free_power
from jaxshroud.signals.averages import Reduction, reduction
from jaxshroud.signals.statistics import confidence_interval
from jaxshroud.verbs.power import FIRST_PERIODS, is_converged

RHOS, LENGTHS, REPLICATIONS, MOST = (0.0, 0.5, 0.8, 0.9), (64, 512, 2048), 1000, 16384
STOPS = (64, 256)  # independent samples whose ideal interval is as wide as the tolerance
SCENES = {"gamma 5.5, M_0 100": (5.5, 100.0), "gamma 6.5, M_0 1": (6.5, 1.0), "gamma 7.5, M_0 0.2": (7.5, 0.2)}
LANES, PERIODS, DISCARDED, STEPS = 64, 3200, 200, 100
GOLDEN = (np.sqrt(5) - 1) / 2


def autoregressive(rho: float, lanes: int, n: int, seed: int) -> np.ndarray:
    """Stationary AR(1) series (lanes, n) of mean 0 and variance 1."""
    noise = np.random.default_rng(seed).standard_normal((lanes, n))
    noise[:, 1:] *= np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise, axis=1)


def quasi_periodic(lanes: int, n: int, seed: int) -> np.ndarray:
    """Two incommensurate sines (lanes, n) of any phase."""
    turns = np.random.default_rng(seed).uniform(size=(lanes, 2))
    k = np.arange(n)
    return np.sin(2 * np.pi * (GOLDEN * k + turns[:, :1])) + 0.5 * np.sin(2 * np.pi * (GOLDEN / 2 * k + turns[:, 1:]))


def orbits(lanes: int, n: int, seed: int) -> np.ndarray:
    """Orbits of period 3 and mean 0 with noise, (lanes, n)."""
    return autoregressive(0.5, lanes, n, seed) + np.resize([4.0, -3.0, -1.0], n)


def ideal(rho: float, n: int | np.ndarray) -> np.ndarray:
    """Half width that holds the mean of n AR(1) samples with 95 %."""
    return 1.96 * np.sqrt(((1 + rho) / (1 - rho) - 2 * rho * (1 - rho**n) / (1 - rho) ** 2 / n) / n)


def averaged(series: np.ndarray, number: int) -> Reduction:
    """What `reduction` makes of P_d of each period, (lanes, n)."""
    power = np.stack([1 - series / 100, np.ones_like(series)], axis=-1)
    return reduction(power, np.ones(2), np.full(len(series), number, np.int32))


class Stop(NamedTuple):
    """Where `power` would stop on each of many series."""

    periods: np.ndarray
    P_d: np.ndarray
    ci: np.ndarray
    stable: np.ndarray


def stopped(series: np.ndarray, tolerance: float, number: int = 0) -> Stop:
    """Stops on `series` of P_d (lanes, n), by the rule and at the looks of `power`."""
    lanes, n, q = np.arange(len(series)), FIRST_PERIODS, max(number, 1)
    found = Stop(*(np.zeros(len(series), kind) for kind in (int, float, float, bool)))
    close = np.zeros(len(series), bool)
    while len(lanes):
        now = averaged(series[lanes, :n], number)
        change = np.abs(series[lanes, : n // (2 * q) * q].mean(axis=1) - now.P_d)
        enough = is_converged(now, change, tolerance)
        stable = enough & ((now.settled & (number > 0)) | close[lanes])
        for old, new in zip(found, (now.n, now.P_d, now.ci, stable), strict=True):
            old[lanes] = new
        close[lanes] = enough
        lanes = lanes[~stable] if n < series.shape[1] else lanes[:0]
        n = min(2 * n, series.shape[1])
    return found


def covered(got: Reduction | Stop, truth: float, best: np.ndarray | float | None = None) -> dict[str, float]:
    """Share of intervals that hold the truth, and their median half width over the best possible, where it is known."""
    share = {"coverage": round(float(np.mean(np.abs(got.P_d - truth) <= got.ci)), 4)}
    return share if best is None else share | {"half width over ideal": round(float(np.median(got.ci / best)), 3)}


def lasted(got: Stop) -> dict[str, float]:
    """How long stopped runs were, and how many of them stable."""
    return {"median periods": float(np.median(got.periods)), "stable": float(got.stable.mean())}


def fixed_lengths(replications: int) -> dict[str, Any]:
    """AR(1) series of given length."""
    found = {}
    for i, rho in enumerate(RHOS):
        for n in LENGTHS:
            got = averaged(autoregressive(rho, replications, n, seed=i), 0)
            flagged = {"flagged as short": float(got.ci_short.mean())}
            found[f"rho {rho}, n {n}"] = covered(got, 0.0, ideal(rho, n)) | flagged
    return found


def stops(replications: int, most: int) -> dict[str, Any]:
    """AR(1) series stopped by the rule of `power`."""
    found = {}
    for i, rho in enumerate(RHOS):
        series = autoregressive(rho, replications, most, seed=10 + i)
        for n in STOPS:
            tolerance = float(ideal(rho, n * (1 + rho) / (1 - rho)))
            got = stopped(series, tolerance)
            early = got.stable & (got.periods * (1 - rho) / (1 + rho) < 30)
            told = covered(got, 0.0, ideal(rho, got.periods)) | lasted(got)
            found[f"rho {rho}, tolerance of {n} independent samples"] = told | {
                "stable below 30 correlation times": float(early.mean())
            }
    return found


def others(replications: int, most: int) -> dict[str, Any]:
    """Quasi-periodic series and orbits with noise."""
    found: dict[str, Any] = {}
    made: dict[str, tuple[Callable, int]] = {"quasi-periodic": (quasi_periodic, 0), "period 3 with noise": (orbits, 3)}
    for name, (make, number) in made.items():
        series = make(replications, most, seed=20)
        for n in (512, 2048):
            got = averaged(series[:, :n], number)
            found[f"{name}, n {n}"] = covered(got, 0.0, 1.96 * got.P_d.std())
        end = stopped(series, 0.2, number)
        found[f"{name}, stopped at 0.2"] = covered(end, 0.0) | lasted(end)
    return found


def chaotic(gamma: float, moment: float, periods: int) -> np.ndarray:
    """P_d of each period of motions that begin a millionth apart, (lanes, periods)."""
    scene = js.load("table1", [f"contact.gamma={gamma}", f"drive.M_0={moment}", "drive.F_0=60"]).scene
    scenes = repeat_lane(scene, LANES)
    states = initial_states(jax.tree.map(np.asarray, scenes))
    x = np.asarray(states.motion.x) + 1e-9 * np.arange(LANES)[:, None]
    states = eqx.tree_at(lambda state: state.motion.x, states, x)
    method = choices(js.RungeKutta("tsit5"))
    came = run_lanes(scenes, states, Plan(DISCARDED, periods, STEPS, 0.0, method), lambda _: None)
    assert not came.last.status.any()
    return 100 * (1 - float(area(scene.shroud)) * np.asarray(came.samples.power[..., 0]) / float(free_power(scene)[0]))


def of_the_model(periods: int) -> dict[str, Any]:
    """Stretches of chaotic motions against the mean of all periods."""
    found = {}
    for name, (gamma, moment) in SCENES.items():
        series = chaotic(gamma, moment, periods)
        truth = float(series.mean())
        told: dict[str, Any] = {"P_d": truth, "half width": float(confidence_interval(series.reshape(1, -1))[0])}
        for n in (512, 1024):
            got = averaged(series[:, : periods // n * n].reshape(-1, n), 0)
            told[f"{len(got.ci)} stretches of {n}"] = covered(got, truth, 1.96 * got.P_d.std())
        end = stopped(series, 2 * float(np.median(averaged(series, 0).ci)))
        told["stopped"] = covered(end, truth) | lasted(end)
        found[name] = told
    return found


def main() -> None:
    """All cases."""
    jax.config.update("jax_enable_x64", True)
    out = {
        "command": "python tests/studies/coverage.py",
        "version": js.__version__,
        "replications": REPLICATIONS,
        "fixed lengths": fixed_lengths(REPLICATIONS),
        "stopped": stops(REPLICATIONS, MOST),
        "other series": others(REPLICATIONS, MOST),
        "chaotic scenes": of_the_model(PERIODS),
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(out, indent=1) + "\n", "utf-8")
    print(json.dumps(out, indent=1))


if __name__ == "__main__":
    main()
