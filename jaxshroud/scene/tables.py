"""The scene from tables of plain numbers, as in a file, and the entries that say where a march begins."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxshroud.scene.blades import Aero, Blades, Coupling
from jaxshroud.scene.drive import ComplexHarmonic, Drive, Harmonic
from jaxshroud.scene.engine_orders import order_of
from jaxshroud.scene.keys import (
    ALL_KEYS,
    HARMONIC_ENTRY,
    MODAL_LOAD_KEYS,
    MODE_ENTRY,
    SINGLE_LOADS,
    Motion,
    number_shape,
)
from jaxshroud.scene.layout import Layout, Parts, Start, layout_with
from jaxshroud.scene.modes import BladeMode, ModalBlades
from jaxshroud.scene.optional import split_list
from jaxshroud.scene.point_numbers import with_listed_places
from jaxshroud.scene.points import ContactPoints
from jaxshroud.scene.scene import Contact, Friction, Row, Scene, Shroud
from jaxshroud.scene.speed import ORDER

START_ENTRIES = ("start", "friction")  # of the table `initial`, beside its numbers


def scene_of(tables: Mapping[str, Mapping[str, Any]], given: Mapping[str, Any]) -> Scene:
    """The scene from tables of plain SI numbers, as in a file, and the inputs from which some were worked out."""
    row = Row(**tables["row"]) if "row" in tables else None
    layout = layout_with(row)
    parts = tables["parts"]
    given = {key: _for_layout(key, value, layout) for key, value in given.items()}
    tables = {
        table: {name: _for_layout(f"{table}.{name}", value, layout) for name, value in entries.items()}
        for table, entries in tables.items()
    }
    blades = _blades_of(tables["blades"])
    motion = tuple(parts["motion"])
    if isinstance(blades, ModalBlades):
        motion = blades.motion_of(motion)
    return Scene(
        blades,
        Shroud(**tables["shroud"]),
        _contact_of(tables),
        Friction(**tables["friction"]),
        _drive_of(tables["drive"], given.get(ORDER)),
        Motion(**{name: value for name, value in tables["initial"].items() if name not in START_ENTRIES}),
        Parts(**{**parts, "motion": motion}),
        given=given,  # pyright: ignore[reportArgumentType]
        row=row,
        coupling=Coupling(**tables.get("coupling", {})),
        aero=Aero(**tables.get("aero", {})),
        start=_start_of(tables["initial"]),
    )


def _blades_of(entries: Mapping[str, Any]) -> Blades | ModalBlades:
    """The blades from the entries of their table, by modes or lumped."""
    plain, modes = split_list(entries, MODE_ENTRY)
    return ModalBlades(tuple(BladeMode(**mode) for mode in modes), **plain) if modes else Blades(**plain)


def _start_of(entries: Mapping[str, Any]) -> Start:
    """Where a march begins, from the entries of the table `initial`."""
    if entries.get("friction") is not None:
        return "from rest"
    return "motion" if entries.get("start") is None else "static"


def start_entries(start: Start) -> dict[str, str]:
    """The entries of the table `initial` that say where a march begins."""
    friction = {"friction": "from rest"} if start == "from rest" else {}
    return {} if start == "motion" else {"start": "static", **friction}


def _drive_of(entries: Mapping[str, Any], engine_order: Any) -> Drive:
    """The drive from the entries of its table, those of its harmonics among them, and its engine order, if any."""
    plain, of = split_list(entries, HARMONIC_ENTRY)
    harmonics = tuple(_harmonic_of(i, one, engine_order) for i, one in enumerate(of))
    return Drive(**{**dict.fromkeys(SINGLE_LOADS), **plain}, harmonic=harmonics or None)


def _harmonic_of(i: int, entries: dict[str, Any], engine_order: Any) -> Harmonic | ComplexHarmonic:
    own = entries.pop("engine_order", None)
    order = {} if own is None else {"order": order_of(own, float(engine_order), i), "by_engine_order": True}
    if "F" in entries:
        return Harmonic(**entries, **order)
    modal = {name: load for name in MODAL_LOAD_KEYS if (load := entries.pop(name, None)) is not None}
    return ComplexHarmonic(**entries, **order, modal=modal)


def _contact_of(tables: Mapping[str, Mapping[str, Any]]) -> Contact:
    entries = {"k": None, "gamma": None, **tables["contact"]}
    entries = with_listed_places(entries)
    points, shares = entries.pop("points", None), entries.pop("shares", None)
    return Contact(**entries, points=None if points is None else ContactPoints(points, shares))


def _for_layout(key: str, value: Any, layout: Layout) -> Any:
    """A value of a file, a number with one entry for each blade or interface."""
    if key not in ALL_KEYS or value is None:
        return value
    return np.full(number_shape(ALL_KEYS[key], layout), value, float)
