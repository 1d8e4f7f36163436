"""The two blocks: where their corners and points of contact are, and how they lie."""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from jaxshroud.model.arithmetic import Pair, Scalar, Symbolic, is_zero, plus, sine_versine


class FacePoint(NamedTuple):
    """A point of contact of both faces."""

    place: Scalar  # up the face from its middle [m]
    share: Scalar  # of the stiffnesses of the interface


class Corners(NamedTuple):
    """The constants of the blocks: corners a and b of the left one about its centre, and the angle of the face."""

    a_x: Scalar
    b_x: Scalar
    h_y: Scalar  # a_y = h_y, b_y = -h_y
    sin_alpha: Scalar
    cos_alpha: Scalar
    gap: Scalar
    l_ab: Scalar  # from b to a, along the face
    points: tuple[FacePoint, ...] = ()  # of contact; none where a corner touches


class Pose(NamedTuple):
    """The positions of both blocks, with the sine, cosine and versine of their angles."""

    x: Pair
    y: Pair
    theta: Pair
    sin: Pair
    cos: Pair
    versine: Pair  # 1 - cos


def rotation(theta: Scalar) -> tuple[Scalar, Scalar]:
    """The sine and the versine of an angle."""
    return theta.sine_versine() if isinstance(theta, Symbolic) else sine_versine(theta)


def rounding_of_sum(terms: tuple[Scalar, ...]) -> Scalar:
    """Four roundings of every term of a sum."""
    size = reduce(plus, map(abs, terms))
    return size if is_zero(size) else 4 * float(jnp.finfo(size.dtype).eps) * size
