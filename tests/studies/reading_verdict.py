"""What speaks for a reading: hits of the printed periods, trends of P_d, and what scrambled labels would reach."""

from collections.abc import Callable
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from reading_scenes import FIG10, FIG12, FIG14, FIG16, FIG17, FIG18, TABLE5, columns

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
CHAOS, STOPPED = 0, -1
LABELS = {"Fig. 10": (1, 2, 3, CHAOS), "Fig. 14": (1, 4, CHAOS, 2), "Fig. 12": (CHAOS, 4, 2, 1)}
ORDERS = np.array(list(permutations(range(4))))  # the first leaves all labels where they are
DRAWS, SEED = 10_000, 13
ALPHA = 0.05
SLACK, FLAT = 2.0, 5.0  # percentage points: against the trend, and between neighbours on a plateau
TRENDS = {
    "Fig. 15": "P_d(n) settles in chaos",
    "Fig. 16": "P_d(gamma) rises to a best value, then falls to a nearly stable one",
    "Fig. 17": "P_d falls with the gap to 0",
    "Fig. 18": "P_d rises with F_0 to a plateau",
}


class Found(NamedTuple):
    """What all readings (first axis) did at all points (second axis)."""

    period: NDArray[np.integer]  # period number; 0: none up to 16; -1: the run stopped
    P_d: Floats  # [%], NaN where it stopped
    wander: Floats  # of P_d(n) from its last value, at most, over the second half of n [percentage points]


class Hits(NamedTuple):
    """Labels met by each reading for every order of the labels of a figure, (readings, 24)."""

    fig10: Whole
    fig14: Whole
    fig12: Whole  # with the best of the lost gamma and F_0

    @property
    def chosen_by(self) -> Whole:
        """Of Figs. 10 and 14, (readings, 24, 24)."""
        return self.fig10[:, :, None] + self.fig14[:, None, :]


def hits_of(found: Found) -> Hits:
    """How many labels each reading meets."""

    def of(points, labels) -> Whole:
        got = found.period[:, columns(points)]
        return np.stack([(got == np.array(labels)[order]).sum(axis=1) for order in ORDERS], axis=1)

    lost = np.stack([of(points, LABELS["Fig. 12"]) for points in FIG12])
    return Hits(of(FIG10, LABELS["Fig. 10"]), of(FIG14, LABELS["Fig. 14"]), lost.max(axis=0))


def table5(found: Found) -> Whole:
    """How many of Table 5's two chaotic points are, (readings,)."""
    return (found.period[:, columns(TABLE5)] == CHAOS).sum(axis=1)


def trends(found: Found) -> dict[str, NDArray[np.bool_]]:
    """Which readings show the four trends, (readings,) each."""
    with np.errstate(invalid="ignore"):
        gaps = [found.P_d[:, columns(points)] for points in FIG17]
        return {
            "Fig. 15": _settles(found),
            "Fig. 16": _peaks(found.P_d[:, columns(FIG16)]),
            "Fig. 17": np.any([_falls(curve) for curve in gaps], axis=0),
            "Fig. 18": _saturates(found.P_d[:, columns(FIG18)]),
        }


def _settles(found: Found) -> NDArray[np.bool_]:
    chaotic = found.period[:, columns(TABLE5)] == CHAOS
    return chaotic.any(axis=1) & (~chaotic | (found.wander[:, columns(TABLE5)] < SLACK)).all(axis=1)


def _peaks(P_d: Floats) -> NDArray[np.bool_]:
    best = np.nan_to_num(P_d, nan=-np.inf).argmax(axis=1)
    top, last = P_d.max(axis=1), P_d[:, -1]
    inside = (best > 0) & (best < P_d.shape[1] - 1)
    return inside & (P_d[:, 0] > 0) & (top - last > SLACK / 2) & (np.abs(last - P_d[:, -2]) < FLAT) & (last > 0)


def _falls(P_d: Floats) -> NDArray[np.bool_]:
    return (P_d[:, 0] > FLAT) & (np.diff(P_d, axis=1) < SLACK).all(axis=1) & (np.abs(P_d[:, -1]) < FLAT)


def _saturates(P_d: Floats) -> NDArray[np.bool_]:
    rises = (np.diff(P_d, axis=1) > -SLACK).all(axis=1) & (P_d[:, -1] - P_d[:, 0] > FLAT)
    return rises & (np.abs(P_d[:, -1] - P_d[:, -2]) < FLAT) & (P_d[:, -1] > 0)


class Null(NamedTuple):
    """A statistic with the printed labels, and with scrambled ones."""

    observed: float
    scrambled: Floats  # one for each draw

    @property
    def p(self) -> float:
        """How often scrambled labels reach as much; the printed order counts as one more draw."""
        return float((1 + (self.scrambled >= self.observed - 1e-9).sum()) / (1 + self.scrambled.size))


class Verdict(NamedTuple):
    """What the labels say."""

    chosen: NDArray[np.intp]  # readings with the best score on Figs. 10 and 14
    choice: Null  # that best score
    all_labels: Null  # best score on all twelve
    judged: Null  # best score of the chosen ones on Fig. 12
    mean_judged: Null  # mean score of the chosen ones on Fig. 12, against those that scrambled labels choose
    mean_trends: Null  # mean number of trends that the chosen ones show, likewise

    @property
    def supported(self) -> bool:
        """Whether the choice beats scrambled labels, and what was not used for it agrees."""
        return self.choice.p < ALPHA and self.judged.p < ALPHA and self.mean_trends.p < ALPHA

    @property
    def word(self) -> str:
        """The verdict in a word."""
        return "supported" if self.supported else "undetermined"


def verdict(found: Found, seed: int = SEED, draws: int = DRAWS) -> Verdict:
    """Choose on Figs. 10 and 14, judge on Fig. 12 and the trends; labels are scrambled within each figure."""
    hits, rng = hits_of(found), np.random.default_rng(seed)
    shown = np.sum(list(trends(found).values()), axis=0)
    a, b, c = rng.integers(len(ORDERS), size=(3, draws))
    score = hits.chosen_by
    best = score.max(axis=0)
    chosen = score == best

    def null(value: Callable[[int, int, int], float], of: tuple[NDArray, ...]) -> Null:
        keys = list(zip(*of, strict=True))
        known = {key: value(*key) for key in {(0, 0, 0), *keys}}
        return Null(known[0, 0, 0], np.array([known[key] for key in keys]))

    zero = np.zeros_like(a)
    totals = [(score[:, i] + hits.fig12[:, None, j]).max(axis=0) for i in range(24) for j in range(24)]
    total = np.array(totals).reshape(24, 24, 24)  # orders of Figs. 10, 12, 14
    return Verdict(
        chosen=np.flatnonzero(chosen[:, 0, 0]),
        choice=null(lambda i, j, _: float(best[i, j]), (a, b, zero)),
        all_labels=null(lambda i, j, k: float(total[i, k, j]), (a, b, c)),
        judged=null(lambda i, j, k: float(hits.fig12[chosen[:, 0, 0], k].max()), (zero, zero, c)),
        mean_judged=null(lambda i, j, _: float(hits.fig12[chosen[:, i, j], 0].mean()), (a, b, zero)),
        mean_trends=null(lambda i, j, _: float(shown[chosen[:, i, j]].mean()), (a, b, zero)),
    )
