"""A third opinion, in extended precision: `extended.c`, compiled by the system's C compiler when it is asked.

It shares nothing with the march (double precision, events on polynomials) and only the parameters with `reference.py`.
"""

import ctypes
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from reference import Parameters

SOURCE = Path(__file__).with_suffix(".c")
STATUSES = ("ok", "crowded", "turned")
MOST_EVENTS = 150_000


class End(NamedTuple):
    """Where a run from rest ended."""

    status: str
    samples: np.ndarray  # (periods, 12) x, y, theta and their rates at the ends of periods, left blade before right
    switches: int  # of the case, under load
    events: int  # all others


class _Numbers(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double * 6) for name in ("m", "k", "c", "F")),
        ("phase", ctypes.c_double * 2),
        *((name, ctypes.c_double) for name in ("omega", "alpha", "l_oa", "l_ab", "gap", "k_n", "k_d", "mu")),
    ]


@cache
def _library() -> ctypes.CDLL:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "extended.so"
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", str(SOURCE), "-o", str(path), "-lm"], check=True)
        return ctypes.CDLL(str(path))


def _numbers(p: Parameters) -> _Numbers:
    sides = [(F * np.cos(np.longdouble(b)), F * np.sin(np.longdouble(b))) for F, b in zip(p.F_0, p.beta, strict=True)]
    forces = [float(side[i]) for i in (0, 1) for side in sides]
    six = lambda *values: (ctypes.c_double * 6)(*values)
    return _Numbers(
        six(*p.m, *p.m_y, *p.I),
        six(*p.k_x, *p.k_y, *p.k_T),
        six(*p.c_x, *p.c_y, *p.c_T),
        six(*forces, *p.M_0),
        (ctypes.c_double * 2)(*p.phase),
        *(p.omega, p.alpha, p.l_oa, p.l_ab, p.gap, p.k, p.k_d, p.mu),
    )


def simulate(p: Parameters, periods: int, fineness: float, flat: float) -> End:
    """So many periods from rest.

    Args:
        p: The blades; apart at the start.
        periods: Of the drive.
        fineness: The share of the usual step.
        flat: Rocking that returns within this time [s] is taken as flat contact.
    """
    samples, counts = np.full((periods, 12), np.nan, np.longdouble), (ctypes.c_long * 2)()
    status = _library().march(
        ctypes.byref(_numbers(p)),
        periods,
        ctypes.c_double(fineness),
        ctypes.c_double(flat),
        ctypes.c_long(MOST_EVENTS),
        samples.ctypes.data_as(ctypes.c_void_p),
        counts,
    )
    return End(STATUSES[status], samples, *counts)
