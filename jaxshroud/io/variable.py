"""The variables of results: how values are labelled, stored and read, for a single lane and for many."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion, keys_of_table
from jaxshroud.scene.typed import Tree

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.march.method import Method

MOTION = {row.parts[1]: (row.netcdf, row.about) for row in keys_of_table("initial")}  # name -> units, long name
Entry = tuple[str, tuple[tuple[str, ...], np.ndarray, Mapping[str, object]]]  # name; dimensions, values, attributes
Value = TypeVar("Value")  # that a result gives for a variable


class HasDataset(Protocol):
    """An object whose variables are read from its dataset."""

    data: "xr.Dataset"


class Variable(Generic[Value]):
    """A quantity of a result, with a value for each lane.

    Args:
        long_name: What the quantity is.
        units: SI units as NetCDF writes them; None for flags and counts.
        dims: The dimensions that follow those of the lanes; `interface` is dropped where there is but that of a pair.
        stored: The type in the dataset, where it differs from that of the given values.
        kind: The type that users get, where it differs from the stored one.
        alone: Whether a value without dimensions is an attribute, and a plain number, in the result of a single scene.
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
        attributes = {"units": units, "long_name": long_name or None, **self.more}
        self.attributes = {name: value for name, value in attributes.items() if value is not None}
        self.dims, self.stored, self.kind, self.alone = dims, stored, kind, alone

    def __set_name__(self, owner: type, name: str):
        self.name = self.name or name

    @overload
    def __get__(self, result: None, owner: type) -> Self: ...

    @overload
    def __get__(self, result: HasDataset, owner: type) -> Value: ...

    def __get__(self, result: HasDataset | None, owner: type) -> "Self | Value":
        """The values of a result: None where it has none, a plain number where an attribute holds it."""
        return self if result is None else self.read(result.data)

    def entries(self, values: Value, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """The variables that hold the values."""
        yield self.name, ((*lanes, *self.dims), np.asarray(values, self.stored), self.attributes)

    def among(self, data: "xr.Dataset") -> list[str]:
        """The names of the variables of a dataset that hold the values."""
        return [self.name] if self.name in data.data_vars else []

    def read(self, data: "xr.Dataset") -> Any:  # `Value`, or None
        """The values that a dataset holds, or None if it holds none."""
        if self.alone and self.name in data.attrs:
            return (self.kind or float)(data.attrs[self.name])
        if self.name not in data.variables:
            return None
        values = data[self.name].to_numpy()
        return values if self.kind is None else values.astype(self.kind)


class Attribute(Variable[Value]):
    """A value that all lanes have in common.

    Args:
        kind: The type of the value.
        name: Its name in files, where it differs from the name in Python.
    """

    def __init__(self, kind: type[Value] | type[float] = float, name: str = ""):
        super().__init__("", kind=kind, alone=True)
        self.name = name

    def entries(self, values: Value, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One value without dimensions."""
        yield self.name, ((), np.asarray(values), {})


class MethodAttribute(Attribute["Method"]):
    """The method of a march with its steps, as verbs take it; files hold a text of `method_as_json`."""

    def read(self, data: "xr.Dataset") -> "Method | None":
        """The method, or None of a result that was not marched.

        Raises:
            InputError: The file does not say by which method.
        """
        from jaxshroud.march.method import method_from_json  # which needs JAX

        return method_from_json(str(data.attrs[self.name])) if self.name in data.attrs else None


class MotionVariable(Variable[Motion]):
    """The displacements and rates of both blades, as six variables."""

    def entries(self, values: Motion, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each field."""
        for name, array in values._asdict().items():
            units, long_name = MOTION[name]
            attributes = {"units": units, "long_name": long_name}
            yield name, ((*lanes, *self.dims, "blade"), np.asarray(array), attributes)

    def read(self, data: "xr.Dataset") -> Motion:
        """A `Motion` of arrays.

        Raises:
            InputError: The run has kept none.
        """
        if "x" not in data:
            raise InputError("This result keeps no samples of the motion: it was made with keep_samples=False.")
        return Motion._make(data[name].to_numpy() for name in Motion._fields)


class CountsVariable(Variable[Mapping[str, Any]]):
    """The numbers of events by name: a variable for each kind of event, or an attribute for a single scene.

    Args:
        long_name: What is counted.
        prefix: The prefix of the names in the dataset.
        dims: The dimensions that follow those of the lanes.
    """

    def __init__(self, long_name: str, prefix: str = "", dims: tuple[str, ...] = ()):
        super().__init__(long_name, dims=dims, alone=True)
        self.label = f"{long_name}: "
        self.prefix = prefix

    def entries(self, values: Mapping[str, Any], lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each counter."""
        for name, n in values.items():
            dims = (*lanes, *self.dims)
            yield f"{self.prefix}{name}", (dims, np.asarray(n), {"long_name": f"{self.label}{name}"})

    def among(self, data: "xr.Dataset") -> list[str]:
        """The names of the counters' variables."""
        return [str(n) for n, a in data.data_vars.items() if str(a.attrs.get("long_name")).startswith(self.label)]

    def read(self, data: "xr.Dataset") -> dict[str, Any]:
        """The counts by the names of events."""
        arrays = {name: data[name].to_numpy() for name in self.among(data)}
        counts = {name: int(n) for name, n in data.attrs.items() if self.prefix and str(name).startswith(self.prefix)}
        return {str(name).removeprefix(self.prefix): n for name, n in (arrays or counts).items()}


class FlagsVariable(Variable):
    """The flags that are set for a lane: a tuple of their names for a single scene, an array of tuples for many."""

    def __init__(self, long_name: str, flags: Sequence[str], dim: str):
        super().__init__(long_name, dims=(dim,), more={"flag_meanings": ", ".join(flags)})
        self.flags = flags

    def entries(self, values: Any, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """For each flag whether it is set."""
        is_set = [[flag in names for flag in self.flags] for names in (values.ravel() if lanes else [values])]
        shape = (*(values.shape if lanes else ()), len(self.flags))
        yield self.name, ((*lanes, *self.dims), np.array(is_set, np.int8).reshape(shape), self.attributes)

    def read(self, data: "xr.Dataset") -> Any:
        """The names of the flags that are set."""
        is_set = data[self.name].to_numpy().astype(bool)
        rows = is_set.reshape(-1, len(self.flags))
        names = [tuple(flag for flag, here in zip(self.flags, row, strict=True) if here) for row in rows]
        return lanes_in_shape(names, is_set.shape[:-1])


class ComplexVariable(Variable[NDArray[np.complex128]]):
    """Complex numbers: a variable for the real parts and one for the imaginary parts."""

    def entries(self, values: NDArray[np.complex128], lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each part."""
        for part in ("real", "imag"):
            attributes = {**self.attributes, "long_name": f"{self.attributes['long_name']}: {part} part"}
            yield f"{self.name}_{part}", ((*lanes, *self.dims), getattr(np.asarray(values), part), attributes)

    def read(self, data: "xr.Dataset") -> NDArray[np.complex128] | None:
        """The numbers that a dataset holds, or None if it holds none."""
        if f"{self.name}_real" not in data.variables:
            return None
        return data[f"{self.name}_real"].to_numpy() + 1j * data[f"{self.name}_imag"].to_numpy()


def lanes_in_shape(values: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """The values of lanes (arrays, named tuples of arrays, or tuples of strings) as arrays that start with `shape`.

    For a single scene, of shape (), the only value is returned as it is.
    """
    first = values[0]
    if not shape:
        return first
    if hasattr(first, "_fields"):
        return type(first)(*(lanes_in_shape(field, shape) for field in zip(*values, strict=True)))
    if isinstance(first, tuple):
        tuples = np.empty(len(values), object)
        for lane, value in enumerate(values):
            tuples[lane] = value
        return tuples.reshape(shape)
    return np.stack([np.asarray(value) for value in values]).reshape(*shape, *np.shape(first))


def lane_arrays(tree: Tree, lane: tuple[int, ...]) -> Tree:
    """One lane of a tree of arrays."""
    import jax

    return jax.tree.map(lambda a: np.asarray(a)[lane], tree)


def jax_lane_arrays(tree: Tree, lane: tuple[int, ...]) -> Tree:
    """One lane of a tree of arrays, as JAX arrays."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda a: jnp.asarray(np.asarray(a)), lane_arrays(tree, lane))


def lanes_in_words(lanes: np.ndarray, failed: int) -> str:
    """The number of lanes, and of those that failed, as text."""
    count = f"{' x '.join(map(str, np.shape(lanes)))} lanes"
    return f"{count}, {failed} failed" if failed else count


EVENT_PREFIX = "event_"  # of the names of all variables that are stored at events
EVENT_AFTER = "event_after"  # the sample that precedes an event; the states before and after it follow each other


def with_events(ds: "xr.Dataset", of: Sequence[str] | None = None) -> "xr.Dataset":
    """The samples of a run and the states on both sides of every event, in order; an event takes no time.

    Args:
        ds: A run of a single scene; without stored events it is returned unchanged.
        of: The variables to keep; by default all that vary in time.
    """
    names = [str(name) for name, a in ds.data_vars.items() if "time" in a.dims] if of is None else [*of]
    samples = ds[names]
    if EVENT_AFTER not in ds.variables:
        return samples
    import xarray as xr

    events = ds[[EVENT_PREFIX + name for name in names]].rename({EVENT_PREFIX + name: name for name in names})
    times = np.concatenate([ds["time"].to_numpy(), ds[f"{EVENT_PREFIX}t"].to_numpy()])
    order = np.argsort(np.concatenate([np.arange(ds.sizes["time"]), ds[EVENT_AFTER].to_numpy() + 0.5]), kind="stable")
    states = xr.concat([samples.drop_vars("time"), events.rename(event="time")], "time", combine_attrs="override")
    return states.assign_coords(time=("time", times, ds["time"].attrs)).isel(time=order)
