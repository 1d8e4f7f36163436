"""Every way to read the article at once, and the points at which its figures are compared.

A reading fixes what the print leaves open: which equation was integrated, which formulas were coded, what the lengths
and angles are, I, the damping of torsion, the unit of M_0 and where a run starts. The points are the labelled ones of
Figs. 10, 12 and 14, Table 5's, and some between and beyond for the trends of Figs. 15 to 18.
"""

from itertools import chain, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import MISPRINTS
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud

Floats = NDArray[np.float64]

FORMULAS = {
    "consistent": (),
    **{name: (name,) for name in (*MISPRINTS, "M_N1_sign")},
    "printed": MISPRINTS,
    "printed, M_N1_sign": (*MISPRINTS, "M_N1_sign"),
    "printed but for gap_sign": MISPRINTS[1:],
}
SI, LITERAL, OWN = "(1) in SI", "(21) literally", "(21), tau = omega_x t"
EQUATIONS = (SI, LITERAL, OWN)
LENGTHS = ("sides", "half diagonals")
ANGLES = ("as drawn", "interchanged")
INERTIA = (2.46e-3, 2.46e-5)  # as printed; the block's own [kg m^2]
TORSION = ("c_T = 0.506", "2 %")  # damping: as printed, or as that of bending
MOMENTS = (0.1, 1.0, 5.0, 10.0, 46.0, 100.0)  # M_0 [N m]; 5, 10 and 46 are of earlier leads
STARTS = ("rest", "apart")  # x_1 = -gap, x_2 = gap


class Reading(NamedTuple):
    """One way to read the article."""

    formulas: str = "consistent"
    angles: str = "as drawn"
    equation: str = SI
    M_0: float = 0.1
    I: float = 2.46e-3
    torsion: str = "c_T = 0.506"
    lengths: str = "sides"
    start: str = "rest"

    @property
    def kept(self) -> frozenset[str]:
        """What the package calls the `reading` of a scene."""
        return frozenset((*FORMULAS[self.formulas], *(("corner_angles",) if self.angles == "interchanged" else ())))

    @property
    def stiff(self) -> bool:
        """Whether light blocks on Eq. (1)'s own springs ask for shorter steps."""
        return self.equation == SI and INERTIA[0] > self.I


def readings() -> list[Reading]:
    """All that differ: Eq. (21) knows I only by the damping of torsion, so a stated one leaves no choice of I."""
    every = (Reading(*row) for row in product(FORMULAS, ANGLES, EQUATIONS, MOMENTS, INERTIA, TORSION, LENGTHS, STARTS))
    return [r for r in every if r.equation == SI or r.torsion != "2 %" or INERTIA[0] == r.I]


class Point(NamedTuple):
    """One simulation of every reading."""

    gamma: float = 2.6
    F_0: float = 60.0  # [N]
    gap: float = 0.022e-3  # [m]


GAMMAS, FORCES, GAPS = (0.3, 2.5, 4.2, 7.5), (10.0, 37.0, 50.0, 67.0), (0.007e-3, 0.02e-3, 0.06e-3, 0.15e-3)
LOST = tuple(product((2.6, 6.0), (10.0, 25.0, 60.0)))  # gamma and F_0 of Tables 3 and 7
FIG10 = [Point(gamma=gamma) for gamma in GAMMAS]
FIG14 = [Point(F_0=F_0) for F_0 in FORCES]
FIG12 = [[Point(gamma, F_0, gap) for gap in GAPS] for gamma, F_0 in LOST]
TABLE5 = [Point(gamma=7.0), Point(F_0=50.0)]
FIG16 = [Point(gamma=gamma) for gamma in (0.1, 0.3, 1.0, 2.5, 4.2, 7.5, 11.0, 15.0)]
FIG17 = [[Point(gamma, F_0, gap) for gap in (*GAPS, 1.5e-3)] for gamma, F_0 in LOST]
FIG18 = [Point(F_0=F_0) for F_0 in (5.0, 10.0, 20.0, 37.0, 50.0, 67.0, 90.0)]
POINTS = list(dict.fromkeys(chain(FIG10, FIG14, TABLE5, *FIG12, FIG16, *FIG17, FIG18)))


def columns(points: list[Point]) -> list[int]:
    """Where some points lie in `POINTS`."""
    return [POINTS.index(point) for point in points]


def scenes(rows: list[Reading], points: list[Point]) -> Scene:
    """Every point of every reading, points slowest; all readings keep the same misprints."""
    (kept,) = {row.kept for row in rows}
    number = {name: np.array([getattr(row, name) for row in rows]) for name in Reading._fields}
    (l_oa, l_ab), blades = _sides(number["lengths"]), _blades(number)
    over = lambda a: np.tile(a, len(points))
    pairs = lambda a: np.stack([a, a], axis=-1)
    gamma, F_0, gap = (np.repeat(column, len(rows)) for column in zip(*points, strict=True))
    away = np.where(over(number["start"] == "apart"), gap, 0.0)
    full = np.ones_like(gap)
    still = pairs(0 * full)
    return Scene(
        Blades(*(pairs(over(column)) for column in blades)),
        Shroud(np.pi / 3 * full, over(l_oa), over(l_ab), gap),
        Contact(None, gamma, kept),
        Friction(1e6 * full, 0.5 * full),
        Drive(536.0 * full, pairs(np.pi / 6 * full), pairs(F_0), pairs(over(number["M_0"])), (0 * full, np.pi * full)),
        Motion(np.stack([-away, away], axis=-1), *[still] * 5),
    )


def _sides(lengths: NDArray[np.str_]) -> tuple[Floats, Floats]:
    """Sides of the block where Table 1's l_oa = 0.05 m, l_ab = 0.035 m are those, or half its diagonals."""
    total, product_ = 2 * (0.05**2 + 0.035**2), (0.05**2 - 0.035**2) / np.cos(np.pi / 3)
    long, short = (np.sqrt(total + 2 * product_) + np.array([1, -1]) * np.sqrt(total - 2 * product_)) / 2
    sides = lengths == "sides"
    return np.where(sides, 0.05, long), np.where(sides, 0.035, short)


def _blades(number: dict[str, NDArray]) -> tuple[Floats, ...]:
    """m, I, k_x, k_y, k_T, c_x, c_y, c_T, m_y: Eq. (21) puts every natural frequency equal to that of its time."""
    k_x, k_y, k_T, m, I = 1e5, 3e6, 2000.0, 0.08, number["I"]
    eps = (
        3.57 / (2 * np.sqrt(k_x * m)),
        19.6 / (2 * np.sqrt(k_y * m)),
        np.where(number["torsion"] == "2 %", 0.02, 0.506 / (2 * np.sqrt(k_T * I))),
    )
    common = np.where(number["equation"] == LITERAL, 536.0, np.sqrt(k_x / m))
    own = np.sqrt(k_x / m), np.sqrt(k_y / m), np.sqrt(k_T / I)
    omega = [np.where(number["equation"] == SI, w, common) for w in own]
    k = k_x, k_y, k_T
    m_x, m_y, inertia = (stiff / w**2 for stiff, w in zip(k, omega, strict=True))
    c = (2 * e * stiff / w for e, stiff, w in zip(eps, k, omega, strict=True))
    same = np.ones(len(I))
    return m_x, inertia, k_x * same, k_y * same, k_T * same, *c, m_y
