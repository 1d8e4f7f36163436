"""The points of contact of a face as plain numbers: where they are, and their shares of its stiffnesses.

A file lists their places, `points = ["-17.5 mm", 0, "17.5 mm"]`. As entries of the table [contact] of a scene,
`point[0].place`, they are numbers of the scene like all others. Points that are given by their number alone follow the
length of the face, and have no such entries.
"""

from collections.abc import Iterable, Mapping
from functools import reduce
from operator import and_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxshroud.scene.checks import InputError, digits_apart
from jaxshroud.scene.keys import POINT_ENTRY, list_length

MIN_POINTS, MAX_POINTS = 2, 16
PLACES_IN_A_LIST = 'points = ["-17.5 mm", "17.5 mm"] with shares = [0.5, 0.5]'  # an example


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


def shares_hold(shares: Any) -> Any:
    """Whether the shares (..., points) of each scene are not negative and sum to 1, by NumPy or JAX."""
    return (shares >= 0).all(-1) & _sum_to_1(shares.sum(-1))


def _sum_to_1(total: Any) -> Any:
    return abs(total - 1) <= _rounding(total)


def places_hold(lengths: Iterable[Any], l_ab: Any) -> Any:
    """Whether points at places [m] lie on a face of that length [m], by NumPy or JAX."""
    return reduce(and_, (_is_on_face(place, l_ab) for place in lengths))


def _is_on_face(place: Any, l_ab: Any) -> Any:
    return abs(place) <= l_ab / 2 * (1 + _rounding(l_ab))


def _rounding(number: Any) -> float:
    """The relative rounding that counts as none, in the precision of an array."""
    return max(1e-9, 8 * float(np.finfo(number.dtype).eps))


def check_shares(shares: NDArray[np.floating], number: int) -> None:
    """Raise InputError unless these are the shares of so many points."""
    if shares.shape[-1:] != (number,):
        raise InputError(f"[contact] shares has {shares.size} numbers for {number} points; give one for each.")
    if not (shares >= 0).all():
        raise InputError(f"[contact] shares must not be negative, but one is {np.min(shares):g}; give positive ones.")
    total = np.sum(shares, axis=-1)
    if not (holds := _sum_to_1(total)).all():
        raise InputError(f"[contact] shares sum to {digits_apart(float(total[~holds][0]), 1.0)}, not to 1; scale them.")


def check_places(lengths: Iterable[Any], l_ab: Any) -> None:
    """Raise InputError unless points at these places [m], of many scenes or of one, lie on faces of that length [m]."""
    for m, place in enumerate(lengths):
        one, length = np.broadcast_arrays(np.asarray(place, float), np.asarray(l_ab))
        if not np.isfinite(one).all():
            raise InputError(f"contact.{place_entry(m)} must be a finite number, but is {one[~np.isfinite(one)][0]}.")
        beyond = ~np.asarray(_is_on_face(one, length))
        if beyond.any():
            reach = float(abs(one[beyond][0]))
            end = float(length[beyond][0]) / 2
            raise InputError(
                f"[contact] points has a place {digits_apart(reach, end)} m from the middle of the face, beyond its "
                f"end at {end:g} m."
            )


def check_points(points: Any, shares: Any, l_ab: float) -> None:
    """Raise InputError unless a file gives points of a face: their number, or the place of each [m]."""
    found = np.asarray(shares_of(points, shares), float)
    check_shares(found, len(points) if np.ndim(points) else points)
    if np.ndim(points):
        check_places(points, l_ab)


def place_entry(m: int) -> str:
    """The entry of the place of point `m`."""
    return f"point[{m}].place"


def with_place_entries(contact: Mapping[str, Any]) -> dict[str, Any]:
    """A table [contact] with the places of a list `points` as entries of their own."""
    contact = dict(contact)
    if isinstance(contact.get("points"), list | tuple):
        contact |= {place_entry(m): place for m, place in enumerate(contact.pop("points"))}
    return contact


def with_listed_places(contact: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `with_place_entries`."""
    contact = dict(contact)
    places = [contact.pop(place_entry(m)) for m in range(list_length(contact, POINT_ENTRY))]
    return {**contact, "points": places} if places else contact


def no_place(m: int, count: int) -> str:
    """Why a scene that lists so many places has none of point `m`."""
    if count:
        return f"the scene has no point [{m}] of contact: it lists {count} of them, numbered from 0"
    return f"the scene lists no places of contact points; give [contact] {PLACES_IN_A_LIST}"
