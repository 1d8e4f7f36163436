"""Faces with several points of contact: an independent march, the balance of energy, and what a file may give."""

import jax
import jax.numpy as jnp
import numpy as np
import points_reference
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from quotients import assert_tangents_by_keys

import jaxshroud as js
from jaxshroud.model.geometry import contact_kinematics, pose
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.model.rhs import loaded_contact
from jaxshroud.scene.config import parse
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.points import ContactPoints
from jaxshroud.scene.text import text_of

LIGHT = ("blades.I=2.46e-5 kg m^2", "contact.gamma=2.6", "drive.M_0=0.3")
CHAIN = ("row.blades=3", "row.closed=false", "drive.engine_order=1", "blades.I=2.46e-5 kg m^2", "drive.M_0=0.3")
METHOD = js.RungeKutta("dopri8", steps=400)
BY_SERIES = js.Taylor(order=14, tolerance=1e-12, steps=METHOD.steps)
PERIODS = 2


def scene_with(points, *changes, name="table1"):
    return js.load(name, [f"contact.points={points}", *changes]).scene


def by_reference(scene, periods=PERIODS, steps=200):
    """The states at the ends of periods (periods, 6, N), and the counts of each point."""
    row = points_reference.row_of(scene)
    return points_reference.followed(row, np.array([*scene.initial]), periods, steps)


def ends_of(run):
    return np.stack(run.motion, axis=1)[METHOD.steps :: METHOD.steps]


PAIR, ROW_OF_THREE = scene_with(2, *LIGHT), scene_with(3, *CHAIN, name="row_ring12")


@pytest.mark.full(but=["pair by series"])
@pytest.mark.parametrize(
    ("scene", "method"),
    [(PAIR, METHOD), (PAIR, BY_SERIES), (ROW_OF_THREE, METHOD), (ROW_OF_THREE, BY_SERIES)],
    ids=["pair", "pair by series", "row of three", "row of three by series"],
)
def test_a_march_agrees_with_an_independent_one(scene, method):
    run, (states, counts) = js.simulate(scene, n_periods=PERIODS, method=method), by_reference(scene)
    size = np.abs(states).max(axis=(0, 2), keepdims=True)
    assert np.abs((ends_of(run) - states) / size).max() < 1e-8  # the error of events that are located by cubics
    for name, of_points in counts.items():
        assert_array_equal(run.counters[name], of_points.sum(axis=-1).reshape(np.shape(run.counters[name])))
    assert sum(n.sum() for n in counts.values()) > 20
    # Energy: the residual over the work of the drive, to the order of the method.
    assert abs(run.energy_residual) < 1e-10
    # What is told of the interface are sums over its points, and its mode follows from theirs.
    assert_allclose(run.point_N.sum(axis=-1), run.N, rtol=1e-13, atol=1e-12)
    assert_allclose(run.point_F.sum(axis=-1), run.F, rtol=1e-13, atol=1e-12)
    slips, sticks = (np.isin(run.point_mode, modes).any(axis=-1) for modes in ([2, 3], [1]))
    assert_array_equal(run.mode == Mode.APART, ~slips & ~sticks)
    assert_array_equal(run.mode == Mode.STICK, sticks & ~slips)
    # Control: stiffer faces move otherwise.
    stiffer = js.simulate(js.vary(scene, "contact.gamma", 2.7), n_periods=PERIODS, method=method)
    assert np.abs((ends_of(stiffer) - states) / size).max() > 1e-2


@pytest.mark.full
def test_a_corner_moves_otherwise_than_two_points():
    points, corner = (
        js.simulate(scene, n_periods=PERIODS, method=METHOD)
        for scene in (scene_with(2, *LIGHT), js.load("table1", list(LIGHT)).scene)
    )
    states = ends_of(points)
    size = np.abs(states).max(axis=(0, 2))[None, :, None]
    assert np.abs((ends_of(corner) - states) / size).max() > 1e-2


@pytest.mark.full
@pytest.mark.parametrize(
    ("points", "M_0", "P_d"), [(2, 0.3, 41.16555), (2, 20, 27.22832), (5, 20, 31.88863)], ids=["2", "2, heavy", "5"]
)
def test_the_power_reduction_is_that_of_independent_marches(points, M_0, P_d):
    scene = scene_with(points, *LIGHT, f"drive.M_0={M_0}", "shroud.gap=22 um", "drive.F_0=60")
    found = js.power(scene, n_periods=1, transient=599, method=METHOD)
    assert found.status == 0
    assert abs(np.ravel(found.P_d)[0] - P_d) < 1e-5


@pytest.mark.full
def test_the_run_goes_on_from_its_last_state():
    scene = scene_with(3, *LIGHT)
    whole = js.simulate(scene, n_periods=2, method=METHOD)
    first = js.simulate(scene, n_periods=1, method=METHOD)
    rest = js.simulate(scene, first.last, n_periods=1, method=METHOD)
    x = np.concatenate([first.motion.x[:-1], rest.motion.x])
    assert_allclose(x, whole.motion.x, rtol=0, atol=1e-9 * np.abs(x).max())  # a slider is told by its stretch


@pytest.mark.parametrize(
    "changes",
    [
        ["contact.points=2"],
        ["contact.points=5", "contact.shares=[0.1, 0.2, 0.4, 0.2, 0.1]"],
        ['contact.points=["-17.5 mm", 0, "17.5 mm"]', "contact.shares=[0.25, 0.5, 0.25]"],
    ],
)
def test_points_are_read_as_they_are_written(changes):
    file = js.load("table1", changes)
    same = lambda a, b: jax.tree.all(jax.tree.map(np.array_equal, a, b))
    assert same(parse(file.text(), "text").scene, file.scene)
    assert same(parse(text_of(file.scene, {"periods": 3}), "text").scene, file.scene)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["contact.points=1"], "from 2 to 16 points"),
        (["contact.points=0"], "from 2 to 16 points"),
        (["contact.points=17"], "from 2 to 16 points"),
        (["contact.points=2.5"], "a number of points, or a list"),
        (["contact.points=2", "contact.shares=[0.5, 0.6]"], "sum to 1.1"),
        (["contact.points=2", "contact.shares=[-0.5, 1.5]"], "must not be negative"),
        (["contact.points=2", "contact.shares=[0.2, 0.3, 0.5]"], "3 numbers for 2 points"),
        (["contact.points=[-0.02, 0.0175]", "contact.shares=[0.5, 0.5]"], "beyond its end"),
        (["contact.points=[-0.01, 0.01]"], "add `shares`"),
        (["contact.shares=[0.5, 0.5]"], "add points"),
        (["contact.points=2", 'contact.reading="printed"'], "not with a printed `reading`"),
        (["contact.points=2", "parts.contact=smooth", "contact.width=1 um"], 'not with contact = "smooth"'),
    ],
)
def test_wrong_points_are_told(changes, told):
    with pytest.raises(js.InputError, match=told):
        js.load("table1", changes)


def test_what_does_not_know_points_refuses_them_by_name():
    file = js.load("table1", ["contact.points=2"])
    with pytest.raises(js.InputError, match="`trade` does not know faces with several points"):
        js.trade(file)
    with pytest.raises(js.InputError, match="do not know contact points"):
        js.with_contact_law(file.scene, js.Laws(js.Hertz(1e7)))


KEYS = ("contact.gamma", "friction.k_d", "friction.mu", "shroud.gap", "shroud.l_ab", "drive.M_0")


@pytest.mark.full
@pytest.mark.parametrize(
    "scene",
    [scene_with(2, *LIGHT), scene_with(3, *CHAIN, "contact.gamma=2.5", name="row_ring12")],
    ids=["pair", "row of three"],
)
def test_tangents_are_those_of_differences(scene):
    assert_tangents_by_keys(scene, KEYS, METHOD, 1e-6)


def placed(points, q, rate=(0.0,) * 6):
    """The forces of two faces at displacements (x_1, x_2, y_1, y_2, theta_1, theta_2), stuck from there, by Eq. (1)."""
    model = prepared_model(scene_with(points, *LIGHT))
    pair = lambda values, i: (jnp.asarray(values[i]), jnp.asarray(values[i + 1]))
    z = Motion(*(pair(values, i) for values in (q, rate) for i in (0, 2, 4)))
    slider = float(contact_kinematics(pose(z.x, z.y, z.theta), jnp.int32(0), model.block, frozenset()).u) - 1e-6
    state = State(z, (jnp.asarray(slider),) * points, (jnp.int32(Mode.STICK),) * points, jnp.int32(0))
    return model, loaded_contact(state, model), state


def test_forces_are_those_of_virtual_work_and_balance():
    q = np.array([3e-4, -2e-4, 1e-4, 2e-4, 0.02, -0.015])
    model, place, state = placed(3, q)

    def energy(q):
        at = contact_kinematics(pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5])), jnp.int32(0), model.block, frozenset())
        return model.law.energy_at(at, model.law.stretch_at(at, state.u_s, state.mode), state.mode)

    load = place.load
    found = np.array([load.R_x, -load.R_x, load.R_y, -load.R_y, *load.M])
    assert_allclose(found, -jax.grad(energy)(jnp.asarray(q)), rtol=0, atol=1e-10 * np.abs(found).max())
    # Angular momentum: both moments, and that of the couple of forces at a distance of l_oa + gap between the centres.
    apart = float(2 * (model.block.a_x + model.block.b_x) / 2 + model.block.gap) + q[1] - q[0], q[3] - q[2]
    total = load.M[0] + load.M[1] + apart[0] * load.R_y - apart[1] * load.R_x
    assert abs(total) < 1e-12 * np.abs(found).max()
    # The half turn: displacements (-x_2, -y_2, theta_2, -x_1, -y_1, theta_1).
    turned = placed(3, np.array([-q[1], -q[0], -q[3], -q[2], q[5], q[4]]))[1].load
    assert_allclose([turned.R_x, turned.R_y], [load.R_x, load.R_y], rtol=1e-11)
    assert_allclose(turned.M, load.M[::-1], rtol=1e-11)


@pytest.mark.parametrize(
    ("points", "of_force", "of_moment"), [(5, 0.125, 0.217), (9, 0.0417, 0.0642), (16, 0.0134, 0.0226)]
)
def test_a_tilted_face_is_loaded_as_by_winklers_springs(points, of_force, of_moment):
    # N = k p^2 / (2 phi l) and M = N (l / 2 - p / (3 phi)) of a face of springs that is pressed in by p at one end.
    l, k, phi = 0.035, 1.0, 1e-3
    points = ContactPoints(points)
    s, w = np.asarray(points.places) * l, np.asarray(points.shares)
    errors = []
    for share in np.linspace(0.25, 1.0, 61):
        p = share * phi * l
        v = np.maximum(p + phi * (s - l / 2), 0.0)
        N, M = np.sum(w * k * v), np.sum(w * k * v * s)
        true = k * p**2 / (2 * phi * l)
        errors.append((abs(N / true - 1), abs(M / (true * (l / 2 - p / (3 * phi))) - 1)))
    assert_allclose(np.max(errors, axis=0), (of_force, of_moment), rtol=0.01)


def test_points_are_advised_where_faces_stay_nearly_parallel():
    light = ["blades.I=block", "drive.M_0=0.3"]
    (advice,) = js.check(js.load("table1", light)).advice
    assert "points = 2" in advice
    for changes in (["blades.I=block", "drive.M_0=100"], ["drive.M_0=0.3"], [*light, "contact.points=2"]):
        assert not js.check(js.load("table1", changes)).advice
