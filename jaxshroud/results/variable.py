"""The numbers of a result, one declaration each: how they are labelled, stored and given back.

A class of results lists its numbers as class attributes, and that is all there is to say of them: the dataset, the
file, its units and the attribute that users read are made from it.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.scene.keys import rows_of
from jaxshroud.scene.motion import Motion

if TYPE_CHECKING:
    import xarray as xr

MOTION = {row.parts[1]: (row.netcdf, row.about) for row in rows_of("initial")}  # name -> units, words
Entry = tuple[str, tuple[tuple[str, ...], np.ndarray, dict[str, Any]]]  # name; dimensions, values, attributes


class Variable:
    """One number of a result, for each lane.

    Args:
        long_name: What it is.
        units: In SI, as NetCDF writes them; none for flags and counts.
        dims: Its dimensions after those of the lanes.
        stored: Type in the dataset where it is another than that of the numbers given.
        kind: Type of what users get where it is another than the stored one.
        alone: The result of a single scene holds it as an attribute, and gives a plain number.
        more: Further attributes of the variable.
    """

    name = ""

    def __init__(
        self,
        long_name: str,
        units: str | None = None,
        dims: tuple[str, ...] = (),
        *,
        stored: type | None = None,
        kind: type | None = None,
        alone: bool = False,
        more: Mapping[str, Any] | None = None,
    ):
        self.more = dict(more or {})
        told = {"units": units, "long_name": long_name or None, **self.more}
        self.attributes = {name: value for name, value in told.items() if value is not None}
        self.dims, self.stored, self.kind, self.alone = dims, stored, kind, alone

    def __set_name__(self, owner: type, name: str):
        self.name = self.name or name

    def __get__(self, result: Any, owner: type | None = None) -> Any:
        """The values of a result, None where it has none; a plain number where an attribute holds it."""
        return self if result is None else self.read(result.data)

    def entries(self, values: Any, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """The variables that hold the values."""
        yield self.name, ((*lanes, *self.dims), np.asarray(values, self.stored), self.attributes)

    def among(self, data: "xr.Dataset") -> list[str]:
        """The variables of a dataset that hold the values."""
        return [self.name] if self.name in data.data_vars else []

    def read(self, data: "xr.Dataset") -> Any:
        """The values that a dataset holds, None where it has none."""
        if self.alone and self.name in data.attrs:
            return (self.kind or float)(data.attrs[self.name])
        if self.name not in data.variables:
            return None
        values = data[self.name].to_numpy()
        return values if self.kind is None else values.astype(self.kind)


class Attribute(Variable):
    """What all lanes have in common.

    Args:
        kind: Its type.
        name: In files, where it is called otherwise there.
    """

    def __init__(self, kind: type = float, name: str = ""):
        super().__init__("", kind=kind, alone=True)
        self.name = name

    def entries(self, values: Any, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One value without dimensions."""
        yield self.name, ((), np.asarray(values), {})


class Moving(Variable):
    """Displacements and rates of both blades, as six variables."""

    def entries(self, values: Motion, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each field."""
        for name, array in values._asdict().items():
            units, long_name = MOTION[name]
            told = {"units": units, "long_name": long_name}
            yield name, ((*lanes, *self.dims, "blade"), np.asarray(array), told)

    def read(self, data: "xr.Dataset") -> Motion:
        """A `Motion` of arrays."""
        return Motion(*(data[name].to_numpy() for name in Motion._fields))


class Counts(Variable):
    """Numbers of events by their names: a variable each, or an attribute each where there is a single scene.

    Args:
        long_name: What is counted.
        prefix: Of the names, in the dataset.
    """

    def __init__(self, long_name: str, prefix: str = ""):
        super().__init__(long_name, alone=True)
        self.words, self.prefix = f"{long_name}: ", prefix

    def entries(self, values: Mapping[str, Any], lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each counter."""
        for name, n in values.items():
            yield f"{self.prefix}{name}", (lanes, np.asarray(n), {"long_name": f"{self.words}{name}"})

    def among(self, data: "xr.Dataset") -> list[str]:
        """One variable for each counter."""
        return [str(n) for n, a in data.data_vars.items() if str(a.attrs.get("long_name")).startswith(self.words)]

    def read(self, data: "xr.Dataset") -> dict[str, Any]:
        """Numbers by the names of events."""
        many = {name: data[name].to_numpy() for name in self.among(data)}
        one = {name: int(n) for name, n in data.attrs.items() if self.prefix and str(name).startswith(self.prefix)}
        return {str(name).removeprefix(self.prefix): n for name, n in (many or one).items()}
