"""What the second opinion makes of random rows of blades, kept in a file: plain Python takes minutes to come to it.

`python tests/row_opinions.py` writes it anew. Rows are left out where the second opinion gives up (faces that are flat
on each other), where nothing touches, and where a nudge of the start by 1e-12 moves the end by more than `MOVED`.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import reference
import row_reference
from row_reference import RowParameters

FILE = Path(__file__).parent / "row_opinions.npz"
PERIODS, MOVED, MAX_DRAWS = 3, 1e-9, 400
SIZES = ((3, False), (4, True), (5, False), (6, True), (7, False), (8, True), (8, False), (3, True))  # blades, closed
RANDOM, PARALLEL = 5, 6  # rows of each size; nearly parallel ones, which become flat most often, of up to five blades


class RowOpinion(NamedTuple):
    """One row and what the second opinion finds."""

    parameters: RowParameters
    samples: np.ndarray  # (periods, 6, N) states at the ends of the periods
    counts: np.ndarray  # (kinds, interfaces), in the order of `reference.COUNTS`
    moved: float  # change of the last state by the nudge, over the largest of its kind


def drawn_row(place: int, seed: int, parallel: bool) -> RowParameters:
    """A row of the size at that place."""
    return row_reference.random_row(np.random.default_rng([place, seed, parallel]), *SIZES[place], parallel)


def row_opinion(p: RowParameters) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Samples, counts and `moved`; None where the second opinion gives up."""
    found = row_reference.simulate_row(p, PERIODS)
    counts = np.array([found.counts[kind] for kind in reference.COUNTS])
    if found.status != "ok" or not counts[:3].any():
        return None
    other = row_reference.simulate_row(row_reference.nudged(p), PERIODS)
    if other.status != "ok":
        return None
    size = np.abs(found.samples).max(axis=(0, 2))[:, None]
    return found.samples, counts, float(np.max(np.abs(other.samples - found.samples)[-1] / size))


def chosen(place: int, parallel: bool) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """The first seeds with which the second opinion copes, and what it finds."""
    found = []
    for seed in range(MAX_DRAWS):
        told = row_opinion(drawn_row(place, seed, parallel))
        if told is not None and told[2] < MOVED:
            found.append((seed, *told))
        if len(found) == (PARALLEL if parallel else RANDOM):
            break
    print(place, parallel, [one[0] for one in found], flush=True)
    return found


def kept_rows(place: int) -> list[RowOpinion]:
    """The rows in the file of the size at that place."""
    with np.load(FILE) as file:
        rows = []
        for parallel in (False, True):
            if f"{place}_{int(parallel)}_seeds" not in file:
                continue
            a = [file[f"{place}_{int(parallel)}_{name}"] for name in ("seeds", "samples", "counts", "moved")]
            for seed, samples, counts, moved in zip(*a, strict=True):
                rows.append(RowOpinion(drawn_row(place, int(seed), parallel), samples, counts, float(moved)))
        return rows


def write() -> None:
    """Form the opinions."""
    tasks = [(place, False) for place in range(len(SIZES))]
    tasks += [(place, True) for place, (blades, _) in enumerate(SIZES) if blades <= 5]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        told = list(pool.map(chosen, *zip(*tasks, strict=True)))
    arrays = {}
    for (place, parallel), found in zip(tasks, told, strict=True):
        for name, a in zip(("seeds", "samples", "counts", "moved"), zip(*found, strict=True), strict=True):
            arrays[f"{place}_{int(parallel)}_{name}"] = np.array(a)
    np.savez_compressed(FILE, **arrays)


if __name__ == "__main__":
    sys.exit(write())
