"""What all readings say together, as the numbers that texts quote."""

from collections import Counter
from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reading_scenes import (
    FIG10,
    FIG12,
    FIG14,
    FIG16,
    FIG17,
    FIG18,
    LOST,
    POINTS,
    SI,
    TABLE5,
    Point,
    Reading,
    columns,
    readings,
)
from reading_verdict import LABELS, SEED, TRENDS, Found, Null, Verdict, hits_of, table5, trends, verdict

PLAUSIBLE = Reading()  # Eq. (1) in SI, consistent, Table 1 but for M_0 = 0.1 N m, from rest
GUESS = {"Fig. 10": (1, 0, 0, 0), "Fig. 14": (1, 0, 0, 0), "Fig. 12": (0, 0, 0, 1)}  # 1 where least touches, else chaos
FEW, SAMPLE = 8, 24  # readings told one by one; readings that are run again


def labelled() -> list[Point]:
    """All points that have a label."""
    return [point for point in POINTS if point in {*FIG10, *FIG14, *TABLE5, *chain(*FIG12)}]


def report(found: Found, again: Callable[[list[Reading]], Found]) -> dict[str, Any]:
    """The verdict, what led to it and what it is worth; `again` runs some readings longer and finer."""
    rows, said = readings(), verdict(found)
    told = said.chosen[:FEW]
    some = np.random.default_rng(SEED).choice(len(rows), SAMPLE, replace=False)
    fine = again([rows[i] for i in (*told, *some)])
    return {
        "verdict": said.word,
        "readings": len(rows),
        "points": len(POINTS),
        "stopped": int((found.period < 0).any(axis=1).sum()),
        "labels": LABELS,
        "null": {name: _null(getattr(said, name)) for name in Verdict._fields[1:]},
        "guess": guesses(found),
        "scores": scores(found),
        "orders met in full": full(found),
        "table5": {str(n): int((table5(found) == n).sum()) for n in range(3)},
        "chosen": len(said.chosen),
        "chosen_readings": [one(found, i) for i in said.chosen[:FEW]],
        "chosen_again": [periods(fine, i) for i in range(len(told))],
        "same label when finer and longer": same_labels(found.period[some], fine.period[len(told) :]),
        "trends": {"what": TRENDS, "all": shares(found, np.ones(len(rows), bool)), **groups(found, rows)},
        "plausible": one(found, rows.index(PLAUSIBLE)),
        "by": {name: by(found, rows, name) for name in Reading._fields},
    }


def _null(null: Null) -> dict[str, Any]:
    few = {f"{q:g} %": float(np.percentile(null.scrambled, q)) for q in (50, 95, 100)}
    return {"observed": round(null.observed, 3), "p": round(null.p, 4), "scrambled": few}


def guesses(found: Found) -> dict[str, Any]:
    """Labels that a constant guess meets, and how many readings meet more."""
    by_figure = {name: sum(map(int.__eq__, GUESS[name], labels)) for name, labels in LABELS.items()}
    hits = hits_of(found)
    chosen_by, total = hits.chosen_by[:, 0, 0], hits.chosen_by[:, 0, 0] + hits.fig12[:, 0]
    eight = by_figure["Fig. 10"] + by_figure["Fig. 14"]
    return {
        "labels": GUESS,
        "of 8": eight,
        "of 12": sum(by_figure.values()),
        "readings above it, of 8": int((chosen_by > eight).sum()),
        "readings above it, of 12": int((total > sum(by_figure.values())).sum()),
    }


def scores(found: Found) -> dict[str, dict[str, int]]:
    """How many readings meet how many labels."""
    hits = hits_of(found)
    eight = hits.chosen_by[:, 0, 0]
    every = {"Fig. 10": hits.fig10[:, 0], "Fig. 14": hits.fig14[:, 0], "Fig. 12": hits.fig12[:, 0]}
    every |= {"Figs. 10 and 14": eight, "all": eight + hits.fig12[:, 0]}
    return {name: {str(n): c for n, c in sorted(Counter(s.tolist()).items())} for name, s in every.items()}


def full(found: Found) -> dict[str, dict[str, int]]:
    """How many readings meet all labels of a figure, and how many of their 24 orders some reading meets in full."""
    hits = hits_of(found)
    every = {"Fig. 10": hits.fig10, "Fig. 14": hits.fig14, "Fig. 12": hits.fig12}
    return {
        name: {"readings": int((met[:, 0] == 4).sum()), "orders": int((met == 4).any(axis=0).sum())}
        for name, met in every.items()
    }


def one(found: Found, row: int) -> dict[str, Any]:
    """A reading and what it does."""
    here = slice(row, row + 1)
    mine = Found(found.period[here], found.P_d[here], found.wander[here])
    at = lambda points: mine.period[0, columns(points)].tolist()
    met = [sum(map(int.__eq__, at(points), LABELS["Fig. 12"])) for points in FIG12]
    lost = int(np.argmax(met))
    P_d = lambda points: [None if np.isnan(p) else round(float(p), 1) for p in mine.P_d[0, columns(points)]]
    return {
        **readings()[row]._asdict(),
        "Fig. 10": at(FIG10),
        "Fig. 14": at(FIG14),
        "Fig. 12": at(FIG12[lost]),
        "lost gamma, F_0": LOST[lost],
        "Table 5": at(TABLE5),
        "trends": [name for name, shown in trends(mine).items() if shown[0]],
        "P_d": {"Fig. 16": P_d(FIG16), "Fig. 17": P_d(FIG17[lost]), "Fig. 18": P_d(FIG18)},
    }


def periods(found: Found, row: int) -> dict[str, Any]:
    """Period numbers of a reading that was run at the labelled points alone."""
    place = {point: i for i, point in enumerate(labelled())}
    at = lambda points: [int(found.period[row, place[point]]) for point in points]
    return {"Fig. 10": at(FIG10), "Fig. 14": at(FIG14), "Fig. 12": [at(points) for points in FIG12]}


def same_labels(coarse: NDArray[np.integer], fine: NDArray[np.integer]) -> dict[str, Any]:
    """How many period numbers of readings at all points are those of a better run at the labelled points, [%]."""
    coarse = coarse[:, columns(labelled())]
    share = lambda which: round(100 * float((coarse == fine)[which].mean()), 1)
    return {"readings": len(fine), "all": share(fine > -2), "periodic": share(fine > 0), "aperiodic": share(fine == 0)}


def shares(found: Found, which: NDArray[np.bool_]) -> dict[str, Any]:
    """How many of some readings show each trend, [%]."""
    mine = {name: shown[which] for name, shown in trends(found).items()}
    together = np.sum(list(mine.values()), axis=0)
    percent = {name: round(100 * float(shown.mean()), 1) for name, shown in mine.items()}
    positive = (found.P_d[which][:, columns([*FIG16, *FIG18])] > 0).all(axis=1)
    return {"readings": int(which.sum()), **percent, "all four": int((together == 4).sum()),
            "P_d positive everywhere": round(100 * float(positive.mean()), 1)}  # fmt: skip


def groups(found: Found, rows: list[Reading]) -> dict[str, Any]:
    """The trends among readings with the consistent or the printed sign of the gap, and small or large moments."""
    printed_gap = np.array(["gap_sign" in row.kept for row in rows])
    small = np.array([row.M_0 <= 1 for row in rows])
    si, hundred = np.array([row.equation == SI for row in rows]), np.array([row.M_0 == 100 for row in rows])
    return {
        "(1) in SI, gap_sign consistent, M_0 <= 1 N m": shares(found, si & ~printed_gap & small),
        "(1) in SI, gap_sign consistent, M_0 >= 5 N m": shares(found, si & ~printed_gap & ~small),
        "(1) in SI, gap_sign consistent, M_0 = 100 N m": shares(found, si & ~printed_gap & hundred),
        "(1) in SI, gap_sign printed": shares(found, si & printed_gap),
        "(21), gap_sign consistent": shares(found, ~si & ~printed_gap),
        "(21), gap_sign printed": shares(found, ~si & printed_gap),
    }


def by(found: Found, rows: list[Reading], name: str) -> dict[str, Any]:
    """For each choice of one doubt: labels met on average and at most, and the trends."""
    hits = hits_of(found)
    total = hits.chosen_by[:, 0, 0] + hits.fig12[:, 0]
    values = np.array([str(getattr(row, name)) for row in rows])
    return {
        str(value): {
            "labels of 12, mean": round(float(total[values == value].mean()), 2),
            "labels of 12, most": int(total[values == value].max()),
            "labels of 8, most": int(hits.chosen_by[values == value, 0, 0].max()),
            "trends": shares(found, values == value),
        }
        for value in dict.fromkeys(values.tolist())
    }
