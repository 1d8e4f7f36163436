"""What the second opinion makes of random scenes, kept in a file: plain Python takes minutes to come to it.

`python tests/opinions.py` writes it anew; a test forms some of these opinions again.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import reference

FILE = Path(__file__).parent / "opinions.npz"
SEED, PERIODS = 2021, 3
DRAWS = {"consistent": 64, "printed": 64}  # as many lanes as run at once
READINGS = {"consistent": frozenset(), "printed": reference.PRINTED}


class Opinions(NamedTuple):
    """The outcomes of all scenes of one reading, in the order in which they are drawn."""

    status: np.ndarray  # (scenes,)
    samples: np.ndarray  # (scenes, periods, 12) states at the ends of the periods; NaN beyond the end of a run
    moved: np.ndarray  # (scenes,) change of the last state between rtol 1e-11 and 1e-12 over its largest; NaN if not OK


@cache
def scenes(reading: str) -> list[reference.Parameters]:
    """Random scenes."""
    rng = np.random.default_rng(SEED)
    return [reference.random_parameters(rng, READINGS[reading]) for _ in range(DRAWS[reading])]


def opinion(p: reference.Parameters) -> tuple[str, np.ndarray, float]:
    """Status, samples and `moved` of one scene."""
    tight = reference.simulate(p, PERIODS)
    samples = np.full((PERIODS, 12), np.nan)
    samples[: len(tight.samples)] = tight.samples
    if tight.status != "ok":
        return tight.status, samples, np.nan
    loose = reference.simulate(p, PERIODS, rtol=1e-11)
    return tight.status, samples, float(np.max(np.abs(loose.y - tight.y) / np.abs(samples).max(axis=0)))


def kept(reading: str) -> Opinions:
    """The opinions in the file."""
    with np.load(FILE) as file:
        return Opinions(*(file[f"{reading}_{name}"] for name in Opinions._fields))


if __name__ == "__main__":
    told = {reading: [np.array(a) for a in zip(*map(opinion, scenes(reading)), strict=True)] for reading in DRAWS}
    np.savez_compressed(
        FILE, **{f"{r}_{name}": a for r, of in told.items() for name, a in zip(Opinions._fields, of, strict=True)}
    )
