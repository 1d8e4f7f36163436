"""Numbers that scatter about what a design has."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.keys import found
from jaxshroud.scene.valid import check_values


class Scattering(NamedTuple):
    """Numbers that scatter uniformly about what a design or a condition has, and draws that stand for them."""

    keys: tuple[str, ...]
    half_width: np.ndarray  # (keys,) [SI], or over the number itself
    relative: np.ndarray  # (keys,) whether it is over the number itself
    places: np.ndarray  # (draws, keys) of the draws, between -1 and 1
    others: Mapping[str, float] = {}  # those that are neither tuned nor conditions, with their values; never changed

    @property
    def size(self) -> int:
        """How many draws."""
        return len(self.places)

    def stretch(self, keys: Sequence[str]) -> np.ndarray:
        """Factors (draws, keys) of numbers."""
        factors = np.ones((self.size, len(keys)))
        factors[:, self._at(keys)] += np.where(self.relative, self.half_width, 0.0) * self.places
        return factors

    def of(self, keys: Sequence[str], values: np.ndarray) -> np.ndarray:
        """Values (n, keys) at every draw, (n * draws, keys)."""
        moved = np.zeros((self.size, len(keys)))
        moved[:, self._at(keys)] = np.where(self.relative, 0.0, self.half_width) * self.places
        return (values[:, None] * self.stretch(keys) + moved).reshape(-1, len(keys))

    def ends(self, key: str, value: float) -> tuple[float, float]:
        """The least and the largest that a number becomes by its scatter."""
        i = self.keys.index(key)
        by = float(self.half_width[i]) * (abs(value) if self.relative[i] else 1.0)
        return value - by, value + by

    def at_ends(self) -> "Scattering":
        """Draws at the ends of the scatter: every combination, or one by one where these are many."""
        return self._replace(places=2 * cube_corners(len(self.keys), most=4) - 1)

    def again(self, samples: int, random: np.random.Generator) -> "Scattering":
        """Other draws, independent of one another."""
        return self._replace(places=random.uniform(-1, 1, (samples, len(self.keys))))

    def _at(self, keys: Sequence[str]) -> list[int]:
        return [list(keys).index(key) for key in self.keys]


def scattering_of(
    tolerance: Mapping[str, float], spread: Mapping[str, float], draws: int, seed: int
) -> Scattering | None:
    """What scatters, with quasi-random draws; None if nothing does.

    Args:
        tolerance: Keys with half widths in SI units.
        spread: Keys with half widths over the number itself.
        draws: How many; made a power of 2.
        seed: Of the draws.

    Raises:
        InputError: A half width is not positive, a share is 1 or more, or a key is in both.
    """
    both = set(tolerance) & set(spread)
    if both:
        raise InputError(f"{sorted(both)[0]} has both a tolerance and a spread; give one of them.")
    for key, by in {**tolerance, **spread}.items():
        if not 0 < by < np.inf:
            raise InputError(f"{key} scatters by {by}; give a positive half width.")
    for key, share in spread.items():
        if share >= 1:
            raise InputError(f"The spread of {key} is a share of it, such as 0.2 for 20 %, but is {share}.")
    count_argument("draws", draws, 1)
    keys = (*tolerance, *spread)
    if not keys:
        return None
    sobol = qmc.Sobol(len(keys), rng=np.random.default_rng([seed, 1]))
    places = 2 * sobol.random_base2((draws - 1).bit_length()) - 1
    relative = np.array([key in spread for key in keys])
    return Scattering(keys, np.array([*tolerance.values(), *spread.values()], float), relative, places)


def cube_corners(size: int, most: int = 8) -> np.ndarray:
    """Corners of the unit cube (n, size): all, or one by one where there are more than `most` sides."""
    if size > most:
        return np.vstack([np.zeros(size), np.ones(size), np.eye(size), 1 - np.eye(size)])
    return np.stack(np.meshgrid(*[[0.0, 1.0]] * size, indexing="ij"), axis=-1).reshape(-1, size)


def check_told_apart(scattering: Scattering, known: Sequence[str]) -> None:
    """Raise InputError where a number that scatters is part of another one that is known by a different key."""
    keys = [*known, *(key for key in scattering.keys if key not in known)]
    for key in scattering.keys:
        for other in keys:
            if key != other and key.partition("[")[0] == other.partition("[")[0] and not ("[" in key and "[" in other):
                raise InputError(f"{key} and {other} are partly the same number; name the blades' numbers one by one.")


def check_ends(keys: Sequence[str], values: np.ndarray) -> None:
    """Raise SceneError where a number is out of its range at an end of the scatter; `values` (n, keys)."""
    for key, column in zip(keys, values.T, strict=True):
        check_values(found(key)[0], column, f"{key}, at an end of its scatter,")
