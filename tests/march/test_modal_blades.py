"""Blades by modes, in pairs and rows: a march, closed forms, and what they refuse."""

import dataclasses

import jax
import jax.numpy as jnp
import modal_reference
import numpy as np
import pytest
import row_reference
from modal_reference import COORDINATES, assert_alike, difference, ends_of
from numpy.testing import assert_allclose, assert_array_equal
from row_runs import row_scene_of
from scipy.linalg import eigh, null_space

import jaxshroud as js
from jaxshroud.batch.lanes import lanes_last
from jaxshroud.batch.xla import one_lane, vmapped
from jaxshroud.model.blade import ModalMotion
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import clusters_of, prepared_row, row_rhs
from jaxshroud.verbs.trials import choose

PERIODS, STEPS = 2, 3200
FINE = js.RungeKutta("dopri8", STEPS)
SERIES = js.Taylor(order=14, tolerance=1e-13, steps=400)
BY_BOTH = pytest.mark.parametrize("method", [SERIES, FINE], ids=["series", "dopri8"])
PAIRS = [(seed, 2, False, 0 if seed % 2 else 2) for seed in range(1, 41)]
ROWS = [(seed, 3 + seed % 2, bool(seed % 2), 2 * (seed % 2)) for seed in range(41, 51)]
AT_ONCE = "1-2-False-0-series"
DRAWN = [pytest.param(*one, SERIES, id="-".join(map(str, (*one, "series")))) for one in PAIRS + ROWS]
DRAWN += [pytest.param(*one, FINE, id="-".join(map(str, (*one, "dopri8")))) for one in (PAIRS + ROWS)[1::4]]


@dataclasses.dataclass
class Drawn:
    """A random scene: its numbers, its modes, and the scene."""

    p: row_reference.RowParameters
    modes: modal_reference.Modes
    scene: js.Scene
    points: int

    def opinion(self):
        """The states at the ends of periods and the counts of events; None where the reference gives up."""
        if self.points or self.modes.f.shape[0] < 3:
            # With 800 steps it counts a stick that is none.
            return modal_reference.point_ends(self.scene, self.modes, PERIODS, STEPS)
        return modal_reference.corner_ends(self.p, self.modes, PERIODS)


def drawn(seed, blades, closed, points):
    rng = np.random.default_rng(seed)
    n, row = int(rng.integers(1, 9)), row_reference.random_row(rng, blades, closed)
    gap = tuple(abs(one) + 1e-6 for one in row.gap)
    p = dataclasses.replace(row, mistuning=(0.0,) * blades, initial=(0.0,) * (6 * blades), gap=gap)
    modes = modal_reference.random_modes(rng, n, p)
    return Drawn(p, modes, modal_reference.scene_of(p, modes, points), points)


@pytest.mark.full(but=[AT_ONCE])
@pytest.mark.parametrize(("seed", "blades", "closed", "points", "method"), DRAWN)
def test_a_march_is_that_of_a_plain_integrator(seed, blades, closed, points, method):
    one = drawn(seed, blades, closed, points)
    opinion = one.opinion()
    if opinion is None:
        pytest.skip("the reference gives up, as faces become flat")
    assert_alike(js.simulate(one.scene, n_periods=PERIODS, method=method), *opinion)


@pytest.mark.parametrize("wrong", ["zeta", "theta"])
def test_a_wrong_mode_is_another_motion(wrong):
    # The control of the test above: damping times 1.001, or theta of the other hand.
    one = drawn(*PAIRS[0])
    wanted, _ = one.opinion()
    hand = np.array([1, 1, -1])[:, None, None] if wrong == "theta" else 1
    changed = one.modes._replace(
        zeta=one.modes.zeta * (1.001 if wrong == "zeta" else 1), shapes=one.modes.shapes * hand
    )
    scene = dataclasses.replace(one.scene, blades=changed.blades)
    assert difference(js.simulate(scene, n_periods=PERIODS, method=FINE), wanted) > 1e-6


TABLE1 = ["drive.M_0=1"]


@pytest.mark.full
def test_an_accuracy_is_promised_and_kept():
    one = drawn(5, 2, False, 0)
    wanted, _ = modal_reference.corner_ends(one.p, one.modes, 3)

    def reached(setting):
        method = js.Taylor(setting.order, setting.tolerance, 200)
        return difference(js.simulate(one.scene, n_periods=3, method=method), wanted)

    choice = choose(one_lane(one.scene), 1, "balanced", lane_periods=8)
    assert choice.promised
    assert reached(choice.setting) < choice.accuracy
    # Control: ten thousand times its tolerance.
    assert reached(choice.setting._replace(tolerance=1e4 * choice.setting.tolerance)) > choice.accuracy


# With less friction a nudge of 1e-13 stays 1e-14 over three periods.
THREE = [
    "friction.mu=0.1",
    "row.blades=3",
    "shroud.gap=22 um",
    "row.closed=true",
    "drive.engine_order=1",
    "blades.I=2.46e-3",
]


@pytest.mark.full
@pytest.mark.parametrize("method", [js.RungeKutta("rk4", 400), js.Taylor(14, 1e-14, 400)], ids=["rk4", "series"])
@pytest.mark.parametrize(("name", "numbers"), [("table1", TABLE1), ("row_chain5", THREE)], ids=["pair", "ring"])
def test_lumped_blades_are_three_modes(name, numbers, method):
    # Its start is not at rest: the shapes of x, y and theta also carry a motion of the shroud.
    moved = ["initial.x=2e-5", "initial.v_theta=0.1"]
    scene = js.load(name, [*numbers, *moved]).scene
    modes = modal_reference.modes_of_lumped(scene.blades)
    by_modes = dataclasses.replace(scene, blades=modes.blades)
    run, other = (js.simulate(one, n_periods=3, method=method) for one in (scene, by_modes))
    assert difference(other, ends_of(run, 3)) < 1e-12
    for kind, count in run.counters.items():
        assert_array_equal(other.counters[kind], count)
    assert_allclose(js.largest_frequency(by_modes), js.largest_frequency(scene), rtol=1e-12)
    assert_allclose(by_modes.k, scene.k, rtol=1e-14)  # by gamma
    free, own = steady_amplitudes(scene)[1], steady_amplitudes(by_modes)[1]
    assert_allclose(np.stack(own), np.stack(free), rtol=1e-12)


@pytest.mark.full
def test_flat_faces_of_a_ring_are_the_limit_of_springs_between_them():
    # The plain integrator knows no flat faces, but springs between them: what these leave falls as their compliance.
    p = row_reference.table1_row(3, True, 1, M_0=0.1, gap=-4e-4, I=2.5e-4, mu=0.3)
    modes = modal_reference.modes_of_lumped(row_scene_of(p).blades)
    run = simulated(p, modes)
    assert np.all(np.mean(run.case == FLAT, axis=0) > 0.3)

    def by_springs(k_face):
        springs = modal_reference.ModalRun(dataclasses.replace(p, k_face=k_face), modes, 1e-9)
        states = []
        for eighth in range(1, 9):
            springs.advance(eighth * springs.period / 8)
            states.append(springs.y[: 6 * p.blades].reshape(6, -1).copy())
        return np.array(states)

    soft, stiff = map(by_springs, (1e6, 1e7))
    assert difference(run, soft) / difference(run, stiff) == pytest.approx(10, rel=0.05)
    limit = (10 * stiff - soft) / 9
    assert difference(run, limit) < 3e-5  # found 2e-5 in v_theta, 4e-7 in x
    # Control: shrouds that turn by 1 % more.
    wrong = modes._replace(shapes=modes.shapes * np.array([1, 1, 1.01])[:, None, None])
    assert difference(simulated(p, wrong), limit) > 1e-2


def simulated(p, modes):
    """A march of one period by steps of a four-hundredth."""
    return js.simulate(modal_reference.scene_of(p, modes), n_periods=1, method=js.RungeKutta("dopri8", 400))


@pytest.mark.full
def test_a_rigid_neighbour_of_a_blade_by_modes():
    scene = js.load("griffin").scene
    by_modes = dataclasses.replace(scene, blades=modal_reference.modes_of_lumped(scene.blades).blades)
    settings = {"n_periods": 2, "transient": 1, "method": js.RungeKutta("rk4", 400)}
    run, other = (js.sweep(one, {"shroud.gap": [0.0, 1e-5]}, **settings) for one in (scene, by_modes))
    assert_allclose(other.motion.x, run.motion.x, rtol=1e-10, atol=0)


# Three modes of the shroud and one of the airfoil, which moves the shroud as well.
N = 3
SHAPES = np.array([[3.5, 0.3, 0.1, 4.0], [-0.3, 3.5, 0.1, 0.6], [7.0, -3.5, 20.0, 17.0]])
MODES = modal_reference.Modes(
    np.outer([170.0, 450.0, 980.0, 1600.0], [1.0, 1.015, 0.99]),
    np.full((4, N), 0.02),
    np.repeat(SHAPES[..., None], N, axis=2),
)


def chain(motion=COORDINATES, **changes):
    p = row_reference.table1_row(N, False, 1, M_0=1.0, **changes)
    scene = modal_reference.scene_of(p, MODES)
    return dataclasses.replace(scene, parts=js.Parts(motion=motion)), p


def assembled(p, stuck, turns=False):
    """The stiffness (4 N, 4 N) of the chain, blade by blade, with all faces stuck on each other or apart."""
    K = np.diag(MODES.k.T.ravel())
    s, c = np.sin(p.alpha), np.cos(p.alpha)
    arm = p.l_oa / 2 if turns else 0.0
    for j in range(N - 1 if stuck else 0):
        for k, (x, y, theta) in ((p.k[j], (s, -c, arm * c)), (p.k_d[j], (c, s, -arm * s))):
            along = np.zeros(4 * N)
            along[4 * j : 4 * j + 4] = np.array([x, y, theta]) @ SHAPES
            along[4 * j + 4 : 4 * j + 8] = np.array([-x, -y, theta]) @ SHAPES
            K += k * np.outer(along, along)
    return K


def stiffness_of(scene, mode, case):
    """The opposite slopes (4 N, 4 N) of the accelerations of a row by its coordinates, from the package."""
    model = lanes_last(jax.tree.map(lambda a: a[None], prepared_row(scene)))
    wave, shape = (jnp.zeros(1), jnp.ones(1)), (N - 1, 1)
    contact = jnp.full(shape, mode, jnp.int32), jnp.full(shape, case, jnp.int32)

    def accelerations(q):
        numbers = tuple(q.reshape(N, 4)[:, j : j + 1] for j in range(4))
        now = State(ModalMotion(numbers, jax.tree.map(jnp.zeros_like, numbers)), jnp.zeros(shape), *contact)
        a = row_rhs(wave, now, clusters_of(now, model), model, Recorded(), vmapped)[0].acceleration
        return jnp.concatenate(a, axis=1).ravel()

    return -np.asarray(jax.jit(jax.jacfwd(accelerations))(jnp.zeros(4 * N)))


@pytest.mark.parametrize("mode", [Mode.APART, Mode.STICK])
def test_natural_frequencies_are_those_of_the_assembled_modes(mode):
    stuck = mode == Mode.STICK
    scene, p = chain(("x", "y"))
    found = np.sqrt(np.sort(np.linalg.eigvals(stiffness_of(scene, mode, int(stuck))).real))
    assert_allclose(found, np.sqrt(eigh(assembled(p, stuck), eigvals_only=True)), rtol=1e-10)


@pytest.mark.full
def test_flat_faces_turn_shrouds_as_one():
    # Rows of the map are constrained, theta of neighbours equal, and a null space leaves what can move.
    scene, p = chain(gap=0.0)
    unlike = np.zeros((N - 1, 4 * N))
    for j in range(N - 1):
        unlike[j, 4 * j : 4 * j + 4], unlike[j, 4 * j + 4 : 4 * j + 8] = SHAPES[2], -SHAPES[2]
    K, Z = assembled(p, True, turns=True), null_space(unlike)
    wanted = Z @ Z.T @ K @ Z
    found = stiffness_of(scene, Mode.STICK, FLAT) @ Z
    assert_allclose(found, wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())
    # Control: without the constraint the row accelerates otherwise.
    assert np.abs(K @ Z - wanted).max() > 1e-3 * np.abs(wanted).max()


def test_the_response_without_contact_is_that_of_the_modes():
    scene, _ = chain()
    F, beta, phase, omega = (np.asarray(getattr(scene.drive, name)) for name in ("F_0", "beta", "phase", "omega"))
    M = np.asarray(scene.drive.M_0)
    loads = np.stack([F * np.cos(beta), F * np.sin(beta), M]) * np.exp(1j * phase)
    q = np.einsum("ajb,ab->jb", MODES.shapes, loads) / (MODES.k - omega**2 + 1j * omega * MODES.c)
    wanted = np.einsum("ajb,jb->ab", MODES.shapes, q)
    assert_allclose(np.stack(steady_amplitudes(scene)[1]), wanted, rtol=1e-11)


@pytest.mark.full
def test_power_is_compared_with_the_response_of_the_modes():
    scene, _ = chain(gap=1.0)
    power = js.power(scene, n_periods=2, transient=60, method=js.RungeKutta("rk4", 400))
    assert_allclose(power.P_d, 0.0, rtol=0, atol=1e-3)


def test_a_rigid_motion_and_no_damping_are_allowed():
    # A free mass under a constant force and a spring: a mode of frequency 0 falls with F t^2 / 2 m.
    scene = js.load("table1", ['parts.motion=["x"]', "drive.F_0=0", "drive.F_x_mean=[2, 0]", "shroud.gap=1"]).scene
    phi = np.zeros((3, 1))
    phi[0] = 5.0
    scene = dataclasses.replace(scene, blades=js.modal_blades([0.0], 0.0, phi))
    run = js.simulate(scene, n_periods=2, method=js.RungeKutta("rk4", 400))
    assert_allclose(run.motion.x[:, 0], 2 * 25.0 * np.asarray(run.t) ** 2 / 2, rtol=1e-12)


def test_frequencies_grow_with_the_speed():
    scene = js.load("table1", ["drive.engine_order=2", "drive.speed=268", "shroud.gap=1"]).scene
    own = modal_reference.modes_of_lumped(scene.blades)
    B, square = np.array([[1.5], [0.5], [2.0]]) * np.ones((1, 2)), (float(scene.drive.omega) / 2) ** 2
    blades = js.modal_blades(own.f, own.zeta, own.shapes, B=B)
    grown = np.sqrt(own.k + B * square) / (2 * np.pi)
    alike = js.modal_blades(grown, own.zeta * own.f / grown, own.shapes)  # the dampers stay
    one, other = (dataclasses.replace(scene, blades=b) for b in (blades, alike))
    found, wanted = (np.stack(steady_amplitudes(s)[1]) for s in (one, other))
    assert_allclose(found, wanted, rtol=1e-12)
    assert one.depends_on_speed
    assert np.max(np.abs(found / np.stack(steady_amplitudes(scene)[1]) - 1)) > 1e-3
