"""What all results have in common: labelled numbers with where they come from, shown, saved and drawn alike."""

import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.results.dimension import text_of_one
from jaxshroud.results.status import FLAGS, counted, messages
from jaxshroud.results.store import read, write_dataset
from jaxshroud.results.variable import Attribute, Variable
from jaxshroud.scene.errors import InputError, StoreError
from jaxshroud.version import __version__

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Kind of a result -> its module and class.
CLASSES = {
    "sweep": ("sweep", "SweepResult"),
    "trajectory": ("trajectory", "Trajectory"),
    "power": ("power", "PowerResult"),
    "orbit": ("orbit", "Orbit"),
    "gradient": ("gradient", "Gradient"),
    "lyapunov": ("lyapunov", "Lyapunov"),
    "tuned": ("tuned", "Tuned"),
    "diagnosis": ("diagnosis", "Diagnosis"),
    "branch": ("branch", "Branch"),
    "attractors": ("attractors", "Attractors"),
    "basins": ("basins", "Basins"),
    "scatter": ("scatter", "Scatter"),
}


class Result:
    """A labelled dataset whose numbers are attributes too.

    Leading axes of all arrays are those of the scenes that were asked for; there are none for a single scene. A
    subclass declares its numbers as `Variable`s, and nothing else needs to be said of them.

    Args:
        data: The dataset, as `to_xarray` gives it and files hold it.
    """

    stored_as: ClassVar[str] = ""  # in the attribute `kind` of files
    never_without: ClassVar[tuple[str, ...]] = ()  # what all files have
    variables: ClassVar[dict[str, Variable]]

    status = Variable("how each lane ended", stored=np.int8, kind=np.int32, more=FLAGS)
    method = Attribute(str)
    steps_per_period = Attribute(int)
    accuracy = Attribute(str)  # asked for, and what it chose
    chatter = Attribute(str)  # what alternated in the first lane that stopped with TOO_MANY_EVENTS

    def __init__(self, data: "xr.Dataset"):
        self.data = data

    def __init_subclass__(cls):
        known = [item for base in reversed(cls.__mro__) for item in vars(base).items()]
        cls.variables = {name: value for name, value in known if isinstance(value, Variable)}

    @classmethod
    def from_values(
        cls,
        values: Mapping[str, Any],
        *,
        lanes: Sequence[str] = (),
        coords: Mapping[str, Any] | None = None,
        attrs: Mapping[str, Any] | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> Self:
        """A result from its numbers.

        Args:
            values: The numbers, by the names of the `variables`; None is left out.
            lanes: Names of the leading dimensions.
            coords: Coordinates as xarray takes them.
            attrs: Attributes of the whole, such as where it comes from.
            more: Further variables as xarray takes them, such as the numbers that differ between scenes.
        """
        import xarray as xr

        data: dict[str, Any] = {}
        told: dict[str, Any] = {}
        for name, number in cls.variables.items():
            value = values.get(name)
            if value is None:
                continue
            for entry, (dims, array, attributes) in number.entries(value, tuple(lanes)):
                if number.alone and not dims:
                    told |= {entry: array.item(), **number.more}
                else:
                    data[entry] = (dims, array, attributes)
        whole = {**(attrs or {}), **told, "kind": cls.stored_as, "version": __version__}
        return cls(xr.Dataset({**data, **(more or {})}, dict(coords or {}), whole))

    @property
    def failed(self) -> int:
        """How many lanes are not OK."""
        return int(np.sum(self.status != Status.OK))

    @property
    def messages(self) -> list[str]:
        """What to do about lanes that are not OK: one line for each status that occurs."""
        return list(messages(self.status, self.chatter))

    @property
    def scene(self) -> str:
        """The scene as TOML in SI units; of many scenes the first, with what differs in the dataset."""
        return str(self.data.attrs.get("scene", ""))

    def lane(self, *at: int) -> Self:
        """One of many lanes, as a result of its own.

        Args:
            at: Its place along each leading axis.

        Raises:
            ValueError: There are not so many leading axes.
            IndexError: There is no such lane.
        """
        dims = self.data["status"].dims if "status" in self.data.variables else ()
        if len(at) != len(dims):
            raise InputError(f"This result has {len(dims)} leading axes, but {len(at)} numbers name a lane.")
        one = self.data.isel(dict(zip(dims, at, strict=True)))
        held = [e for v in self.variables.values() if v.alone for e in v.among(one) if not one[e].dims]
        told = {entry: one[entry].item() for entry in held}
        if "scene" in one.attrs:
            told["scene"] = text_of_one(one)
        return type(self)(one.drop_vars(held).assign_attrs(told))

    def to_xarray(self) -> "xr.Dataset":
        """The labelled dataset."""
        return self.data

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as NetCDF: whole or not at all.

        Raises:
            WriteError: The place cannot be written.
        """
        write_dataset(self.data, Path(path))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """A stored result of this class.

        Raises:
            StoreError: The file is missing, damaged, or holds another kind of result.
        """
        found = open(path)
        if not isinstance(found, cls):
            raise StoreError(f"{path}: holds a {type(found).__name__}, not a {cls.__name__}; open it with js.open")
        return found

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """The result as a picture.

        Args:
            ax: Draw the main panel alone, there.
            options: Of the picture.

        Raises:
            ValueError: There is no such picture.
        """
        raise InputError(f"There is no picture of a {type(self).__name__}.")

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {self.ended}; {self.method}, {self.steps_per_period} steps a period"

    @property
    def ended(self) -> str:
        """How many lanes ended how, in words."""
        return ", ".join(f"{n} {name}" for name, n in counted(self.status).items())

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.data._repr_html_()}"


def open(path: str | os.PathLike[str]) -> Result:
    """A result that was saved, by this version or an earlier one.

    Args:
        path: A file that `save` or a command has written.

    Raises:
        StoreError: The file is missing or damaged, or no result.
    """
    if Path(path).suffix == ".json":
        beside = Path(path).with_suffix(".nc")
        cure = f"open {beside}" if beside.exists() else "run the command again, which writes a .nc too"
        raise StoreError(f"{path}: holds plain numbers for other programs; {cure}")
    return opened(read(path), path)


def opened(data: "xr.Dataset", path: str | os.PathLike[str]) -> Result:
    """The result that a dataset holds; messages name its `path`.

    Raises:
        StoreError: It is no result.
    """
    kind = data.attrs.get("kind", _earlier_kind(data))
    if kind not in CLASSES:
        raise StoreError(f"{Path(path)}: not a result of jaxshroud; give a sweep or a trajectory")
    module, name = CLASSES[kind]
    found = getattr(import_module(f"jaxshroud.results.{module}"), name)
    if missing := [name for name in found.never_without if name not in data]:
        raise StoreError(f"{Path(path)}: lacks {', '.join(missing)}; run the command again")
    return found(data)


def _earlier_kind(data: "xr.Dataset") -> str | None:
    """What files are that were written before they said so."""
    if isinstance(data.attrs.get("axes"), str):
        return "sweep"
    return "trajectory" if "end_turns" in data.attrs else None
