"""The tasks every method is timed on: many stiffness ratios, three drive periods from rest."""

from dataclasses import dataclass, replace

import numpy as np

PERIODS = 3


@dataclass(frozen=True)
class Problem:
    """Table 1 of the article with Fig. 10b's gap and force, both blades alike, consistent reading, SI units."""

    gamma: np.ndarray  # (lanes,) stiffness ratio k / k_x
    m: float = 0.08
    I: float = 2.46e-3
    k_x: float = 1e5
    k_y: float = 3e6
    k_T: float = 2000.0
    c_x: float = 3.57
    c_y: float = 19.6
    c_T: float = 0.506
    alpha: float = np.pi / 3
    l_oa: float = 0.05
    l_ab: float = 0.035
    gap: float = 0.022e-3
    k_d: float = 1e6
    mu: float = 0.5
    omega: float = 536.0
    beta: float = np.pi / 6
    F_0: float = 60.0
    M_0: float = 100.0
    phase: tuple[float, float] = (0.0, np.pi)


def problem(lanes: int = 256, *, light: bool = False) -> Problem:
    """Stiffness ratios 0.1 to 8, by Table 1; if `light` with the blocks' own inertia and a small moment.

    Faces are then nearly parallel: hundreds of case switches in a period, and flat contact.
    """
    whole = Problem(np.linspace(0.1, 8.0, lanes))
    return replace(whole, I=2.46e-5, M_0=0.5) if light else whole


def errors(states: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Largest error over the 12 components of a lane, relative to its largest component, (lanes,)."""
    return np.abs(states - reference).max(axis=1) / np.abs(reference).max(axis=1)
