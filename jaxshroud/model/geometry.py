r"""The geometry of the two blocks: penetration and slide of the corner in contact (Sec. 2.3, Eqs. (3)-(20)).

The contact faces ab and cd lean to the right going up; y points up and theta is positive clockwise:

        d-----.   right block: c = -b, d = -a
         \     \
    .-----a    c--.
     \     b
      `----

In each case one corner (the tip) presses on the other block's face:

    case 1: a on cd    case 2: c on ab    (theta_1 > theta_2, upper corners a and c)
    case 3: b on cd    case 4: d on ab    (theta_1 <= theta_2, lower corners b and d)

Where contact at either corner would turn the blocks back, the faces stay parallel, flat on each other. The article does
not treat this limit of a relay; here it is case 5, `FLAT`, with the geometry of case 4.

Faces may have several points of contact instead, see `face_kinematics`; then there are no cases.
"""

from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.model.arithmetic import ZERO, Pair, Scalar, Symbolic, blended, is_zero, plus, sine_versine, where
from jaxshroud.model.series import rate_of
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.points import ContactPoints
from jaxshroud.scene.scene import Shroud


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


def corners(shroud: Shroud, reading: frozenset[str] = frozenset(), points: ContactPoints | None = None) -> Corners:
    """The corners of the blocks from their sides; the faces lean to the right going up.

    Source:
        The article prints neither varphi_1 nor varphi_2. With `corner_angles` in the `reading` they are interchanged,
        as for a block drawn leaning to the left: a and b exchange their distances from the centre, and the angle of the
        faces stays. Flat contact of such a block is only approximate, as its corners are not the ends of one face.
    """
    sin_alpha = jnp.sin(shroud.alpha)
    cos_alpha = jnp.cos(shroud.alpha)
    lean = shroud.l_ab * cos_alpha / 2
    far = shroud.l_oa / 2 + lean
    near = shroud.l_oa / 2 - lean
    h_y = shroud.l_ab * sin_alpha / 2
    if "corner_angles" in reading:
        along = shroud.l_ab * (sin_alpha**2 - cos_alpha**2)
        return Corners(near, far, h_y, sin_alpha, cos_alpha, shroud.gap, along)
    of_face = () if points is None else _face_points(points, shroud.l_ab)
    return Corners(far, near, h_y, sin_alpha, cos_alpha, shroud.gap, shroud.l_ab, of_face)


def _face_points(points: ContactPoints, l_ab: Scalar) -> tuple[FacePoint, ...]:
    places = points.lengths(l_ab)
    return tuple(FacePoint(places[m], points.shares[m]) for m in range(points.number))


def gyration(shroud: Shroud) -> Scalar:
    """The polar second moment of a block's area about its centroid per area, J_A / A [m^2]."""
    return gyration_of_sides(shroud.l_oa, shroud.l_ab)


def gyration_of_sides(l_oa: Any, l_ab: Any) -> Any:
    """`gyration` of blocks with these sides, of any shape of lanes."""
    return (l_oa**2 + l_ab**2) / 12


def pose(x: Pair, y: Pair, theta: Pair) -> Pose:
    """The pose of both blocks from their displacements."""
    (s_1, v_1), (s_2, v_2) = map(rotation, theta)
    return Pose(x, y, theta, (s_1, s_2), (1 - v_1, 1 - v_2), (v_1, v_2))


class CaseBlend(NamedTuple):
    """A mixture of the four cases, as smooth contact has it."""

    upper: Scalar  # share of cases 1 and 2
    left_tip: Scalar  # share of cases 1 and 3


Case = Int[Array, "..."] | CaseBlend


def is_upper(case: Case) -> Bool[Array, "..."] | Scalar:
    """Cases 1 and 2: the upper corners a and c meet."""
    return case.upper if isinstance(case, CaseBlend) else case <= 2


def tip_is_left(case: Case) -> Bool[Array, "..."] | Scalar:
    """Cases 1 and 3: a corner of the left block presses on the right block's face."""
    return case.left_tip if isinstance(case, CaseBlend) else (case == 1) | (case == 3)


class ContactKinematics(NamedTuple):
    """The kinematics of the corner pair of one case; lengths in m, angles in rad."""

    v: Scalar  # penetration, Eqs. (8), (12), (16), (19); contact when v >= 0
    u: Scalar  # slide of the left block against the right one
    height: Scalar  # r_ay - r_cy or r_by - r_dy: decides between tip left and tip right
    turn: Scalar  # theta_1 - theta_2: decides between upper and lower corners
    normal: tuple[Scalar, Scalar]  # n = (sin A, -cos A), A = alpha - theta of the face's block
    tangent: tuple[Scalar, Scalar]  # t = (cos A, sin A)
    corner: Pair  # x of the rotated corner of each block about its centre ...
    corner_y: Pair  # ... and y
    offset: tuple[Scalar, Scalar]  # (d_x - gap, d_y): from the right block's corner to the left one's
    sin_A2: Scalar  # sin(alpha - theta_2), which (20) prints for sin(alpha - theta_1)
    rounding: Scalar  # bound of the rounding errors of v, u and the height
    turn_rounding: Scalar  # bound of the rounding error of theta_1 - theta_2


class PointKinematics(NamedTuple):
    """The kinematics of one of several points of a face."""

    v: Scalar  # penetration [m]
    u: Scalar  # slide of the left block against the right one [m]
    rounding: Scalar  # bound of the rounding errors of both
    reach: Scalar  # from the middle of the faces to the point, along their mean direction [m]


class FaceKinematics(NamedTuple):
    """The kinematics of faces of several points, as `ContactKinematics`; corners and offset are of their middles."""

    u: Scalar  # slide of all points
    height: Scalar
    turn: Scalar
    normal: tuple[Scalar, Scalar]
    tangent: tuple[Scalar, Scalar]
    corner: Pair
    corner_y: Pair
    offset: tuple[Scalar, Scalar]
    points: tuple[PointKinematics, ...]

    @property
    def v(self) -> Scalar:
        """The penetration of the deepest point [m]."""
        return reduce(jnp.maximum, (point.v for point in self.points))

    @property
    def rounding(self) -> Scalar:
        """A bound of the rounding errors of all points [m]."""
        return reduce(jnp.maximum, (point.rounding for point in self.points))

    @property
    def turn_rounding(self) -> Scalar:
        """A bound of the rounding error of theta_1 - theta_2."""
        return self.rounding


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
    v = e_x * sin_A - d_y * cos_A
    u = e_x * cos_A + d_y * sin_A
    terms = (*q.x, *q.y, dl_x, dr_x, dl_y, dr_y, block.gap)

    def at(point: FacePoint) -> PointKinematics:
        opening = 2 * (point.place * lean[0])
        turned = (point.place * theta for theta in q.theta)
        return PointKinematics(v + opening, u, rounding_of_sum((*terms, *turned)), point.place * (1 - lean[1]))

    return FaceKinematics(
        u=u,
        height=d_y,
        turn=q.theta[0] - q.theta[1],
        normal=(sin_A, -cos_A),
        tangent=(cos_A, sin_A),
        corner=(half + dl_x, dr_x - half),
        corner_y=(dl_y, dr_y),
        offset=(e_x, d_y),
        points=tuple(map(at, block.points)),
    )


class PointRates(NamedTuple):
    """The time derivatives of the scalars of `PointKinematics`."""

    v: Scalar
    u: Scalar


class FaceRates(NamedTuple):
    """The time derivatives of the scalars of `FaceKinematics`."""

    v: Scalar  # of the deepest point; absent of series
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


Kinematics = ContactKinematics | FaceKinematics
AtPoint = Kinematics | PointKinematics  # of a corner, or of one of several points


def _corner_shift(px: Scalar, py: Scalar, s: Scalar, versine: Scalar) -> tuple[Scalar, Scalar]:
    """The displacement of a corner by a clockwise rotation, without cancellation of the much larger positions."""
    return py * s - px * versine, -px * s - py * versine


def contact_kinematics(q: Pose, case: Case, block: Corners, reading: frozenset[str]) -> Kinematics:
    """The penetration, the slide and the contact points while the `case` is fixed.

    Source:
        Eqs. (3)-(6) as exact rotations. The printed gap functions (7), (11), (15), (18) have `+ d_y cos A`, which
        contradicts the force directions of Eq. (1); it is kept under the misprint `gap_sign`.
    """
    if block.points:
        return face_kinematics(q, block)
    upper = is_upper(case)
    p_y = blended(upper, block.h_y, -block.h_y)
    left_x = blended(upper, block.a_x, block.b_x)
    right_x = -blended(upper, block.b_x, block.a_x)
    dl_x, dl_y = _corner_shift(left_x, p_y, q.sin[0], q.versine[0])
    dr_x, dr_y = _corner_shift(right_x, p_y, q.sin[1], q.versine[1])
    e_x = (q.x[0] - q.x[1]) + dl_x - dr_x - block.gap
    d_y = (q.y[0] - q.y[1]) + dl_y - dr_y
    terms = (*q.x, *q.y, dl_x, dr_x, dl_y, dr_y, block.gap)

    left_tip = tip_is_left(case)
    s_f, c_f = blended(left_tip, q.sin[1], q.sin[0]), blended(left_tip, q.cos[1], q.cos[0])
    sin_A = block.sin_alpha * c_f - block.cos_alpha * s_f
    cos_A = block.cos_alpha * c_f + block.sin_alpha * s_f
    lean = -d_y if "gap_sign" in reading else d_y
    return ContactKinematics(
        v=e_x * sin_A - lean * cos_A,
        u=e_x * cos_A + lean * sin_A,
        height=d_y,
        turn=q.theta[0] - q.theta[1],
        normal=(sin_A, -cos_A),
        tangent=(cos_A, sin_A),
        corner=(left_x + dl_x, right_x + dr_x),
        corner_y=(p_y + dl_y, p_y + dr_y),
        offset=(e_x, d_y),
        sin_A2=block.sin_alpha * q.cos[1] - block.cos_alpha * q.sin[1],
        rounding=rounding_of_sum(terms),
        turn_rounding=rounding_of_sum(q.theta),
    )


class ContactRates(NamedTuple):
    """The time derivatives of the scalars of `ContactKinematics`."""

    v: Scalar
    u: Scalar
    height: Scalar
    turn: Scalar


Rates = ContactRates | FaceRates
RatesAtPoint = Rates | PointRates


def contact_rates(at: Kinematics, z: Motion, case: Case, reading: frozenset[str]) -> Rates:
    """The time derivatives of the scalars of `at` along the motion while the case is fixed.

    The offset e moves with the corners' velocities, and the axes n, t turn with the face: A' = -theta_f'. Hence
    v' = e'.n - theta_f' u and u' = e'.t + theta_f' v. Those of faces of points turn with the mean of both blocks.
    """
    if isinstance(at, FaceKinematics) and isinstance(at.u, Symbolic):
        u = rate_of(at.u)
        points = tuple(PointRates(rate_of(point.v), u) for point in at.points)
        return FaceRates(v=ZERO, u=u, height=rate_of(at.height), turn=rate_of(at.turn), points=points)
    if isinstance(at.v, Symbolic):
        return ContactRates(rate_of(at.v), rate_of(at.u), rate_of(at.height), rate_of(at.turn))
    (l_x, r_x), (l_y, r_y) = at.corner, at.corner_y
    w = z.v_theta
    e_x = (z.v_x[0] - z.v_x[1]) + w[0] * l_y - w[1] * r_y
    d_y = (z.v_y[0] - z.v_y[1]) - w[0] * l_x + w[1] * r_x
    sin_A, cos_A = at.tangent[1], at.tangent[0]
    lean = -d_y if "gap_sign" in reading else d_y
    if isinstance(at, FaceKinematics):
        return face_rates(at, z, e_x, d_y)
    w_face = blended(tip_is_left(case), w[1], w[0])
    return ContactRates(
        v=e_x * sin_A - lean * cos_A - w_face * at.u,
        u=e_x * cos_A + lean * sin_A + w_face * at.v,
        height=d_y,
        turn=w[0] - w[1],
    )


def blended_case(q: Pose, block: Corners, width: Scalar) -> CaseBlend:
    """The mixture of the cases by the distances of the corners from the case boundaries, over a `width`.

    Near theta_1 = theta_2 the point of contact moves along the face from corner to corner.
    """
    upper = _smooth_step((q.theta[0] - q.theta[1]) * block.l_ab, width)
    higher = _smooth_step(
        contact_kinematics(q, CaseBlend(upper, jnp.full_like(upper, 0.5)), block, frozenset()).height, width
    )
    return CaseBlend(upper, upper + higher - 2 * upper * higher)


def _smooth_step(x: Scalar, width: Scalar) -> Scalar:
    return (1 + x / jnp.sqrt(x * x + width * width)) / 2


def natural_case(q: Pose, block: Corners) -> Int[Array, ""]:
    """The case that Sec. 2.3 assigns to a position: 1-4 from the signs of theta_1 - theta_2 and of the height."""
    upper = q.theta[0] - q.theta[1] > 0
    return corner_case(upper, contact_kinematics(q, where(upper, 1, 3), block, frozenset()).height)


def corner_case(upper: Bool[Array, ""], height: Scalar) -> Int[Array, ""]:
    """The case of the upper or the lower corners at a height difference."""
    left_tip = where(upper, height < 0, height > 0)
    return where(upper, where(left_tip, 1, 2), where(left_tip, 3, 4)).astype(jnp.int32)
