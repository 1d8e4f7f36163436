"""Sweeps in several directions as one result, with what they tell together: jumps and coexisting motions."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.model.modes import Status
from jaxshroud.motion.hysteresis import AROUND, Lane, differ, jumps
from jaxshroud.results.sweep import DIRECTION, SweepResult
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import WAYS, Direction

if TYPE_CHECKING:
    import xarray as xr

AT_ONCE = 4096  # values whose samples are held
NO = 0  # verdict of `settling`: the transient is not over


def overlaid(found: Mapping[str, SweepResult]) -> SweepResult:
    """Results of sweeps along the same values as one, with a leading dimension `direction`.

    Directions that are missing have not been run.
    """
    import xarray as xr

    first = next(iter(found.values())).data
    each = _each(first)
    way = xr.DataArray(list(WAYS), dims=DIRECTION, name=DIRECTION)
    parts = [found[way].data[each] if way in found else _not_run(first[each]) for way in WAYS]
    data = first.drop_vars(each).merge(xr.concat(parts, dim=way, combine_attrs="override"))
    complete = len(found) == len(WAYS) and all(result.complete for result in found.values())
    data.attrs = {**first.attrs, "complete": int(complete)}
    chatter = next((result.chatter for result in found.values() if result.chatter), None)
    if chatter is not None:
        data.attrs["chatter"] = chatter
    return SweepResult(data.assign(compared(data)) if complete else data)


def _not_run(like: "xr.Dataset") -> "xr.Dataset":
    """As many lanes, none of which has run."""
    import xarray as xr

    fill = {str(name): np.nan if a.dtype.kind == "f" else 0 for name, a in like.data_vars.items()}
    return like.map(lambda a: xr.full_like(a, {**fill, "status": Status.NOT_RUN}[str(a.name)]))


def in_direction(data: "xr.Dataset", way: Direction) -> "xr.Dataset":
    """The result of one direction as a part of `overlaid`."""
    return data.assign({name: data[name].expand_dims({DIRECTION: [way]}) for name in _each(data)})


def _each(data: "xr.Dataset") -> list[str]:
    """Names of what each direction has its own of."""
    lanes = set(data["status"].dims)
    common = {"gap", *(str(n) for n, a in data.data_vars.items() if "key" in a.attrs)}
    return [str(n) for n, a in data.data_vars.items() if lanes <= set(a.dims) and n not in common]


def compared(data: "xr.Dataset") -> "dict[str, xr.Variable]":
    """What sweeps along one number in all directions tell together: where motions jump, and where they coexist."""
    import xarray as xr

    dims = data["status"].dims
    if DIRECTION not in dims or len(dims) > 2 or not set(Motion._fields) <= set(data):
        return {}
    (dim,) = set(dims) - {DIRECTION}
    n = data.sizes[dim]
    windows = [(first, min(first + AT_ONCE, n)) for first in range(0, n, AT_ONCE)]
    parts = [data.isel({dim: slice(*window)}) for window in windows]
    sizes = [max(_size(part[name]) for part in parts) or 1.0 for name in Motion._fields]
    jumped, coexist = np.zeros((len(WAYS), n), np.int8), np.zeros(n, np.int8)
    for first, last in windows:
        before, after = min(first, AROUND), min(n - last, AROUND + 1)  # neighbours that tell what a usual step is
        around = data.isel({dim: slice(first - before, last + after)})
        rows = [_lanes(around.sel({DIRECTION: way}), sizes) for way in WAYS]
        columns = list(zip(*rows, strict=True))[before : before + last - first]
        coexist[first:last] = [any(differ(a, b) for a, b in combinations(column, 2)) for column in columns]
        for row, way in enumerate(WAYS):
            if way != "independent":
                between = jumps(rows[row])[before : before + last - first]  # each value and the next
                place = first + (way == "forward")
                jumped[row, place : place + len(between)] = between
    words = {"long_name": "the motion jumps between this value and the one before it in the direction"}
    several = {"long_name": "motions from different directions differ: they coexist"}
    return {
        "jump": xr.Variable((DIRECTION, dim), jumped, words),
        "coexisting": xr.Variable((dim,), coexist, several),
    }


def _size(part: "xr.DataArray") -> float:
    """The largest magnitude."""
    return float(np.nanmax(np.abs(part.to_numpy()), initial=0.0))


def _lanes(data: "xr.Dataset", sizes: Sequence[float]) -> list[Lane]:
    """The motions of one direction, in sizes of the largest of all."""
    order = data.transpose(*data["status"].dims, "period", "blade", ...)
    scaled = [order[name].to_numpy() / size for name, size in zip(Motion._fields, sizes, strict=True)]
    points = np.concatenate(scaled, axis=-1)
    numbers, settling = data["period_number"].to_numpy(), data["settling"].to_numpy()
    return [Lane(p, int(q), bool(v != NO)) for p, q, v in zip(points, numbers, settling, strict=True)]
