"""Displacements and rates of both blocks."""

from typing import Any, NamedTuple


class Motion(NamedTuple):
    """Displacements and rates of both blocks, left first; theta is positive clockwise.

    A field is `PerBlade` in a scene or state, a `Pair` in compiled loops, and an array (..., 2) in results.
    """

    x: Any  # [m]
    y: Any  # [m]
    theta: Any  # [rad]
    v_x: Any  # [m/s]
    v_y: Any  # [m/s]
    v_theta: Any  # [rad/s]


AT_REST = Motion(*[(0.0, 0.0)] * 6)
