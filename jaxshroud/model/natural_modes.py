"""The natural modes of the blades: Eq. (1) linearised, with the springs of contact engaged or not.

Coordinates are q = (x_1, x_2, y_1, y_2, theta_1, theta_2), as in `contact_gradients`; of N blades, those of x of all
blades, then y, then theta. All interfaces of a row are in the same state of contact. Contact is looked at where it
begins: the blocks at their unloaded angles, corner at corner, without preload. Blades keep their stiffness at all
speeds: there is no centrifugal stiffening.
"""

from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.scene.typed import FloatArray

# How the blocks touch: not at all; face on face with the normal spring alone, or with both; corner at corner with both.
NaturalContact = Literal["apart", "sliding", "stuck", "corner"]
COORDINATES = ("x", "y", "theta")
TINY = float(np.finfo(float).tiny)  # a square that rounding made negative, or a drive without force


class LinearContact(NamedTuple):
    """All blades and the contact between them as one linear system."""

    mass: FloatArray  # (3 N,) [kg, kg m^2]
    damping: FloatArray  # (3 N,)
    stiffness: FloatArray  # (3 N,)
    moves: np.ndarray  # (3 N,) whether the model has that coordinate
    v_q: FloatArray  # (E, 3 N) gradient of the penetration of the upper corners of each interface
    u_q: FloatArray  # (E, 3 N) gradient of their slide
    k: FloatArray  # (E,) normal spring [N/m]
    k_d: FloatArray  # (E,) tangential spring [N/m]


class NaturalModes(NamedTuple):
    """Undamped natural modes, the lowest frequency first."""

    omega: FloatArray  # (n,) natural circular frequency [rad/s]
    zeta: FloatArray  # (n,) damping ratio, to first order in the damping
    shape: FloatArray  # (n, 3 N) normalised by the masses


def natural_modes(blades: LinearContact, contact: NaturalContact) -> NaturalModes:
    """The modes of all blades in one state of contact.

    Source:
        With w = v for the normal spring and w = u for the tangential one, contact adds k w_q w_q' to the stiffness of
        Eq. (1): along x and y that is k n n' + k_d t t' on the relative displacement, with n = (sin alpha, -cos alpha)
        and t = (cos alpha, sin alpha). Faces that stay on each other turn all blocks by one angle.
    """
    K = np.diag(blades.stiffness)
    if contact != "apart":
        K = K + sum(k * np.outer(v_q, v_q) for k, v_q in zip(blades.k, blades.v_q, strict=True))
    if contact in ("stuck", "corner"):
        K = K + sum(k_d * np.outer(u_q, u_q) for k_d, u_q in zip(blades.k_d, blades.u_q, strict=True))
    free = _free_directions(blades.moves, faces_touch=contact in ("sliding", "stuck"))
    root = np.sqrt(free.T**2 @ blades.mass)
    squares, vectors = np.linalg.eigh(free.T @ K @ free / np.outer(root, root))
    omega, shape = np.sqrt(np.maximum(squares, TINY)), (free @ (vectors / root[:, None])).T
    return NaturalModes(omega, shape**2 @ blades.damping / (2 * omega), shape)


def _free_directions(moves: np.ndarray, faces_touch: bool) -> FloatArray:
    """The directions in which the blocks can move, as columns; blocks whose faces touch turn together."""
    columns, turns = np.eye(moves.size), moves.size // 3 * 2  # the first coordinate of rotation
    if faces_touch:
        columns = np.column_stack([columns[:, :turns], columns[:, turns:].sum(axis=1)])
        moves = np.append(moves[:turns], moves[turns:].all())
    return columns[:, moves]


def drive_shares(shape: FloatArray, load: np.ndarray) -> FloatArray:
    """The share of the drive that works on each mode (n,): |shape . load|^2 over the sum for all modes.

    Args:
        shape: The modes (n, 3 N), normalised by the masses.
        load: The complex amplitudes (3 N,) of the drive's forces and moments.
    """
    squares = np.abs(shape @ load) ** 2
    return squares / max(float(squares.sum()), TINY)
