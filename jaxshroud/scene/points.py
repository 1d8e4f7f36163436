"""The points of contact of a face, as numbers of a scene."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.point_numbers import (
    check_number_of_points,
    check_places,
    check_shares,
    evenly_spaced,
    place_entry,
    shares_of,
    trapezoidal_shares,
)


class ContactPoints(eqx.Module):
    """The points of contact of both faces of an interface, alike at all interfaces.

    Args:
        places: A number of points from 2 to 16, evenly spaced, ends of the face included; or the place of each, up the
            face from its middle [m].
        shares: The share of the stiffnesses k and k_d of each point; they sum to 1. Those of M evenly spaced points
            are by default 1 / (2 (M - 1)) at the ends, and twice that in between.

    Raises:
        InputError: There are too few or too many points, or shares are missing, negative or do not sum to 1.

    Source:
        The trapezoidal rule for a face of springs (Winkler's).
    """

    places: tuple[Float[Array, "..."], ...]  # as fractions of l_ab, or [m]
    shares: Float[Array, "... points"]
    scale_with_face: bool = eqx.field(static=True)  # whether places are fractions of l_ab

    def __init__(self, places: Any, shares: Any = None):
        self.scale_with_face = np.ndim(places) == 0
        own = evenly_spaced(places) if self.scale_with_face else places
        shares = shares_of(places, shares)
        check_number_of_points(len(own))
        if not is_traced(shares):
            check_shares(np.asarray(shares, float), len(own))
        self.places = tuple(jnp.asarray(place, float) for place in own)
        self.shares = jnp.asarray(shares, float)

    @property
    def number(self) -> int:
        """How many points there are."""
        return len(self.places)

    def lengths(self, l_ab: Any) -> Any:
        """The places of the points on a face of that length [m], one after another."""
        return tuple(place * l_ab for place in self.places) if self.scale_with_face else self.places

    def by_entry(self) -> dict[str, Any]:
        """The places [m] by their entries of the table [contact]; none where they scale with the face."""
        return {} if self.scale_with_face else {place_entry(m): place for m, place in enumerate(self.places)}

    def check_on(self, l_ab: Any) -> None:
        """Raise InputError unless the points, and their shares, are those of a face of that length [m]; traced pass."""
        if not is_traced(self.lengths(l_ab)):
            check_places(self.lengths(l_ab), l_ab)
        if not is_traced(self.shares):
            check_shares(np.asarray(self.shares), self.number)

    def as_given(self) -> dict[str, Any]:
        """The points of one scene as a file gives them, without the places of `by_entry`."""
        shares = np.asarray(self.shares)
        if not self.scale_with_face:
            return {"shares": shares.tolist()}
        usual = np.array_equal(shares, trapezoidal_shares(self.number))
        return {"points": self.number, **({} if usual else {"shares": shares.tolist()})}
