"""Coupled blades without contact: closed forms of a ring by nodal diameters, and direct solutions by NumPy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, eigh

import jaxshroud as js
from jaxshroud.batch.lanes import lanes_last
from jaxshroud.batch.xla import vmapped
from jaxshroud.linear.mistuned import linear_systems, linear_waves
from jaxshroud.model.blade import ModalMotion
from jaxshroud.model.linear import free_power, static_position, steady_amplitudes
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import prepared_row, row_rhs
from jaxshroud.scene.keys import Motion

N = 6
L = {"L0": -300 + 120j, "L1": 500 - 700j, "L_1": -200 + 900j}
K_C, C_C = {"x": 2e4, "y": 1e5, "theta": 50.0}, {"x": 0.3, "y": 2.0, "theta": 0.02}
SPRINGS = [
    f"row.coupling.{kind}_{s}={of[q]}" for kind, of in (("k", K_C), ("c", C_C)) for q, s in zip(of, "xyT", strict=True)
]
FLOW = [f"row.aero.{name}=[{value.real}, {value.imag}]" for name, value in L.items()]


@jax.jit
def response(scene):
    """The amplitudes of the first harmonic."""
    return steady_amplitudes(scene)[1]


def ring(*changes, n=N):
    return js.load("row_ring12", [f"row.blades={n}", "drive.engine_order=1", *changes]).scene


def wave_stiffness(h, omega, coordinate, flow=True):
    """What coupling adds to the dynamic stiffness of a wave of nodal diameter h."""
    added = 4 * np.sin(np.pi * h / N) ** 2 * (K_C[coordinate] + 1j * omega * C_C[coordinate])
    if flow and coordinate == "x":
        turn = np.exp(2j * np.pi * h / N)
        of_drive = L["L0"] + L["L1"] * turn + L["L_1"] / turn
        added += of_drive
    return added


@pytest.mark.parametrize("order", [1, 2, 3, 5, 0])
def test_the_response_of_a_tuned_ring_is_that_of_its_nodal_diameter(order):
    scene = ring(*SPRINGS, *FLOW, f"drive.engine_order={order}")
    found, b, omega = response(scene), scene.blades, float(scene.drive.omega)
    loads = {"x": scene.drive.harmonics()[1].F_x, "y": scene.drive.harmonics()[1].F_y, "theta": scene.drive.M_0}
    numbers = {"x": (b.m, b.c_x, b.k_x), "y": (b.m, b.c_y, b.k_y), "theta": (b.I, b.c_T, b.k_T)}
    for name in numbers:
        m, c, k = (float(a[0]) for a in numbers[name])
        dynamic = k - omega**2 * m + 1j * omega * c + wave_stiffness(order, omega, name)
        want = np.asarray(loads[name]) * np.exp(1j * np.asarray(scene.drive.phase)) / dynamic
        assert_allclose(getattr(found, name), want, rtol=1e-12)
    # Control: without coupling some displacement is another by far.
    apart = response(ring(f"drive.engine_order={order}"))
    assert abs(apart.x[0] / found.x[0] - 1) > 1e-3


def assembled(scene, name, kind):
    """Stiffness (kind "k") or damping of one coordinate by loops over interfaces, without the flow's."""
    suffix = {"x": "x", "y": "y", "theta": "T"}[name]
    matrix = np.diag(np.asarray(getattr(scene.mistuned_blades, f"{kind}_{suffix}"), float))
    numbers = getattr(scene.coupling, f"{kind}_{suffix}")
    for j, value in enumerate(np.atleast_1d(np.zeros(scene.layout.interfaces) if numbers is None else numbers)):
        i = (j + 1) % scene.layout.blades
        for a, b, sign in ((j, j, 1), (i, i, 1), (j, i, -1), (i, j, -1)):
            matrix[a, b] += sign * value
    return matrix


def direct(scene, order=1):
    """x, y and theta of all blades by direct solutions of lumped blades, (3, N)."""
    b, omega, load = scene.blades, float(scene.drive.omega) * order, scene.drive.harmonics()[order]
    found = []
    for name, mass in (("x", b.m), ("y", b.inertia_y), ("theta", b.I)):
        K, C = (assembled(scene, name, kind) for kind in "kc")
        force = np.asarray(load.load(name)) * np.exp(1j * np.asarray(load.phase))
        found.append(np.linalg.solve(K - omega**2 * np.diag(mass) + 1j * omega * C, force))
    return np.array(found)


def test_unlike_interfaces_a_chain_and_a_pair_are_those_of_matrices():
    unlike = ["row.coupling.k_x=[1e4, 2e4, 0]", "row.coupling.c_x=0.5", "row.coupling.k_T=[20, 0, 3]"]
    chain = ring(*unlike, "row.closed=false", "row.mistuning=[0, 0.02, -0.01, 0.03]", n=4)
    pair = js.load("table1", ["coupling.k_x=3e4", "coupling.k_y=1e6", "coupling.c_T=0.1"]).scene
    for scene in (chain, pair):
        assert_allclose(np.array(response(scene)), direct(scene), rtol=1e-12)
    held = js.load("table1", ["coupling.k_x=3e4", "parts.neighbour=rigid"]).scene
    stiffer = js.vary(js.load("table1", ["parts.neighbour=rigid"]).scene, "blades.k_x", [1.3e5, 1e5])
    assert_allclose(response(held).x, response(stiffer).x, rtol=1e-13)


def test_mean_loads_hold_coupled_blades():
    pair = js.load("table1", ["coupling.k_x=3e4", "drive.F_x_mean=[5, -4]"]).scene
    assert_allclose(static_position(pair).x, direct(pair, 0)[0].imag, rtol=1e-13)
    assert_allclose(static_position(pair).x, np.linalg.solve([[1.3e5, -3e4], [-3e4, 1.3e5]], [5, -4]))


def test_numbers_of_coupling_have_derivatives_of_the_power_without_contact():
    scene = ring(*SPRINGS, *FLOW, 'parts.motion=["x"]')
    keys, at = ("coupling.k_x[2]", "coupling.c_x", "aero.L1_re", "aero.L_1_im"), np.array([2e4, 0.3, 500.0, 900.0])

    @jax.jit
    def power(values):
        varied = scene
        for key, value in zip(keys, values, strict=True):
            varied = js.vary(varied, key, value)
        return jnp.sum(free_power(varied))

    slopes = jax.jit(jax.jacfwd(power))(jnp.asarray(at))
    for i, step in enumerate(1e-4 * np.diag(at)):
        difference = (power(at + step) - power(at - step)) / (2 * step[i])
        assert_allclose(slopes[i], difference, rtol=1e-6)


def modes(scene, contact, motion):
    sheet = js.check(scene)
    return {m.blades: m for m in sheet.modes if (m.contact, m.motion) == (contact, motion)}


def test_natural_frequencies_and_damping_ratios_are_those_of_nodal_diameters():
    scene = ring(*SPRINGS, 'parts.motion=["x", "y"]')
    m, (c_x, k_x) = float(scene.blades.m[0]), (float(a[0]) for a in (scene.blades.c_x, scene.blades.k_x))
    found = modes(scene, "apart", "x")
    for h in range(4):
        s = 4 * np.sin(np.pi * h / N) ** 2
        omega = np.sqrt((k_x + s * K_C["x"]) / m)
        mode = found[f"nodal diameter {h}"]
        assert_allclose(mode.frequency, omega / (2 * np.pi), rtol=1e-12)
        assert_allclose(mode.zeta, (c_x + s * C_C["x"]) / (2 * m * omega), rtol=1e-12)
    # With all faces stuck: D_h = K + 4 sin^2(pi h / N) (K_c of the disk and of contact).
    stuck, s = js.check(scene), 4 * np.sin(np.pi * 2 / N) ** 2
    n, t = np.array([np.sin(np.pi / 3), -0.5]), np.array([0.5, np.sin(np.pi / 3)])
    D = np.diag([1e5, 3e6]) + s * (np.diag([2e4, 1e5]) + 2.6e5 * np.outer(n, n) + 1e6 * np.outer(t, t))
    want = np.sqrt(np.linalg.eigvalsh(D) / m) / (2 * np.pi)
    told = sorted({m.frequency for m in stuck.modes if m.contact == "stuck" and m.blades == "nodal diameter 2"})
    assert_allclose(told, want, rtol=1e-10)


def test_linear_answers_of_mistuned_rows_are_coupled():
    scene, delta = ring(*SPRINGS, *FLOW, 'parts.motion=["x"]'), np.array([0.02, -0.01, 0.0, 0.03, -0.02, 0.01])
    systems = linear_systems(jax.tree.map(lambda a: a[None], scene), "apart", 0)
    found = np.abs(linear_waves(jax.tree.map(lambda a: np.asarray(a)[0], systems), delta)[1])
    assert_allclose(found, np.abs(response(js.vary(scene, "row.mistuning", delta)).x), rtol=1e-11)
    # Control: the flow and the springs move it by far.
    assert np.max(np.abs(found / np.abs(response(ring('parts.motion=["x"]')).x) - 1)) > 1e-2


# A blisk of 24 sectors, each of a part of the disk, m_0 on a spring to the ground, and two masses of a blade on it;
# the frequencies [Hz] are those that pyHarm's tutorial 006 prints, with the masses of its code.
SECTORS, K_DISK = 24, 5e7
MASSES, K_GROUND, K_BLADE = (1.2, 0.35, 0.25), 6e5, (1e6, 2e6)
PRINTED = {
    0: (88.26374399, 249.31165161, 619.34330474),
    1: (169.3441295, 335.56537939, 619.82021678),
    2: (189.3018526, 555.31017863, 626.2025859),
    3: (193.0496227, 615.15017797, 810.0067968),
    12: (195.67605066, 617.32579659, 2062.97567761),
}


def sector_matrices():
    """The stiffness and the mass of a sector, of which the first mass is the x of the row's coordinates."""
    a, b = K_BLADE
    return np.array([[K_GROUND + a, -a, 0], [-a, a + b, -b], [0, -b, b]]), np.diag(MASSES)


def blisk():
    scene = ring(f"row.coupling.k_x={K_DISK}", 'parts.motion=["x"]', n=SECTORS)
    squares, shapes = eigh(*sector_matrices())
    phi = np.stack([shapes[0], 0 * shapes[0], 0 * shapes[0]])
    blades = js.modal_blades(np.sqrt(squares) / (2 * np.pi), 0.0, phi, blades=SECTORS)
    return dataclasses.replace(scene, blades=blades)


@pytest.mark.parametrize("closed", [True, False])
def test_accelerations_of_blades_in_a_flow_are_those_of_loops_over_them(closed):
    scene = ring(*SPRINGS, *FLOW, f"row.closed={str(closed).lower()}", "drive.F_0=0", "drive.M_0=0")
    model = lanes_last(jax.tree.map(lambda a: a[None], prepared_row(scene)))
    rng = np.random.default_rng(1)
    b = scene.blades
    omega = float(scene.drive.omega)
    q, v = rng.standard_normal((2, 3, N))
    apart = jnp.zeros((N if closed else N - 1, 1), jnp.int32)
    now = State(Motion(*map(jnp.asarray, [*q[..., None], *v[..., None]])), jnp.zeros(apart.shape), apart, apart)
    found = row_rhs((jnp.zeros(1), jnp.ones(1)), now, None, model, Recorded(), vmapped)[0].acceleration
    numbers = ((b.m, b.c_x, b.k_x), (b.m, b.c_y, b.k_y), (b.I, b.c_T, b.k_T))
    for n, (name, (m, c, k)) in enumerate(zip(K_C, numbers, strict=True)):
        for i in range(N):
            force = -float(k[i]) * q[n, i] - float(c[i]) * v[n, i]
            for j, of_flow in ((i, L["L0"]), (i + 1, L["L1"]), (i - 1, L["L_1"])):
                if closed or 0 <= j < N:
                    other = j % N
                    force += K_C[name] * (q[n, other] - q[n, i]) + C_C[name] * (v[n, other] - v[n, i])
                    if name == "x":
                        force -= of_flow.real * q[n, other] + of_flow.imag / omega * v[n, other]
            assert_allclose(found[n][i, 0], force / float(m[i]), rtol=1e-12)


@pytest.mark.published
def test_a_published_blisk_of_24_sectors_is_assembled_by_coupling(published):
    model = lanes_last(jax.tree.map(lambda a: a[None], prepared_row(blisk())))
    shape = (SECTORS, 1)
    wave, contact = (jnp.zeros(1), jnp.ones(1)), jnp.zeros(shape, jnp.int32)

    def accelerations(q):
        numbers = tuple(q.reshape(SECTORS, 3)[:, j : j + 1] for j in range(3))
        z = ModalMotion(numbers, jax.tree.map(jnp.zeros_like, numbers))
        now = State(z, jnp.zeros(shape), contact, contact)
        return jnp.concatenate(row_rhs(wave, now, None, model, Recorded(), vmapped)[0].acceleration, axis=1).ravel()

    linear = -jax.jit(jax.jacfwd(accelerations))(jnp.zeros(3 * SECTORS))
    found = np.sqrt(np.sort(np.linalg.eigvals(linear).real)) / (2 * np.pi)
    want = sorted(f for h, of in PRINTED.items() for f in of * (1 if h in (0, 12) else 2))
    nearest = [found[np.argmin(abs(found - f))] for f in want]
    assert_allclose(nearest, want, rtol=1e-9)  # of as many digits as are printed
    published("Blisk of 24 sectors", [nearest[want.index(f)] for f in PRINTED[0] + PRINTED[12]])
    # Control: without coupling every sector has the frequencies of a free one.
    assert abs(found[-1] - 619.34330474) > 1000


def test_the_response_of_such_sectors_is_that_of_the_assembled_matrices():
    scene = js.vary(blisk(), "drive.omega", 700.0)
    K, M = (block_diag(*[matrix] * SECTORS) for matrix in sector_matrices())
    disk = 3 * np.arange(SECTORS)
    for i, j in zip(disk, np.roll(disk, -1), strict=True):
        K[np.ix_([i, j], [i, j])] += K_DISK * np.array([[1, -1], [-1, 1]])
    load = np.zeros(3 * SECTORS, complex)
    load[disk] = np.asarray(scene.drive.harmonics()[1].F_x) * np.exp(1j * np.asarray(scene.drive.phase))
    want = np.linalg.solve(K - 700.0**2 * M, load)[disk]
    assert_allclose(response(scene).x, want, rtol=1e-10)
    assert np.all(eigh(K, M, eigvals_only=True) > 0)
