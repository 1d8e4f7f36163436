"""Lyapunov exponents of what has known ones: textbook maps, and blades that never touch."""

import numpy as np
import pytest

from jaxshroud import load
from jaxshroud.batch.runs import initial_states
from jaxshroud.march.method import FAST
from jaxshroud.motion.lyapunov import first_frames, largest_exponents, mean_exponents, next_frames
from jaxshroud.scene.grids import scenes_at


def henon(z):
    return np.array([1 - 1.4 * z[0] ** 2 + z[1], 0.3 * z[0]]), np.array([[-2.8 * z[0], 1.0], [0.3, 0.0]])


def logistic(z):
    return 4 * z * (1 - z), np.array([4 - 8 * z])


def cat(z):
    M = np.array([[2.0, 1.0], [1.0, 1.0]])
    return M @ z % 1.0, M


def exponents_of(step, z, n):
    frames, growth = first_frames(len(z)), []
    for _ in range(n):
        z, M = step(z)
        frames, grown = next_frames(frames, M)
        growth += grown
    return mean_exponents(np.array(growth))[:2]


@pytest.mark.parametrize(
    ("step", "start", "known"),
    [
        (logistic, [0.3], [np.log(2)]),
        (henon, [0.1, 0.1], [0.41922, -1.62319]),
        (cat, [0.1, 0.4], np.log((3 + np.sqrt(5)) / 2) * np.array([1, -1])),
    ],
)
def test_textbook_maps(step, start, known):
    # Published values lie within 1.5 half widths of 95 % intervals (once in 300 they do not, by chance), where frames
    # that are still turning when the average begins leave up to 1e-4.
    mean, ci = exponents_of(step, np.array(start), 3000)
    assert np.all(ci < 0.02)
    assert np.all(np.abs(mean - known) <= 1.5 * ci + 1e-4)
    # The sum is the mean logarithm of the determinant, whatever the frames do: exact.
    if step is not logistic:
        np.testing.assert_allclose(mean.sum(), np.log(0.3) if step is henon else 0.0, atol=1e-12)


def test_blades_that_never_touch_forget_with_their_dampers():
    # Each lane's x_1 decays as exp(-c t / 2 m); a push that is measured in energy does not swing by more than zeta.
    base = load("table1", ['parts.motion=["x"]', 'shroud.gap="5 mm"']).scene
    damping = np.array([2.0, 4.0, 8.0])
    scenes = scenes_at(base, ["blades.c_x"], damping[:, None])
    found = largest_exponents(scenes, initial_states(scenes), 32, 100, FAST)
    exact = -damping / (2 * 0.08) * np.asarray(scenes.drive.period)
    # RK4 at omega h = 0.13 damps by (omega h)^5 / 144 a step more: 3e-5 of a period's 0.15 at least.
    np.testing.assert_allclose(found.exponent, exact, rtol=0.02)
    assert np.all(np.abs(found.exponent - exact) <= found.ci + 2e-4)
