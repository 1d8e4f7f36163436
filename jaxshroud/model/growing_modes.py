"""Natural modes over the speed of a rotor: blades whose stiffness grows with the square of the speed, by NumPy.

    K(Omega) = K_0 + Omega^2 diag(B) M

An engine order e meets a natural frequency where omega = e Omega, so that Omega^2 is an eigenvalue of
(K_0 + K_c) phi = Omega^2 (e^2 M - diag(B) M) phi: exact, with none where e^2 <= B for all that moves.
"""

from typing import NamedTuple

import numpy as np

from jaxshroud.model.natural_modes import LinearContact, NaturalContact, contact_stiffness, free_directions
from jaxshroud.scene.typed import FloatArray


class Growth(NamedTuple):
    """How the stiffness of all blades grows, and the speed at which they have that of a `LinearContact`."""

    by_square: FloatArray  # (3 N,) B times the mass of each coordinate
    square: float  # Omega^2 [rad^2/s^2]


class _Oscillators(NamedTuple):
    """All that moves in one state of contact, in coordinates in which its mass is 1."""

    at_rest: FloatArray  # (n, n) stiffness
    growth: FloatArray  # (n, n) its growth by Omega^2
    square: float  # Omega^2 of the scene's own speed

    def modes(self, square: float) -> tuple[FloatArray, FloatArray]:
        """The squares of the natural frequencies at a speed, the lowest first, and the modes, in columns."""
        squares, vectors = np.linalg.eigh(self.at_rest + square * self.growth)
        return squares, vectors


def _oscillators(blades: LinearContact, contact: NaturalContact, growth: Growth) -> _Oscillators:
    free = free_directions(blades.moves, contact, bool(blades.turns_as_one))
    root = np.sqrt(free.T**2 @ blades.mass)

    def reduced(K):
        return free.T @ K @ free / np.outer(root, root)

    grown = reduced(np.diag(growth.by_square))
    K = blades.own_stiffness + contact_stiffness(blades, contact)
    own = reduced((K + K.T) / 2)
    return _Oscillators(own - growth.square * grown, grown, growth.square)


def speed_curves(blades: LinearContact, contact: NaturalContact, growth: Growth, squares: FloatArray) -> FloatArray:
    """The natural frequencies [rad/s] of each mode at speeds, (modes, speeds); modes are followed by their shapes.

    Args:
        blades: The blades at the scene's own speed.
        contact: The state of contact.
        growth: How their stiffness grows.
        squares: The squares of the speeds (speeds,), increasing [rad^2/s^2].
    """
    of = _oscillators(blades, contact, growth)
    found = np.empty((len(of.at_rest), len(squares)))
    for places in (np.flatnonzero(squares >= of.square), np.flatnonzero(squares < of.square)[::-1]):
        shapes = of.modes(of.square)[1]
        for i in places:
            values, vectors = of.modes(float(squares[i]))
            order = _matching(shapes, vectors)
            shapes, found[:, i] = vectors[:, order], np.sqrt(np.maximum(values[order], 0.0))
    return found


def order_crossings(blades: LinearContact, contact: NaturalContact, growth: Growth, order: float) -> FloatArray:
    """The speed at which an engine order meets each mode, (modes,) [rad/s]; NaN where it does at none."""
    of = _oscillators(blades, contact, growth)
    root = np.linalg.cholesky(of.at_rest)
    half = np.linalg.solve(root, order**2 * np.eye(len(root)) - of.growth)
    inverse_squares, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
    shapes = np.linalg.solve(root.T, vectors)
    shapes = shapes / np.linalg.norm(shapes, axis=0)
    matching = _matching(of.modes(of.square)[1], shapes)
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = 1 / np.sqrt(inverse_squares)
    return np.where(inverse_squares > 0, speeds, np.nan)[matching]


def _matching(modes: FloatArray, others: FloatArray) -> np.ndarray:
    """Which of the `others` is each of the modes, both in columns: those whose shapes agree best."""
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(-((modes.T @ others) ** 2))[1]


class Pressing(NamedTuple):
    """What presses the faces of all blades together at rest, as a linear function of Omega^2."""

    mean: FloatArray  # (3 N,) mean loads [N, N m]
    gap: FloatArray  # (E,) at rest [m]
    gap_by_square: FloatArray  # (E,) its growth by Omega^2
    sine: float  # of the angle of the faces


def static_normal_forces(blades: LinearContact, growth: Growth, by: Pressing, square: float) -> FloatArray:
    """The normal force at each interface (E,) at rest, where all faces are held together; negative: they come apart.

    The faces are on each other and slide freely: where the normal force vanishes so does friction.
    """
    free = free_directions(blades.moves, "sliding", bool(blades.turns_as_one))
    wedge = (by.gap + square * by.gap_by_square) * by.sine
    v_q, k = blades.v_q, blades.k
    grown = np.diag((square - growth.square) * growth.by_square)
    stiffness = blades.own_stiffness + grown + v_q.T @ (k[:, None] * v_q)
    loads = by.mean * blades.moves + v_q.T @ (k * wedge)
    q = free @ np.linalg.solve(free.T @ stiffness @ free, free.T @ loads)
    return k * (v_q @ q - wedge)


POINTS_OF_RANGE = 65  # speeds at which it is looked whether faces are pressed together
HALVINGS = 60


def pressed_ranges(
    blades: LinearContact, growth: Growth, by: Pressing, start: float, stop: float
) -> list[tuple[float, float]]:
    """The ranges of speeds [rad/s] in which all faces are pressed together at rest, from `start` to `stop`."""

    def least(speed):
        return float(np.min(static_normal_forces(blades, growth, by, speed**2)))

    speeds = np.linspace(start, stop, POINTS_OF_RANGE)
    pressed = np.array([least(speed) > 0 for speed in speeds])
    changes = np.flatnonzero(pressed[1:] != pressed[:-1])
    ends = [_change_of_sign(least, float(speeds[i]), float(speeds[i + 1])) for i in changes]
    ends = [*([start] if pressed[0] else []), *ends, *([stop] if pressed[-1] else [])]
    return list(zip(ends[::2], ends[1::2], strict=True))


def _change_of_sign(f, low: float, high: float) -> float:
    """Where a function that has different signs at two places passes from one to the other, by bisection."""
    rises = f(low) <= 0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if (f(middle) > 0) == rises:
            high = middle
        else:
            low = middle
    return (low + high) / 2
