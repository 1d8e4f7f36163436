"""The branches of a response within its dataset: the points of all members, under names of their own."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

BRANCH_PREFIX, MEMBER = "branch_", "member"
BRANCH_ENDS = "branch_ends"  # the attribute with the ends of each member's branches
BRANCH_KIND = "branch_kind"  # the attribute with the kind of the branches as results
BETWEEN_MEMBERS = " | "


def joined_points(branches: "Sequence[xr.Dataset | None]") -> "xr.Dataset":
    """The points of the branches of all members that have any, under names of their own."""
    import xarray as xr

    points = [
        data.assign({MEMBER: ("point", np.full(data.sizes["point"], i))})
        for i, data in enumerate(branches)
        if data is not None
    ]
    if not points:
        return xr.Dataset()
    turns = max(data.sizes["turn"] for data in points)
    joined = xr.concat(
        [data.pad(turn=(0, turns - data.sizes["turn"])) for data in points], "point", combine_attrs="drop"
    )
    return joined.rename({str(name): f"{BRANCH_PREFIX}{name}" for name in joined.data_vars})


def points_of_member(data: "xr.Dataset", member: int) -> "xr.Dataset | None":
    """The points of a member's branches as `Branch` holds them; None where it has none."""
    ends = str(data.attrs[BRANCH_ENDS]).split(BETWEEN_MEMBERS)[member]
    if not ends:
        return None
    names = {str(n): str(n).removeprefix(BRANCH_PREFIX) for n in data.data_vars if str(n).startswith(BRANCH_PREFIX)}
    points = data[[*names]].rename(names)
    own = points.isel(point=np.flatnonzero(points[MEMBER].to_numpy() == member)).drop_vars(MEMBER)
    return own.assign_attrs(data.attrs, ends=ends, kind=data.attrs.get(BRANCH_KIND, "branch"))
