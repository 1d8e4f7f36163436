"""A number that was varied, as an axis of pictures."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxshroud.results.drawing import PLAIN, Floats, Look, quantity


class Axis(NamedTuple):
    """A sweep's parameter in the unit of the picture."""

    values: Floats
    edges: Floats  # borders of the cells around the values
    label: str


def axis_of(coordinate: xr.DataArray, look: Look = PLAIN) -> Axis:
    """A number of the scene in the unit of pictures."""
    key = str(coordinate.attrs.get("key", coordinate.name))
    label, factor = quantity(key, look, str(coordinate.attrs.get("units", "1")).removeprefix("1"))
    values = coordinate.to_numpy().astype(float) * factor
    return Axis(values, _edges(values), label)


def _edges(values: Floats) -> Floats:
    if values.size < 2:
        return values.sum() + np.array([-0.5, 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.array([2 * values[0] - middle[0], *middle, 2 * values[-1] - middle[-1]])
