"""The natural modes of both blades in closed form: Eq. (1) linearised, with the springs of contact engaged or not.

Coordinates are q = (x_1, x_2, y_1, y_2, theta_1, theta_2), as in `contact_gradients`. Contact is looked at where it
begins: the blocks at their unloaded angles, corner at corner, without preload. Blades keep their stiffness at all
speeds: there is no centrifugal stiffening.
"""

from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.scene.typed import FloatArray

# How the blocks touch: not at all; face on face with the normal spring alone, or with both; corner at corner with both.
NaturalContact = Literal["apart", "sliding", "stuck", "corner"]
COORDINATES = ("x", "y", "theta")
TURNS = slice(4, 6)  # theta_1 and theta_2
TINY = float(np.finfo(float).tiny)  # a square that rounding made negative, or a drive without force


class LinearPair(NamedTuple):
    """Both blades and the contact between them as one linear system."""

    mass: FloatArray  # (6,) [kg, kg m^2]
    damping: FloatArray  # (6,)
    stiffness: FloatArray  # (6,)
    moves: np.ndarray  # (6,) whether the model has that coordinate
    v_q: FloatArray  # (6,) gradient of the penetration of the upper corners
    u_q: FloatArray  # (6,) gradient of their slide
    k: float  # normal spring [N/m]
    k_d: float  # tangential spring [N/m]


class NaturalModes(NamedTuple):
    """Undamped natural modes, the lowest frequency first."""

    omega: FloatArray  # (n,) natural circular frequency [rad/s]
    zeta: FloatArray  # (n,) damping ratio, to first order in the damping
    shape: FloatArray  # (n, 6) normalised by the masses


def natural_modes(pair: LinearPair, contact: NaturalContact) -> NaturalModes:
    """The modes of both blades in one state of contact.

    Source:
        With w = v for the normal spring and w = u for the tangential one, contact adds k w_q w_q' to the stiffness of
        Eq. (1): along x and y that is k n n' + k_d t t' on the relative displacement, with n = (sin alpha, -cos alpha)
        and t = (cos alpha, sin alpha). Faces that stay on each other turn both blocks by one angle.
    """
    K = np.diag(pair.stiffness)
    if contact != "apart":
        K = K + pair.k * np.outer(pair.v_q, pair.v_q)
    if contact in ("stuck", "corner"):
        K = K + pair.k_d * np.outer(pair.u_q, pair.u_q)
    free = _free_directions(pair.moves, faces_touch=contact in ("sliding", "stuck"))
    root = np.sqrt(free.T**2 @ pair.mass)
    squares, vectors = np.linalg.eigh(free.T @ K @ free / np.outer(root, root))
    omega, shape = np.sqrt(np.maximum(squares, TINY)), (free @ (vectors / root[:, None])).T
    return NaturalModes(omega, shape**2 @ pair.damping / (2 * omega), shape)


def _free_directions(moves: np.ndarray, faces_touch: bool) -> FloatArray:
    """The directions in which the blocks can move, as columns; blocks whose faces touch turn together."""
    columns = np.eye(moves.size)
    if faces_touch:
        columns = np.column_stack([columns[:, : TURNS.start], columns[:, TURNS].sum(axis=1)])
        moves = np.append(moves[: TURNS.start], moves[TURNS].all())
    return columns[:, moves]


def drive_shares(shape: FloatArray, load: np.ndarray) -> FloatArray:
    """The share of the drive that works on each mode (n,): |shape . load|^2 over the sum for all modes.

    Args:
        shape: The modes (n, 6), normalised by the masses.
        load: The complex amplitudes (6,) of the drive's forces and moments.
    """
    squares = np.abs(shape @ load) ** 2
    return squares / max(float(squares.sum()), TINY)
