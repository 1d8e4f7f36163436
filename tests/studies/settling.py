"""Whether "settled" is evidence: 300 scenes, each judged by its own run ten times longer.

    python tests/studies/settling.py

Scenes are Table 1's with c_x from 0.02 to 4 N s/m (log-uniform), gamma from 0.3 to 8, F_0 from 20 to 80 N, M_0 of 100,
10 or 0.1 to 1 N m, and gaps from 0.01 to 1 mm (wide ones leave the blades to their own dampers). Each is run from rest
for N periods, of which the last 16 to 256 are kept: every second one for 20 decay times of its lightest damper,
2 m / c_x each, the others for 0.3 to 20 of them, but 20 periods at least.

Defined before looking, with the last 256 periods of 10 N as the truth:

- "yes" of `settling` is wrong where the period number is not the truth's; or where, with a period number q, a
  displacement at any phase of the orbit is off by more than twice the tolerance of the period number; or where, in
  aperiodic motion, the mean or root mean square of a displacement is off by more than a fifth of its largest value.
- "yes" of `P_d_settling` is wrong where P_d is off by more than 0.02 percentage points and more than 1.5 times the
  interval of the difference (of 95 % intervals, 0.3 % are that far off by chance).
- "unknown" is counted among the runs of 20 decay times.
"""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.states import final_states, initial_states
from jaxshroud.march.method import choices
from jaxshroud.model.linear import area
from jaxshroud.scene.grids import scenes_at
from jaxshroud.signals.averages import displacements, half_diagonal, period_maxima, reduction
from jaxshroud.signals.period import closing_tolerances, repetition

KEYS = ("blades.c_x", "contact.gamma", "drive.F_0", "drive.M_0", "shroud.gap")
LIGHTEST, HEAVIEST, SCENES, GROUPS = 0.02, 4.0, 300, 5  # c_x in N s/m; a group is marched together
LONGER, TAIL, DECAY_TIMES, LEAST = 10, 256, 20.0, 20
PIECE, STEPS = 512, 100
VERDICTS = ("no", "yes", "unknown")


class Stretch(NamedTuple):
    """Successive periods of one lane."""

    z: np.ndarray  # displacements (n, 6)
    sizes: np.ndarray  # and their largest within each period (n, 6)
    power: np.ndarray  # (n, 2)


class Run(NamedTuple):
    """One scene, what its run kept and what the long one ended with."""

    values: np.ndarray  # of `KEYS`
    decay_times: float
    status: int
    kept: Stretch
    tail: Stretch
    later: int  # periods from the first kept one to the first of the tail
    P_0: np.ndarray
    lever: float


def drawn(rng: np.random.Generator, lightest: float, heaviest: float, n: int) -> np.ndarray:
    """Values (n, keys) of scenes."""
    log = lambda low, high: np.exp(rng.uniform(np.log(low), np.log(high), n))
    moment = np.choose(rng.integers(0, 3, n), [np.full(n, 100.0), np.full(n, 10.0), log(0.1, 1.0)])
    return np.stack([log(lightest, heaviest), log(0.3, 8.0), rng.uniform(20, 80, n), moment, log(1e-5, 1e-3)], axis=1)


def runs(seed: int, lightest: float, heaviest: float, n: int) -> list[Run]:
    """Short and long runs of `n` scenes."""
    rng = np.random.default_rng(seed)
    values, base = drawn(rng, lightest, heaviest, n), js.load("table1").scene
    decay = 2 * 0.08 / values[:, 0] / float(base.drive.period)
    times = np.where(np.arange(n) % 2 == 0, DECAY_TIMES, np.exp(rng.uniform(np.log(0.3), np.log(DECAY_TIMES), n)))
    last = np.maximum(np.ceil(decay * times), LEAST).astype(int)
    first = last - np.minimum(2 ** rng.integers(4, 9, n), last - 1)
    windows = [[(first[i], last[i]), (LONGER * last[i] - TAIL, LONGER * last[i])] for i in range(n)]
    found: list[list[list[Stretch]]] = [[[], []] for _ in range(n)]
    scenes = scenes_at(base, KEYS, values)
    states, method, status = initial_states(scenes), choices(js.RungeKutta("tsit5")), np.zeros(n, int)
    for at in range(0, LONGER * last.max(), PIECE):
        came = run_lanes(scenes, states, Plan(0, PIECE, STEPS, 0.0, method), lambda _: None)
        states, status = final_states(came.last.state), np.asarray(came.last.status)
        s = came.samples
        all_lanes = Stretch(displacements(s), period_maxima(s), s.power)
        for i, pair in enumerate(windows):
            for (begin, end), parts in zip(pair, found[i], strict=True):
                cut = slice(max(begin - at, 0), max(end - at, 0))
                parts.append(Stretch(*(a[i, cut] for a in all_lanes)))
    whole = [[Stretch(*(np.concatenate(a) for a in zip(*parts, strict=True))) for parts in pair] for pair in found]
    P_0 = np.asarray(jax.vmap(js.free_power)(scenes)) / float(area(base.shroud))  # like the mean squares
    later, lever = LONGER * last - TAIL - first, float(half_diagonal(base.shroud))
    rest = zip(values, last / decay, status.tolist(), whole, later, P_0, strict=True)
    return [Run(v, t, s, *pair, int(gap), free, lever) for v, t, s, pair, gap, free in rest]


def judged(run: Run) -> dict[str, Any]:
    """Both verdicts on one scene, and what the long run says of them."""
    number, told, power = averages(run.kept, run)
    true_number, _, true_power = averages(run.tail, run)
    off = abs(float(power.P_d[0] - true_power.P_d[0]))
    doubt = 1.5 * float(np.hypot(power.ci[0], true_power.ci[0]))
    return {
        "values": dict(zip(KEYS, (float(f"{v:.4g}") for v in run.values), strict=True)),
        "decay_times": round(float(run.decay_times), 2),
        "kept": len(run.kept.z),
        "period_number": [number, true_number],
        "settling": VERDICTS[told.verdict[0]],
        "P_d_settling": VERDICTS[power.settling[0]],
        "wrong": number != true_number or bool(strayed(run, number)),
        "P_d_wrong": off > max(0.02, doubt),
        "periods_more": float(told.periods_more[0]),
    }


def averages(stretch: Stretch, run: Run):
    """Period number, settling and power of one stretch."""
    lever, sizes = np.array([run.lever]), stretch.sizes.max(axis=0)[None]
    number, told = repetition(stretch.z[None], sizes, lever, 1e-3, np.float64)
    return int(number[0]), told, reduction(stretch.power[None], run.P_0[None], number)


def strayed(run: Run, q: int) -> bool:
    """Whether the long run ends elsewhere than the short one."""
    kept, tail, sizes = run.kept.z, run.tail.z, run.kept.sizes.max(axis=0)
    if q == 0:
        far = [abs(f(kept) - f(tail)) for f in (lambda z: z.mean(0), lambda z: np.sqrt((z**2).mean(0)))]
        return bool((np.array(far) > 0.2 * sizes).any())
    near = closing_tolerances(sizes, np.asarray(run.lever), 1e-3, np.float64)
    last = np.arange(len(kept) - q, len(kept))
    ends = np.array([tail[(i - run.later) % q :: q].mean(0) for i in last])
    return bool((np.abs(ends - kept[last]) > 2 * near).any())


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of both verdicts."""
    long = [row for row in rows if row["decay_times"] >= 0.99 * DECAY_TIMES]
    told = {}
    for name, wrong in (("settling", "wrong"), ("P_d_settling", "P_d_wrong")):
        yes = [row for row in rows if row[name] == "yes"]
        told[name] = {
            **{verdict: sum(row[name] == verdict for row in rows) for verdict in VERDICTS},
            "yes, but wrong": sum(row[wrong] for row in yes),
            "share of wrong among yes": sum(row[wrong] for row in yes) / max(len(yes), 1),
            "runs of 20 decay times": len(long),
            "share of unknown among these": sum(row[name] == "unknown" for row in long) / max(len(long), 1),
        }
    return told


def main() -> None:
    """All scenes, in groups of like damping."""
    jax.config.update("jax_enable_x64", True)
    edges = np.exp(np.linspace(np.log(LIGHTEST), np.log(HEAVIEST), GROUPS + 1))
    group = lambda i: runs(i, edges[i], edges[i + 1], SCENES // GROUPS)
    with ThreadPoolExecutor(2) as pool:
        found = [run for group in pool.map(group, range(GROUPS)) for run in group]
    rows = [judged(run) for run in found if run.status == js.Status.OK]
    doubtful = [row for row in rows if row["settling"] != "no" and (row["wrong"] or row["settling"] == "unknown")]
    about = {"command": "python tests/studies/settling.py", "seeds": list(range(GROUPS)), "version": js.__version__}
    out = {
        **about,
        "scenes": len(found),
        "stopped": len(found) - len(rows),
        **figures(rows),
        "not yes or wrong": doubtful,
    }
    text = json.dumps(out, indent=1, default=lambda a: a.item())
    Path(__file__).with_suffix(".json").write_text(text.replace("NaN", "null") + "\n", "utf-8")
    print(json.dumps(figures(rows), indent=1))


if __name__ == "__main__":
    main()
