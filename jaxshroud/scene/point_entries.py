"""The places of points of contact as entries of the table [contact] of a scene, `point[0].place`.

A file lists them, `points = ["-17.5 mm", 0, "17.5 mm"]`. As entries of their own they are numbers of the scene like all
others. Points that are given by their number alone follow the length of the face, and have no such entries.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from jaxshroud.scene.keys import POINT_ENTRY

PLACES_IN_A_LIST = 'points = ["-17.5 mm", "17.5 mm"] with shares = [0.5, 0.5]'  # an example


def place_entry(m: int) -> str:
    """The entry of the place of point `m`."""
    return f"point[{m}].place"


def place_count(entries: Iterable[str]) -> int:
    """How many places the entries of a table [contact] have; 0 where points are given by their number, or none are."""
    matches = [POINT_ENTRY.fullmatch(entry) for entry in entries]
    return 1 + max((int(match["index"]) for match in matches if match), default=-1)


def with_place_entries(contact: Mapping[str, Any]) -> dict[str, Any]:
    """A table [contact] with the places of a list `points` as entries of their own."""
    contact = dict(contact)
    if isinstance(contact.get("points"), list | tuple):
        contact |= {place_entry(m): place for m, place in enumerate(contact.pop("points"))}
    return contact


def with_listed_places(contact: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `with_place_entries`."""
    contact = dict(contact)
    places = [contact.pop(place_entry(m)) for m in range(place_count(contact))]
    return {**contact, "points": places} if places else contact


def no_place(m: int, count: int) -> str:
    """Why a scene that lists so many places has none of point `m`."""
    if count:
        return f"the scene has no point [{m}] of contact: it lists {count} of them, numbered from 0"
    return f"the scene lists no places of contact points; give [contact] {PLACES_IN_A_LIST}"
