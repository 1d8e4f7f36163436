"""A blade of one's own, with four modal coordinates, in a row of three: it is defined here and marches as it stands."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import row_reference
from row_runs import row_scene_of
from scipy.linalg import eigh, null_space

import jaxshroud as js
from jaxshroud.batch.lanes import lanes_last
from jaxshroud.batch.xla import vmapped
from jaxshroud.model.blade import ElasticMotion
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import clusters_of, prepared_row, row_rhs
from jaxshroud.scene.blades import BladeMatrices, Blades
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.other_parts import with_parts

N, PERIODS, STEPS = 3, 2, 12800
ROW = row_reference.table1_row(N, False, 1, M_0=1.0)
# Three modes of the shroud and one of the airfoil, which moves the shroud as well.
MAP = np.array([[1.0, 0.1, 0.02, 0.6], [-0.08, 1.0, 0.01, 0.1], [2.0, -1.0, 1.0, 3.0]])
TUNED = np.array([1.0, 1.03, 0.98])  # stiffness of each blade over the nominal one
COORDINATES = ("x", "y", "theta")


def matrices():
    """Mass, damping and stiffness (N, 4, 4), with couplings, and the map (N, 3, 4)."""
    mass, damping, stiffness = (
        np.diag(d) for d in ([0.08, 0.08, 2.46e-3, 0.03], [3.6, 20, 0.5, 5], [1e5, 3e6, 2e3, 2.5e5])
    )
    mass[0, 3] = mass[3, 0] = 0.01
    damping[0, 3] = damping[3, 0] = 0.8
    stiffness[0, 2] = stiffness[2, 0] = 1e3
    each = lambda a: np.broadcast_to(a, (N, *a.shape))
    return each(mass), each(damping), TUNED[:, None, None] * stiffness, each(MAP)


class ModalBlades(Blades):
    """Blades by their matrices."""

    M: jax.Array
    C: jax.Array
    K: jax.Array
    S: jax.Array

    def __init__(self, lumped: Blades, *of_blades: np.ndarray):
        for name, number in vars(lumped).items():
            setattr(self, name, number)
        self.M, self.C, self.K, self.S = map(jnp.asarray, of_blades)

    def matrices(self) -> BladeMatrices:
        return BladeMatrices(self.M, self.C, self.K, self.S)


def scene_with(of_blades):
    return eqx.tree_at(lambda s: s.blades, row_scene_of(ROW), ModalBlades(row_scene_of(ROW).blades, *of_blades))


class ModalRow(row_reference.RowRun):
    """The second opinion of such blades: of x, y and theta of the shrouds and, last, of the fourth coordinates."""

    def __init__(self, p, of_blades, rtol):
        super().__init__(p, rtol)
        self.M, self.C, self.K, S = of_blades
        airfoil = np.broadcast_to(np.eye(4)[3:], (N, 1, 4))
        self.T, self.S = np.concatenate([S, airfoil], axis=1), S
        self.y = np.concatenate([self.y, np.zeros(2 * N)])
        self.atol = np.concatenate([self.atol, self.atol[:N], self.atol[3 * N : 4 * N]])

    def rhs(self, t, y):
        p, load = self.p, np.zeros((N, 3))
        for j, interface in enumerate(self.interfaces):
            R_x, R_y, M_1, M_2, _ = interface.loads(y[self.rows[j]].tolist())
            left, right = p.sides(j)
            load[left] += R_x, R_y, M_1
            load[right] += -R_x, -R_y, M_2
        swing = np.sin(p.omega * t + np.array(p.phase))[:, None]
        beta, F_0 = np.array(p.beta), np.array(p.F_0)
        load += swing * np.stack([F_0 * np.cos(beta), F_0 * np.sin(beta), p.M_0], axis=-1)
        shrouds = y[: 6 * N].reshape(2, 3, N).transpose(0, 2, 1)
        r, rate = np.concatenate([shrouds, y[-2 * N :].reshape(2, N, 1)], axis=-1)  # (N, 4) each
        q, q_t = (np.linalg.solve(self.T, a[..., None]) for a in (r, rate))
        forces = self.S.transpose(0, 2, 1) @ load[..., None] - self.C @ q_t - self.K @ q
        a = (self.T @ np.linalg.solve(self.M, forces))[..., 0]
        quadratures = np.zeros(len(y) - 8 * N)
        return [*y[3 * N : 6 * N], *a[:, :3].T.ravel(), *quadratures, *rate[:, 3], *a[:, 3]]


def plain_ends(of_blades):
    """The places of the shrouds (periods, 3, N) at ends of periods by the plain integrator, and its events."""
    run, found = ModalRow(ROW, of_blades, 1e-12), []
    for period in range(1, PERIODS + 1):
        run.advance(period * run.period)
        assert run.status == "ok"
        found.append(run.y[: 3 * N].reshape(3, N).copy())
    return np.array(found), {kind: sum(one.counts[kind] for one in run.interfaces) for kind in reference.COUNTS}


def marched_ends(scene, steps):
    run = js.simulate(scene, n_periods=PERIODS, method=js.RungeKutta("rk4", steps))
    assert not run.status
    return np.stack([np.asarray(getattr(run.motion, name))[steps::steps] for name in COORDINATES], axis=1), run


def error_of(found, wanted):
    """The largest difference of each displacement over its size."""
    return np.max(np.abs(found - wanted), axis=(0, 2)) / np.max(np.abs(wanted), axis=(0, 2))


def assembled(of_blades, stuck, turns=False):
    """Mass and stiffness (4 N, 4 N) of the row by NumPy, with all faces stuck on each other or apart."""
    mass, _, stiffness, shroud = of_blades
    M, K = np.zeros((4 * N, 4 * N)), np.zeros((4 * N, 4 * N))
    for i in range(N):
        own = slice(4 * i, 4 * i + 4)
        M[own, own], K[own, own] = mass[i], stiffness[i]
    s, c = math.sin(ROW.alpha), math.cos(ROW.alpha)
    arm = ROW.l_oa / 2 if turns else 0.0
    for j in range(N - 1 if stuck else 0):
        for k, (x, y, theta) in ((ROW.k[j], (s, -c, arm * c)), (ROW.k_d[j], (c, s, -arm * s))):
            along = np.zeros(4 * N)
            along[4 * j : 4 * j + 4], along[4 * j + 4 : 4 * j + 8] = (
                np.array(by) @ shroud[i] for i, by in ((j, (x, y, theta)), (j + 1, (-x, -y, theta)))
            )
            K += k * np.outer(along, along)
    return M, K


def stiffness_per_mass(scene, mode, case, motion):
    """The opposite slopes (4 N, 4 N) of the accelerations of a row by its coordinates, from the package."""
    model = lanes_last(jax.tree.map(lambda a: a[None], prepared_row(with_parts(scene, Parts(motion=motion)))))
    wave, shape = (jnp.zeros(1), jnp.ones(1)), (N - 1, 1)
    contact = jnp.full(shape, mode, jnp.int32), jnp.full(shape, case, jnp.int32)

    def accelerations(q):
        numbers = tuple(q.reshape(N, 4)[:, j : j + 1] for j in range(4))
        now = State(ElasticMotion(numbers, jax.tree.map(jnp.zeros_like, numbers)), jnp.zeros(shape), *contact)
        a = row_rhs(wave, now, clusters_of(now, model), model, Recorded(), vmapped)[0].acceleration
        return jnp.concatenate(a, axis=1).ravel()

    return -np.asarray(jax.jit(jax.jacfwd(accelerations))(jnp.zeros(4 * N)))


def natural_frequencies(scene, mode):
    """The natural circular frequencies (4 N,) of a row in bending."""
    stiffness = stiffness_per_mass(scene, mode, int(mode != Mode.APART), ("x", "y"))
    return np.sqrt(np.sort(np.linalg.eigvals(stiffness).real))


@pytest.mark.parametrize("mode", [Mode.APART, Mode.STICK])
def test_natural_frequencies_are_those_of_the_matrices(mode):
    stuck, of_blades = mode == Mode.STICK, matrices()
    M, K = assembled(of_blades, stuck)
    found = natural_frequencies(scene_with(of_blades), mode)
    np.testing.assert_allclose(found, np.sqrt(eigh(K, M, eigvals_only=True)), rtol=1e-10)
    # Control: a mode of the airfoil that leaves the shroud at rest changes what contact does.
    held = (*of_blades[:3], of_blades[3] * [1, 1, 1, 0])
    moved = np.abs(natural_frequencies(scene_with(held), mode) / found - 1).max()
    assert moved > 0.05 if stuck else moved < 1e-10


@pytest.mark.full
def test_flat_faces_turn_shrouds_as_one():
    # Rows of the map are constrained, S_theta q of neighbours equal, and a null space leaves what can move.
    of_blades = matrices()
    scene = eqx.tree_at(lambda s: s.shroud.gap, scene_with(of_blades), jnp.zeros(N - 1))
    shroud, unlike = of_blades[3], np.zeros((N - 1, 4 * N))
    for j in range(N - 1):
        unlike[j, 4 * j : 4 * j + 4], unlike[j, 4 * j + 4 : 4 * j + 8] = shroud[j][2], -shroud[j + 1][2]
    M, K = assembled(of_blades, True, turns=True)
    Z = null_space(unlike)
    wanted = Z @ np.linalg.solve(Z.T @ M @ Z, Z.T @ K @ Z)
    found = stiffness_per_mass(scene, Mode.STICK, FLAT, COORDINATES) @ Z
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())
    # Control: without the constraint the row accelerates otherwise.
    assert np.abs(np.linalg.solve(M, K @ Z) - wanted).max() > 1e-3 * np.abs(wanted).max()


def test_the_response_without_contact_is_that_of_the_matrices():
    mass, damping, stiffness, shroud = matrices()
    scene = scene_with(matrices())
    F, beta, phase, omega = (np.asarray(getattr(scene.drive, name)) for name in ("F_0", "beta", "phase", "omega"))
    loads = (
        np.stack([F * np.cos(beta), F * np.sin(beta), np.asarray(scene.drive.M_0)], axis=-1)
        * np.exp(1j * phase)[:, None]
    )
    dynamic = stiffness - omega**2 * mass + 1j * omega * damping
    wanted = shroud @ np.linalg.solve(dynamic, shroud.transpose(0, 2, 1) @ loads[..., None])
    found = np.stack(steady_amplitudes(scene)[1], axis=-1)
    np.testing.assert_allclose(found, wanted[..., 0], rtol=1e-11)


@pytest.fixture(scope="module")
def marched():
    """The ends of periods and the run by the package."""
    return marched_ends(scene_with(matrices()), STEPS)


@pytest.mark.full
def test_a_march_is_that_of_a_plain_integrator(marched):
    # Two periods from rest with a dozen events; both march to some 1e-10, which contact lets grow.
    wanted, counts = plain_ends(matrices())
    assert counts["separation"] >= 2
    found, run = marched
    assert np.all(error_of(found, wanted) < 1e-7), error_of(found, wanted)
    assert np.max(np.abs(run.energy_residual)) < 1e-8
    # Control: the lumped blades that the scene has beside the matrices move otherwise.
    lumped, _ = marched_ends(row_scene_of(ROW), 400)
    assert np.all(error_of(lumped, wanted) > 0.05)


@pytest.mark.full
def test_power_is_compared_with_the_response_of_the_matrices():
    scene = eqx.tree_at(lambda s: s.shroud.gap, scene_with(matrices()), jnp.ones(N - 1))
    power = js.power(scene, n_periods=2, transient=60, method=js.RungeKutta("rk4", 400))
    np.testing.assert_allclose(power.P_d, 0.0, rtol=0, atol=1e-3)


def test_such_blades_march_in_rows_alone():
    pair = js.load("table1").scene
    own = ModalBlades(pair.blades, *(a[:2] for a in matrices()))
    with pytest.raises(InputError, match="march in rows so far"):
        js.simulate(eqx.tree_at(lambda s: s.blades, pair, own), n_periods=1, method=js.RungeKutta("rk4", 400))
