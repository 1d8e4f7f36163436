"""Rules of scene files that concern several entries, and entries that a file gives in forms of their own."""

from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from jaxshroud.scene.checks import did_you_mean
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import (
    ACCURACIES,
    AERO_FORCES,
    COUPLED_WITHOUT_CONTACT,
    MOTIONS,
    SPRUNG,
    Layout,
    Sector,
    require_capability,
    require_parts,
)
from jaxshroud.scene.point_numbers import check_number_of_points, check_points
from jaxshroud.scene.typed import is_number
from jaxshroud.scene.units import to_si

NO_STIFFNESS = "no_stiffness"  # the type of pydantic's error for a [contact] without one


def one_stiffness(contact: Any) -> Any:
    """The table [contact], which gives k or gamma."""
    cure = "one of them, e.g. gamma = 2.5 (gamma = k / k_x of the left blade)"
    if contact.k is None and contact.gamma is None:
        raise PydanticCustomError(NO_STIFFNESS, f"lacks a stiffness; add {cure}")  # pyright: ignore[reportArgumentType]
    if contact.k is not None and contact.gamma is not None:
        raise ValueError(f"gives both `k` and `gamma`; keep {cure}")
    return contact


def parts_are_of_its_layout(file: Any, layout: Layout) -> Any:
    """The file, whose parts a pair or a row can have."""
    require_parts(file.parts, file.contact.reading, layout)
    return file


def coupling_is_of_its_layout(file: Any, layout: Layout) -> Any:
    """The file, whose blades a pair or a row couples so."""
    if file.aero is not None:
        require_capability(AERO_FORCES, layout)
    coupled = any(table is not None and any(v is not None for _, v in table) for table in (file.coupling, file.aero))
    if coupled and file.parts.contact == "none":
        raise ValueError(COUPLED_WITHOUT_CONTACT)
    return file


def smooth_has_a_width(file: Any) -> Any:
    """The file, which gives a width for smooth contact and for no other."""
    smooth = file.parts.contact == "smooth"
    width = file.contact.width
    if smooth and width is None:
        raise ValueError('[contact] lacks `width`; add it for contact = "smooth", e.g. width = "0.1 um"')
    if smooth and file.contact.reading:
        raise ValueError('[contact] reading must be "consistent" for contact = "smooth"')
    if width is not None and not smooth:
        raise ValueError('[contact] width is for smooth contact; drop it, or add [parts] contact = "smooth"')
    return file


def static_start_has_no_motion(file: Any) -> Any:
    """The file, which gives no initial motion beside a static start."""
    if file.initial.start is None and file.initial.friction is None:
        return file
    for name in Motion._fields:
        if np.any(getattr(file.initial, name)):
            raise ValueError(f"[initial] {name} is of a start in motion; drop it, or start and friction")
    if file.contact.reading or file.parts.contact not in (*SPRUNG, "none"):
        other = "a printed `reading`" if file.contact.reading else f'contact = "{file.parts.contact}"'
        raise ValueError(
            f"[initial] a static start goes with located contact in the consistent reading, not with {other}"
        )
    return file


def points_are_of_their_face(file: Any) -> Any:
    """The file, whose points of contact lie on the face and go with its contact."""
    contact, l_ab = file.contact, file.shroud.l_ab
    if contact.shares is not None and contact.points is None:
        raise ValueError("[contact] shares are those of points; add points, e.g. points = 2")
    if contact.points is None:
        return file
    if contact.reading or file.parts.contact not in SPRUNG:
        other = "a printed `reading`" if contact.reading else f'contact = "{file.parts.contact}"'
        raise ValueError(f"[contact] points go with located contact in the consistent reading, not with {other}")
    check_points(contact.points, contact.shares, l_ab)
    return file


def points_in_file(value: Any) -> Any:
    """A number of points, or the place of each [m], from a file."""
    if isinstance(value, int) and not isinstance(value, bool):
        check_number_of_points(value)
        return value
    places = [to_si("m", one) for one in value] if isinstance(value, list | tuple) else []
    if not _is_list_of_numbers(places):
        raise ValueError("must be a number of points, or a list of their places up the face from its middle")
    check_number_of_points(len(places))
    return [float(one) for one in places]


def _is_list_of_numbers(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(map(is_number, value))


def shares_in_file(value: Any) -> Any:
    """The shares of the stiffnesses of points, from a file."""
    if not _is_list_of_numbers(value):
        raise ValueError("must be a list with a number for each point")
    return [float(one) for one in value]


def coordinates_in_file(value: Any) -> Any:
    """The coordinates in which blocks move, from a file."""
    if not isinstance(value, list | tuple) or tuple(value) not in MOTIONS:
        raise ValueError('must be ["x"], ["x", "y"] or ["x", "y", "theta"]')
    return tuple(value)


def accuracy_in_file(value: Any) -> Any:
    """An accuracy, by its name or as a number, from a file."""
    known = value in ACCURACIES if isinstance(value, str) else is_number(value) and 0.999e-10 <= value <= 1.001e-2
    if not known:
        cure = did_you_mean(value, ACCURACIES) if isinstance(value, str) else ""
        raise ValueError(f"must be {', '.join(ACCURACIES)} or a number from 1e-10 to 1e-2{cure}")
    return value


def sector_in_file(sector: Sector | None) -> Sector | None:
    """How a ring is marched, from a file; None: whole."""
    return None if sector == "whole" else sector
