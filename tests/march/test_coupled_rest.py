"""Coupled blades at rest, and in contact that stays in one state: by closed forms and by the march."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.linear.equilibrium import static_equilibria
from jaxshroud.model.linear import static_position

SPRINGS = ("coupling.k_x=2e4", "coupling.k_y=1e5", "coupling.c_x=1")
FLOW = ("row.aero.L0=[-300, 420]", "row.aero.L1=[500, -70]", "row.aero.L_1=[-200, 90]")
BENDING, METHOD = 'parts.motion=["x", "y"]', js.RungeKutta("dopri8", steps=300)
RING = ("row.blades=3", "drive.engine_order=1", *FLOW)
CHAIN = (*RING, "row.closed=false")


def scene_of(name, *changes):
    return js.load(name, [BENDING, *SPRINGS, *changes]).scene


@pytest.mark.full(but=["pair"])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("table1", ("drive.F_x_mean=[5, -4]",)),
        *(("row_ring12", (*of, "drive.F_x_mean=[5, -4, 2]")) for of in (RING, CHAIN)),
    ],
    ids=["pair", "ring", "chain"],
)
def test_without_contact_the_equilibrium_is_the_static_position(name, changes):
    scene = scene_of(name, *changes, "shroud.gap=1")
    found = static_equilibria(jax.tree.map(lambda a: np.asarray(a)[None], scene))
    np.testing.assert_allclose(found.q[0, 0], static_position(scene).x, rtol=1e-12)
    # Control: blades by themselves stand elsewhere.
    assert np.max(np.abs(found.q[0, 0] / (np.asarray(scene.drive.F_x_mean) / 1e5) - 1)) > 1e-2


@pytest.mark.full
@pytest.mark.parametrize(("name", "changes"), [("table1", ()), ("row_ring12", CHAIN)], ids=["pair", "chain"])
def test_undriven_blades_stay_where_contact_and_coupling_balance(name, changes):
    scene = scene_of(name, *changes, "shroud.gap=-0.4 mm", "initial.start=static", "drive.F_0=0", "drive.M_0=0")
    run = js.simulate(scene, n_periods=2, method=METHOD)
    drift = np.abs(np.asarray(run.motion.x) - np.asarray(run.motion.x)[0]).max()
    assert drift < 1e-12 * np.abs(np.asarray(run.motion.x)).max()


@pytest.mark.full
@pytest.mark.parametrize(("name", "changes"), [("table1", ()), ("row_ring12", RING)], ids=["pair", "ring"])
def test_stuck_contact_in_closed_form_is_what_the_march_settles_on(name, changes):
    damped = "blades.c_x=60", "blades.c_y=300", "shroud.gap=-2 mm", "drive.F_0=5", "initial.start=static"
    scene = scene_of(name, *changes, *damped)
    closed = js.power(scene, n_periods=1, transient=0, linear="stuck")
    marched = js.power(scene, n_periods=1, transient=60, method=METHOD)
    np.testing.assert_allclose(closed.final_P_d_vibration, marched.final_P_d_vibration, rtol=1e-9)
    # Control: without coupling it is another.
    bare = js.load(name, [BENDING, *[c for c in changes if "aero" not in c], *damped]).scene
    other = js.power(bare, n_periods=1, transient=0, linear="stuck")
    assert np.max(np.abs(np.asarray(other.final_P_d_vibration) - np.asarray(closed.final_P_d_vibration))) > 1e-2
