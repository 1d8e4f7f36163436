"""Marches of coupled blades: against plain integrations, their energy, free decays and a limit cycle."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from quotients import assert_tangents_by_keys
from scipy.integrate import solve_ivp

import jaxshroud as js

SOFT = ("contact.gamma=0.01", "friction.k_d=100", "shroud.gap=1")  # which never closes, and asks for no short steps
SPRINGS = ("coupling.k_x=2e4", "coupling.k_T=80", "coupling.c_x=1", "coupling.c_y=3", "coupling.c_T=0.05")
AERO = {"L0": -300 + 120j, "L1": 500 - 700j, "L_1": -200 + 900j}
FLOW = tuple(f"row.aero.{name}=[{value.real}, {value.imag}]" for name, value in AERO.items())
METHOD, PERIODS = js.RungeKutta("dopri8", 400), 2
BY_SERIES = js.Taylor(tolerance=1e-13)
DIFFERENTIATED = js.RungeKutta("dopri8", 800)


def plain_end(scene, t_end, flow):
    """x, y and theta of all blades (3, N) after a time, by DOP853 and loops over blades, and its drive's work."""
    b, drive, coupling, row = scene.blades, scene.drive, scene.coupling, scene.row
    n, closed = scene.layout.blades, row is not None and row.closed
    of = lambda a: np.broadcast_to(np.zeros(1) if a is None else np.asarray(a, float), (n if closed else n - 1,))
    own = [
        [np.asarray(a, float) for a in one] for one in ((b.m, b.c_x, b.k_x), (b.m, b.c_y, b.k_y), (b.I, b.c_T, b.k_T))
    ]
    between = [[of(getattr(coupling, f"{kind}_{s}")) for kind in "ck"] for s in "xyT"]
    load = drive.harmonics()[1]
    loads, phase, omega = (
        [np.asarray(load.load(q)) for q in ("x", "y", "theta")],
        np.asarray(drive.phase),
        float(drive.omega),
    )

    def rhs(t, z):
        q, v = z.reshape(2, 3, n)
        a = np.zeros((3, n))
        for k in range(3):
            m, c, stiffness = own[k]
            force = loads[k] * np.sin(omega * t + phase) - c * v[k] - stiffness * q[k]
            for j in range(n if closed else n - 1):
                i = (j + 1) % n
                pull = between[k][1][j] * (q[k, i] - q[k, j]) + between[k][0][j] * (v[k, i] - v[k, j])
                force[j] += pull
                force[i] -= pull
            for i in range(n if k == 0 and flow else 0):
                for L, to in zip(flow, (i, i + 1, i - 1), strict=True):
                    if closed or 0 <= to < n:
                        force[i] -= L.real * q[0, to % n] + L.imag / omega * v[0, to % n]
            a[k] = force / m
        return np.concatenate([v.ravel(), a.ravel()])

    start = np.array([np.asarray(a, float) for a in scene.initial]).ravel()
    return solve_ivp(rhs, (0, t_end), start, "DOP853", rtol=1e-13, atol=1e-20).y[: 3 * n, -1].reshape(3, n)


START = ("initial.x=[1e-5, -2e-5, 3e-5]", "initial.v_theta=[0.1, 0, -0.2]")


@pytest.mark.full
@pytest.mark.parametrize("method", [METHOD, BY_SERIES], ids=["dopri8", "series"])
@pytest.mark.parametrize(
    ("name", "changes", "flow"),
    [
        ("row_ring12", ("row.blades=3", *START, *FLOW), AERO.values()),
        ("row_ring12", ("row.blades=3", "row.closed=false", *START, *FLOW), AERO.values()),
        ("table1", ("initial.x=[1e-5, -2e-5]",), ()),
    ],
    ids=["ring", "chain", "pair"],
)
def test_a_march_without_contact_is_that_of_a_plain_integrator(name, changes, flow, method):
    order = ["drive.engine_order=1"] if name == "row_ring12" else []
    scene = js.load(name, [*order, *changes, *SPRINGS, *SOFT, "blades.I=2.46e-3", "drive.M_0=0.3"]).scene
    run = js.simulate(scene, n_periods=PERIODS, method=method)
    found = np.array([np.asarray(getattr(run.motion, q))[-1] for q in ("x", "y", "theta")])
    want = plain_end(scene, PERIODS * float(scene.drive.period), flow)
    error = np.max(np.abs(found - want), axis=1) / np.max(np.abs(want), axis=1)
    assert np.all(error < 1e-10), error
    assert abs(run.energy_residual) < 1e-9  # over the work of the drive
    # Control: a plain integrator without the springs is elsewhere.
    bare = js.load(name, [*order, *changes, *SOFT, "blades.I=2.46e-3", "drive.M_0=0.3"]).scene
    assert np.max(np.abs(plain_end(bare, PERIODS * float(scene.drive.period), ()) - want)) > 1e-3 * np.max(np.abs(want))


@pytest.mark.full
def test_a_coupled_pair_of_turning_blocks_is_a_chain_of_two_and_marches_by_series():
    # The light block of a pair turns; contact is flat for a while, so that energy drops where its faces join.
    pair = js.load("table1", [*SPRINGS, "drive.M_0=0.3"])
    run = js.simulate(pair, n_periods=PERIODS, method=js.RungeKutta("dopri8", 1600))
    assert run.counters["separation"] > 2
    assert abs(run.energy_residual) < 1e-9
    series = js.simulate(pair, n_periods=PERIODS, method=js.Taylor())
    assert abs(series.energy_residual) < 1e-9
    assert_allclose(np.asarray(series.motion.x)[-1], np.asarray(run.motion.x)[-1], rtol=1e-7)
    row = js.load("table1", ["row.blades=2", *SPRINGS, "drive.M_0=0.3"])
    chain = js.simulate(row, n_periods=PERIODS, method=js.RungeKutta("dopri8", 1600))
    assert_allclose(np.asarray(chain.motion.x)[-1], np.asarray(run.motion.x)[-1], rtol=1e-9)
    assert abs(chain.energy_residual) < 1e-9


@pytest.mark.full
def test_the_energy_of_a_coupled_ring_in_a_flow_balances():
    scene = js.load("row_ring12", ["row.blades=3", "drive.engine_order=1", *SPRINGS, *FLOW, "blades.I=2.46e-3"])
    run = js.simulate(scene, n_periods=3, method=js.RungeKutta("dopri8", 1600))
    assert np.min(run.counters["separation"]) > 1
    assert abs(run.energy_residual) < 1e-9
    series = js.simulate(scene, n_periods=3, method=js.Taylor(tolerance=1e-12, steps=1600))
    assert abs(series.energy_residual) < 1e-9
    assert_allclose(series.motion.x[-1], run.motion.x[-1], rtol=1e-8)


RING = ("row.blades=6", "drive.engine_order=1", 'parts.motion=["x"]', "blades.c_x=1", "coupling.k_x=1e4", *SOFT)
FEEDING = (
    "row.aero.L0=[0, 1000]",
    "row.aero.L1=[-1500, -600]",
    "row.aero.L_1=[1500, -600]",
    "drive.F_0=0",
    "drive.M_0=0",
)


@pytest.mark.full
def test_free_decays_have_the_damping_of_each_nodal_diameter():
    scene = js.load("row_ring12", [*RING, *FEEDING]).scene
    told = {mode.nodal_diameter: mode for mode in js.check(scene).flow_modes}
    assert [*told] == [-2, -1, 0, 1, 2, 3]
    place = np.arange(6)
    for h in (-2, 0, 1, 3):
        mode = told[h]
        size = 2 * np.pi * mode.frequency
        root = complex(-mode.zeta * size, size * np.sqrt(1 - mode.zeta**2))
        wave = 1e-5 * np.exp(2j * np.pi * h * place / 6)
        start = js.vary(js.vary(scene, "initial.x", wave.real), "initial.v_x", (root * wave).real)
        run = js.simulate(start, n_periods=4, method=js.RungeKutta("dopri8", 100))
        late = np.asarray(run.t)[-1]
        want = (wave * np.exp(root * late)).real
        # An error of the damping ratio of 1e-6 over some 14 radians is one of 1e-5 of the wave.
        assert_allclose(np.asarray(run.motion.x)[-1], want, rtol=0, atol=1e-7 * abs(wave[0] * np.exp(root.real * late)))
    assert told[1].zeta < 0 < told[-1].zeta


def test_check_tells_what_the_flow_feeds():
    sheet = js.check(js.load("row_ring6_flutter"))
    # By the definition at the frequency of the drive, that of the wave: Im L_h over twice its stiffness.
    wave = {mode.nodal_diameter: mode for mode in sheet.flow_modes}[1]
    L_h = 1000j + (-1500 - 600j) * np.exp(1j * np.pi / 3) + (1500 - 600j) * np.exp(-1j * np.pi / 3)
    assert wave.zeta_flow == pytest.approx(L_h.imag / (2 * 0.08 * (2 * np.pi * wave.frequency) ** 2), rel=2e-3)
    assert any("the flow feeds the blades: 1 of 6 waves grow" in doubt for doubt in sheet.doubts)
    assert not any("do not come near enough" in doubt for doubt in sheet.doubts)
    mistuned = js.check(js.load("row_ring6_flutter", ["row.mistuning=[0.03, -0.02, 0.01, -0.03, 0.02, 0]"]))
    assert [mode.nodal_diameter for mode in mistuned.flow_modes] == [None] * 6
    # Mistuning averages what the flow gives and takes: the sum of all rates of decay stays.
    rates = lambda of: sum(mode.zeta * mode.frequency for mode in of.flow_modes)
    assert rates(mistuned) == pytest.approx(rates(sheet), rel=1e-9)
    assert min(mode.zeta for mode in mistuned.flow_modes) > min(mode.zeta for mode in sheet.flow_modes)


@pytest.mark.full
def test_contact_bounds_a_wave_that_the_flow_feeds():
    file = js.load("row_ring6_flutter", ["initial.x=[90 um, 45 um, -45 um, -90 um, -45 um, 45 um]"])
    run = js.simulate(file, n_periods=60, method=js.RungeKutta("rk4", 100))
    largest = lambda x, a, b: np.max(np.abs(x[int(a * len(x)) : int(b * len(x))]))
    x = np.asarray(run.motion.x)
    end = largest(x, 0.9, 1)
    assert end == pytest.approx(largest(x, 0.8, 0.9), rel=2e-3)
    assert 0.1e-3 < end < 0.13e-3  # a little beyond the gap
    assert abs(run.energy_residual) < 1e-5
    assert np.sum(run.loss_friction) > 0
    assert run.loss_viscous < 0  # what the dampers and the flow take
    # Control: with gaps that never close the same wave grows on.
    free = js.simulate(js.vary(file.scene, "shroud.gap", 1.0), n_periods=60, method=js.RungeKutta("rk4", 100))
    assert np.max(np.abs(np.asarray(free.motion.x)[-100:])) > 2 * end


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "changes", "keys"),
    [
        ("table1", ('parts.motion=["x", "y"]', "coupling.k_y=1e5"), ("coupling.k_x", "coupling.k_y", "coupling.c_x")),
        (
            "row_ring12",
            ("row.blades=3", "drive.engine_order=1", *FLOW),
            ("coupling.k_x[1]", "aero.L1_re", "aero.L_1_im"),
        ),
    ],
)
def test_tangents_by_numbers_of_coupling_are_those_of_differences(name, changes, keys):
    scene = js.load(name, [*changes, *SPRINGS, "drive.M_0=0.3", "blades.I=2.46e-3"]).scene
    assert_tangents_by_keys(scene, keys, DIFFERENTIATED, 1e-5)
