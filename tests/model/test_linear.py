"""The blades' closed-form response without contact, and its power."""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxshroud.model.linear import free_power, power_reduction, steady_amplitudes
from jaxshroud.model.rhs import blade_mean_square
from jaxshroud.scene.vary import vary

UNEQUAL = {
    "blades.m[1]": 0.11,
    "blades.I": (2.46e-5, 3e-3),
    "blades.c_x[1]": 9.0,
    "blades.c_T": (0.05, 0.9),
    "blades.k_T[1]": 900.0,
    "drive.beta": (0.7, -2.1),
    "drive.F_0[1]": 35.0,
    "drive.phase": (0.4, 2.9),
}


@pytest.fixture(scope="module")
def unequal(table1):
    """Two different blades, one of them also with an inertia in y of its own."""
    varied = table1
    for key, value in (UNEQUAL | {"blades.m_y": (10.4, 0.3)}).items():
        varied = vary(varied, key, jnp.asarray(value))
    return varied


def samples(scene, n: int) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Displacement, velocity and acceleration (2, n) of the closed form over one drive period."""
    omega = float(scene.drive.omega)
    turn = np.exp(2j * np.pi * np.arange(n) / n)
    free = steady_amplitudes(scene)[1]._asdict()
    return {
        name: tuple(np.imag((1j * omega) ** order * np.outer(amplitude, turn)) for order in range(3))
        for name, amplitude in free.items()
    }


def loads(scene, n: int) -> dict[str, np.ndarray]:
    """The drive's forces and moment over one period, Sec. 3.1."""
    d = scene.drive
    wave = np.sin(2 * np.pi * np.arange(n) / n + np.asarray(d.phase)[:, None])
    amplitudes = {"x": d.F_0 * np.cos(d.beta), "y": d.F_0 * np.sin(d.beta), "theta": d.M_0}
    return {name: np.asarray(amplitude)[:, None] * wave for name, amplitude in amplitudes.items()}


def residual(scene, inertia_y) -> float:
    """Largest violation of Eq. (1), relative to the load."""
    b, n = scene.blades, 40
    coefficients = {"x": (b.m, b.c_x, b.k_x), "y": (inertia_y, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    found, wanted = samples(scene, n), loads(scene, n)
    worst = 0.0
    for name, values in coefficients.items():
        m, c, k = (np.asarray(value)[:, None] for value in values)
        place, velocity, acceleration = found[name]
        worst = max(worst, exact.furthest(m * acceleration + c * velocity + k * place, wanted[name]))
    return worst


def test_the_steady_response_satisfies_equation_1(unequal):
    assert residual(unequal, unequal.blades.m_y) < 1e-13  # a division and a dozen products
    # Control: with m for the inertia in y it does not.
    assert residual(unequal, unequal.blades.m) > 0.01


def test_an_inertia_in_y_that_is_not_given_is_the_mass(table1):
    assert table1.blades.m_y is None
    assert residual(table1, table1.blades.m) < 1e-13


def block_points(scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Legendre points (X, Y) of the parallelogram and their weights, exact for (23)'s polynomial in X, Y."""
    s = scene.shroud
    nodes, weights = np.polynomial.legendre.leggauss(4)
    along, up = (grid.ravel() / 2 for grid in np.meshgrid(nodes, nodes))  # from -1/2 to 1/2 of either side
    alpha, l_oa, l_ab = float(s.alpha), float(s.l_oa), float(s.l_ab)
    X, Y = along * l_oa + up * l_ab * np.cos(alpha), up * l_ab * np.sin(alpha)
    return X, Y, np.outer(weights, weights).ravel() / 4 * l_oa * l_ab * np.sin(alpha)


def power_by_quadrature(scene, sign_y: float, n: int = 64) -> np.ndarray:
    """Eqs. (22), (23) over time and area as they stand; `sign_y` is the sign in r_LY, printed +, rigid -."""
    X, Y, weights = block_points(scene)
    motion = samples(scene, n)
    x, y, theta = (motion[name][0][:, :, None] for name in ("x", "y", "theta"))
    rho, varphi = np.hypot(X, Y), np.arctan2(Y, X)
    r_LX = x + 2 * rho * np.sin(theta / 2) * np.sin(varphi - theta / 2)
    r_LY = y + sign_y * 2 * rho * np.sin(theta / 2) * np.cos(varphi - theta / 2)
    return np.mean((r_LX**2 + r_LY**2) @ weights, axis=1)


@pytest.mark.parametrize("M_0", [0.0, 1.0, 100.0, 3000.0])
def test_free_power_is_the_quadrature_over_time_and_area(unequal, M_0):
    # 3,000 N m turns the blocks by several radians: the closed form is not one of small angles.
    scene = vary(unequal, "drive.M_0", M_0)
    for sign_y in (-1.0, 1.0):  # the misprint in (22) is harmless: cross terms vanish by symmetry
        assert_allclose(free_power(scene), power_by_quadrature(scene, sign_y), rtol=1e-10)


def test_power_can_be_differentiated(unequal):
    # P_0 is quadratic in F_0 where M_0 = 0: the slope is 2 P_0 / F_0.
    scene = vary(unequal, "drive.M_0", 0.0)
    force = jnp.asarray(20.0)
    power = lambda F_0: free_power(vary(scene, "drive.F_0", F_0))[0]
    assert_allclose(jax.grad(power)(force), 2 * power(force) / force, rtol=1e-12)


def test_a_reduction_without_drive_is_unknown_and_its_slope_is_no_infinity():
    # Where P_0 = 0 a bare quotient would be infinite, and its derivative NaN beside a finite number.
    for kind in (np.asarray, jnp.asarray):
        assert_array_equal(power_reduction(kind([1.0, 1.0]), kind([0.0, 2.0])), [np.nan, 50.0])
    slope = jax.grad(lambda P: jnp.nansum(power_reduction(P, jnp.array([0.0, 2.0]))))(jnp.array([1.0, 1.0]))
    assert_array_equal(slope, [0.0, -50.0])


def test_the_square_displacement_of_a_block_that_turns_is_the_mean_over_its_area():
    # Four points of Gauss's rule are exact for squares: of a block's points, which theta turns about its middle.
    sides = np.array([0.05, 0.0]), 0.035 * np.array([0.5, np.sqrt(0.75)])
    theta = 0.3
    points = np.array([(s * sides[0] + t * sides[1]) / np.sqrt(12) for s in (-1, 1) for t in (-1, 1)])
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    moved = points @ turn.T + (2e-3, -1e-3) - points
    gyration = jnp.asarray((0.05**2 + 0.035**2) / 12)
    found = blade_mean_square(2e-3, -1e-3, np.sin(theta), 1 - np.cos(theta), gyration, None)
    assert_allclose(found, (moved**2).sum(axis=1).mean(), rtol=1e-14)
