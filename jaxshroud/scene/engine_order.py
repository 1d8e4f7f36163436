"""The engine order of a scene: the drive periods in one revolution of the rotor."""

import math

import numpy as np
from numpy.typing import ArrayLike

from jaxshroud.scene.drive import Drive
from jaxshroud.scene.scene import Scene

PHASE_ROUNDING = 1e-9  # [rad] by which phases may miss those of an engine order


def engine_order_of(scene: Scene) -> float | None:
    """The engine order by which a scene is given; None where only the frequency of its drive is known."""
    order = getattr(scene, "given", {}).get("drive.engine_order")
    return None if order is None else float(order)


def order_of_drive(drive: Drive) -> int | None:
    """The engine order modulo N of a row with this drive: harmonic n has n times its phases; None if there is none."""
    orders = {n: order_of_phases(one.phase) for n, one in drive.harmonics().items()}
    N = np.shape(drive.phase)[-1]
    return next((e for e in range(N) if all(order == n * e % N for n, order in orders.items())), None)


def order_of_phases(phase: ArrayLike) -> int | None:
    """The engine order modulo N of a row with the phases (N,) of its drive; None where they are those of none."""
    phase = np.asarray(phase, float)
    N = len(phase)
    order = round(N * (phase[1] - phase[0]) / math.tau) % N
    miss = phase - phase[0] - math.tau * order * np.arange(N) / N
    return None if np.max(np.abs(miss - math.tau * np.round(miss / math.tau))) > PHASE_ROUNDING else order
