"""A static start: the equilibrium of contact and mean loads, with sliders where the faces then are."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.linear.equilibrium import static_equilibria
from jaxshroud.scene.checks import KeyNameError
from jaxshroud.scene.config import parse

UNDRIVEN = ["initial.start=static", "drive.F_0=0", "drive.M_0=0"]
TWIST = "drive.M_mean=[0.1,0,0,.2,-3,1,0,0,0.5,4,-.3,0]"
SCENES = {
    "x": ("table1", 'parts.motion=["x"]', "shroud.gap=-0.4 mm"),
    "x and y": ("table1", 'parts.motion=["x","y"]', "shroud.gap=-0.4 mm", "drive.F_x_mean=[5,-5]"),
    "flat": ("table1", "shroud.gap=-0.4 mm", "drive.M_mean=[0.1,-0.1]"),
    "corner": ("table1", "shroud.gap=-0.4 mm", "drive.M_mean=[3,-1]"),
    "smooth faces": ("table1", "drive.F_x_mean=[50,-50]", "drive.M_mean=[0.3,0.1]", "friction.mu=0"),
    "points": ("table1_points", "drive.F_x_mean=[50,-50]", "drive.M_mean=[0.3,0.1]"),
    "ring": ("row_ring12", "shroud.gap=-0.4 mm", "row.mistuning={sigma=0.05,seed=3}", TWIST),
    "chain": ("row_chain5", 'parts.motion=["x","y"]', "shroud.gap=-0.1 mm", "drive.F_y_mean=[0.1,0,3,9,-4]"),
}


def equilibrium(name, *settings):
    scene = js.load(name, [*settings, "initial.start=static"]).scene
    return static_equilibria(jax.tree.map(lambda a: np.asarray(a)[None], scene))


@pytest.mark.full(but=["flat", "chain"])
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_no_force_is_left_over(scene):
    found = equilibrium(*scene)
    assert found.residual < 1e-12  # of the largest force; Newton's method ends at some 1e-15
    assert found.found == 1


@pytest.mark.full
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_undriven_blades_stay(scene):
    method = js.RungeKutta("dopri8", steps=300)
    run = lambda settings, n: js.simulate(js.load(scene[0], settings).scene, n_periods=n, method=method, every=150)
    drift = lambda motion: np.abs(motion.x - motion.x[0]).max() / np.abs(motion.x).max()
    settings = [*scene[1:], *UNDRIVEN]
    assert drift(run(settings, 50).motion) < 1e-12
    settings.remove("initial.start=static")
    assert drift(run(settings, 1).motion) > 1e-3  # the control: from the unloaded position they move


@pytest.mark.full
@pytest.mark.parametrize("name", ["flat", "smooth faces", "chain"])
def test_without_friction_it_is_where_a_damped_march_ends(name):
    scene = [*SCENES[name], "friction.mu=0", "blades.c_x=60", "blades.c_y=600", "blades.c_T=0.6"]
    begun = js.load(scene[0], [*scene[1:], "drive.F_0=0", "drive.M_0=0"]).scene
    end = js.simulate(begun, n_periods=200, method=js.RungeKutta("dopri8", steps=300), every=300).motion
    at = equilibrium(*scene).q[0]
    for own, place in zip(at, (end.x, end.y, end.theta), strict=True):
        assert np.abs(place[-1] - own).max() < 1e-9 * np.abs(at[0]).max()


def test_a_mean_load_that_opens_contact_leaves_the_position_without_it():
    found = equilibrium("table1", "drive.F_x_mean=[-5,5]")
    np.testing.assert_allclose(found.q[0, 0], [-5e-5, 5e-5], rtol=1e-14)
    assert (found.contact.mode == 0).all()


def test_files_name_a_static_start():
    text = js.load("table1", ["shroud.gap=-0.4 mm"]).text()
    tables, _, _ = text.partition("[initial]")
    short = parse('initial = "static"\n' + tables + "[run]\nperiods = 2\n", "a file")
    assert short.scene.start == "static"
    assert parse(short.text(), "the same").scene.start == "static"
    assert parse(text, "another").scene.start == "motion"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["initial.start=static", "initial.x=1e-5"], "initial motion|start in motion"),
        (["initial.start=static", "contact.reading=printed"], "consistent reading"),
        (["initial.start=static", 'parts.contact="smooth"', "contact.width=1 um"], "located contact"),
        (["initial.start=stat"], "'static'"),
        (["initial.friction=rest"], "from rest"),
    ],
)
def test_bad_starts_are_refused_in_one_line(settings, words):
    with pytest.raises(ValueError, match=words) as error:
        js.load("table1", settings)
    assert "\n" not in str(error.value)


def test_a_static_start_has_no_initial_motion_to_vary():
    scene = js.load("table1", ["initial.start=static"])
    with pytest.raises(KeyNameError, match="static start"):
        js.vary(scene.scene, "initial.x", 1e-5)
    with pytest.raises(KeyNameError, match="static start"):
        js.sweep(scene.scene, {"initial.x[0]": [0.0, 1e-5]}, n_periods=1, transient=0)
