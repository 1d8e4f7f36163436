"""Harmonics of a drive by complex amplitudes: the same as by a force, a direction and a phase, and more than these."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.model.linear import free_power, steady_amplitudes
from jaxshroud.scene.config import load, parse

BETA = 0.5
BY_FORCE = """
[[drive.harmonic]]
order = 1
F = 40.0
beta = 0.5
M = 0.2
phase = 0.3
[[drive.harmonic]]
order = 2
F = 25.0
beta = 0.5
phase = 1.9
"""


def complex_table(order, F, M, psi):
    """A harmonic by complex amplitudes, from a force, a moment and their phase."""
    x, y = F * np.cos(BETA), F * np.sin(BETA)
    parts = {"F_x_re": x * np.cos(psi), "F_x_im": x * np.sin(psi), "F_y_re": y * np.cos(psi), "F_y_im": y * np.sin(psi)}
    parts |= {"M_re": M * np.cos(psi), "M_im": M * np.sin(psi)}
    return "\n".join(["[[drive.harmonic]]", f"order = {order}", *(f"{k} = {float(v)!r}" for k, v in parts.items()), ""])


BY_PARTS = complex_table(1, 40.0, 0.2, 0.3) + complex_table(2, 25.0, 0.0, 1.9)
ELLIPTIC = "[[drive.harmonic]]\norder = 1\nF_x_re = 30.0\nF_y_im = [20.0, -10.0]\nM_im = 0.1\n"


def file_with(harmonics, *overrides):
    """Table 1 with other harmonics."""
    kept = [line for line in load("table1").text().splitlines() if line.split(" = ")[0] not in ("beta", "F_0", "M_0")]
    return parse("\n".join([*kept, harmonics]), "own.toml", list(overrides))


def motions(method, *overrides):
    """The positions of both forms of one drive."""
    runs = [js.simulate(file_with(h, *overrides), n_periods=2, method=method) for h in (BY_FORCE, BY_PARTS)]
    assert not any(np.any(run.status) for run in runs)
    return [np.concatenate([np.asarray(run.motion.x), np.asarray(run.motion.theta)], axis=-1) for run in runs]


@pytest.mark.parametrize("name", ["rk4", "series", "row"])
@pytest.mark.full
def test_both_forms_of_one_drive_move_the_blades_alike(name):
    row = ("row.blades=3", "row.closed=true", "drive.engine_order=1") if name == "row" else ()
    method = js.Taylor(tolerance=1e-10) if name == "series" else js.RungeKutta(steps=200)
    wanted, found = motions(method, *row)
    size = min(len(wanted), len(found))
    assert_allclose(found[:size], wanted[:size], rtol=0, atol=1e-11 * np.abs(wanted).max())


def test_closed_forms_are_alike():
    by_force, by_parts = (file_with(h).scene for h in (BY_FORCE, BY_PARTS))
    assert_allclose(free_power(by_parts), free_power(by_force), rtol=1e-13)
    for n, one in steady_amplitudes(by_force).items():
        for a, b in zip(steady_amplitudes(by_parts)[n], one, strict=True):
            assert_allclose(a, b, rtol=1e-13)


def test_an_elliptic_force_has_a_phase_for_each_coordinate():
    # The imaginary part of Q exp(i omega t) along y is a cosine: x and y of the free blades differ by a quarter turn.
    scene = js.vary(file_with(ELLIPTIC).scene, "drive.phase", [0.0, 0.4])
    b, omega = jax.tree.map(np.asarray, scene.blades), float(scene.drive.omega)
    free = steady_amplitudes(scene)[1]
    turn = np.exp(1j * np.array([0.0, 0.4]))
    x = 30.0 * turn / (b.k_x - b.m * omega**2 + 1j * omega * b.c_x)
    y = 1j * np.array([20.0, -10.0]) * turn / (b.k_y - b.m * omega**2 + 1j * omega * b.c_y)
    assert_allclose(free.x, x, rtol=1e-13)
    assert_allclose(free.y, y, rtol=1e-13)
    # A derivative by a part that is 0 exists, and is that of differences.
    level = lambda value: jnp.sum(free_power(js.vary(scene, "drive.harmonic[0].F_x_im", value)))
    slope = float(jax.grad(level)(1e-3))
    assert_allclose(slope, (level(2e-3) - level(0.0)) / 2e-3, rtol=1e-6)


def test_keys_and_files_know_the_parts():
    file = file_with(BY_PARTS, "drive.harmonic[1].M_im=0.3")
    assert js.value_of(file.scene, "drive.harmonic[1].M_im") == 0.3
    assert parse(file.text(), "again.toml").text() == file.text()
    one = js.vary(file.scene, "drive.harmonic[0].F_x_re[1]", 3.0)
    assert_allclose(one.drive.harmonic[0].F_x_re, [40 * np.cos(BETA) * np.cos(0.3), 3.0], rtol=1e-14)
    louder = js.vary(file.scene, "drive.level", 2.0)
    assert_array_equal(louder.drive.harmonics()[2].M_im, [0.6, 0.6])


@pytest.mark.parametrize(
    ("harmonics", "key", "told"),
    [
        (BY_PARTS, "drive.harmonic[1].F", "is given by F_x_re and its like"),
        (BY_FORCE, "drive.harmonic[0].M_re", "is given by F, beta, M and phase"),
    ],
)
def test_a_number_of_the_other_form_is_refused(harmonics, key, told):
    with pytest.raises(js.KeyNameError, match=told):
        js.vary(file_with(harmonics).scene, key, 1.0)
    with pytest.raises(js.SceneError, match=r"has no key `harmonic\[0\].F`"):
        file_with("[[drive.harmonic]]\norder = 1\nF = 3.0\nF_x_re = 2.0\n")
