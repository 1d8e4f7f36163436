"""Sweeps in several directions as one result, with what they tell together: jumps and coexisting motions."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from jaxshroud.motion.hysteresis import Lane, differ, jumps
from jaxshroud.results.sweep import DIRECTION, SweepResult
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import WAYS

if TYPE_CHECKING:
    import xarray as xr

NO = 0  # verdict of `settling`: the transient is not over


def overlaid(found: Mapping[str, SweepResult]) -> SweepResult:
    """Results of sweeps along the same values as one, with a leading dimension `direction`."""
    import xarray as xr

    first = next(iter(found.values())).data
    lanes = set(first["status"].dims)
    common = {"gap", *(str(n) for n, a in first.data_vars.items() if "key" in a.attrs)}
    each = [str(n) for n, a in first.data_vars.items() if lanes <= set(a.dims) and n not in common]
    way = xr.DataArray(list(found), dims=DIRECTION, name=DIRECTION)
    parts = [result.data[each] for result in found.values()]
    data = first.drop_vars(each).merge(xr.concat(parts, dim=way, combine_attrs="override"))
    data.attrs = {**first.attrs, "complete": min(int(r.data.attrs["complete"]) for r in found.values())}
    return SweepResult(data if len(lanes) > 1 else _told(data))


def _told(data: "xr.Dataset") -> "xr.Dataset":
    """The sweeps along one number with their jumps and with where motions coexist."""
    sizes = [float(np.nanmax(np.abs(data[name].to_numpy()), initial=0.0)) or 1.0 for name in Motion._fields]
    rows = [_lanes(data.sel({DIRECTION: way}), sizes) for way in WAYS]
    coexist = [any(differ(a, b) for a, b in combinations(column, 2)) for column in zip(*rows, strict=True)]
    jumped = np.zeros((len(WAYS), len(coexist)), np.int8)
    for row, way in enumerate(WAYS):
        between = jumps(rows[row]) if len(coexist) > 1 and way != "independent" else np.zeros(len(coexist) - 1, bool)
        jumped[row, slice(None, -1) if way == "backward" else slice(1, None)] = between
    (dim,) = set(data["status"].dims) - {DIRECTION}
    words = {"long_name": "the motion jumps between this value and the one before it in the direction"}
    several = {"long_name": "motions from different directions differ: they coexist"}
    return data.assign(jump=((DIRECTION, dim), jumped, words), coexisting=((dim,), np.array(coexist, np.int8), several))


def _lanes(data: "xr.Dataset", sizes: Sequence[float]) -> list[Lane]:
    """The motions of one direction, in sizes of the largest of all."""
    order = data.transpose(*data["status"].dims, "period", "blade", ...)
    scaled = [order[name].to_numpy() / size for name, size in zip(Motion._fields, sizes, strict=True)]
    points = np.concatenate(scaled, axis=-1)
    numbers, settling = data["period_number"].to_numpy(), data["settling"].to_numpy()
    return [Lane(p, int(q), bool(v != NO)) for p, q, v in zip(points, numbers, settling, strict=True)]
