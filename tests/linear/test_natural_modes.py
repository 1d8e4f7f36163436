"""Natural modes of blades apart and in contact, against numbers by hand and the model's own right-hand side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from pair_views import rates_in

from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.row import prepared_row
from jaxshroud.scene.config import load
from jaxshroud.scene.keys import Motion
from jaxshroud.verbs.check import check

TWO_PI = 2 * np.pi
IN_PLANE = 'parts.motion=["x", "y"]'
UNALIKE = [
    *("blades.m=[0.08, 0.11]", "blades.I=[2.46e-5, 4e-5]", "blades.k_x=[1e5, 2e5]", "blades.k_T=[2000, 900]"),
    *("shroud.gap=0", "shroud.alpha=50 deg"),
]


def frequencies(sheet, contact):
    """The natural frequencies in one state of contact [Hz]."""
    return np.array([mode.frequency for mode in sheet.modes if mode.contact == contact])


def by_hand(factor, sign=-1.0, m=0.08, alpha=np.pi / 3, k=2.5e5, k_d=1e6):
    """Frequencies [Hz] of Table 1's blade with `factor` K_c beside its own springs, K_c = k n n' + k_d t t'."""
    n, t = np.array([np.sin(alpha), sign * np.cos(alpha)]), np.array([np.cos(alpha), np.sin(alpha)])
    K = np.diag([1e5, 3e6]) + factor * (k * np.outer(n, n) + k_d * np.outer(t, t))
    return np.sqrt(np.linalg.eigvalsh(K) / m) / TWO_PI


@pytest.mark.full
def test_a_pair_in_phase_is_free_and_out_of_phase_has_twice_the_contact():
    # The relative displacement of blades out of phase is twice their own; in phase it is zero. The frequencies are
    # those of a ring of four at nodal diameters 0 and 1, as known: 177.94, 974.62 and 522.69, 1224.71 Hz.
    sheet = check(load("table1", [IN_PLANE]))
    assert_allclose(by_hand(2.0), [522.69, 1224.71], atol=0.005)
    expected = np.sort([*by_hand(0.0), *by_hand(2.0)])
    assert_allclose(frequencies(sheet, "stuck"), expected, rtol=1e-12)  # rounding
    phases = [mode.blades for mode in sheet.modes if mode.contact == "stuck"]
    assert phases == ["in phase", "out of phase", "in phase", "out of phase"]
    # Control: with the sign of n as the article prints it, n = (sin alpha, cos alpha), they are 11 % and 1.9 % off.
    assert np.abs(by_hand(2.0, sign=1.0) / by_hand(2.0) - 1).min() > 0.015


def test_beside_a_rigid_block_a_blade_has_the_contact_once():
    sheet = check(load("table1", [IN_PLANE, "parts.neighbour=rigid"]))
    assert_allclose(frequencies(sheet, "stuck"), by_hand(1.0), rtol=1e-12)
    assert_allclose(frequencies(sheet, "sliding"), by_hand(1.0, k_d=0.0), rtol=1e-12)
    assert {mode.blades for mode in sheet.modes} == {"left"}


@pytest.mark.parametrize(
    ("overrides", "contacts"),
    [
        ([], ["apart", "sliding", "stuck", "corner"]),
        ([IN_PLANE], ["apart", "sliding", "stuck"]),
        (["friction.mu=0"], ["apart", "sliding"]),
        (["friction.k_d=0"], ["apart", "sliding"]),
        (["contact.k=0"], ["apart"]),  # nothing presses, so that nothing rubs
        (["parts.friction=none"], ["apart", "sliding"]),
        (["parts.contact=none"], ["apart"]),
    ],
)
def test_only_what_the_model_has_is_told(overrides, contacts):
    modes = check(load("table1", overrides)).modes
    assert list(dict.fromkeys(mode.contact for mode in modes)) == contacts
    assert {mode.motion for mode in modes if mode.contact == "apart"} == (
        {"x", "y"} if IN_PLANE in overrides else {"x", "y", "theta"}
    )


def jacobian(scene, case):
    """d(accelerations)/d(displacements, rates) of the model's own right-hand side by central differences (6, 12).

    The blocks are where their upper corners begin to touch, so that the normal force is zero; they stick.
    """
    row = prepared_row(scene)
    zero, codes = jnp.zeros(()), (jnp.asarray(int(Mode.STICK)), jnp.asarray(case))

    @jax.jit
    def accelerations(z):
        motion = Motion(*((z[i], z[i + 1]) for i in range(0, 12, 2)))
        return jnp.stack([a for pair in rates_in(State(motion, zero, *codes), row).acceleration for a in pair])

    steps = np.eye(12) * 1e-6
    return np.array([(accelerations(step) - accelerations(-step)) / 2e-6 for step in steps]).T


def eigenvalues(J, turning_together):
    """The eigenvalues [rad/s] of the first-order system, one of each conjugate pair, by ascending magnitude."""
    if turning_together:  # one angle for both blocks, which the right-hand side gives both
        both = np.zeros((12, 10))
        both[:4, :4], both[4:6, 4], both[6:10, 5:9], both[10:, 9] = np.eye(4), 1, np.eye(4), 1
        J, size = (J @ both)[:5], 5
    else:
        size = 6
    first_order = np.block([[np.zeros((size, size)), np.eye(size)], [J]])
    values = np.linalg.eigvals(first_order)
    return sorted(values[values.imag > 0], key=abs)


@pytest.mark.parametrize(("contact", "case"), [("stuck", FLAT), ("corner", 1)])
def test_the_modes_are_those_of_the_right_hand_side(contact, case):
    # Without damping the eigenvalues are i omega. Where the force vanishes, so do the second derivatives of a corner's
    # place that central differences would see: 6e-14 is seen.
    free = [f"blades.c_{name}=0" for name in "xyT"]
    scene = load("table1", [*UNALIKE, *free])
    values = np.array(eigenvalues(jacobian(scene.scene, case), contact == "stuck"))
    assert np.abs(values.real).max() < 1e-10 * np.abs(values).min()
    assert_allclose(frequencies(check(scene), contact), np.abs(values) / TWO_PI, rtol=1e-10)
    # Control: without the levers of the contact, as for x and y alone, at least one frequency is 1 % off.
    in_plane = frequencies(check(load("table1", [*UNALIKE, *free, IN_PLANE])), "stuck")
    nearest = np.abs(in_plane[:, None] * TWO_PI / np.abs(values) - 1).min(axis=1)
    assert nearest.max() > 0.01


def test_damping_ratios_are_those_of_the_right_hand_side_to_first_order():
    # Modes that damping couples have ratios that differ by its square, 1e-6 for 1e-3 of the critical one.
    light = ["blades.c_x=0.2", "blades.c_y=1", "blades.c_T=5e-4"]
    scene = load("table1", [*UNALIKE, *light])
    values = np.array(eigenvalues(jacobian(scene.scene, 1), turning_together=False))
    zeta = [mode.zeta for mode in check(scene).modes if mode.contact == "corner"]
    assert_allclose(zeta, -values.real / np.abs(values), rtol=1e-5)
    assert max(zeta) > 1e-4  # control: there is something to compare


def test_unalike_blades_apart_have_modes_of_their_own():
    sheet = check(load("table1", UNALIKE))
    told = {(mode.motion, mode.blades): mode.frequency for mode in sheet.modes if mode.contact == "apart"}
    expected = {
        (name, side): coordinate.frequency[i]
        for name, coordinate in sheet.coordinates.items()
        for i, side in enumerate(("left", "right"))
    }
    assert told == pytest.approx(expected, rel=1e-12)


def test_the_drive_is_shared_among_the_modes():
    # Free blades: cos^2(beta) goes into x and sin^2(beta) into y. Blades driven in antiphase do not move in phase.
    sheet = check(load("table1", [IN_PLANE]))
    apart = {mode.motion: mode.driven for mode in sheet.modes if mode.contact == "apart"}
    assert apart == pytest.approx({"x": 0.75, "y": 0.25})
    for contact in ("sliding", "stuck"):
        modes = [mode for mode in sheet.modes if mode.contact == contact]
        assert sum(mode.driven for mode in modes) == pytest.approx(1)
        assert all((mode.driven < 1e-12) == (mode.blades == "in phase") for mode in modes)
