"""Blades that never touch: every number with contact is the number without, whatever drives the blades."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxshroud as js
from jaxshroud.scene.config import parse
from jaxshroud.signals.amplitudes import free_level
from jaxshroud.verbs.response import free_peak, peak_ratio

BASE = """
[blades]
m = 0.08
I = "block"
k_x = 1e5
k_y = 3e6
k_T = 2000.0
c_x = 8.0
c_y = 19.6
c_T = 0.506
B_x = 1.1
[shroud]
alpha = "60 deg"
l_oa = 0.05
l_ab = 0.035
gap = 0.5
[contact]
gamma = 2.6
[friction]
k_d = 1e6
mu = 0.5
[drive]
F_x_mean = 200
F_y_mean = 300
M_mean = 1.5
"""
ROWS = """
[row]
blades = {blades}
closed = true
[row.coupling]
k_x = 2e4
c_x = 0.3
k_T = 50.0
"""
FLOW = """
[row.aero]
L0 = [-300, 120]
L1 = [500, -700]
"""
RUN = "[run]\nperiods = 4\ntransient = 60\nsteps_per_period = 60\n"
LOADS = ((60.0, 30.0, 1.0, 0.0), (20.0, 40.0, -2.0, 100.0), (35.0, -20.0, 0.5, 250.0))
CLOSED = {"n_periods": 1, "transient": 1 << 15, "amplitudes": True}  # without stepping: what decays is gone
SLOW, FAST = 360.0, 720.0  # speeds of the drive, below and above the resonance of order 2 [rad/s]


def harmonics(key, orders):
    """The tables of harmonics with the loads of `LOADS`."""
    rows = zip(orders, LOADS, strict=False)
    return "".join(
        f'[[drive.harmonic]]\n{key} = {n}\nF = {F}\nbeta = "{beta} deg"\nM = {M}\nphase = "{psi} deg"\n'
        for n, (F, beta, M, psi) in rows
    )


def pair(orders, *changes, contact="none", motion='["x", "y", "theta"]'):
    """A pair under some orders and mean loads."""
    parts = f'[parts]\nmotion = {motion}\ncontact = "{contact}"\n'
    drive = 'speed = "536 rad/s"\nphase = ["0 deg", "160 deg"]\n'
    return parse(BASE + drive + harmonics("engine_order", orders) + parts + RUN, "pair.toml", changes)


def ring(orders, *changes, blades=3, flow=True, motion='["x", "y"]', sector=False):
    """A coupled ring under some engine orders and mean loads."""
    row = ROWS.format(blades=blades)
    row = row.replace("[row]", '[row]\nsector = "auto"') if sector else row
    drive = 'speed = "536 rad/s"\n'
    text = row + FLOW * flow + BASE + drive + harmonics("engine_order", orders)
    return parse(text + f"[parts]\nmotion = {motion}\n" + RUN, "ring.toml", changes)


def assert_free(found, atol=1e-16, rtol=1e-9):
    """The amplitudes and powers of a result are those without contact, and reductions are 0."""
    for name in ("x", "y", "theta"):
        for measure, free in (("peak", ""), ("rms", "_rms")):
            got, want = (np.asarray(getattr(found, f"{name}_{kind}")) for kind in (measure, f"free{free}"))
            assert_allclose(got, want, rtol, atol, err_msg=f"{name}_{measure}")
    of = "final_" if hasattr(found, "final_P") else ""
    if not hasattr(found, f"{of}P"):
        return
    assert_allclose(getattr(found, f"{of}P"), getattr(found, f"{of}P_0"), rtol)
    assert_allclose(getattr(found, f"{of}P_d"), 0.0, atol=100 * rtol)


DAMPED = ["blades.c_x=180", "blades.c_y=980", "blades.c_T=0.4"]  # critically: no start is left after a period


def test_a_run_without_contact_has_the_amplitudes_of_three_orders_and_means():
    # Cubics through 1,000 samples a period miss 1e-9 where order 3 swings most.
    found = js.simulate(pair((1, 2, 3), *DAMPED), n_periods=8, method=js.RungeKutta(steps=1000))
    assert_free(found, rtol=1e-8)
    # the control: means and magnitudes, added as if all peaked together
    assert np.all(found.x_free < 0.9 * (np.abs(found.x_mean) + np.sqrt(2) * found.x_rms))


@pytest.mark.parametrize("of", ["x_peak", "x_rms"])
def test_the_free_peak_of_two_orders_is_that_known_from_outside(of):
    found = free_peak(two_orders().scene, "drive.omega", 400.0, 700.0, of)
    assert found.amplitude == pytest.approx(KNOWN[of], rel=1e-5)  # of six digits


def two_orders(*changes, motion='["x"]'):
    """Orders 1 and 2 as sines beside a mean load, of opposite blades."""
    text = BASE.replace("B_x = 1.1\n", "").replace("F_y_mean = 300\nM_mean = 1.5\n", "")
    loads = "".join(f'[[drive.harmonic]]\norder = {n}\nF = {F}\nbeta = "30 deg"\n' for n, F in ((1, 60), (2, 20)))
    drive = f'omega = 536\nphase = ["0 deg", "180 deg"]\n{loads}'
    return parse(f"{text}{drive}[parts]\nmotion = {motion}\n{RUN}", "free.toml", changes)


KNOWN = {"x_peak": 2.62749e-3, "x_rms": 1.45510e-3}  # of its left blade from 400 to 700 rad/s, by integration [m]


@pytest.mark.full(but=["orders0"])
@pytest.mark.parametrize("orders", [(1,), (1, 2, 3)])
def test_a_sweep_without_contact_has_its_closed_form(orders):
    # It samples its own course, harmonics, what decays and all, and polishes what it finds.
    assert_free(js.sweep(pair(orders), {"drive.omega": [SLOW, 536.0, FAST]}, **CLOSED))


@pytest.mark.full
@pytest.mark.parametrize(("orders", "options"), [((1, 2), {}), ((3, 6), {"blades": 6, "sector": True, "flow": False})])
def test_a_ring_apart_has_its_closed_form(orders, options):
    found = js.power(ring(orders, **options), linear="apart", amplitudes=True, n_periods=1, transient=0)
    assert_free(found)


@pytest.mark.full
@pytest.mark.parametrize("of", ["x_peak", "x_rms"])
def test_a_response_stands_against_its_own_free_peak(of):
    found = js.response(two_orders().scene, "drive.omega", 400.0, 700.0, num=13, of=of, linear="apart")
    (row,) = found.peaks
    assert row["amplitude"] == pytest.approx(KNOWN[of], rel=1e-5)
    # Both are placed to 1e-6 of the frequency or better, where the amplitude is flat.
    assert row["ratio"] == pytest.approx(1, rel=1e-9)
    assert row["shift"] == pytest.approx(0, abs=1e-6)
    dotted = found.data["x_free" if of == "x_peak" else "x_free_rms"].to_numpy()
    assert_allclose(dotted, found.data[of].to_numpy(), rtol=1e-9)


@pytest.mark.full
def test_the_data_sheet_tells_the_amplitudes_of_a_run():
    file = pair((1, 2, 3))
    found, sheet = js.sweep(file, {"drive.omega": [536.0]}, **CLOSED), js.check(file)
    for name, own in sheet.coordinates.items():
        assert_allclose(own.amplitude, getattr(found, f"{name}_peak")[0], rtol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("of", ["x_peak", "y_rms", "x_mean", "P"])
def test_a_level_without_contact_is_that_of_a_run(of):
    file = pair((1, 2))
    found = js.sweep(file, {"drive.omega": [536.0]}, **CLOSED)
    assert free_level(of, file.scene) == pytest.approx(abs(getattr(found, of)[0, 0]), rel=1e-9)


MARCH = js.RungeKutta("dopri8", steps=500)  # between steps, cubics miss (2 pi 2 / 500)^4 / 384 of a peak, 1e-9
SETTLED = {"n_periods": 4, "transient": 20, "method": MARCH}
FADING = ["blades.c_x=40", "blades.c_y=200", "blades.c_T=0.05"]  # by exp(-2.9) in a period of the slowest: x


@pytest.fixture(scope="module")
def pressed_nowhere():
    """A pair with contact by springs and a gap that it never closes."""
    return pair((1, 2), *FADING, contact="spring", motion='["x", "y"]')


@pytest.mark.full
def test_marches_that_never_touch_tell_no_reduction(pressed_nowhere):
    assert_free(js.power(pressed_nowhere, amplitudes=True, **SETTLED), rtol=1e-8)
    assert_free(js.table(pressed_nowhere, {"friction.mu": [0.2, 0.4]}, **SETTLED), rtol=1e-8)


@pytest.mark.full
def test_peak_stands_against_peak_in_a_report(pressed_nowhere):
    found = peak_ratio(pressed_nowhere.scene, "drive.omega", 500.0, 600.0, "x_peak", SETTLED)
    # Sweeps place a peak to 1e-2 of its width, where an amplitude is flat to 1e-4.
    assert found is not None
    assert found.contact.amplitude / found.free.amplitude == pytest.approx(1, abs=1e-4)


@pytest.mark.full
@pytest.mark.parametrize("of", ["x_peak", "y_rms"])
def test_a_tuned_amplitude_is_reduced_by_nothing(pressed_nowhere, of):
    search = js.SearchOptions(scan=2, n_starts=1, updates=1)
    tuned = js.tune(pressed_nowhere, {"friction.mu": (0.1, 0.4)}, of=of, search=search, **SETTLED)
    assert_allclose(tuned.scanned_scores, 0.0, atol=1e-6)
    assert tuned.level == pytest.approx(tuned.free, rel=1e-8)


@pytest.mark.full
def test_scattered_designs_that_never_touch_are_reduced_by_nothing(pressed_nowhere):
    found = js.scatter(pressed_nowhere, {"friction.mu": 0.1}, linear="apart", draws=4, n_periods=1, transient=0)
    assert_allclose(found.P_d, 0.0, atol=1e-7)


@pytest.mark.full
@pytest.mark.parametrize("options", [{"motion": '["x", "y", "theta"]'}, {"blades": 4, "sector": True}])
def test_marched_rings_that_never_touch_tell_no_reduction(options):
    file = ring((2, 4) if "sector" in options else (1, 2), *FADING, flow="sector" not in options, **options)
    assert_free(js.power(file, amplitudes=True, **SETTLED), rtol=1e-8)


@pytest.mark.full
def test_marched_blades_by_modes_that_never_touch_tell_no_reduction():
    scene = ring((1, 2), flow=False, motion='["x", "y", "theta"]').scene
    phi = np.array([[3.5, 2.0, 0.1], [0.0, 4.0, -2.0], [3.0, -15.0, 20.0]])
    blades = js.modal_blades([170.0, 500.0, 900.0], 0.2, phi, blades=scene.layout.blades)  # no start is left
    assert_free(js.power(dataclasses.replace(scene, blades=blades), amplitudes=True, **SETTLED), rtol=1e-8)
