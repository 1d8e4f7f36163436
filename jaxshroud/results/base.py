"""The base of all results: a labelled dataset and its origin, shown, saved and drawn in one way for every kind."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypedDict

import numpy as np

from jaxshroud.io.lane_status import FLAGS, count_by_status, status_messages
from jaxshroud.io.scene_numbers import scene_text_of_lane
from jaxshroud.io.store import JSONValue, json_values, read, write_dataset, write_json
from jaxshroud.io.variable import Attribute, MethodAttribute, Variable
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError, StoreError
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.typed import typed
from jaxshroud.version import __version__

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ORIGIN = ("title", "scene", "source", "version")
SOURCE = {"source": "scene", "version": "version"}  # attribute -> its name in `summary.json`


class Labels(TypedDict, total=False):
    """The labels of a result's lanes and its origin, as keyword arguments of `Result.from_values`."""

    lanes: Sequence[str]
    attrs: Mapping[str, object] | None
    more: Mapping[str, object] | None


class Result:
    """A labelled dataset whose variables are attributes of the object too.

    The leading axes of all arrays are those of the given scenes; a single scene has none. A subclass only has to
    declare its quantities as `Variable`s.

    Args:
        data: The dataset, as `to_xarray` gives it and files hold it.
    """

    stored_as: ClassVar[str] = ""  # the attribute `kind` of files
    required: ClassVar[tuple[str, ...]] = ()  # variables without which a file is no result of this kind
    variables: ClassVar[dict[str, Variable]]

    status = Variable("how each lane ended", stored=np.int8, kind=np.int32, more=FLAGS)
    method = Attribute(str)  # in words
    march = MethodAttribute()  # the same as verbs take it
    steps_per_period = Attribute(int)
    accuracy = Attribute(str)  # the accuracy requested, and the method chosen for it
    chatter = Attribute(str)  # the contact changes that alternate in the first lane with TOO_MANY_EVENTS

    def __init__(self, data: "xr.Dataset"):
        self.data = data

    classes: ClassVar[dict[str, type["Result"]]] = {}  # by the kinds of results, once their modules are imported

    def __init_subclass__(cls):
        members = [item for base in reversed(cls.__mro__) for item in vars(base).items()]
        cls.variables = {name: value for name, value in members if isinstance(value, Variable)}
        if "stored_as" in vars(cls):  # a subclass without a kind of its own is not what files hold
            Result.classes[cls.stored_as] = cls

    @classmethod
    def from_values(
        cls,
        values: Mapping[str, object],
        *,
        lanes: Sequence[str] = (),
        coords: Mapping[str, object] | None = None,
        attrs: Mapping[str, object] | None = None,
        more: Mapping[str, object] | None = None,
        layout: Layout | None = None,
    ) -> Self:
        """A result from its values.

        Args:
            values: The values by the names of `variables`; those that are None are left out.
            lanes: The names of the leading dimensions.
            coords: Coordinates as xarray takes them.
            attrs: Attributes of the dataset, such as its origin.
            more: Further variables as xarray takes them, such as the numbers that differ between scenes.
            layout: Of the scenes, which decides whether users see an axis of interfaces; None where they always do.
        """
        import xarray as xr

        arrays: dict[str, tuple[tuple[str, ...], np.ndarray, Mapping[str, object]]] = {}
        scalars: dict[str, object] = {}
        for name, variable in cls.variables.items():
            value = values.get(name)
            if value is None:
                continue
            for entry, (declared, array, attributes) in variable.entries(value, tuple(lanes)):
                dims = declared if layout is None else layout.dims(declared)
                if variable.alone and not dims:
                    scalars |= {entry: array.item(), **variable.more}
                else:
                    arrays[entry] = (dims, array, attributes)
        dataset_attrs = {**(attrs or {}), **scalars, "kind": cls.stored_as, "version": __version__}
        return cls(xr.Dataset({**arrays, **(more or {})}, dict(coords or {}), dataset_attrs))

    @property
    def failed(self) -> int:
        """The number of lanes whose status is not OK."""
        return int(np.sum(self.status != Status.OK))

    @property
    def messages(self) -> list[str]:
        """What to do about lanes that are not OK: one line for each status that occurs."""
        return list(status_messages(self.status, self.chatter))

    @property
    def scene(self) -> str:
        """The scene as TOML in SI units; of many scenes the first one, as the dataset has the numbers that differ."""
        return str(self.data.attrs.get("scene", ""))

    @typed
    def lane(self, *at: int) -> Self:
        """One of many lanes, as a result of its own.

        Args:
            at: The lane's index along each leading axis.

        Raises:
            ValueError: The number of indices is not that of the leading axes.
            IndexError: There is no such lane.
        """
        dims = self.data["status"].dims if "status" in self.data.variables else ()
        if len(at) != len(dims):
            raise InputError(f"This result has {len(dims)} leading axes, but {len(at)} numbers name a lane.")
        data = self.data.isel(dict(zip(dims, at, strict=True)))
        names = [name for v in self.variables.values() if v.alone for name in v.among(data) if not data[name].dims]
        scalars = {name: data[name].item() for name in names}
        if "scene" in data.attrs:
            scalars["scene"] = scene_text_of_lane(data)
        return type(self)(data.drop_vars(names).assign_attrs(scalars))

    def to_xarray(self) -> "xr.Dataset":
        """The labelled dataset."""
        return self.data

    @property
    def origin(self) -> dict[str, JSONValue]:
        """Where the result comes from, as far as it is known: title, scene, source and version."""
        return {name: self.data.attrs[name] for name in ORIGIN if name in self.data.attrs}

    @property
    def source(self) -> dict[str, JSONValue]:
        """The file of the scene and the version, as summaries name them."""
        return {new: self.data.attrs[old] for old, new in SOURCE.items() if old in self.data.attrs}

    def summary(self) -> dict[str, JSONValue]:
        """The result as plain numbers and strings, as JSON holds them; None for numbers that are not finite.

        By default these are the numbers of a single lane, the count of lanes for each status, and the origin.
        """
        alone = [name for name, v in self.variables.items() if v.alone and not isinstance(v, MethodAttribute)]
        values = {name: getattr(self, name) for name in alone}
        numbers = {name: value for name, value in values.items() if value is not None and not np.ndim(value)}
        numbers |= {"method": str(self.method), "status": count_by_status(self.status)}
        return json_values({**numbers, **self.origin})

    @typed
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as NetCDF, completely or not at all.

        Raises:
            WriteError: The place cannot be written.
        """
        write_dataset(self.data, Path(path))

    @classmethod
    @typed
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """A stored result of this class.

        Raises:
            StoreError: The file is missing, damaged, or holds another kind of result.
        """
        result = open(path)
        if not isinstance(result, cls):
            raise StoreError(f"{path}: holds a {type(result).__name__}, not a {cls.__name__}; open it with js.open")
        return result

    @typed
    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        over: "Result | None" = None,
        **options: Any,
    ) -> "Figure":
        """The result as a page of panels, or one panel of it.

        Args:
            ax: Draw one panel there, by default the first.
            panel: Draw only this panel; the documentation of the class names them.
            over: Another result, drawn behind this one in grey: one of the same kind, behind a branch a sweep too.
            options: `title`, `xlabel`, `unit` of displacements and of lengths that are varied ("mm", "um", "m" or
                "gap", for x over the gap), `width` of the page [mm], matplotlib `style`, and further options of the
                class.

        Raises:
            ValueError: There is no such picture or panel, an option of the whole figure is given with `ax`, or the
                other result cannot be drawn behind this one.
        """
        from jaxshroud.plotting.pictures import picture

        return picture(*self._drawn(), ax, panel, over=None if over is None else over._drawn(), **options)

    def _drawn(self) -> tuple[str, object]:
        """The kind of picture, and the data from which it is drawn."""
        return self.stored_as, self.data

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {self.ended}; {self.method}, {self.steps_per_period} steps a period"

    @property
    def ended(self) -> str:
        """The number of lanes with each status, as text."""
        return ", ".join(f"{n} {name}" for name, n in count_by_status(self.status).items())

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.data._repr_html_()}"


@typed
def open(path: str | os.PathLike[str]) -> Result:
    """A result that was saved by this version or by an earlier one.

    Args:
        path: A file that `save` or a command has written, or the folder of a command.

    Raises:
        StoreError: The file is missing or damaged, or no result.
    """
    if Path(path).is_dir() and Path(path).suffix != ".zarr":
        path = _result_in(Path(path))
    if Path(path).suffix == ".json":
        netcdf = Path(path).with_suffix(".nc")
        advice = f"open {netcdf}" if netcdf.exists() else "run the command again, which writes a .nc too"
        raise StoreError(f"{path}: holds plain numbers for other programs; {advice}")
    return result_from_dataset(read(path), path)


def _result_in(folder: Path) -> Path:
    """The result that a command has written into a folder: beside a sweep that stands behind it, the other one."""
    found = sorted([*folder.glob("*.nc"), *folder.glob("*.zarr")], key=lambda path: path.stem == "sweep")
    if not found:
        raise StoreError(f"{folder}: holds no result; was the run interrupted?")
    return found[0]


def result_from_dataset(data: "xr.Dataset", path: str | os.PathLike[str]) -> Result:
    """The result that a dataset holds; error messages name its `path`.

    Raises:
        StoreError: The dataset is not a result.
    """
    result_class = _result_class(data.attrs.get("kind"))
    if result_class is None:
        raise StoreError(f"{Path(path)}: not a result of jaxshroud; give a sweep or a trajectory")
    if missing := [name for name in result_class.required if name not in data]:
        raise StoreError(f"{Path(path)}: lacks {', '.join(missing)}; run the command again")
    return result_class(data)


def _result_class(kind: object) -> type[Result] | None:
    """The class of results of a kind: of the module of that name, or of any of this room."""
    if not isinstance(kind, str) or not kind:
        return None
    modules = [module.name for module in iter_modules([str(Path(__file__).parent)])]
    for name in sorted(modules, key=lambda name: name != kind):
        if kind in Result.classes:
            break
        import_module(f"jaxshroud.results.{name}")
    return Result.classes.get(kind)


class PlainResult:
    """The base of dataclasses that verbs return in place of a dataset: shown and saved as results are."""

    def summary(self) -> dict[str, JSONValue]:
        """The fields as plain numbers and strings, as JSON holds them; None for numbers that are not finite."""
        return json_values(asdict(self))  # type: ignore[arg-type]

    @typed
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the summary as JSON, completely or not at all.

        Raises:
            WriteError: The place cannot be written.
        """
        write_json(self.summary(), Path(path))
