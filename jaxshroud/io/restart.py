"""The end of a stored run as the start of another run of the same model."""

import os
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np

from jaxshroud.io.store import read
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.scene.checks import SceneError, StoreError
from jaxshroud.scene.config import parse
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import ContactPart
from jaxshroud.scene.schema import PHYSICS_TABLES

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.model.blade import ModalMotion
    from jaxshroud.model.prepared import State

TOUCHING = (Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS)
FilePath = str | os.PathLike[str]


class StoredEnd(NamedTuple):
    """The end of a stored run."""

    state: "State | None"  # None: the scene's own start
    t: float  # [s]
    turns: float  # phase of the drive [turns]
    differences: tuple[str, ...]  # between its scene and the scene that continues it


def stored_end(path: FilePath, scene_file: SceneFile) -> StoredEnd:
    """The last state of a stored trajectory, as the start of a scene of the same model.

    Raises:
        StoreError: The file is not a trajectory or lacks something, its run stopped, its last state is not finite or
            not possible, or its model has other parts.
    """
    ds = read(path)
    if "end_turns" not in ds.attrs:
        _fail(path, "not a trajectory; give a file written by `jaxshroud simulate`")
    status, turns = (_finite_number(path, name, ds.attrs.get(name)) for name in ("status", "end_turns"))
    if status != Status.OK:
        name = Status(int(status)).name if status in set(Status) else f"status {status:g}"
        _fail(path, f"the run stopped ({name}); start from an earlier file")
    differences = _scene_changes(path, ds, scene_file)
    layout = scene_file.layout
    dims = ("time", "interface")[: 1 + len(layout.interface_shape)]
    shape = layout.interface_shape
    blades = ("time", "blade"), (layout.blades,)
    motion = Motion._make(_last_sample(path, ds, name, *blades) for name in Motion._fields)
    if scene_file.scene.mode_numbers is not None:
        motion = _modal_end(path, ds, (2, scene_file.scene.coordinates, layout.blades))
    case = _last_sample(path, ds, "case", dims, shape).astype(int)
    of_points = ""
    points = scene_file.scene.points
    if points:
        dims = (*dims, "point")
        shape = (*shape, points)
        of_points = "point_"
    mode = _last_sample(path, ds, f"{of_points}mode", dims, shape).astype(int)
    of_each = np.where(mode == Mode.APART, 0, 1) if points else case  # points have no cases
    for pair in zip(mode.flat, of_each.flat, strict=True):
        if not _is_possible(*pair, scene_file.scene.parts.contact):
            ends = "it ends in mode {} and case {}".format(*pair)
            _fail(path, f"{ends}, which this model has not; give a file that is not edited")
    u_s = np.zeros(shape)
    if np.any(mode != Mode.APART):
        sliders = _last_sample(path, ds, f"{of_points}u_s", dims, shape, mode != Mode.APART)
        u_s = np.where(mode == Mode.APART, 0.0, sliders)
    t = float(_last_sample(path, ds, "time", ("time",), ()))
    return StoredEnd(_state(motion, u_s, mode, case), t, turns, differences)


def _modal_end(path: FilePath, ds: "xr.Dataset", shape: tuple[int, ...]) -> "ModalMotion":
    """The coordinates of modes at the end, and their rates."""
    from jaxshroud.batch.lanes import modal_motion

    modal = ds["modal"].to_numpy() if "modal" in ds else np.empty(0)
    if modal.shape != shape or not np.isfinite(modal).all():
        _fail(path, f"its end has not the coordinates of {shape[1]} modes; give a file of the same model")
    return modal_motion(modal)


def _state(motion: "Motion | ModalMotion", u_s: np.ndarray, mode: np.ndarray, case: np.ndarray) -> "State":
    import jax
    import jax.numpy as jnp

    from jaxshroud.model.prepared import State

    return State(
        jax.tree.map(jnp.asarray, motion),
        jnp.asarray(u_s),
        jnp.asarray(mode, jnp.int32),
        jnp.asarray(case, jnp.int32),
    )


def _fail(path: FilePath, reason: str) -> NoReturn:
    raise StoreError(f"{path}: {reason}")


def _finite_number(path: FilePath, name: str, value: object) -> float:
    number = np.asarray(value)
    if number.ndim or not np.issubdtype(number.dtype, np.number) or not np.isfinite(number):
        _fail(path, f"its attribute {name} is no number; run the command again")
    return float(number)


def _last_sample(
    path: FilePath,
    ds: "xr.Dataset",
    name: str,
    dims: tuple[str, ...],
    shape: tuple[int, ...],
    counts: np.ndarray | bool = True,
) -> np.ndarray:
    """The last sample of a variable, which is finite where it `counts`."""
    if name not in ds or ds[name].dims != dims or ds[name].shape[1:] != shape or not ds[name].size:
        _fail(path, f"it lacks {name} over {' and '.join(dims)}; give a complete file of `jaxshroud simulate`")
    end = ds[name].to_numpy()[-1]
    if not np.issubdtype(end.dtype, np.number) or not np.isfinite(end[counts] if end.ndim else end).all():
        _fail(path, f"its last {name} is not finite; start from an earlier file")
    return np.asarray(end, np.float64)


def _is_possible(mode: int, case: int, contact: ContactPart) -> bool:
    """Whether a model with this kind of contact can be in that mode and case."""
    if contact == "smooth":
        return (mode, case) == (Mode.SMOOTH, 0)
    touching = contact != "none" and mode in TOUCHING and 1 <= case <= FLAT
    return touching or (mode, case) == (Mode.APART, 0)


def _scene_changes(path: FilePath, ds: "xr.Dataset", scene_file: SceneFile) -> tuple[str, ...]:
    """The numbers in which the given scene differs from that of the stored run, except for the initial motion."""
    try:
        stored = parse(str(ds.attrs.get("scene", "")), "its scene")
    except SceneError as error:
        _fail(path, f"{error}; give a file written by `jaxshroud simulate`")
    if stored.layout != scene_file.layout:
        change = f"it is of {stored.layout.text}, but this scene of {scene_file.layout.text}"
        _fail(path, f"{change}; give a file of the same model")
    for name, old, new in zip(stored.scene.parts._fields, stored.scene.parts, scene_file.scene.parts, strict=True):
        if old != new:
            change = f"its model has {name} = {_value_text(old)}, but this one {_value_text(new)}"
            _fail(path, f"{change}; give a file of the same model")
    names = ["row", "aero", *(table for table in PHYSICS_TABLES if table not in ("initial", "parts"))]
    tables = {name: (stored.tables.get(name, {}), scene_file.tables.get(name, {})) for name in names}
    return tuple(
        f"{table}.{key} was {_value_text(old)}, is {_value_text(new)}"
        for table, (before, now) in tables.items()
        for key in {**before, **now}
        if (old := before.get(key)) != (new := now.get(key))
    )


def _value_text(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value_text, value))}]"
    return "not given" if value is None else f"{value}"
