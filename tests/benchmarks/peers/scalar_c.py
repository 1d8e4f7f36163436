"""Plain C, one lane at a time: RK4 of fixed step, and 20 bisections of a step that crosses a guard."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from problem import PERIODS, Problem

NAME = "scalar C, RK4 + 20 bisections"
SETTINGS = (125, 250, 500, 1000, 2000)  # steps per period

BISECTIONS = 20
FLAGS = ("-O3", "-march=native", "-ffast-math", "-std=gnu11", "-fPIC", "-shared")
TUNING = ("-fno-tree-reassoc", "-funroll-loops")


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    return None if compiler() else "needs a C compiler (cc, gcc or clang)"


def compiler() -> str | None:
    """Path of the first C compiler found."""
    return next((path for path in map(shutil.which, ("cc", "gcc", "clang")) if path), None)


def library(source: str, *tuning: str) -> ctypes.CDLL:
    """Compile a C file of this folder, with the `tuning` options if the compiler knows them, and load it."""
    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "peer.so")
        files = str(Path(__file__).with_name(source)), "-o", target, "-lm"
        if subprocess.run([compiler(), *FLAGS, *tuning, *files], capture_output=True).returncode:
            subprocess.run([compiler(), *FLAGS, *files], check=True)
        return ctypes.CDLL(target)


def parameters(p: Problem) -> np.ndarray:
    """The scene in the order of the C sources' `Parameters`."""
    blade = (p.m, p.I, p.k_x, p.k_y, p.k_T, p.c_x, p.c_y, p.c_T)
    contact = (p.alpha, p.l_oa, p.l_ab, p.gap, p.k_d, p.mu)
    return np.array([*blade, *contact, p.omega, p.beta, p.F_0, p.M_0, *p.phase], float)


def waves(steps: int) -> np.ndarray:
    """Sine and cosine of the drive's phase at the half steps of one period."""
    angle = np.pi * np.arange(2 * steps + 1) / steps
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def pointer(a: np.ndarray) -> ctypes.c_void_p:
    """The address of an array's numbers."""
    return a.ctypes.data_as(ctypes.c_void_p)


def prepare(problem: Problem, bisections: int = BISECTIONS) -> Callable[[int], np.ndarray]:
    """Integrate all lanes with so many steps per period."""
    run = library("scalar.c", *TUNING).run
    scene, springs = parameters(problem), np.array(problem.gamma * problem.k_x, float)

    def integrate(steps: int) -> np.ndarray:
        drive, ends = waves(steps), np.empty((len(springs), 12))
        sizes = len(springs), steps, PERIODS, bisections
        run(pointer(scene), pointer(springs), *sizes, pointer(drive), pointer(ends))
        return ends

    return integrate
