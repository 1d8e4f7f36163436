"""Whether "settled" is evidence: 300 scenes, each judged by its own run ten times longer.

    python tests/studies/settling.py

Scenes are Table 1's with c_x from 0.02 to 4 N s/m (log-uniform), gamma from 0.3 to 8, F_0 from 20 to 80 N and M_0 of
100, 10 or 0.1 to 1 N m. Each is run from rest for N periods, of which the last K are kept; every second one for at
least 20 decay times of its lightest damper, 2 m / (c_x T) periods each, the others for 0.3 to 20 of them.

Defined before looking, with the last `TAIL` periods of the 10 N as the truth:

- `settling` "yes" is wrong where the period number differs from the truth's (both 0 is alike), or, for a period
  number q, where a displacement at any phase of the orbit (period n mod q) is off by more than twice the tolerance of
  the period number, or, for aperiodic motion, where a displacement's mean or root mean square is off by more than a
  fifth of its largest value.
- `P_d_settling` "yes" is wrong where P_d is off by more than 0.02 percentage points and by more than 1.5 times the
  interval of the difference (for the 95 % interval that leaves 0.3 % by chance).
- Verdicts "unknown" are counted among the runs of at least 20 decay times.
"""

import argparse
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

LIGHTEST, HEAVIEST = 0.02, 4.0  # c_x [N s/m]
GROUP = 60  # scenes marched together, all for as many periods as the longest takes
LONGER, PIECE, TAIL, DECAY_TIMES = 10, 512, 256, 20.0
STEPS = 100
KEYS = ("blades.c_x", "contact.gamma", "drive.F_0", "drive.M_0")


class Case(NamedTuple):
    """One scene, what was kept of its run and of the run ten times longer."""

    values: np.ndarray  # of `KEYS`
    decay_times: float  # that the run lasted
    status: int
    kept: np.ndarray  # x, y, theta of both blades (K, 6)
    sizes: np.ndarray  # the largest of each (6,)
    power: np.ndarray  # (K, 2)
    tail: np.ndarray  # (TAIL, 6)
    tail_sizes: np.ndarray
    tail_power: np.ndarray  # (TAIL, 2)
    gap: int  # periods from the first kept one to the first of the tail
    P_0: np.ndarray
    lever: float


def drawn(rng: np.random.Generator, lightest: float, heaviest: float, n: int) -> np.ndarray:
    """Values (n, keys) of scenes with that range of damping."""
    c_x = np.exp(rng.uniform(np.log(lightest), np.log(heaviest), n))
    gamma, F_0 = np.exp(rng.uniform(np.log(0.3), np.log(8), n)), rng.uniform(20, 80, n)
    M_0 = np.choose(rng.integers(0, 3, n), [np.full(n, 100.0), np.full(n, 10.0), np.exp(rng.uniform(-2.3, 0, n))])
    return np.stack([c_x, gamma, F_0, M_0], axis=1)
