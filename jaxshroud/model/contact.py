"""The contact forces and moments on both blocks (Sec. 2.3, Eqs. (8)-(20))."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.model.arithmetic import Pair, Scalar, blended, where
from jaxshroud.model.geometry import Case, ContactKinematics, Corners, FaceKinematics, is_upper, tip_is_left
from jaxshroud.model.modes import FLAT


class Load(NamedTuple):
    """The load on the blocks: the force on the left one (the right one feels the opposite) and both moments."""

    R_x: Scalar  # [N]
    R_y: Scalar  # [N]
    M: Pair  # clockwise, about each block's centre [N m]


def _cross_product(lever: tuple[Scalar, Scalar], force: tuple[Scalar, Scalar]) -> Scalar:
    return lever[1] * force[0] - lever[0] * force[1]


def _lever_arms(at: ContactKinematics, left_tip) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    """The lever arms from each block's centre to the penetrating corner, the same point in space for both."""
    (l_x, r_x), (l_y, r_y), (e_x, e_y) = at.corner, at.corner_y, at.offset
    left = blended(left_tip, l_x, l_x - e_x), blended(left_tip, l_y, l_y - e_y)
    right = blended(left_tip, r_x + e_x, r_x), blended(left_tip, r_y + e_y, r_y)
    return left, right


def contact_load(
    at: ContactKinematics, N: Scalar, F: Scalar, case: Case, block: Corners, reading: frozenset[str]
) -> Load:
    """The forces and moments of the normal force `N` and the friction force `F` at the corner of `case`.

    Source:
        The left block feels `-N n - F t` at the penetrating corner, the right one the opposite. Printed formulas that
        depart from this are kept in `_printed_moments` and under `friction_components`, which has
        `f_x = F sin A, f_y = F cos A` in Eqs. (8) and (13).
    """
    (n_x, n_y), (t_x, t_y) = at.normal, at.tangent
    left_tip = tip_is_left(case)
    left, right = _lever_arms(at, left_tip)
    # Moments per unit force, which keeps the misprints apart: of N and of F, on the left and on the right block.
    normal = (-_cross_product(left, at.normal), _cross_product(right, at.normal))
    friction = (-_cross_product(left, at.tangent), _cross_product(right, at.tangent))
    if reading:
        printed = _printed_moments(normal, friction, at, case, block, reading)
        normal, friction = jax.tree.map(lambda a, b: where(case == FLAT, a, b), (normal, friction), printed)
    f_x, f_y = (t_y, t_x) if "friction_components" in reading else (t_x, t_y)
    M = (N * normal[0] + F * friction[0], N * normal[1] + F * friction[1])
    return Load(-N * n_x - F * f_x, -N * n_y - F * f_y, M)


def middle_load(at: FaceKinematics, N: Scalar, F: Scalar, couple: Scalar) -> Load:
    """The load of faces of points under forces whose sums are `N` and `F`, each at the middle between two partners.

    `couple` is the sum of the normal forces times the reach of their points [N m].
    """
    (n_x, n_y), (t_x, t_y) = at.normal, at.tangent
    (l_x, r_x), (l_y, r_y), (e_x, e_y) = at.corner, at.corner_y, at.offset
    R = -N * n_x - F * t_x, -N * n_y - F * t_y
    left, right = (l_x - e_x / 2, l_y - e_y / 2), (r_x + e_x / 2, r_y + e_y / 2)
    return Load(R[0], R[1], (_cross_product(left, R) - couple, couple - _cross_product(right, R)))


def sprung_load(at: ContactKinematics, k: Scalar, N: Scalar, F: Scalar, case: Case, block: Corners) -> Load:
    """The same load in the consistent reading, where N = k v, with 5 products instead of 16, which matters for series.

    The offset is e = u t + v n, so that -N n - F t = -G t - k e with G = F - k u. In axes along the face, where the
    face's own corner is at rest, the moment on its block is that of the force at this corner, less v G.
    """
    left_tip = tip_is_left(case)
    e_x, e_y = at.offset
    t_x, t_y = at.tangent
    G = F - k * at.u
    R_x, R_y = -(G * t_x) - k * e_x, -(G * t_y) - k * e_y
    (l_x, r_x), (l_y, r_y) = at.corner, at.corner_y
    tip = _cross_product((where(left_tip, l_x, -r_x), where(left_tip, l_y, -r_y)), (R_x, R_y))
    upper = is_upper(case)
    x = where(left_tip, -where(upper, block.b_x, block.a_x), -where(upper, block.a_x, block.b_x))
    y = where(left_tip == upper, block.h_y, -block.h_y)
    along = x * block.cos_alpha + y * block.sin_alpha
    across = x * block.sin_alpha - y * block.cos_alpha
    face = along * N - across * F - G * at.v
    return Load(R_x, R_y, (where(left_tip, tip, face), where(left_tip, face, tip)))


def _printed_moments(normal, friction, at: ContactKinematics, case, block: Corners, reading: frozenset[str]):
    """The moments per unit N and unit F with each misprint of the `reading` restored.

    Only the moment about the face's own block is misprinted: M_N2 in cases 1 and 3, M_N1 in cases 2 and 4; except
    for the sign of M_N1 in (21). Flat contact is not in the article.
    """
    left_tip = tip_is_left(case)
    height = at.height
    sin_A = at.normal[0]
    across_a = block.a_x * block.sin_alpha - block.h_y * block.cos_alpha  # l_ap sin(alpha - varphi_1) / 2
    if "levers" in reading:  # the lever ends at the corner's *height* on the face, and friction's is constant
        along_a = block.a_x * block.cos_alpha + block.h_y * block.sin_alpha  # l_ap cos(alpha - varphi_1) / 2
        along_b = block.b_x * block.cos_alpha - block.h_y * block.sin_alpha  # l_cg cos(alpha + varphi_2) / 2
        N_face = height / sin_A - where((case == 1) | (case == 4), along_b, along_a)
        F_face = across_a
    else:
        N_face = where(left_tip, normal[1], normal[0])
        F_face = where(left_tip, friction[1], friction[0])
    if "M_N2_case1" in reading:  # (10): sign
        N_face = where(case == 1, -N_face, N_face)
    if "M_N1_case2" in reading:  # (14): sin(alpha - varphi_1) for sin(alpha - theta_1)
        sin_printed = across_a / jnp.hypot(block.a_x, block.h_y)
        N_face = where(case == 2, N_face + height / sin_printed - height / sin_A, N_face)
    if "M_N1_case4" in reading:  # (20): sign, and sin(alpha - theta_2) for sin(alpha - theta_1)
        N_face = where(case == 4, -N_face + height / sin_A - height / at.sin_A2, N_face)
    on_left = where(left_tip, normal[0], N_face), where(left_tip, friction[0], F_face)
    on_right = where(left_tip, N_face, normal[1]), where(left_tip, F_face, friction[1])
    if "M_N1_sign" in reading:  # (21), where (1) has a plus
        on_left = -on_left[0], on_left[1]
    return (on_left[0], on_right[0]), (on_left[1], on_right[1])
