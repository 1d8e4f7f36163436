"""Measurements from CSV files and tables: columns with units in their headers, as SI values."""

import math
import os
import re
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxshroud.scene.checks import InputError, hint
from jaxshroud.scene.csv_text import csv_rows, read_csv_text
from jaxshroud.scene.keys import KEYS
from jaxshroud.scene.measurements import BLADES, MEASURES, Channel, Measurements, channel_named
from jaxshroud.scene.quantities import DISPLACEMENTS
from jaxshroud.scene.units import is_speed_of_rotation, to_si

HEADER = re.compile(r"\s*(?P<name>\w+)\s*(\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*")
LARGEST = 1e30  # number that is taken for measured
LEAST_NOISE = 1e-12  # over the largest value of a channel: that of rounding
SIGMA = "_sigma"  # after the name of a channel
AXIS_UNITS = {"t": "s", "omega": "rad/s", "f": "Hz", "speed": "rad/s", "engine_order": ""}
EXAMPLES = [  # to hint at
    Channel(place=place, label=label, measure=measure).name
    for place, label, measure in product(DISPLACEMENTS, BLADES, ("", *MEASURES))
]
UNIT_EXAMPLES = {"m": "mm", "rad": "deg"}  # of an SI unit
RUN_TIME = "time [s]"  # the head by which a run that `convert` has written is known
RUN_HEAD = re.compile(rf"({'|'.join(DISPLACEMENTS)})\[(\d+)\] (\[\w+\])")


Columns = Mapping[str, np.ndarray]  # in SI units, by name


def read_measurements(path: str | os.PathLike[str]) -> Measurements:
    """Measurements from a CSV file; see `measurements_from`. Lines that begin with # are comments.

    Of a run that `convert` has written the times and the displacements that are not 0 throughout are read.

    Raises:
        InputError: The file cannot be read, or is no such table; one line names the place and the cure.
    """
    text = read_csv_text(Path(path), "a CSV file with a header such as `t [s],x_left [mm]`")
    numbered = enumerate(StringIO(text, newline=""), 1)
    lines = [(n, line) for n, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    _check_separator(lines[0][1] if lines else "", path)
    rows = [(n, *row) for n, row in csv_rows(Path(path), lines, ",")]
    if len(rows) < 2:
        raise InputError(f"{path}: has no data; it needs a header such as `t [s],x_left [mm]` and rows of numbers")
    (_, *headers), *table = rows
    for n, *row in table:
        if len(row) != len(headers):
            raise InputError(f"{path}: line {n} has {len(row)} cells, but the header has {len(headers)}")
    if RUN_TIME in headers:
        headers, table = _history_of_run(headers, table)
    for i, header in enumerate(headers):
        name, *_ = _name_and_unit(header, str(path))
        if header in headers[:i]:
            raise InputError(f"{path}: {name} is there twice")
    columns = {
        header: [_number(cell, n, header, path) for (n, *_), cell in zip(table, cells, strict=True)]
        for header, cells in zip(headers, list(zip(*(row[1:] for row in table), strict=True)), strict=True)
    }
    return _measurements(columns, str(path), [f"line {n}" for n, *_ in table])


def _check_separator(header: str, path: str | os.PathLike[str]) -> None:
    """Raise InputError where something else than commas separates columns."""
    for separator, name in {";": "semicolons", "\t": "tabs"}.items():
        if header.count(separator) > header.count(","):
            cure = "separate them by commas, and write numbers with a point"
            raise InputError(f"{path}: columns are separated by {name}; {cure}")


def _history_of_run(headers: list[str], table: list[tuple]) -> tuple[list[str], list[tuple]]:
    """The columns of a run that are those of a time history, with the heads that these have."""

    def moves(j):
        return any(row[j + 1] not in ("0", "0.0", "-0.0") for row in table)

    found = {j: match for j, head in enumerate(headers) if (match := RUN_HEAD.fullmatch(head))}
    labels = BLADES if max(int(match[2]) for match in found.values()) < len(BLADES) else range(1, 1000)
    names = {j: f"{match[1]}_{labels[int(match[2])]} {match[3]}" for j, match in found.items() if moves(j)}
    names = {headers.index(RUN_TIME): "t [s]"} | names
    return list(names.values()), [(row[0], *(row[j + 1] for j in names)) for row in table]


def _number(cell: str, line: int, header: str, path: str | os.PathLike[str]) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{path}: line {line}, column {header.strip()}: {cell.strip()!r} is no finite number; leave the line out"
        )
    return value


def measurements_from(table: Mapping[str, Any], where: str = "the measurements") -> Measurements:
    """Measurements from a table of columns.

    Args:
        table: Columns by headers `name [unit]`: `t` for a time history, or `omega`, `f`, or `speed` and `engine_order`
            for a frequency response; and channels, `x_left`, `theta_right`, ... of a history, `x_rms_left`,
            `x_peak_right`, ... of a response, each with an optional column of its noise, `x_left_sigma`. The blades of
            a row have their numbers, from 1: `x_1`, `x_rms_12`.
        where: The place that messages name first.

    Raises:
        InputError: A column is unknown, has no unit or a wrong one, or holds what cannot be measured; or the axis is
            missing, or there are two.
    """
    return _measurements(table, where)


def _measurements(table: Mapping[str, Any], where: str, rows: Sequence[str] | None = None) -> Measurements:
    """The same; messages call a row by its name among `rows`, else by its number."""
    pairs = [_si_column(str(header), values, where) for header, values in table.items()]
    columns = dict(pairs)
    if len(columns) < len(pairs):
        names = [name for name, _ in pairs]
        raise InputError(f"{where}: {next(name for name in names if names.count(name) > 1)} is there twice")
    if len({column.size for column in columns.values()}) > 1:
        raise InputError(f"{where}: the columns differ in length")
    is_history = _is_history(columns, where)
    at = columns["t"] if is_history else _drive_frequencies(columns, where)
    channels = [channel for name in columns if (channel := channel_named(name))]
    _check_channels(channels, is_history, columns, where)
    _check_axis(at, is_history, where, rows)
    for channel in channels:
        if not is_history and (columns[channel.name] < 0).any():
            raise InputError(f"{where}: {channel.name} is an amplitude, and cannot be negative")
    values = np.stack([columns[channel.name] for channel in channels], axis=1)
    kind = "history" if is_history else "response"
    return Measurements(kind, at, tuple(channels), values, _sigma(columns, channels, where))


def _name_and_unit(header: str, where: str) -> tuple[str, str, str]:
    """The name of a column, its unit, and the SI unit that belongs to the name."""
    match = HEADER.fullmatch(header)
    name = match["name"] if match else header.strip()
    channel = channel_named(name.removesuffix(SIGMA))
    if match is None or (channel is None and name not in AXIS_UNITS):
        raise InputError(f"{where}: column {header.strip()!r} is unknown{hint(name, [*AXIS_UNITS, *EXAMPLES])}")
    unit = AXIS_UNITS[name] if channel is None else KEYS[f"initial.{channel.place}"].unit
    if match["unit"] is None and unit:
        raise InputError(f"{where}: column {name} has no unit; write e.g. `{name} [{UNIT_EXAMPLES.get(unit, unit)}]`")
    return name, "" if match["unit"] in (None, "1", "-") else match["unit"], unit


def _si_column(header: str, values: Any, where: str) -> tuple[str, np.ndarray]:
    """The name of a column, and its values in SI units."""
    name, given, unit = _name_and_unit(header, where)
    if name == "omega" and is_speed_of_rotation(f"1 {given}"):
        raise InputError(
            f"{where}: column {header.strip()}: {given} is a speed of rotation; write `speed [{given}]` beside "
            "`engine_order`, or omega in rad/s"
        )
    try:
        factor = to_si(unit, f"1 {given}")
    except ValueError as error:
        raise InputError(f"{where}: column {header.strip()}: its unit {error}") from None
    return name, _finite(values, header, where) * factor


def _finite(values: Any, header: str, where: str) -> np.ndarray:
    try:
        numbers = np.asarray(values, float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not numbers.size or not (np.abs(numbers) < LARGEST).all():
        raise InputError(f"{where}: column {header.strip()} must be one finite number per row, below {LARGEST:g}")
    return numbers


def _is_history(columns: Columns, where: str) -> bool:
    """Whether the measurements are a time history; else they are a frequency response."""
    axes = [name for name in ("t", "omega", "f", "speed") if name in columns]
    if not axes:
        raise InputError(
            f"{where}: has neither a time nor a frequency; give a column `t [s]`, `omega [rad/s]` or `f [Hz]`"
        )
    if len(axes) > 1:
        raise InputError(f"{where}: has both {axes[0]} and {axes[1]}; give a time history or a frequency response")
    if ("speed" in columns) != ("engine_order" in columns):
        raise InputError(f"{where}: speed and engine_order give the drive's frequency together; give both or `omega`")
    return axes == ["t"]


def _drive_frequencies(columns: Columns, where: str) -> np.ndarray:
    """The circular frequencies of the drive [rad/s]."""
    if "f" in columns:
        return math.tau * columns["f"]
    if "speed" in columns:
        return columns["speed"] * columns["engine_order"]
    return columns["omega"]


def _check_channels(channels: list[Channel], is_history: bool, columns: Columns, where: str) -> None:
    kind = "time history" if is_history else "frequency response"
    example = "x_left [mm]" if is_history else "x_rms_left [mm]"
    if wrong := [channel.name for channel in channels if (channel.measure == "") != is_history]:
        raise InputError(f"{where}: {wrong[0]} is no channel of a {kind}; give e.g. `{example}`")
    blades = [channel._replace(label=str(channel.blade)) for channel in channels]
    if len({*blades}) < len(blades):
        twice = next(i for i, one in enumerate(blades) if one in blades[:i])
        first = channels[blades.index(blades[twice])]
        raise InputError(f"{where}: {channels[twice].name} is {first.name} by another name; give one of them")
    if not channels:
        raise InputError(f"{where}: measures nothing; give a column such as `{example}`")
    if lone := [name for name in columns if name.endswith(SIGMA) and name.removesuffix(SIGMA) not in columns]:
        raise InputError(f"{where}: {lone[0]} has no column {lone[0].removesuffix(SIGMA)}")


def _check_axis(at: np.ndarray, is_history: bool, where: str, rows: Sequence[str] | None) -> None:
    if is_history and at[0] < 0:
        raise InputError(f"{where}: t begins before 0, which is drive phase 0 and the start of the scene")
    if is_history and (falls := np.flatnonzero(np.diff(at) <= 0)).size:
        at_fall = falls[0] + 1
        row = f"row {at_fall + 1}" if rows is None else rows[at_fall]
        raise InputError(f"{where}: t must grow from row to row, but {row} has {at[at_fall]:g} s")
    if not is_history and not (at > 0).all():
        raise InputError(f"{where}: the frequencies of the drive must be positive")


def _sigma(columns: Columns, channels: list[Channel], where: str) -> np.ndarray | None:
    """The standard deviations of the noise, (n, channels); None where they are not known."""
    names = [channel.name + SIGMA for channel in channels]
    known = [name for name in names if name in columns]
    if not known:
        return None
    if missing := [name for name in names if name not in columns]:
        raise InputError(
            f"{where}: {known[0]} is there, but {missing[0]} is not; give the noise of all channels or none"
        )
    sigma = np.stack([columns[name] for name in names], axis=1)
    largest = np.array([np.abs(columns[channel.name]).max() for channel in channels])
    if not ((sigma > 0) & (sigma > LEAST_NOISE * largest)).all():
        raise InputError(f"{where}: the noise of each value must be positive, and more than rounding")
    return sigma
