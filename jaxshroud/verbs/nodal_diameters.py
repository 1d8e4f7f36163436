"""The damping of the travelling waves of a row in a flow, nodal diameter by nodal diameter, without contact."""

from typing import NamedTuple

import numpy as np

from jaxshroud.model.natural_modes import LinearContact
from jaxshroud.results.data_sheet import FlowMode
from jaxshroud.scene.typed import FloatArray

SAME_ENTRY = 1e-12  # relative difference of the entries of matrices that count as alike


class Oscillators(NamedTuple):
    """Coupled oscillators: M q'' + C q' + K q = 0, complex where they are those of a wave; (n, n) each."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray


def flow_modes(blades: LinearContact, flow: FloatArray, closed: bool) -> tuple[FlowMode, ...]:
    """The modes along x of the blades of a row in a flow, apart: the frequency and the damping of free decays.

    Args:
        blades: The row as a linear system, with arrays of NumPy.
        flow: The damping by the flow within it, along x of all blades (N, N) [N s/m].
        closed: Whether it is a ring.

    Returns:
        The modes of a tuned ring by nodal diameter h from -N/2 on, a wave that travels forward where h > 0; those of
        other rows by frequency.

    Source:
        The roots of D_h + lambda C_h + lambda^2 m, with K + 4 sin^2(pi h / N) K_c + L0 + L1 exp(i 2 pi h / N)
        + L_1 exp(-i 2 pi h / N) as it is marched: Re L in D_h, and Im L / omega_drive in C_h. What the flow adds to the
        damping ratio is the rest that the dampers do not give.
    """
    count = len(flow)
    along_x = slice(0, count)
    row = Oscillators(
        np.diag(blades.mass[along_x]),
        blades.own_damping[along_x, along_x],
        blades.own_stiffness[along_x, along_x],
    )
    own_damping = row.damping - flow
    if closed and all(map(_is_circulant, row)):
        return tuple(
            _mode(*_root_of(Oscillators(*(_of_wave(a, h) for a in row))), _of_wave(own_damping, h), row.mass[:1, :1], h)
            for h in range(-((count - 1) // 2), count // 2 + 1)
        )
    roots, shapes = roots_of(row)
    return tuple(_mode(root, shape, own_damping, row.mass, None) for root, shape in zip(roots, shapes.T, strict=True))


def _is_circulant(matrix: FloatArray) -> bool:
    return bool(np.allclose(np.roll(matrix, (1, 1), (0, 1)), matrix, SAME_ENTRY, SAME_ENTRY * np.abs(matrix).max()))


def _of_wave(matrix: FloatArray, h: int) -> np.ndarray:
    """What a circulant matrix is to a wave of nodal diameter `h`, (1, 1)."""
    return matrix[:1] @ np.exp(2j * np.pi * h * np.arange(len(matrix)) / len(matrix))[:, None]


def roots_of(system: Oscillators) -> tuple[np.ndarray, np.ndarray]:
    """The roots lambda of exp(lambda t) with positive imaginary part, by size, and their shapes as columns."""
    n = len(system.mass)
    companion = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(system.mass, system.stiffness), -np.linalg.solve(system.mass, system.damping)],
        ]
    )
    roots, shapes = np.linalg.eig(companion)
    turning = np.argsort(-np.imag(roots))[:n]
    turning = turning[np.argsort(np.abs(roots[turning]))]
    return roots[turning], shapes[:n, turning]


def _root_of(wave: Oscillators) -> tuple[complex, np.ndarray]:
    """The root and the shape of a wave."""
    roots, shapes = roots_of(wave)
    return complex(roots[0]), shapes[:, 0]


def _mode(root: complex, shape: np.ndarray, own_damping: np.ndarray, mass: np.ndarray, h: int | None) -> FlowMode:
    def of_shape(matrix):
        return float(np.real(shape.conj() @ matrix @ shape))

    zeta, omega = -root.real / abs(root), abs(root)
    of_dampers = of_shape(own_damping) / (2 * omega * of_shape(mass))
    return FlowMode(h, omega / (2 * np.pi), zeta, zeta - of_dampers)
