"""Stiffnesses of small scenes written out by hand, and stored closed answers of 40 scenes."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.linear.held_contact import held_contact
from jaxshroud.linear.linear_motion import linear_motions
from jaxshroud.linear.linear_transient import linear_multipliers
from jaxshroud.linear.natural_modes import linear_contact
from jaxshroud.model.linear_system import directions, free_system
from jaxshroud.model.modes import FLAT
from jaxshroud.scene.scene import without_given

ANSWERS = Path(__file__).with_name("linear_answers.npz")  # of commit 9430e4ff, whose solvers were others
EXACT = {"rtol": 1e-12, "atol": 1e-12}
K_X, K_Y, K_T = 1e5, 3e6, 2000.0  # of a blade of Table 1, as the sides of its block and the angle of its faces
L_OA, L_AB, SINE, COSINE = 0.05, 0.035, np.sqrt(0.75), 0.5
SPRINGS = [[2e4, -2e4, 0], [-2e4, 4e4, -2e4], [0, -2e4, 2e4]]  # of a chain of three
FLOW = [[-300, 500, -200], [-200, -300, 500], [500, -200, -300]]  # L0, L1 of the next and L_1 of the one before
ROW = ["row.blades=3", "drive.engine_order=1"]
IN_FLOW = ["row.aero.L0=[-300, 0]", "row.aero.L1=[500, 0]", "row.aero.L_1=[-200, 0]"]


@pytest.mark.parametrize(
    ("settings", "between"),
    [([*ROW, "row.closed=false", "row.coupling.k_x=2e4"], SPRINGS), ([*ROW, *IN_FLOW], FLOW)],
    ids=["springs", "flow"],
)
def test_the_stiffness_between_blades_is_that_by_hand(settings, between):
    stiffness = free_system(js.load("row_ring12", settings).scene).stiffness
    by_hand = np.diag(np.repeat([K_X, K_Y, K_T], 3))
    by_hand[:3, :3] += between
    assert_allclose(stiffness, by_hand, **EXACT)
    symmetric = (by_hand + by_hand.T) / 2
    assert (between == FLOW) == (np.abs(stiffness - symmetric).max() > 100)  # the control: a flow taken as symmetric


@pytest.mark.parametrize(("name", "places"), [("table1", [1]), ("table1_points", [1, -1])], ids=["corner", "points"])
def test_the_stiffness_of_contact_is_that_by_hand(name, places):
    scene = js.load(name, ["friction.k_d=1e6"]).scene
    found = linear_contact(scene).stuck / float(scene.k)

    def by_hand(places, turn=1.0):
        K = np.zeros((6, 6))
        for e in np.array(places) * L_AB / 2:
            v = [SINE, -SINE, -COSINE, COSINE, turn * (L_OA * COSINE / 2 + e), turn * (L_OA * COSINE / 2 - e)]
            u = [COSINE, -COSINE, SINE, -SINE, -turn * L_OA * SINE / 2, -turn * L_OA * SINE / 2]
            K += (np.outer(v, v) + 1e6 / float(scene.k) * np.outer(u, u)) / len(places)
        return K

    assert_allclose(found, by_hand(places), **EXACT)
    for wrong in (by_hand(places, -1.0), by_hand([1, -1] if len(places) == 1 else [1])):  # of theta's sign, a corner
        assert np.abs(found - wrong).max() > 1e-3


def test_nothing_sticks_without_a_friction_element():
    rubs, plain = (linear_contact(js.load("table1", [f"parts.friction={name}"]).scene) for name in ("bilinear", "none"))
    assert_array_equal(plain.stuck, plain.sliding)
    assert_array_equal(plain.sliding, rubs.sliding)
    assert np.abs(rubs.stuck - rubs.sliding).max() > 1e5  # the control: k_d


def test_flat_faces_turn_as_one():
    moves = np.ones(9, bool)
    one, none = directions(moves, np.array([[True, True], [False, False]]), closed=False)
    turns = np.array([0, 0, 0, 0, 0, 0, 1.0, 1, 1])
    assert_array_equal(one[:, one.any(axis=0)], np.column_stack([np.eye(9)[:, :6], turns]))
    assert_array_equal(none, np.eye(9))  # the control: no constraint
    moves[-1] = False  # a rigid neighbour holds what lies flat on it
    assert not directions(moves, np.array([[True, True]]), closed=False)[0, 6:].any()


def test_multipliers_of_flat_faces_are_those_of_five_coordinates():
    # Of x and y of both blocks and the one angle of them all, by the energy of the springs of parallel faces.
    settings = ["shroud.gap=-0.4 mm", "initial.start=static", "drive.M_0=0.001", "drive.F_0=0.5"]
    scene = js.load("table1", settings).scene
    lane = jax.tree.map(lambda a: np.asarray(a)[None], without_given(scene))
    held = held_contact(lane, "stuck")
    assert held.case == FLAT
    q = np.array([*held.q[0, 0], *held.q[0, 1], held.q[0, 2, 0]])

    def stretches(q):
        x, y, turn = q[0] - q[1] + 4e-4, q[2] - q[3], q[4]
        x, y = x + L_OA * (jnp.cos(turn) - 1), y - L_OA * jnp.sin(turn)
        angle = np.pi / 3 - turn
        return x * jnp.sin(angle) - y * jnp.cos(angle), x * jnp.cos(angle) + y * jnp.sin(angle)

    def energy(q):
        v, u = stretches(q)
        return (2.5 * K_X * v**2 + 1e6 * (u - u_s) ** 2) / 2

    u_s = stretches(q)[1]
    mass = np.array([0.08] * 4 + [2 * 2.46e-3])
    own = np.array([K_X, K_X, K_Y, K_Y, 2 * K_T])
    assert_allclose(jax.grad(energy)(q), -own * q, rtol=0, atol=1e-11 * np.abs(own * q).max())
    K = np.diag(own) + jax.hessian(energy)(q)
    C = np.diag([3.57, 3.57, 19.6, 19.6, 2 * 0.506])
    rates = np.block([[np.zeros((5, 5)), np.eye(5)], [-K / mass[:, None], -C / mass]])
    by_hand = np.exp(2 * np.pi / 536.0 * np.linalg.eigvals(rates))
    found = linear_multipliers(lane, held)[0]
    found = found[np.abs(found) > 0]  # the angle between the blocks has none
    assert_allclose(np.sort_complex(found), np.sort_complex(by_hand), rtol=0, atol=1e-9)


PLAIN, TURNS = ['parts.motion=["x","y"]', "drive.M_0=0"], ["drive.M_0=0.01"]
PRESSED = ["shroud.gap=-0.4 mm", "drive.F_0=2", "friction.mu=0.9", "initial.start=static"]
MEANS = ["drive.F_x_mean=[3, -2]", "drive.F_y_mean=[1, 4]", "coupling.k_x=2e4", "coupling.c_y=2"]
SCENES = {
    "pair": ("table1", [*PLAIN, *PRESSED, *MEANS], "stuck"),
    "points": ("table1_points", [*TURNS, *PRESSED], "stuck"),
    "flow": ("row_ring12", [*ROW, *PLAIN, *PRESSED, *IN_FLOW, "row.mistuning={sigma=0.02,seed=1}"], "stuck"),
    "apart": ("table1", [*TURNS, "shroud.gap=3 mm", "drive.F_0=1"], "apart"),
}


def answers(name, settings, state):
    """The motion, its margins and its multipliers of ten scenes."""
    scene = js.load(name, settings).scene
    lanes = js.scenes_from(
        {"drive.omega": np.linspace(300, 1500, 10), "contact.gamma": np.linspace(1.0, 6.0, 10)}, scene
    )
    lanes = jax.tree.map(np.asarray, without_given(lanes))
    held = held_contact(lanes, state)
    motion = linear_motions(lanes, held)
    multipliers = np.sort_complex(np.round(linear_multipliers(lanes, held), 12))
    parts = motion.power, motion.first, motion.second, *motion.margins, motion.F_max, multipliers
    return [np.asarray(a).reshape(10, -1) for a in parts]


@pytest.mark.full(but=["pair"])
@pytest.mark.parametrize("name", SCENES)
def test_closed_answers_are_the_stored_ones(name):
    with np.load(ANSWERS) as stored:
        for i, found in enumerate(answers(*SCENES[name])):
            known = stored[f"{name} {i}"]
            finite = np.isfinite(known)
            assert_array_equal(finite, np.isfinite(found))
            if finite.any():  # to rounding, of the largest number of the kind
                largest = np.abs(known[finite]).max()
                assert_allclose(found[finite], known[finite], rtol=0, atol=1e-10 * largest)
