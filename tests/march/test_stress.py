"""Stress of blades by modes: its range over whole orbits, and what Goodman makes of it."""

import dataclasses

import modal_reference
import numpy as np
import pytest
import row_reference
from numpy.testing import assert_allclose, assert_array_equal
from test_modal_blades import MODES

import jaxshroud as js
from jaxshroud.cli.commands import main
from jaxshroud.scene.text import text_of
from jaxshroud.signals.amplitudes import free_level

SIGMA = np.array([3e9, -2e10, 5e10, 1e11])
METHODS = pytest.mark.parametrize("method", [js.RungeKutta(steps=800), js.Taylor(12, 1e-10, 200)], ids=str)


def stressed(sigma, **changes):
    p = row_reference.table1_row(2, False, 1, M_0=1.0, **changes)
    modes = modal_reference.Modes(*(a[..., :2] for a in MODES))
    scene = modal_reference.scene_of(p, modes)
    own = [dataclasses.replace(mode, sigma=a) for mode, a in zip(scene.blades.modes, sigma, strict=True)]
    return p, modes, dataclasses.replace(scene, blades=js.ModalBlades(tuple(own)))


def swept(scene, method, **changes):
    """A sweep of one scene."""
    values = {"drive.omega": [float(scene.drive.omega)]}
    return js.sweep(scene.replace(changes), values, n_periods=4, transient=300, method=method, amplitudes=True)


@pytest.mark.full
@METHODS
def test_stress_is_the_sum_of_that_of_the_modes(method):
    # Apart, under a mean force: the sum over modes in closed form.
    p, modes, scene = stressed(SIGMA, gap=1.0)
    limits = {"blades.sigma_e": 400e6, "blades.sigma_u": 900e6, "blades.sigma_0": np.array([1e8, -1e12])}
    run = swept(scene, method, **limits, **{"drive.F_x_mean": 5.0})
    loads = np.array([np.array(p.F_0) * np.cos(p.beta), np.array(p.F_0) * np.sin(p.beta), np.array(p.M_0)])
    q = np.einsum("ajb,ab->jb", modes.shapes, loads) / (modes.k - p.omega**2 + 1j * p.omega * modes.c)
    assert_allclose(run.sigma_a[0], np.abs(SIGMA @ q), rtol=1e-6)
    assert_allclose(run.sigma_m[0], SIGMA @ (modes.shapes[0] * 5.0 / modes.k), rtol=1e-4)
    pulled = (run.sigma_m[0, 0] + 1e8) / 900e6
    assert_allclose(run.goodman[0], run.sigma_a[0] / 400e6 + [pulled, 0.0], rtol=1e-12)
    # What designs are compared with.
    assert free_level("sigma_a", scene) == pytest.approx(np.abs(SIGMA @ q)[0], rel=1e-12)
    loaded = scene.replace({**limits, "drive.F_x_mean": 5.0})
    assert free_level("goodman", loaded) == pytest.approx(run.goodman[0, 0], rel=1e-4)
    # Control: of shapes without signs.
    assert np.max(np.abs(np.abs(np.abs(SIGMA) @ np.abs(q)) / run.sigma_a[0] - 1)) > 0.01


@pytest.mark.full
@METHODS
def test_stress_in_proportion_to_x_has_its_range(method):
    scale = 1e12
    _, _, scene = stressed(scale * MODES.shapes[0][:, 0])
    run = swept(scene, method)
    about = run.sigma_m - scale * run.x_mean
    assert_allclose(run.sigma_a + np.abs(about), scale * run.x_peak, rtol=1e-12)
    assert np.abs(about).max() > 1e-3 * run.sigma_a.max()  # contact makes it lopsided
    assert np.max(run.v_max) > 0


SHORT = {"n_periods": 4, "transient": 30, "method": js.RungeKutta(steps=200)}


LIMITS = {"blades.sigma_e": 4e8, "blades.sigma_u": 9e8}


@pytest.mark.full
@pytest.mark.parametrize("of", ["sigma_a", "goodman"])
def test_designs_have_less_stress(of):
    scene = stressed(SIGMA)[-1].replace(LIMITS)
    gap = np.array([1e-6, 1e-5, 4e-5])
    swept = getattr(js.sweep(scene, {"shroud.gap": gap}, amplitudes=True, **SHORT), of)
    found = js.table(scene, {"shroud.gap [m]": gap}, by=of, **SHORT)
    assert_array_equal(getattr(found, of), swept)
    assert_array_equal(np.argsort(found.rank), np.argsort(swept.max(axis=1)))
    drawn = js.scatter(scene, {"shroud.gap": (1e-6, 4e-5)}, of=of, draws=4, **SHORT)
    again = getattr(js.sweep(scene, {"shroud.gap": drawn.drawn[:, 0]}, amplitudes=True, **SHORT), of)
    assert_allclose(drawn.level, again[:, 0], rtol=1e-12)  # of the left blade
    assert np.max(np.abs(drawn.level / again[:, 1] - 1)) > 1e-3
    search = js.SearchOptions(scan=4, n_starts=1, updates=1)
    tuned = js.tune(scene, {"shroud.gap": (1e-6, 4e-5)}, of=of, search=search, **SHORT)
    design = {key: [value] for key, value in tuned.design.items()}
    own = getattr(js.sweep(scene, design, amplitudes=True, **SHORT), of)
    assert_allclose(tuned.level, own[0, 0], rtol=1e-2)


def test_without_stress_or_limits_there_is_no_aim():
    with pytest.raises(js.InputError, match="give modes their `sigma`"):
        js.gradient(js.load("table1").scene, ["shroud.gap"], of="sigma_a")
    for verb in (lambda s: js.gradient(s, ["shroud.gap"], of="goodman"), lambda s: js.table(s, "", by="goodman")):
        with pytest.raises(js.InputError, match="give them `blades"):
            verb(stressed(SIGMA)[-1])


def test_limits_stand_beside_modes(tmp_path, capsys):
    file = tmp_path / "scene.toml"
    file.write_text(text_of(stressed(SIGMA)[-1].replace({"blades.sigma_e": [4e8, 5e8]}), {"periods": 1}), "utf-8")
    loaded = js.load(file, ["blades.sigma_0=20 MPa", "blades.sigma_e[1]=600 MPa"]).scene
    assert_array_equal(loaded.blades.sigma_e, [4e8, 6e8])
    assert_array_equal(loaded.blades.sigma_0, [2e7, 2e7])
    assert loaded.blades.sigma_u is None
    # A limit that is not given is none.
    assert js.value_of(loaded, "blades.sigma_u") == 1e30
    for options, told in {
        ("blades.sigma_u=-1",): "must be greater than 0",
        ("blades.m=0.08",): "as its blades are given by modes",
    }.items():
        assert main(["check", str(file), *(word for one in options for word in ("--set", one))]) == 2
        assert told in capsys.readouterr().err
    assert main(["check", "table1", "--set", "blades.sigma_e=4e8"]) == 2
    assert "its blades are lumped" in capsys.readouterr().err
    unlimited = text_of(stressed(SIGMA)[-1], {"periods": 1})
    file.write_text(unlimited, "utf-8")
    assert main(["gradient", str(file), "--wrt", "shroud.gap", "--of", "goodman", "--out", str(tmp_path / "g")]) == 2
    told = capsys.readouterr().err
    assert "give them `blades.sigma_e`" in told
    assert len(told.splitlines()) == 1
