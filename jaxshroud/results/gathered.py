"""Results of many lanes from those of each, and kinds of numbers that NetCDF has not."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.variable import Entry, Variable

if TYPE_CHECKING:
    import xarray as xr


class Flags(Variable):
    """Words that are true of a lane: a tuple for a single scene, an array of tuples for many."""

    def __init__(self, long_name: str, words: Sequence[str], dim: str):
        super().__init__(long_name, dims=(dim,), more={"flag_meanings": ", ".join(words)})
        self.words = words

    def entries(self, values: Any, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """For each word whether it is true."""
        raised = lambda flags: [word in flags for word in self.words]  # noqa: E731
        told = np.array([raised(flags) for flags in (values.ravel() if lanes else [values])], np.int8)
        shape = (*(values.shape if lanes else ()), len(self.words))
        yield self.name, ((*lanes, *self.dims), told.reshape(shape), self.attributes)

    def read(self, data: "xr.Dataset") -> Any:
        """The words that are true."""
        raised = data[self.name].to_numpy().astype(bool)
        told = [
            tuple(w for w, up in zip(self.words, row, strict=True) if up) for row in raised.reshape(-1, len(self.words))
        ]
        return in_shape(told, raised.shape[:-1])


class Complex(Variable):
    """Complex numbers: a variable for the real parts and one for the imaginary parts."""

    def entries(self, values: Any, lanes: tuple[str, ...]) -> Iterator[Entry]:
        """Both parts."""
        for part in ("real", "imag"):
            told = {**self.attributes, "long_name": f"{self.attributes['long_name']}: {part} part"}
            yield f"{self.name}_{part}", ((*lanes, *self.dims), getattr(np.asarray(values), part), told)

    def read(self, data: "xr.Dataset") -> Any:
        """The numbers that a dataset holds, None where it has none."""
        if f"{self.name}_real" not in data.variables:
            return None
        return data[f"{self.name}_real"].to_numpy() + 1j * data[f"{self.name}_imag"].to_numpy()


def in_shape(values: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Values of lanes (arrays, named tuples of these, or tuples of words) as arrays that start with `shape`.

    A single scene, of shape (), has its only value as it is.
    """
    first = values[0]
    if not shape:
        return first
    if hasattr(first, "_fields"):
        return type(first)(*(in_shape(field, shape) for field in zip(*values, strict=True)))
    if isinstance(first, tuple):
        told = np.empty(len(values), object)
        for lane, value in enumerate(values):
            told[lane] = value
        return told.reshape(shape)
    return np.stack([np.asarray(value) for value in values]).reshape(*shape, *np.shape(first))


def taken(tree: Any, lane: tuple[int, ...]) -> Any:
    """One lane of a tree of arrays."""
    import jax

    return jax.tree.map(lambda a: np.asarray(a)[lane], tree)


def picked(tree: Any, lane: tuple[int, ...]) -> Any:
    """One lane of a tree of arrays, as JAX arrays."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(jnp.asarray, taken(tree, lane))


def lanes_in_words(lanes: Any, failed: int) -> str:
    """How many lanes there are and how many of them failed."""
    told = f"{' x '.join(map(str, np.shape(lanes)))} lanes"
    return f"{told}, {failed} failed" if failed else told
