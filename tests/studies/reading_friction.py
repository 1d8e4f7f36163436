"""What the article says of friction (Secs. 3.3.1 to 3.3.3, conclusion 3), against shares of the time.

The readings are those of Eq. (1) with M_0 <= 1 N m and a consistent sign of the gap function, whose P_d is that of a
damper, and with I as printed: light blocks in flat contact take ten times as long. What the article calls viscous
motion is read as stick.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from reading_scenes import FIG17, INERTIA, SI, Point, Reading, readings, scenes
from reading_verdict import Floats

import jaxshroud as js
from jaxshroud.verbs.sweep import sweep

TRANSIENT, KEPT, STEPS = 160, 48, 200
METHOD = js.RungeKutta("tsit5", precision="float32")
OVER_GAMMA = [Point(gamma=gamma) for gamma in (0.1, 0.3, 1.0, 2.5, 4.2, 5.5, 7.5, 11.0, 15.0, 30.0)]
OVER_FORCE = [Point(F_0=F_0) for F_0 in (5.0, 10.0, 20.0, 37.0, 50.0, 67.0, 90.0, 200.0)]
PLACES = [*OVER_GAMMA, *OVER_FORCE, *(point for points in FIG17 for point in points)]
GAPS = np.array([[PLACES.index(point) for point in points] for points in FIG17])
LITTLE = 0.01  # of the time: what is less is not there
MOST = 0.5  # of the time in contact: more dominates
PURE = 1e-3  # of the time in contact: with less slip, stick is pure
CLAIMS = {
    "3.3.1, best": "P_d is largest over gamma where the blades separate, stick and slip",
    "3.3.1, gamma = 15": "stick takes more than half of the contact there, and more than at 0.3",
    "3.3.1, gamma = 30": "likewise",
    "3.3.2, no pure stick": "over the gap, no contact is without slip",
    "3.3.2, apart": "at the largest gap the blades never touch",
    "3.3.3, large force": "stick takes more than half of the contact at F_0 = 90 and 200 N, and more than at 5 N",
}


class Times(NamedTuple):
    """P_d [%] and shares of the time of readings (first axis) at `PLACES` (second axis)."""

    P_d: Floats
    apart: Floats
    stick: Floats
    slip: Floats

    @property
    def stick_in_contact(self) -> Floats:
        """Share of stick in the time in contact; NaN where there is none."""
        touching = self.stick + self.slip
        return np.where(touching > 0, self.stick / np.where(touching > 0, touching, 1.0), np.nan)


def damping(rows: list[Reading]) -> list[int]:
    """Which readings are those of a damper."""
    small = [i for i, row in enumerate(rows) if row.equation == SI and row.M_0 <= 1 and INERTIA[0] == row.I]
    return [i for i in small if "gap_sign" not in rows[i].kept]


def times(rows: list[Reading]) -> Times:
    """What every reading does at every place."""
    kinds = [row.kept for row in rows]
    parts = [[i for i, kept in enumerate(kinds) if kept == which] for which in dict.fromkeys(kinds)]
    found = [_together([rows[i] for i in part]) for part in parts]
    back = np.argsort(np.concatenate(parts))
    return Times(*(np.concatenate(column)[back] for column in zip(*found, strict=True)))


def _together(rows: list[Reading]) -> Times:
    run = sweep(
        scenes(rows, PLACES),
        n_periods=KEPT,
        transient=TRANSIENT,
        method=METHOD.replace(steps=STEPS),
        keep_samples=False,
    )
    got = (run.P_d, run.time_apart, run.time_stick, run.time_slip)
    ended = run.status == 0
    return Times(*(np.where(ended, a, np.nan).reshape(len(PLACES), len(rows)).T for a in got))


def claims(found: Times) -> dict[str, Any]:
    """Which readings bear out each claim, (readings,); over the gap with each of the lost gamma and F_0."""
    stick = found.stick_in_contact
    gamma, force = stick[:, _at(OVER_GAMMA)], stick[:, _at(OVER_FORCE)]
    return {
        "3.3.1, best": _all_three(found),
        "3.3.1, gamma = 15": (gamma[:, -2] > MOST) & (gamma[:, -2] > gamma[:, 1]),
        "3.3.1, gamma = 30": (gamma[:, -1] > MOST) & (gamma[:, -1] > gamma[:, 1]),
        "3.3.2, no pure stick": ~_pure(found).any(axis=2),
        "3.3.2, apart": found.apart[:, GAPS][:, :, -1] == 1,
        "3.3.3, large force": (force[:, -2:] > MOST).all(axis=1) & (force[:, -2:] > force[:, [0]]).all(axis=1),
    }


def _pure(found: Times) -> NDArray[np.bool_]:
    """Where contact is all stick, (readings, lost gamma and F_0, gaps)."""
    return 1 - found.stick_in_contact[:, GAPS] < PURE


def _at(points: list[Point]) -> list[int]:
    return [PLACES.index(point) for point in points]


def _all_three(found: Times) -> NDArray[np.bool_]:
    """Whether the blades separate, stick and slip where P_d is largest over gamma."""
    own = Times(*(a[:, _at(OVER_GAMMA)] for a in found))
    best = np.nan_to_num(own.P_d, nan=-np.inf).argmax(axis=1)[:, None]
    return np.all([np.take_along_axis(a, best, axis=1)[:, 0] > LITTLE for a in own[1:]], axis=0)


def friction(plausible: Reading) -> dict[str, Any]:
    """What is borne out of each claim by how many readings, and all shares of the plausible one."""
    every = readings()
    rows = [every[i] for i in damping(every)]
    found = times(rows)
    shown, mine = claims(found), rows.index(plausible)
    return {
        "run": {"transient": TRANSIENT, "kept": KEPT, "steps": STEPS, "how": str(METHOD)},
        "readings": len(rows),
        "of which none stops": int(np.isfinite(found.P_d).all(axis=1).sum()),
        "claims": CLAIMS,
        "borne out by [%]": {name: round(100 * float(a.mean()), 1) for name, a in shown.items()},
        "pure stick at each gap of Fig. 17 [%]": (100 * _pure(found).mean(axis=(0, 1))).round(1).tolist(),
        "stick in contact, 5 %, median, 95 %": {
            "over gamma": _spread(found, OVER_GAMMA),
            "over F_0": _spread(found, OVER_FORCE),
        },
        "plausible": {
            "borne out": [name for name, a in shown.items() if np.all(a[mine])],
            "over gamma": _table(found, mine, OVER_GAMMA),
            "over F_0": _table(found, mine, OVER_FORCE),
            "over the gap": [_table(found, mine, points) for points in FIG17],
        },
    }


def _spread(found: Times, points: list[Point]) -> list[list[float]]:
    """Over the readings, at each point."""
    return np.nanquantile(found.stick_in_contact[:, _at(points)], (0.05, 0.5, 0.95), axis=0).T.round(3).tolist()


def _table(found: Times, row: int, points: list[Point]) -> list[dict[str, float | None]]:
    """What one reading does at some points."""
    columns = {**found._asdict(), "stick in contact": found.stick_in_contact}
    told = {name: a[row, _at(points)] for name, a in columns.items()}
    number = lambda a: None if np.isnan(a) else round(float(a), 3)
    return [{**point._asdict(), **{name: number(a[i]) for name, a in told.items()}} for i, point in enumerate(points)]
