"""Corners, penetration and slide against Eqs. (3)-(6) with their half angles, and the cases of Sec. 2.3."""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact import CASES, CONSISTENT, furthest
from numpy.testing import assert_allclose, assert_array_equal

from jaxshroud.model.geometry import corners, natural_case

DRAW = exact.draw(2000)
GAP_SIGN = frozenset({"gap_sign"})


def test_table_1_has_the_angles_and_lengths_worked_out_by_hand(table1):
    sides = exact.Sides(*(float(v) for v in vars(table1.shroud).values() if v is not None))
    l_ap, l_ob, varphi_1, varphi_2 = exact.lengths(sides)
    assert_allclose(np.degrees([varphi_1, varphi_2]), [24.2, 43.0], atol=0.05)  # the digits given
    assert_allclose([l_ap, l_ob], [0.0740, 0.0444], atol=5e-5)


def test_corners_are_the_lengths_and_angles_of_the_article():
    block = jax.vmap(corners)(exact.shrouds(DRAW.sides))
    l_ap, l_ob, varphi_1, varphi_2 = exact.lengths(DRAW.sides)
    assert_allclose(2 * np.hypot(block.a_x, block.h_y), l_ap, rtol=1e-14)
    assert_allclose(2 * np.hypot(block.b_x, block.h_y), l_ob, rtol=1e-14)
    assert_allclose(np.arctan2(block.h_y, block.a_x), varphi_1, rtol=1e-14)
    assert_allclose(np.arctan2(block.h_y, block.b_x), varphi_2, rtol=1e-14)


def test_interchanged_corner_angles_keep_the_height_and_the_face(table1):
    as_drawn, other = corners(table1.shroud), corners(table1.shroud, frozenset({"corner_angles"}))
    assert (other.a_x, other.b_x, other.h_y) == (as_drawn.b_x, as_drawn.a_x, as_drawn.h_y)
    varphi = np.degrees([np.arctan2(other.h_y, other.a_x), np.arctan2(other.h_y, other.b_x)])
    assert_allclose(varphi, [43.0, 24.2], atol=0.05)  # the digits given
    for block in (as_drawn, other):
        along = (block.a_x - block.b_x) * block.cos_alpha + 2 * block.h_y * block.sin_alpha
        assert_allclose(block.l_ab, along, rtol=1e-14)


@pytest.mark.parametrize("case", CASES)
def test_displacements_are_those_of_equations_3_to_6(case):
    at, _ = exact.touches(DRAW, case)
    d_x, d_y = exact.relative_displacement(DRAW.sides, DRAW.q, case)
    # The package rotates corners where the article uses half angles: the same to rounding of 5 cm, 1e-17 m.
    assert_allclose(at.offset[0], d_x - DRAW.sides.gap, rtol=0, atol=1e-16)
    assert_allclose(at.offset[1], d_y, rtol=0, atol=1e-16)
    assert_array_equal(at.height, at.offset[1])
    assert_array_equal(at.turn, DRAW.q[:, 4] - DRAW.q[:, 5])


@pytest.mark.parametrize(("reading", "gap_sign"), [(CONSISTENT, -1.0), (GAP_SIGN, 1.0)])
@pytest.mark.parametrize("case", CASES)
def test_penetration_and_slide_are_the_offset_along_the_faces_axes(case, reading, gap_sign):
    at, _ = exact.touches(DRAW, case, reading)
    v, u = exact.penetration_and_slide(DRAW.sides, DRAW.q, case, gap_sign)
    assert_allclose(at.v, v, rtol=0, atol=1e-16)
    assert_allclose(at.u, u, rtol=0, atol=1e-16)
    A = exact.face_angle(DRAW.sides, DRAW.q, case)
    assert_allclose(np.stack(at.normal), [np.sin(A), -np.cos(A)], rtol=0, atol=1e-15)
    assert_allclose(np.stack(at.tangent), [np.cos(A), np.sin(A)], rtol=0, atol=1e-15)
    # Control: the other sign of d_y is another gap function.
    assert exact.share_beyond(at.v, exact.penetration_and_slide(DRAW.sides, DRAW.q, case, -gap_sign)[0], 0.01) > 0.9


@exact.over_draws
def along_the_motion(reading, case, shroud, q, rate):
    def scalars(q):
        at, _ = exact.touch_at(shroud, q, case, reading)
        return at.v, at.u, at.height, at.turn

    return jax.jvp(scalars, (q,), (rate,))[1]


@pytest.mark.parametrize("reading", [CONSISTENT, GAP_SIGN])
@pytest.mark.parametrize("case", CASES)
def test_rates_by_hand_are_the_derivatives_along_the_motion(case, reading):
    _, rate = exact.touches(DRAW, case, reading)
    want = along_the_motion(reading, case, exact.shrouds(DRAW.sides), DRAW.q, DRAW.rate)
    for by_hand, derivative in zip(rate, want, strict=True):
        assert furthest(by_hand, np.asarray(derivative)) < 1e-14  # both are a few sums of products


def test_equal_angles_give_both_corner_pairs_the_same_displacement():
    # Then ac and bd are equal parallel vectors: this is why 1<->4 and 2<->3 are the generic switches there.
    q = DRAW.q.copy()
    q[:, 5] = q[:, 4]
    (upper, _), (lower, _) = (exact.touches(DRAW._replace(q=q), case) for case in (1, 3))
    assert_allclose(upper.offset, lower.offset, rtol=0, atol=5e-17)
    # Control: with different angles they are far from equal.
    (upper, _), (lower, _) = (exact.touches(DRAW, case) for case in (1, 3))
    assert exact.share_beyond(upper.offset, np.asarray(lower.offset), 0.01) > 0.9


@jax.jit
@jax.vmap
def natural(shroud, q):
    return natural_case(exact.posed(q), corners(shroud)), exact.touch_at(shroud, q, jnp.int32(1))[0].height


def test_the_case_is_that_of_section_2_3():
    case, _ = natural(exact.shrouds(DRAW.sides), jnp.asarray(DRAW.q))
    assert_array_equal(case, exact.case_of(DRAW.sides, DRAW.q))
    assert set(np.unique(case)) == set(CASES)


def test_equal_angles_belong_to_the_lower_corners():
    q = DRAW.q.copy()
    q[:, 5] = q[:, 4]
    case, height = natural(exact.shrouds(DRAW.sides), jnp.asarray(q))
    assert_array_equal(case, np.where(height > 0, 3, 4))  # theta_1 <= theta_2 in cases 3 and 4


def test_equal_heights_belong_to_the_right_tip():
    # r_ay - r_cy >= 0 in case 2, r_by - r_dy <= 0 in case 4. Heights that are exactly zero: unturned blocks for the
    # lower corners; for the upper ones, the left block is lifted back and those without a rounding error are kept.
    shrouds = exact.shrouds(DRAW.sides)
    q = DRAW.q * np.array([1.0, 1.0, 0.0, 0.0, 1.0, 1.0])
    unturned = q * np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    assert np.all(natural(shrouds, jnp.asarray(unturned))[0] == 4)
    q[:, 2] = -np.asarray(natural(shrouds, jnp.asarray(q))[1])
    case, height = natural(shrouds, jnp.asarray(q))
    level = (np.asarray(height) == 0) & (q[:, 4] > q[:, 5])
    assert level.sum() > 100
    assert np.all(np.asarray(case)[level] == 2)
