"""Where the points of contact of a face are, and their shares of its stiffnesses, as plain numbers."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxshroud.scene.checks import InputError

MIN_POINTS, MAX_POINTS = 2, 16


def evenly_spaced(number: Any) -> NDArray[np.float64]:
    """The places of so many points, as fractions of the face."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise InputError(f"[contact] points must be a whole number or a list of places, but is {number!r}.")
    check_number_of_points(int(number))
    return np.arange(number) / (number - 1) - 0.5


def trapezoidal_shares(number: int) -> NDArray[np.float64]:
    """The share of each of so many evenly spaced points."""
    ends = np.isin(np.arange(number), (0, number - 1))
    return np.where(ends, 0.5, 1.0) / (number - 1)


def shares_of(points: Any, shares: Any) -> Any:
    """The shares of points, which are given by their number or their places: those given, or the usual ones."""
    if shares is not None:
        return shares
    if np.ndim(points):
        raise InputError("[contact] points with places need the share of each; add `shares`, which sum to 1.")
    return trapezoidal_shares(points)


def check_number_of_points(number: int) -> None:
    """Raise InputError unless a face can have so many points."""
    if not MIN_POINTS <= number <= MAX_POINTS:
        raise InputError(f"must be from {MIN_POINTS} to {MAX_POINTS} points, or left out, so that a corner touches")


def check_shares(shares: NDArray[np.float64], number: int) -> None:
    """Raise InputError unless these are the shares of so many points."""
    if shares.shape[-1:] != (number,):
        raise InputError(f"[contact] shares has {shares.size} numbers for {number} points; give one for each.")
    if not (shares >= 0).all():
        raise InputError(f"[contact] shares must not be negative, but one is {np.min(shares):g}; give positive ones.")
    total = np.sum(shares, axis=-1)
    if not (np.abs(total - 1) <= 1e-9).all():
        raise InputError(f"[contact] shares sum to {float(np.ravel(total)[0]):g}, not to 1; scale them.")


def check_places(lengths: Iterable[Any], l_ab: Any) -> None:
    """Raise InputError unless points at these places [m], of many scenes or of one, lie on faces of that length [m]."""
    for place in lengths:
        reach, end = np.broadcast_arrays(np.abs(np.asarray(place)), np.asarray(l_ab) / 2)
        beyond = ~(reach <= end * (1 + 1e-9))
        if beyond.any():
            longest, end = (float(a[beyond][0]) for a in (reach, end))
            raise InputError(
                f"[contact] points has a place {longest:g} m from the middle of the face, beyond its end at {end:g} m."
            )


def check_points(points: Any, shares: Any, l_ab: float) -> None:
    """Raise InputError unless a file gives points of a face: their number, or the place of each [m]."""
    found = np.asarray(shares_of(points, shares), float)
    check_shares(found, len(points) if np.ndim(points) else points)
    if np.ndim(points):
        check_places(points, l_ab)
