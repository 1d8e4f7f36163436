"""pyHarm, a published harmonic-balance code (Apache-2.0, by Safran), on the scene `dry_friction_2dof`.

Its element `Penalty3D` is a contact spring under a preload N_0 whose friction is limited by the normal force at every
instant. Displacements are counted from rest, they open the contact where they are positive (x has the opposite sign),
and there has to be a second tangential direction, which nothing drives here.

The element as we read version 1.2.2 cannot express contact that opens, which leaves the other scenes out: under a
preload its spring force, k x up to N_0, is 0 beyond instead of N_0, and with a gap (N_0 = 0) its friction acts only
where the normal force is not positive, which is never in contact.
"""

import importlib
import importlib.util
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from unittest import mock

import jax
import numpy as np
from harmonic_balance import Oscillator

NAME = "pyHarm"
SAMPLES = 1000  # in a period, of the contact forces
FOLDER = tempfile.TemporaryDirectory()


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    return None if importlib.util.find_spec("pyHarm") else "needs pyHarm-os"


@contextmanager
def quiet_elsewhere() -> Iterator[None]:
    """A folder that goes with this process, for the settings that it writes; and no log."""
    home = {"HOME": FOLDER.name, "USERPROFILE": FOLDER.name}
    logging.disable(logging.CRITICAL)
    try:
        with chdir(FOLDER.name), mock.patch.dict(os.environ, home), jax.numpy_dtype_promotion("standard"):
            yield
    finally:
        logging.disable(logging.NOTSET)


def model(system: Oscillator, harmonics: int) -> dict:
    """Its description of an oscillator in x and y whose face is along y and always pressed."""
    k, k_d, mu = system.contact
    at_rest = k * system.v_0 * system.k[0] / (system.k[0] + k)  # both springs share the preload
    matrices = {name: np.diag([*one, 1.0]) for name, one in zip("MCK", system[:3], strict=True)}
    at = {"connect": {"blade": [0]}}
    contact = {"type": "Penalty3D", **at, "dirs": [0, 1, 2], "mu": mu, "N0": at_rest, "k_n": k, "k_t": k_d, "g": 0.0}
    drives = {
        f"drive {way}": {"type": "GOForcing", **at, "dirs": [way], "dto": 0, "ho": 1, "amp": abs(force), "phi": turn}
        for way, force, turn in zip((0, 1), system.drive, -np.angle(system.drive * [-1, 1]), strict=True)
    }
    frequency = {"study": "frf", "puls_inf": system.omega, "puls_sup": system.omega, "verbose": False}
    return {
        "system": {"type": "Base", "nh": harmonics, "nti": SAMPLES},
        "substructures": {"blade": {"matrix": matrices, "ndofs": 3, "nnodes": 1}},
        "connectors": {"contact": contact, **drives},
        "analysis": {"balance": frequency},
    }


def period_of_y(system: Oscillator, harmonics: int) -> np.ndarray:
    """y over a period, by its own choice of a start, at one frequency.

    Raises:
        ArithmeticError: Its solver has not ended at a solution.
    """
    with quiet_elsewhere():
        run = importlib.import_module("pyHarm.Maestro").Maestro(model(system, harmonics))
        run.nls["balance"].initialise()
    found = run.nls["balance"].SolList[-1]
    if np.max(np.abs(found.R)) > 1e-6 * np.max(np.abs(system.drive)):
        raise ArithmeticError(f"pyHarm ends with a residual of {np.max(np.abs(found.R)):.1e}")
    return found.x[:-1].reshape(-1, 3)[:, 1] @ run.system.dynop["ft"]
