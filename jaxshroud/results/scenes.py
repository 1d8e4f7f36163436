"""The scenes of a result: what differs between them as labelled numbers, and the scenes made from these again."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.dimension import about, dimension

if TYPE_CHECKING:
    import xarray as xr

    from jaxshroud.scene.checks import Precision
    from jaxshroud.scene.scene import Scene


def differing(scenes: "Scene", shape: tuple[int, ...], lanes: tuple[str, ...]) -> dict[str, Any]:
    """Numbers that are not the same in all scenes (leading axes of that `shape`), as xarray takes variables."""
    from jaxshroud.scene.text import numbers_of

    told = {}
    for key, values in numbers_of(scenes).items() if shape else ():
        if np.any(values != values[(0,) * len(shape)]):
            dims = (*lanes, "blade") if values.ndim > len(shape) else lanes
            told[dimension(key)] = (dims, values, about(key))
    return told


def scenes_of(data: "xr.Dataset", shape: tuple[int, ...], precision: "Precision") -> "Scene":
    """The scenes (leading axes of that `shape`) that a dataset tells of by its first and by what differs."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from jaxshroud.scene.config import parse
    from jaxshroud.scene.precision import in_precision

    first = in_precision(parse(data.attrs["scene"], "the scene of this result").scene, precision)
    scenes = jax.tree.map(lambda a: jnp.broadcast_to(a, (*shape, *a.shape)), first)
    for variable in data.variables.values():
        if "key" in variable.attrs:
            table, name = variable.attrs["key"].split(".")
            place = lambda s, table=table, name=name: getattr(getattr(s, table), name)  # noqa: E731
            scenes = eqx.tree_at(place, scenes, jnp.asarray(variable.to_numpy(), precision))
    return scenes
