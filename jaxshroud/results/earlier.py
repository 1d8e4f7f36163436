"""Where a stored run ended, as a start for another run of the same model."""

import os
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.results.store import read
from jaxshroud.scene.config import parse
from jaxshroud.scene.errors import SceneError, StoreError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import ContactLaw
from jaxshroud.scene.schema import PHYSICS

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.model.state import State

TOUCHING = (Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS)


class Earlier(NamedTuple):
    """The end of a stored run."""

    state: "State | None"  # None: the scene's own start
    t: float  # [s]
    turns: float  # phase of the drive [turns]
    differences: tuple[str, ...]  # between its scene and the one that goes on from it


def last_state(path: str | os.PathLike[str], scene_file: SceneFile) -> Earlier:
    """The last state of a stored trajectory, as a start for a scene of the same model.

    Raises:
        StoreError: The file is no trajectory, it lacks something, its run had stopped, its last state is not finite or
            not possible, or its model has other parts.
    """
    ds = read(path)
    if "end_turns" not in ds.attrs:
        _fail(path, "not a trajectory; give a file written by `jaxshroud simulate`")
    status, turns = (_number(path, name, ds.attrs.get(name)) for name in ("status", "end_turns"))
    if status != Status.OK:
        name = Status(int(status)).name if status in set(Status) else f"status {status:g}"
        _fail(path, f"the run stopped ({name}); start from an earlier file")
    differences = _differences(path, ds, scene_file)
    motion = Motion(*(_finite(path, ds, name, ("time", "blade"), (2,)) for name in Motion._fields))
    mode, case = (int(_finite(path, ds, name, ("time",), ())) for name in ("mode", "case"))
    if not _possible(mode, case, scene_file.scene.parts.contact):
        _fail(path, f"it ends in mode {mode} and case {case}, which this model has not; give a file that is not edited")
    u_s = np.zeros(()) if mode == Mode.APART else _finite(path, ds, "u_s", ("time",), ())
    t = float(_finite(path, ds, "time", ("time",), ()))
    return Earlier(_state(motion, u_s, mode, case), t, turns, differences)


def _state(motion: Motion, u_s: np.ndarray, mode: int, case: int) -> "State":
    import jax.numpy as jnp

    from jaxshroud.model.state import State

    return State(Motion(*map(jnp.asarray, motion)), jnp.asarray(u_s), jnp.int32(mode), jnp.int32(case))


def _fail(path: Any, what: str) -> NoReturn:
    raise StoreError(f"{path}: {what}")


def _number(path: Any, name: str, value: Any) -> float:
    if np.ndim(value) or not np.issubdtype(np.asarray(value).dtype, np.number) or not np.isfinite(value):
        _fail(path, f"its attribute {name} is no number; run the command again")
    return float(value)


def _finite(path: Any, ds: "xr.Dataset", name: str, dims: tuple[str, ...], shape: tuple[int, ...]) -> np.ndarray:
    """The last sample of a variable."""
    if name not in ds or ds[name].dims != dims or ds[name].shape[1:] != shape or not ds[name].size:
        _fail(path, f"it lacks {name} over {' and '.join(dims)}; give a complete file of `jaxshroud simulate`")
    end = ds[name].to_numpy()[-1]
    if not np.issubdtype(end.dtype, np.number) or not np.isfinite(end).all():
        _fail(path, f"its last {name} is not finite; start from an earlier file")
    return np.asarray(end, np.float64)


def _possible(mode: int, case: int, contact: ContactLaw) -> bool:
    """Whether a model with such a contact can be in that state."""
    if contact == "smooth":
        return (mode, case) == (Mode.SMOOTH, 0)
    touching = contact == "spring" and mode in TOUCHING and 1 <= case <= FLAT
    return touching or (mode, case) == (Mode.APART, 0)


def _differences(path: Any, ds: "xr.Dataset", scene_file: SceneFile) -> tuple[str, ...]:
    """What the stored run's scene has that is not so in the given one, but for the initial motion."""
    try:
        then = parse(str(ds.attrs.get("scene", "")), "its scene")
    except SceneError as error:
        _fail(path, f"{error}; give a file written by `jaxshroud simulate`")
    for name, old, new in zip(then.scene.parts._fields, then.scene.parts, scene_file.scene.parts, strict=True):
        if old != new:
            _fail(
                path, f"its model has {name} = {_shown(old)}, but this one {_shown(new)}; give a file of the same model"
            )
    tables = [table for table in PHYSICS if table not in ("initial", "parts")]
    return tuple(
        f"{table}.{key} was {_shown(was)}, is {_shown(now)}"
        for table in tables
        for key in {**then.tables[table], **scene_file.tables[table]}
        if (was := then.tables[table].get(key)) != (now := scene_file.tables[table].get(key))
    )


def _shown(value: Any) -> str:
    listed = isinstance(value, list | tuple)
    return f"[{', '.join(map(_shown, value))}]" if listed else "not given" if value is None else f"{value}"
