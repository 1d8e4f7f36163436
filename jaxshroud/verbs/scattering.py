"""Numbers that scatter: their half widths, as users give them, and quasi-random draws of them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np

from jaxshroud.results.attractors import share_interval
from jaxshroud.results.tuned import HalfWidth
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.keys import ROW_KEYS, find_key, key_stem
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import is_number
from jaxshroud.scene.valid import check_values
from jaxshroud.scene.vary import value_of, with_numbers

Spread = float | str | tuple[float, float]  # half width [SI], or as a share such as "20%"; or lower and upper bound


class Scattering(NamedTuple):
    """Numbers that scatter uniformly about their values in a design or a condition, and draws of them."""

    keys: tuple[str, ...]
    half_width: np.ndarray  # (keys,) [SI], or over the number itself
    relative: np.ndarray  # (keys,) whether the half width is over the number itself
    places: np.ndarray  # (draws, keys) the draws, from -1 to 1 between the ends of the scatter
    others: Mapping[str, float] = {}  # numbers that are neither tuned nor conditions, with their values; never mutated

    @property
    def size(self) -> int:
        """The number of draws."""
        return len(self.places)

    def stretch(self, keys: Sequence[str]) -> np.ndarray:
        """Factors (draws, keys) by which relative scatter multiplies numbers."""
        factors = np.ones((self.size, len(keys)))
        factors[:, self._indices(keys)] += np.where(self.relative, self.half_width, 0.0) * self.places
        return factors

    def of(self, keys: Sequence[str], values: np.ndarray) -> np.ndarray:
        """The values (n, keys) at every draw, (n * draws, keys)."""
        shifts = np.zeros((self.size, len(keys)))
        shifts[:, self._indices(keys)] = np.where(self.relative, 0.0, self.half_width) * self.places
        return (values[:, None] * self.stretch(keys) + shifts).reshape(-1, len(keys))

    def ends(self, key: str, value: float) -> tuple[float, float]:
        """The smallest and the largest value that a number takes by its scatter."""
        i = self.keys.index(key)
        return HalfWidth(float(self.half_width[i]), bool(self.relative[i])).around(value)

    def at_ends(self) -> "Scattering":
        """Draws at the ends of the scatter: every combination, or one number at a time if there are many."""
        return self._replace(places=2 * cube_corners(len(self.keys), most=4) - 1)

    def redrawn(self, samples: int, random: np.random.Generator) -> "Scattering":
        """The same scatter with independent pseudo-random draws."""
        return self._replace(places=random.uniform(-1, 1, (samples, len(self.keys))))

    def _indices(self, keys: Sequence[str]) -> list[int]:
        return [list(keys).index(key) for key in self.keys]


def half_widths(scatters: Mapping[str, Spread]) -> dict[str, HalfWidth]:
    """The half widths of numbers that scatter about their values.

    Raises:
        InputError: A half width is not positive, a share is 100 % or more, or bounds are given.
    """
    widths = {}
    for key, spread in scatters.items():
        width = _half_width(key, spread)
        if width is None:
            raise InputError(
                f"{key} scatters about its value in a design; give a half width, such as 5e-6 or '20%', not {spread}."
            )
        widths[key] = width
    return widths


def _half_width(key: str, spread: Spread) -> HalfWidth | None:
    """The half width; None where bounds are given."""
    if isinstance(spread, str):
        try:
            size = float(spread.strip().removesuffix("%")) / 100
            relative = True
        except ValueError:
            raise InputError(f"{key} scatters by a number, or a share such as '20%', not {spread!r}.") from None
    elif is_number(spread):
        size = float(cast(float, spread))
        relative = False
    else:
        return None
    if not 0 < size < np.inf:
        raise InputError(f"{key} scatters by {spread}; give a positive half width.")
    if relative and size >= 1:
        raise InputError(f"{key} scatters by a share of it, which must be below 100 %, but is {spread}.")
    return HalfWidth(size, relative)


def scatter_bounds(scene: Scene, scatters: Mapping[str, Spread]) -> dict[str, tuple[float, float]]:
    """The bounds of numbers that scatter: those given, or the half width on either side of the scene's value.

    The mistuning of a row scatters for each blade by itself: draws of `row.mistuning` are patterns.

    Raises:
        KeyNameError: The scene has no such number.
        InputError: A half width is not positive, or a share of zero.
    """
    bounds = {}
    for key, spread in _by_blade(scatters, scene.layout).items():
        width = _half_width(key, spread)
        if width is None:
            low, high = np.asarray(spread, float).tolist()
            bounds[key] = low, high
            continue
        value = value_of(with_numbers(scene, [key]), key)
        if width.relative and value == 0:
            raise InputError(f"{key} is 0, and a share of 0 does not scatter; give its half width.")
        bounds[key] = width.around(value)
    return bounds


def scattering_of(scatters: Mapping[str, Spread], draws: int, seed: int, layout: Layout = PAIR) -> Scattering | None:
    """The scatter about a design, with quasi-random draws; None if no number scatters.

    Args:
        scatters: Keys with half widths, see `half_widths`.
        draws: The number of draws, rounded up to a power of 2.
        seed: Of the draws.
        layout: The layout of the scene; the mistuning of a row scatters for each blade by itself, in patterns.

    Raises:
        InputError: See `half_widths`.
    """
    count_argument("draws", draws, 1)
    widths = half_widths(_by_blade(scatters, layout))
    if not widths:
        return None
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(widths), rng=np.random.default_rng([seed, 1]))
    places = 2 * sobol.random_base2((draws - 1).bit_length()) - 1
    sizes, relative = (np.array(column) for column in zip(*widths.values(), strict=True))
    return Scattering(tuple(widths), sizes, relative, places)


def _by_blade(scatters: Mapping[str, Spread], layout: Layout) -> dict[str, Spread]:
    """The scatters with `row.mistuning` by a key for each blade."""

    def each(key):
        return [f"{key}[{i}]" for i in range(layout.blades)] if key in ROW_KEYS else [key]

    return {one: spread for key, spread in scatters.items() for one in each(key)}


def cube_corners(size: int, most: int = 8) -> np.ndarray:
    """Corners (n, size) of the unit cube: all, or above `most` dimensions the two extreme ones and their neighbours."""
    if size > most:
        return np.vstack([np.zeros(size), np.ones(size), np.eye(size), 1 - np.eye(size)])
    return np.stack(np.meshgrid(*[[0.0, 1.0]] * size, indexing="ij"), axis=-1).reshape(-1, size)


def check_overlap(scattering: Scattering, keys: Sequence[str]) -> None:
    """Raise an InputError where a number that scatters is part of another number with a different key."""
    all_keys = [*keys, *(key for key in scattering.keys if key not in keys)]
    for key in scattering.keys:
        for other in all_keys:
            stem = key_stem(key)
            if key != other and stem == key_stem(other) and stem in (key, other):
                raise InputError(f"{key} and {other} are partly the same number; name the blades' numbers one by one.")


def check_ends(keys: Sequence[str], values: np.ndarray, layout: Layout = PAIR) -> None:
    """Raise a SceneError where a number of `values` (n, keys) is out of its range at an end of its scatter."""
    for key, column in zip(keys, values.T, strict=True):
        check_values(find_key(key, layout=layout)[0], column, f"{key}, at an end of its scatter,")


def probability_values(P_d: np.ndarray, at_least: float) -> dict[str, float]:
    """The share of draws (draws,) with at least that P_d, and its interval; draws that stopped (NaN, -inf) miss it."""
    successes = np.array([np.sum(P_d >= at_least)])
    low, high = (float(end[0]) for end in share_interval(successes, P_d.size))
    share = float(successes[0] / P_d.size)
    return {"at_least": at_least, "probability": share, "probability_low": low, "probability_high": high}
