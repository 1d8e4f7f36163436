"""Contact forces and moments: mechanics, the printed formulas word for word, and a second opinion."""

from typing import NamedTuple

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from exact import CASES, CONSISTENT, MISPRINTS, PRINTED, furthest

from jaxshroud.model.contact import contact_load
from jaxshroud.model.modes import Mode
from jaxshroud.model.spring_contact import BilinearContact

DRAW = exact.draw(2000, seed=4)
SHROUDS = exact.shrouds(DRAW.sides)
K, K_D, MU = 1e6, 3e5, 0.4
U_S = np.random.default_rng(5).normal(0, 1e-3, 2000)
MODES = [int(mode) for mode in (Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS)]
UNIT, NONE = np.ones(2000), np.zeros(2000)


class Pieces(NamedTuple):
    """The article's names for what the contact does, Eqs. (9)-(20)."""

    N_x: np.ndarray
    N_y: np.ndarray
    f_x: np.ndarray
    f_y: np.ndarray
    M_N1: np.ndarray
    M_f1: np.ndarray
    M_N2: np.ndarray
    M_f2: np.ndarray


def printed(case: int, d: exact.Draw, N, f) -> Pieces:
    """Eqs. (9), (10), (13), (14), (17), (20) as printed, except that `l_cd` of (10) is read as l_cg."""
    sin, cos, alpha = np.sin, np.cos, d.sides.alpha
    l_ap, l_ob, varphi_1, varphi_2 = exact.lengths(d.sides)
    l_ed, l_cg = l_ap, l_ob
    theta_1, theta_2 = d.q[:, 4], d.q[:, 5]
    r = exact.corner_displacements(d.sides, d.q)
    r_ay, r_by, r_cy, r_dy = (r[corner][1] for corner in "abcd")
    if case in (1, 3):
        A = alpha - theta_2
        f_x, f_y = f * sin(A), f * cos(A)  # (9)
    else:
        A = alpha - theta_1
        f_x, f_y = -f * sin(A), -f * cos(A)  # (13)
    N_x, N_y = N * sin(A), N * cos(A)
    if case == 1:  # (10)
        M_N1 = -N * l_ap / 2 * cos(alpha - varphi_1 + theta_1 - theta_2)
        M_f1 = f * l_ap / 2 * sin(alpha - varphi_1 + theta_1 - theta_2)
        M_N2 = N * (l_cg / 2 * cos(alpha + varphi_2) + (r_cy - r_ay) / sin(alpha - theta_2))
        M_f2 = f * l_ed * sin(alpha - varphi_1) / 2
    elif case == 2:  # (14)
        M_N1 = -N * (l_ap / 2 * cos(alpha - varphi_1) - (r_ay - r_cy) / sin(alpha - varphi_1))
        M_f1 = -f * l_ap * sin(alpha - varphi_1) / 2
        M_N2 = -N * l_cg / 2 * cos(alpha + varphi_2 - theta_1 + theta_2)
        M_f2 = -f * l_cg / 2 * sin(alpha + varphi_2 - theta_1 + theta_2)
    elif case == 3:  # (17)
        M_N1 = -N * l_ob / 2 * cos(alpha + varphi_2 - theta_2 + theta_1)
        M_f1 = f * l_ob / 2 * sin(alpha + varphi_2 - theta_2 + theta_1)
        M_N2 = -N * (l_ap / 2 * cos(alpha - varphi_1) - (r_by - r_dy) / sin(alpha - theta_2))
        M_f2 = f * l_ed * sin(alpha - varphi_1) / 2
    else:  # (20)
        M_N1 = N * (l_cg / 2 * cos(alpha + varphi_2) + (r_dy - r_by) / sin(alpha - theta_2))
        M_f1 = -f * l_ap * sin(alpha - varphi_1) / 2
        M_N2 = -N * l_ed / 2 * cos(alpha - varphi_1 + theta_2 - theta_1)
        M_f2 = -f * l_ed / 2 * sin(alpha - varphi_1 + theta_2 - theta_1)
    return Pieces(N_x, N_y, f_x, f_y, M_N1, M_f1, M_N2, M_f2)


def signed(case: int, F):
    """The article's f for our F: in print f acts on the tip, which is the right block's in cases 2 and 4."""
    return F if case in (1, 3) else -F


def by_equation_1(p: Pieces) -> np.ndarray:
    """R_x, R_y, M_1, M_2 as the pieces enter Eq. (1), (4, n)."""
    return np.stack([-p.N_x - p.f_x, p.N_y - p.f_y, p.M_N1 + p.M_f1, p.M_N2 + p.M_f2])


@exact.over_draws
def _loads(reading, case, shroud, q, N, F):
    at, block = exact.touch_at(shroud, q, case, reading)
    load = contact_load(at, N, F, case, block, reading)
    return jnp.stack([load.R_x, load.R_y, *load.M])


def loads(d: exact.Draw, N, F, case: int, reading=CONSISTENT) -> np.ndarray:
    """R_x, R_y, M_1, M_2 of the package, (4, n)."""
    return np.asarray(_loads(reading, case, exact.shrouds(d.sides), d.q, N, F)).T


@exact.over_draws
def force_and_gradients(reading, case, shroud, q, u_s):
    """Generalised contact force (6,), and -N dv/dq - F du/dq with N = k v and F = k_d (u - u_s)."""
    v = lambda q: exact.touch_at(shroud, q, case, reading)[0].v
    u = lambda q: exact.touch_at(shroud, q, case, reading)[0].u
    at, block = exact.touch_at(shroud, q, case, reading)
    N, F = K * at.v, K_D * (at.u - u_s)
    load = contact_load(at, N, F, case, block, reading)
    force = jnp.stack([load.R_x, -load.R_x, load.R_y, -load.R_y, *load.M])
    return force, -N * jax.grad(v)(q) - F * jax.grad(u)(q)


def virtual_work_error(case: int, reading: frozenset[str]) -> np.ndarray:
    """Difference of both, relative to their size, state by state; moments are told in forces at the arm l_oa."""
    force, gradient = map(np.array, force_and_gradients(reading, case, SHROUDS, DRAW.q, U_S))
    force[:, 4:] /= DRAW.sides.l_oa[:, None]
    gradient[:, 4:] /= DRAW.sides.l_oa[:, None]
    return np.linalg.norm(force - gradient, axis=-1) / np.linalg.norm(gradient, axis=-1)


@pytest.mark.parametrize("case", CASES)
def test_the_contact_force_is_that_of_two_scalars(case):
    # The whole model is v and u: the generalised force is -N dv/dq - F du/dq, so virtual work leaves no room for
    # another lever or direction. Both sides are a dozen products of numbers of order one.
    assert virtual_work_error(case, CONSISTENT).max() < 1e-12
    # Control: the printed reading creates work, by more than 1 % of the force in nearly every state.
    assert np.mean(virtual_work_error(case, PRINTED) > 0.01) > 0.95


@pytest.mark.parametrize("misprint", MISPRINTS)
def test_every_single_misprint_breaks_virtual_work(misprint):
    # Control for each row of the table alone, in the cases it touches. The weakest are the levers, wrong by O(v).
    cases = [int(misprint[-1])] if misprint[-1].isdigit() else CASES
    for case in cases:
        assert np.mean(virtual_work_error(case, frozenset({misprint})) > 1e-3) > 0.9


@pytest.mark.parametrize("case", CASES)
def test_interchanged_corner_angles_create_no_work(case):
    # They are another geometry, not another force: each case alone still has the two scalars v and u.
    assert virtual_work_error(case, frozenset({"corner_angles"})).max() < 1e-12


@pytest.mark.parametrize("case", CASES)
def test_equation_21_turns_round_one_moment(case):
    want = loads(DRAW, UNIT, NONE, case) * np.array([[1], [1], [-1], [1]])  # of N, on the left block
    np.testing.assert_array_equal(loads(DRAW, UNIT, NONE, case, frozenset({"M_N1_sign"})), want)
    others = loads(DRAW, NONE, UNIT, case)
    np.testing.assert_array_equal(loads(DRAW, NONE, UNIT, case, frozenset({"M_N1_sign"})), others)


def moment_balance(case: int, reading: frozenset[str]) -> np.ndarray:
    """Sum of all contact moments about a point fixed in space, relative to N l_oa."""
    R_x, R_y, M_1, M_2 = loads(DRAW, UNIT, UNIT, case, reading)
    x_1, x_2, y_1, y_2, *_ = DRAW.q.T
    apart = DRAW.sides.l_oa + DRAW.sides.gap  # the unloaded centres' distance along x
    about_right_centre = (y_1 - y_2) * R_x - (x_1 - x_2 - apart) * R_y  # clockwise, of the left block's force
    return np.abs(M_1 + M_2 + about_right_centre) / DRAW.sides.l_oa


@pytest.mark.parametrize("case", CASES)
def test_action_is_reaction_and_angular_momentum_is_kept(case):
    # Momentum: Eq. (1) gives the right block the opposite force (Load has one force only). Angular momentum: force
    # and reaction act at the same point in space, so both moments and the couple of the forces cancel.
    assert moment_balance(case, CONSISTENT).max() < 1e-14
    # Control: in the printed reading they do not, by more than 1 % of N l_oa.
    assert np.mean(moment_balance(case, PRINTED) > 0.01) > 0.95


@pytest.mark.parametrize("case", CASES)
def test_the_full_printed_reading_is_the_article_word_for_word(case):
    v_1, _ = exact.penetration_and_slide(DRAW.sides, DRAW.q, case, gap_sign=1.0)  # (8), (12), (16), (19)
    at, _ = exact.touches(DRAW, case, PRINTED)
    np.testing.assert_allclose(at.v, v_1, rtol=0, atol=1e-16)
    N, F = K * v_1, K_D * U_S
    want = by_equation_1(printed(case, DRAW, N, signed(case, F)))
    for got, row in zip(loads(DRAW, N, F, case, PRINTED), want, strict=True):
        assert furthest(got, row) < 1e-13


@exact.over_draws
def in_mode(reading, case, shroud, q, u_s, mode):
    """R_x, R_y, M_1, M_2, N, F, v, u of the package in one mode."""
    at, block = exact.touch_at(shroud, q, case, reading)
    law = BilinearContact(*(jnp.asarray(value) for value in (K, K_D, MU, MU * K / K_D)))
    N = law.normal_force(at.v, mode)
    F = law.friction_force(at.v, at.u, u_s, mode)
    load = contact_load(at, N, F, case, block, reading)
    return jnp.stack([load.R_x, load.R_y, *load.M, N, F, at.v, at.u])


READINGS = [CONSISTENT, PRINTED, *(frozenset({name}) for name in MISPRINTS)]


@pytest.mark.parametrize("reading", READINGS, ids=lambda reading: "+".join(sorted(reading)) or "consistent")
@pytest.mark.parametrize("case", CASES)
def test_a_second_opinion_has_the_same_loads(case, reading):
    modes = (MODES * 667)[:2000]  # stick and both slips in turn
    got = in_mode(reading, case, SHROUDS, DRAW.q, U_S, np.array(modes, np.int32))[::4]
    opinion = [
        reference.load(
            reference.table1(**scalars, k=K, k_d=K_D, mu=MU, reading=reading), q, (0.0,) * 6, mode, case, u_s
        )
        for scalars, q, u_s, mode in zip(
            DRAW.sides.records()[::4], DRAW.q[::4].tolist(), U_S[::4].tolist(), modes[::4], strict=True
        )
    ]
    for column, want in zip(np.asarray(got).T, np.array(opinion).T, strict=True):
        assert furthest(column, want) < 1e-13


def test_blocks_apart_feel_nothing():
    apart = np.full(2000, Mode.APART, np.int32)
    assert not np.any(np.asarray(in_mode(PRINTED, 1, SHROUDS, DRAW.q, U_S, apart))[:, :6])
