"""The geometry of faces that touch at several points."""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from jaxshroud.model.arithmetic import Pair, Scalar, where
from jaxshroud.model.blocks import Corners, FacePoint, Pose, rotation, rounding_of_sum
from jaxshroud.scene.keys import Motion


class PointKinematics(NamedTuple):
    """The kinematics of one of several points of a face."""

    v: Scalar  # penetration [m]
    u: Scalar  # slide of the left block against the right one [m]
    rounding: Scalar  # bound of the rounding errors of both
    reach: Scalar  # from the middle of the faces to the point, along their mean direction [m]


class FaceKinematics(NamedTuple):
    """The kinematics of faces of several points, as `ContactKinematics`; corners and offset are of their middles."""

    v: Scalar  # penetration of the deepest point
    u: Scalar  # slide of all points
    height: Scalar
    turn: Scalar
    normal: tuple[Scalar, Scalar]
    tangent: tuple[Scalar, Scalar]
    corner: Pair
    corner_y: Pair
    offset: tuple[Scalar, Scalar]
    rounding: Scalar
    turn_rounding: Scalar
    points: tuple[PointKinematics, ...]


def face_kinematics(q: Pose, block: Corners) -> FaceKinematics:
    """The penetrations and the slide of the points of two faces.

    A point at s on the left block's face, and its partner on the right block's, are at s t_0 from the middles of the
    faces in the axes of their blocks. Along the axes n and t that lean by the mean of both angles, the offset e of the
    partners is v = e.n = v_0 + 2 s sin((theta_1 - theta_2) / 2), and u = e.t is the same at all points.
    """
    half = (block.a_x + block.b_x) / 2
    dl_x, dl_y = -(half * q.versine[0]), -(half * q.sin[0])
    dr_x, dr_y = half * q.versine[1], half * q.sin[1]
    e_x = (q.x[0] - q.x[1]) + dl_x - dr_x - block.gap
    d_y = (q.y[0] - q.y[1]) + dl_y - dr_y
    mean, lean = rotation((q.theta[0] + q.theta[1]) / 2), rotation((q.theta[0] - q.theta[1]) / 2)
    sin_A = block.sin_alpha * (1 - mean[1]) - block.cos_alpha * mean[0]
    cos_A = block.cos_alpha * (1 - mean[1]) + block.sin_alpha * mean[0]
    v, u = e_x * sin_A - d_y * cos_A, e_x * cos_A + d_y * sin_A
    terms = (*q.x, *q.y, dl_x, dr_x, dl_y, dr_y, block.gap)

    def at(point: FacePoint) -> PointKinematics:
        opening, turned = 2 * (point.place * lean[0]), (point.place * theta for theta in q.theta)
        return PointKinematics(v + opening, u, rounding_of_sum((*terms, *turned)), point.place * (1 - lean[1]))

    points = tuple(map(at, block.points))
    deepest = reduce(jnp.maximum, (point.v for point in points))
    rounding = reduce(jnp.maximum, (point.rounding for point in points))
    return FaceKinematics(
        v=deepest,
        u=u,
        height=d_y,
        turn=q.theta[0] - q.theta[1],
        normal=(sin_A, -cos_A),
        tangent=(cos_A, sin_A),
        corner=(half + dl_x, dr_x - half),
        corner_y=(dl_y, dr_y),
        offset=(e_x, d_y),
        rounding=rounding,
        turn_rounding=rounding,
        points=points,
    )


class PointRates(NamedTuple):
    """The time derivatives of the scalars of `PointKinematics`."""

    v: Scalar
    u: Scalar


class FaceRates(NamedTuple):
    """The time derivatives of the scalars of `FaceKinematics`."""

    v: Scalar
    u: Scalar
    height: Scalar
    turn: Scalar
    points: tuple[PointRates, ...]


def face_rates(at: FaceKinematics, z: Motion, e_x: Scalar, d_y: Scalar) -> FaceRates:
    """`contact_rates` of faces of points whose middles move apart at (e_x, d_y)."""
    (w_1, w_2), (cos_A, sin_A), (x, y) = z.v_theta, at.tangent, at.offset
    w = (w_1 + w_2) / 2
    middle = e_x * sin_A - d_y * cos_A - w * at.u
    u = e_x * cos_A + d_y * sin_A + w * (x * sin_A - y * cos_A)
    points = tuple(PointRates(middle + (w_1 - w_2) * point.reach, u) for point in at.points)
    deepest = points[0].v
    for point, rate in zip(at.points[1:], points[1:], strict=True):
        deepest = where(point.v >= at.v, rate.v, deepest)
    return FaceRates(deepest, u, d_y, w_1 - w_2, points)
