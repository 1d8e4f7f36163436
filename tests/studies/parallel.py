"""Is 1e-9 kept between nearly parallel faces, and said where it is not? python tests/studies/parallel.py

Two hundred random pairs around Table 1 with light blocks and small moments, three periods from rest, judged by a third
opinion in extended precision (`extended.py`), whose ends are kept in `parallel.npz`; `--opinions` forms them anew, in a
quarter of an hour, and needs a C compiler. It follows every case switch, until a rocking returns within a time, ever
shorter in `LEVELS`; ends are extrapolated to none. A lane counts as judged where its ends by the last two levels, or
the extrapolations from the last two pairs of them, agree to `SETTLED`.

The accuracy is asked for all lanes in one sweep, and for some each alone; a `COARSE` setting must miss it.
`parallel.json` has for each how many judged lanes keep it, how many of these are marked, and every lane that misses it
without a mark.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import extended
import reference
from side_by_side import scene_of

from jaxshroud.orbits.short_runs import HORIZON, end_states, state_errors
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import Choice, by_series
from jaxshroud.verbs.trials import choose, missed_lanes
from jaxshroud.version import __version__

FILE = Path(__file__).with_suffix(".npz")
SCENES, SEED, ASKED = 200, 2026, 1e-9
LEVELS = ((0.5, 4e-7), (0.35, 1e-7), (0.5, 2.5e-8), (0.35, 6e-9), (0.5, 1.5e-9))  # shares of a step, times of return
LEAST_LEVELS = 4  # earlier extrapolations agreed to 1e-11 on what was 8e-8 off
ALONE = 10
COARSE = Choice(ASKED, by_series(14, 1e-12), 343, True)  # its flat contact drops too much
SAME, SETTLED = 1e-13, 2e-10


class Opinions(NamedTuple):
    """What the third opinion makes of the scenes, (scenes,)."""

    end: np.ndarray  # (scenes, 12) states after the last period
    moved: np.ndarray  # by the last quartering, relative as `state_errors` are; NaN where a run did not end
    switches: np.ndarray  # of the case, under load

    @property
    def judged(self) -> np.ndarray:
        """Whether each scene's end is known."""
        return self.moved <= SETTLED


def drawn(count: int = SCENES, seed: int = SEED) -> list[reference.Parameters]:
    """Random pairs with light blocks, or ten times heavier ones, and small moments."""
    rng = np.random.default_rng(seed)
    return [_parallel(rng) for _ in range(count)]


def _parallel(rng: np.random.Generator) -> reference.Parameters:
    log = lambda low, high: math.exp(rng.uniform(math.log(low), math.log(high)))
    inertia = (2.46e-5, 2.5e-4)[rng.integers(2)] * rng.uniform(0.9, 1.1)
    opposite, (first, other) = rng.random() < 0.6, rng.uniform(0, 2 * math.pi, 2).tolist()
    return reference.table1(
        I=inertia,
        gap=log(1e-6, 3e-4),
        k=log(3e4, 1e6),
        F_0=log(5, 80),
        M_0=log(0.05, 1),
        mu=log(0.05, 0.8),
        k_d=log(2e5, 3e6),
        omega=rng.uniform(300, 900),
        beta=rng.uniform(0.1, 1),
        alpha=rng.uniform(0.7, 1.3),
        phase=(first, first + math.pi if opposite else other),
    )


def opinion(p: reference.Parameters) -> tuple[np.ndarray, float, int]:
    """The end of one scene, how far the last quartering has moved it, and its case switches."""
    ends, found, moved, before = [], [], np.nan, None
    distance = lambda a, b: float(state_errors(a[None], b[None])[0])
    for level in LEVELS:
        run = extended.simulate(p, HORIZON, *level)
        last = run.samples[-1]
        if run.status != "ok":
            return last, np.nan, run.switches
        ends.append(last)
        if len(ends) > 1:
            before, moved = ends[-2], distance(last, ends[-2])
            if moved < SAME:
                return last, moved, run.switches
            found.append(last + (last - before) / 15)  # what is left by dropped rocking falls with the time's square
        if len(found) > 1:
            moved = distance(found[-1], found[-2])
        if len(ends) >= LEAST_LEVELS and moved <= SETTLED:
            break
    return (found or ends)[-1], moved, run.switches


def formed(scenes: list[reference.Parameters]) -> Opinions:
    """The opinions of scenes, formed anew."""
    ends, moved, switches = zip(*map(opinion, scenes), strict=True)
    return Opinions(np.array(ends, float), np.array(moved), np.array(switches))


def kept() -> Opinions:
    """The opinions in the file."""
    with np.load(FILE) as file:
        return Opinions(*(file[name] for name in Opinions._fields))


def lanes_of(scenes: list[reference.Parameters]) -> Scene:
    """The scenes with a leading axis."""
    return jax.tree.map(lambda *a: np.stack(a), *map(scene_of, scenes))


class Marked(NamedTuple):
    """What came of lanes for which the accuracy was asked, (lanes,)."""

    end: np.ndarray  # (lanes, 12)
    missed: np.ndarray  # marked as missing it
    seconds: tuple[float, float]  # of the choice, and of the marks


def asked(lanes: Scene, given: Choice | None = None) -> Marked:
    """All lanes by one choice, or by a given one."""
    start = time.perf_counter()
    choice: Choice = given or choose(lanes, 1, ASKED)
    chosen = time.perf_counter()
    missed = missed_lanes(lanes, choice)
    seconds = chosen - start, time.perf_counter() - chosen
    return Marked(end_states(lanes, choice.steps, choice.method).motions, missed, seconds)


def asked_alone(lanes: Scene) -> Marked:
    """Each lane by a choice of its own."""
    each = [asked(jax.tree.map(lambda a, i=i: a[i : i + 1], lanes)) for i in range(len(lanes.drive.omega))]
    seconds = np.sum([one.seconds for one in each], axis=0)
    return Marked(np.concatenate([a.end for a in each]), np.concatenate([a.missed for a in each]), tuple(seconds))


def figures(marked: Marked, by: Opinions) -> dict[str, Any]:
    """How the judged lanes fare."""
    error, judged = state_errors(marked.end, by.end), by.judged
    keep = judged & (error <= ASKED)
    unmarked = np.flatnonzero(judged & (error > ASKED) & ~marked.missed)
    return {
        "judged": int(judged.sum()),
        "keep it": int(keep.sum()),
        "of these marked": int((keep & marked.missed).sum()),
        "miss it": int((judged & (error > ASKED)).sum()),
        "unmarked": {int(i): float(f"{error[i]:.3g}") for i in unmarked},
        "marked of those not judged": f"{int((~judged & marked.missed).sum())} of {int((~judged).sum())}",
        "seconds": {"choice": round(marked.seconds[0], 1), "marks": round(marked.seconds[1], 1)},
    }


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opinions", action="store_true", help="form the third opinions anew")
    parser.add_argument("--seed", type=int, default=SEED, help="of other pairs, whose figures are printed alone")
    words = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    scenes = drawn(seed=words.seed)
    lanes = lanes_of(scenes)
    if words.seed != SEED:
        print(json.dumps(figures(asked(lanes), formed(scenes)), indent=1))
        return
    if words.opinions:
        np.savez_compressed(FILE, **formed(scenes)._asdict())
    by = kept()
    about = {"command": "python tests/studies/parallel.py", "version": __version__, "scenes": SCENES, "seed": SEED}
    about |= {"not judged": np.flatnonzero(~by.judged).tolist(), "most switches": int(by.switches.max())}
    some = slice(0, None, ALONE)
    few, by_few = jax.tree.map(lambda a: a[some], lanes), Opinions(*(a[some] for a in by))
    found = {"in one sweep": figures(asked(lanes), by)}
    found |= {"by a coarse setting": figures(asked(lanes, COARSE), by)}
    found |= {f"every {ALONE}th alone": figures(asked_alone(few), by_few)}
    Path(__file__).with_suffix(".json").write_text(json.dumps(about | found, indent=1) + "\n", "utf-8")
    print(json.dumps(about | found, indent=1))


if __name__ == "__main__":
    main()
