"""The numbers that a scene may be without: what stands for them, and how they are refused where nothing does."""

import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

from jaxshroud.scene.checks import KeyNameError
from jaxshroud.scene.key import LARGEST_NUMBER
from jaxshroud.scene.keys import (
    AERO_KEYS,
    ALL_KEYS,
    COMPLEX_KEYS,
    HARMONIC_ENTRY,
    HARMONIC_KEYS,
    LIMIT_KEYS,
    MODAL_LOAD_KEYS,
    MODE_ENTRY,
    POINT_ENTRY,
    SINGLE_LOADS,
    keys_of_table,
    list_length,
)
from jaxshroud.scene.point_numbers import no_place
from jaxshroud.scene.speed import GROWTHS, UNTWIST

NO_WIDTH = 'the scene has no contact.width: its contact is not smooth; add [parts] contact = "smooth"'
MEAN_LOADS = ("drive.F_x_mean", "drive.F_y_mean", "drive.M_mean")
COUPLINGS = tuple(row.name for row in (*keys_of_table("coupling"), *AERO_KEYS))
# of which a scene without them is the same
WITHOUT_EFFECT = {
    "drive.level": 1.0,
    **dict.fromkeys(LIMIT_KEYS, LARGEST_NUMBER),
    **dict.fromkeys((*MEAN_LOADS, *COUPLINGS, *GROWTHS, "blades.sigma_0"), 0.0),
}
A_HARMONIC = "[[drive.harmonic]] with order = 2, F = 20 and beta = 0.5"  # an example
A_MODE = "[[blades.modes]] with f = 178, zeta = 0.002 and phi_x = 3.5"  # likewise


def harmonic_count(entries: Iterable[str]) -> int:
    """How many harmonics the entries of a table `drive` have; 0 for a drive without a list of them."""
    return list_length(entries, HARMONIC_ENTRY)


class HarmonicForm(NamedTuple):
    """How a file gives a harmonic."""

    is_complex: bool  # by complex amplitudes; else by a force and its phase
    order: str  # the entry of its order


def harmonic_forms(entries: Iterable[str]) -> tuple[HarmonicForm, ...]:
    """How the entries of a table `drive` give each harmonic."""
    entries = set(entries)
    forms = []
    for i in range(harmonic_count(entries)):
        is_complex = any(f"harmonic[{i}].{name}" in entries for name in (*COMPLEX_KEYS, *MODAL_LOAD_KEYS))
        order = "engine_order" if f"harmonic[{i}].engine_order" in entries else "order"
        forms.append(HarmonicForm(is_complex=is_complex, order=order))
    return tuple(forms)


def split_list(entries: Mapping[str, Any], pattern: re.Pattern) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The entries of a table that are of no table in a list, and those of each such table by their names in it."""
    plain: dict[str, Any] = {}
    listed: list[dict[str, Any]] = [{} for _ in range(list_length(entries, pattern))]
    for entry, value in entries.items():
        match = pattern.fullmatch(entry)
        if match is None:
            plain[entry] = value
        else:
            listed[int(match["index"])][match["name"]] = value
    return plain, listed


def require_number(name: str, present: Collection[str], where: str = "") -> None:
    """Raise a KeyNameError, which begins with `where`, for a number that scenes with those `present` cannot have.

    Args:
        name: A key without the index of a blade.
        present: The keys of the scene's numbers.
        where: The place that the message names first.
    """
    if name in present:
        return
    if reason := _absence(name, present):
        raise KeyNameError(f"{where}: {reason}" if where else reason)


def _absence(name: str, present: Collection[str]) -> str:
    """Why a scene with these numbers cannot have another; empty: it can."""
    if name == "contact.width":
        return NO_WIDTH
    if name in UNTWIST:
        return f"the scene has no {name}: its gap does not depend on its speed; add {' and '.join(UNTWIST)} to its file"
    table, _, entry = name.partition(".")
    entries = [key.partition(".")[2] for key in present if key.startswith(f"{table}.")]
    if table == "contact" and (point := POINT_ENTRY.fullmatch(entry)):
        return no_place(int(point["index"]), list_length(entries, POINT_ENTRY))
    if table == "blades":
        return _why_not_of_blades(name, entry, list_length(entries, MODE_ENTRY))
    match = HARMONIC_ENTRY.fullmatch(entry)
    count = harmonic_count(entries)
    if table != "drive":
        return ""
    if match is not None and int(match["index"]) >= count:
        has = f"{_in_words(count)}, numbered from 0" if count else "no list of harmonics"
        return f"the scene has no {name}: its drive has {has}; add a table {A_HARMONIC}"
    if match is not None:
        is_complex = harmonic_forms(entries)[int(match["index"])].is_complex
        if is_complex and match["name"] in MODAL_LOAD_KEYS:
            return f"the scene has no {name}: no load of its harmonic [{match['index']}] acts on that mode; give one"
        if is_complex == (match["name"] in HARMONIC_KEYS):
            other = "F_x_re and its like" if is_complex else "F, beta, M and phase"
            return f"the scene has no {name}: its harmonic [{match['index']}] is given by {other}; name these"
    if entry in SINGLE_LOADS and count:
        one = f"drive.harmonic[0].{entry.removesuffix('_0')}"
        many = "" if entry == "beta" else "drive.level for all of them, or "
        return f"the scene has no {name}, as its drive is a list of {_in_words(count)}; name {many}{one} for one"
    return ""


def _why_not_of_blades(name: str, entry: str, count: int) -> str:
    """Why a scene whose blades have so many modes, or are lumped, lacks a number of them; empty: it can have it."""
    mode = MODE_ENTRY.fullmatch(entry)
    if mode is None and name not in LIMIT_KEYS:
        other = f"the scene has no {name}, as its blades are given by modes; name one of these, such as"
        return f"{other} blades.modes[0].f" if count else ""
    if not count:
        return f"the scene has no {name}: its blades are lumped, without [[blades.modes]]"
    if mode is None:
        return ""
    of = "one mode" if count == 1 else f"{count} modes"
    return "" if int(mode["index"]) < count else f"the scene has no {name}: its blades have {of}, numbered from 0"


def _in_words(harmonics: int) -> str:
    return f"{harmonics} harmonic{'s' * (harmonics > 1)}"


def standing_for(name: str, numbers: Mapping[str, Any]) -> Any:
    """What stands for a number that is not there: the mass for that in y, or what changes nothing, of any array."""
    if name == "blades.m_y":
        return numbers["blades.m"]
    if name in WITHOUT_EFFECT:
        row = ALL_KEYS[name]
        like = "drive.phase" if row.pair else "shroud.gap" if row.per_interface else "drive.omega"
        return WITHOUT_EFFECT[name] + 0 * numbers[like]
    stem, _, entry = name.rpartition(".")
    return 0 * numbers[f"{stem}.{'F' if entry == 'phase' else 'f'}"]  # of a harmonic, or of a mode
