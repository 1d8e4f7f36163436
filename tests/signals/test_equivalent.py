"""The equivalent stiffness and damping of contact, against the element's closed form and by what they give back."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.xla import one_lane
from jaxshroud.results.power import sentences_of
from jaxshroud.signals.equivalent import (
    equivalent_contact,
    first_harmonics,
    joined_displacements,
    linear_blades,
)

pytestmark = pytest.mark.full

PLANE = ['parts.motion=["x", "y"]']
SERIES = js.Taylor(order=12, tolerance=1e-12, steps=200)
# A face almost along x, pressed by N = 1 whatever x does, and a mass so heavy for its drive that x is a sine.
ELEMENT = [
    *('parts.motion=["x", "y"]', "parts.neighbour=rigid", "shroud.alpha=1e-4", "shroud.gap=-1e5", "contact.k=0.1"),
    *("friction.k_d=1", "friction.mu=1", "blades.m=1", "blades.k_x=400", "blades.c_x=40", "blades.k_y=1e4"),
    *("blades.c_y=200", "drive.omega=40", "drive.beta=0", "drive.M_0=0", "drive.phase=[0, 0]"),
]


@pytest.mark.parametrize("F_0", [3000.0, 8000.0])
def test_an_elastic_friction_element_has_its_closed_form(F_0):
    scene = js.load("table1", [*ELEMENT, f"drive.F_0={F_0}"]).scene
    found = js.power(scene, n_periods=4, transient=64, amplitudes=True, method=SERIES)
    A, limit = float(found.x_peak[0]), 1.0  # its stretch at the limit: mu N / k_d
    angle = np.arccos(1 - 2 * limit / A)
    # The third harmonic of the force moves the mass by 1e-5 of A, and N varies by 1e-5.
    assert found.k_t == pytest.approx((angle - np.sin(2 * angle) / 2) / np.pi, rel=1e-4)
    assert found.c_t * 40 == pytest.approx(4 * limit * (A - limit) / (np.pi * A**2), rel=1e-4)
    told = found.summary()  # what was asked for is kept, and nothing else
    assert told["amplitudes"]["x_peak"] == pytest.approx(found.x_peak.tolist())
    assert told["loads"] == {}
    assert found.zeta_t == pytest.approx(found.c_t / 2 / np.sqrt(400 + found.k_t), rel=1e-6)
    # Controls: a stuck spring is far too stiff, a slider without a spring damps too much.
    assert found.k_t < 0.9
    assert found.c_t * 40 < 0.9 * 4 * limit / (np.pi * A)


@pytest.fixture(scope="module", params=["contact.gamma=2.5", "contact.gamma=0.3"])
def sampled(request):
    """The linear blades of a scene whose blocks do not turn, with samples of its motion, steps and contact."""
    scene, steps = js.load("fig09_best", [*PLANE, request.param]).scene, 400
    start = js.simulate(scene, n_periods=32, every=steps, method=js.RungeKutta(steps=steps)).last
    run = js.simulate(scene, start, n_periods=2, method=js.RungeKutta(steps=steps))
    rows = np.concatenate(run.motion, axis=-1)
    blades = linear_blades(one_lane(scene), 0)
    return blades, first_harmonics(rows, steps, blades.omega), equivalent_contact(blades, rows, steps)


def test_blades_joined_by_the_equivalents_move_as_the_first_harmonic(sampled):
    # By definition of the equivalents, up to what the motion gains over its two periods, which is not closed.
    blades, motion, contact = sampled
    dynamic = contact.stiffness + 1j * blades.omega * contact.damping
    mass, damping, stiffness = blades.free
    gained = mass * motion.acceleration + damping @ motion.rate + stiffness @ motion.q
    drive = np.where(blades.moves, blades.drive + blades.free.dynamic(blades.omega) @ motion.q - gained, 0.0)
    joined = joined_displacements(blades._replace(drive=drive), dynamic)
    size = np.abs(motion.q).max()
    # Both blocks feel opposite forces to the order of the samples, 1e-7 of the drive.
    np.testing.assert_allclose(joined, motion.q, rtol=0, atol=1e-5 * size)
    # Control: without the damping it is another motion.
    undamped = joined_displacements(blades._replace(drive=drive), contact.stiffness)
    assert np.abs(undamped - motion.q).max() > 1e-2 * size


SHORT = {"n_periods": 8, "transient": 32, "method": js.RungeKutta(steps=400)}


def test_losses_are_the_work_of_the_drive():
    found = js.power(js.load("fig09_best", [*PLANE, "contact.gamma=0.3"]).scene, **SHORT)
    stored = found.work_drive - found.loss_viscous - found.loss_friction
    # What is stored at the ends differs little from period to period, and not at all on an orbit.
    assert abs(stored) < 0.05 * found.work_drive
    assert found.loss_friction > 0.1 * found.work_drive
    share = 100 * found.loss_friction / (found.loss_friction + found.loss_viscous)
    assert found.mechanism.startswith(f"Of the drive's work {share:.3g} % is lost in friction")
    assert f"P_d = {found.P_d_stiffness:.4g} %" in found.mechanism
    assert sentences_of(found) == found.mechanism


def test_what_case_switches_give_is_told():
    # On an orbit nothing is stored: what the drive and the switches under load give is lost, to the march's balance.
    scene = js.load("table1", ["contact.gamma=0.3", "drive.M_0=1"]).scene
    found = js.power(scene, n_periods=16, transient=400, method=js.RungeKutta("dopri8", steps=400))
    assert found.final["period_number"] > 0
    lost = found.loss_viscous + found.loss_friction + found.loss_flat
    assert found.work_drive + found.work_switches == pytest.approx(lost, rel=1e-6)
    # Control: without them the balance misses.
    assert abs(found.work_drive / lost - 1) > 1e-5
    share = 100 * abs(found.work_switches) / found.work_drive
    assert (f"{share:.2g} %" in found.mechanism.partition("case switches under load")[2]) == (share >= 0.005)


@pytest.mark.parametrize(
    ("switches", "told"), [(0.0022, "give 0.22 %"), (-0.1, "take 10 %"), (4e-5, None), (0.0, None)]
)
def test_the_sentence_adds_up(switches, told):
    # The parts are of the drive's work: friction and dampers lose what it gives, and what the switches give.
    losses = {"loss_friction": 0.4 * (1 + switches), "loss_viscous": 0.6 * (1 + switches), "loss_flat": 0.0}
    words = sentences_of(SimpleNamespace(work_switches=switches, P_d_stiffness=None, **losses))
    shares = [100 * losses[name] for name in ("loss_friction", "loss_viscous")]
    assert words.startswith("Of the drive's work {:.3g} % is lost in friction, {:.3g} % in the dampers".format(*shares))
    assert ("case switches" in words) == (told is not None)
    assert told is None or f"case switches under load {told}." in words


NUMBERS = ("k_n", "k_t", "c_n", "c_t", "zeta_n", "zeta_t", "P_d_stiffness")


def test_faces_that_never_touch_have_no_equivalent():
    found = js.power(js.load("fig09_best", [*PLANE, "shroud.gap=1"]).scene, **SHORT | {"transient": 400})
    assert found.touches == 0
    assert all(np.isnan(getattr(found, name)) for name in NUMBERS)
    assert found.mechanism.endswith("No equivalent of contact: the faces never touch.")


# Pressed together by a millimetre, always stuck, and driven along the tangent alone, or along the normal as well.
PRESSED = [
    *('parts.motion=["x", "y"]', "shroud.alpha=90 deg", "shroud.gap=-1 mm", "contact.k=5e3", "friction.k_d=1e4"),
    *("friction.mu=50", "blades.m=1", "blades.k_x=1e3", "blades.c_x=5", "blades.k_y=1e3", "blades.c_y=20"),
    *("drive.omega=40", "drive.F_0=0.5", "drive.M_0=0", 'drive.phase=["0 deg", "180 deg"]'),
]


@pytest.mark.full
@pytest.mark.parametrize("beta", ["90 deg", "60 deg"])
def test_a_direction_along_which_nothing_moves_has_no_stiffness(beta):
    scene = js.load("table1", [*PRESSED, f"drive.beta={beta}"]).scene
    found = js.power(scene, **SHORT | {"transient": 64})
    # The springs of the faces themselves, up to what has not decayed of the start, 1e-11, and the order of the samples.
    assert found.touches == 1
    assert (found.k_t, found.c_t) == (pytest.approx(1e4, rel=1e-5), pytest.approx(0, abs=1e-3))
    still = beta == "90 deg"
    assert ("does not move along the normal" in found.mechanism) is still
    if still:  # rounding over rounding is no stiffness
        assert np.isnan([found.k_n, found.c_n, found.zeta_n]).all()
        free, joined = 1e3 - 40**2 + 1j * 40 * 20, 2e4 + 1e3 - 40**2 + 1j * 40 * 20
        assert found.P_d_stiffness == pytest.approx(100 * (1 - abs(free / joined) ** 2), rel=1e-6)
    else:
        assert found.k_n == pytest.approx(5e3, rel=1e-5)


MODES = f"blades.modes={Path(__file__).parents[2] / 'configs' / 'fem_blade.csv'}"


@pytest.mark.full(but=['parts.motion=["x"]'])
@pytest.mark.parametrize("parts", ['parts.motion=["x"]', "parts.contact=none", MODES])
def test_where_there_is_no_equivalent_the_reason_is_given(parts):
    found = js.power(js.load("fig09_best", [parts]).scene, **SHORT)
    assert np.isnan(found.k_n)
    assert np.isnan(found.P_d_stiffness)
    assert "it takes contact" in found.mechanism or found.mechanism == "Nothing is lost."


def test_a_mean_load_is_no_contact():
    apart = js.load("table1", ["shroud.gap=50 mm", "drive.F_x_mean=[5, -5]", "blades.c_x=100", "blades.c_y=200"]).scene
    blades = linear_blades(one_lane(apart), 0)
    np.testing.assert_array_equal(blades.mean, [5.0, -5.0, 0.0, 0.0, 0.0, 0.0])
    static, still = np.linalg.solve(blades.free.stiffness, blades.mean), np.zeros(6)
    rows = np.tile(np.concatenate([static, still]), (65, 1))
    assert not equivalent_contact(blades._replace(drive=0 * blades.drive), rows, 64).touches
    # Control: blades that do not feel it are held by a contact.
    assert equivalent_contact(blades._replace(drive=0 * blades.drive, mean=still), rows, 64).touches
