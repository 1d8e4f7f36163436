"""Cases that others have published: one mass, chains and beams by their modes; see published.py and docs/validation.md.

A face at 90 degrees is a wall across x, along which y slides; `neighbour = "rigid"` holds the other side.
"""

import dataclasses
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from published import CASES, OURS, PAGE, cells, numbers_shown, rows
from scipy.linalg import eigh

import jaxshroud as js

ROOT = PAGE.parent.parent
MASS = ("shroud.alpha=90 deg", "drive.F_0=0", "drive.F_x_mean=0", "initial.v_x=0")
SLIDER = ("shroud.alpha=90 deg", "shroud.gap=-1", "contact.k=10", "blades.m=1e12", "blades.m_y=1", "drive.beta=90 deg")
BLADES = ('parts.motion=["x"]', "drive.M_0=0", "drive.engine_order=1", "row.mistuning=0")


def dopri8(steps):
    return js.RungeKutta("dopri8", steps=steps)


def mass_at_a_wall(*numbers, neighbour="rigid"):
    parts = ('parts.motion=["x"]', "parts.friction=none", f"parts.neighbour={neighbour}")
    return js.load("griffin", [*parts, *MASS, *numbers]).scene


def block_under_friction(*numbers):
    """A block that y moves; it is so heavy along x that its normal force stays 10 N."""
    return js.load("griffin", ['parts.motion=["x", "y"]', "friction.mu=0.1", *SLIDER, *numbers]).scene


def contacts(run):
    """The instants at which contact begins and ends, in turn."""
    return run.events.t[::2]


@pytest.mark.published
@pytest.mark.full
def test_a_mass_is_thrown_against_a_wall(published):
    scene = mass_at_a_wall("blades.m=100", "blades.k_x=1e4", "shroud.gap=0", "contact.k=1e6", "initial.v_x=1")
    run = js.simulate(js.vary(scene, "drive.f", 2.0), n_periods=1, method=dopri8(10_000), events=True)
    late = run.t > 0.1
    onset, separation = contacts(run)[:2]
    published("SDND101a", [run.N.max(), separation - onset, run.t[late][run.N[late].argmax()]])


@pytest.mark.published
@pytest.mark.full
def test_a_wall_is_a_blade_in_antiphase(published):
    m, k, omega = 25.0, 98696.0, 20 * np.pi
    c = 0.14 * np.sqrt(k * m)
    force = -(k + 1j * omega * c) / omega**2  # of the base, which moves by -sin(omega t) / omega^2
    shared = [f"blades.m={m}", f"blades.k_x={k}", f"blades.c_x={c}", f"drive.omega={omega}", f"drive.F_0={abs(force)}"]
    phase, v_x = np.angle(force), 1 / omega
    wall = [f"drive.phase={phase}", f"initial.v_x={-v_x}", "shroud.gap=0.5e-3", "contact.k=5.76e7"]
    blade = [f"drive.phase=[{phase}, {phase + np.pi}]", f"initial.v_x=[{-v_x}, {v_x}]"]
    blade += ["shroud.gap=1e-3", "contact.k=2.88e7"]
    x = [
        js.simulate(mass_at_a_wall(*shared, *of, neighbour=name), n_periods=10, method=dopri8(1000)).motion.x[..., 0]
        for name, of in (("rigid", wall), ("blade", blade))
    ]
    assert_allclose(x[1], x[0], rtol=0, atol=1e-12)
    at = np.round(10_000 * np.array([0.05, 0.156, 0.25, 0.4, 0.5, 0.8, 0.9, 1.0])).astype(int)
    published("SDND102a", 1e6 * x[0][at])


@pytest.mark.published
@pytest.mark.full
def test_friction_stops_a_block(published):
    # Theirs is rigid friction, of which a stiff friction spring is the limit.
    scene = block_under_friction("blades.k_y=1e4", "friction.k_d=4e8", "initial.y=0.85e-3", "drive.F_0=0")
    run = js.simulate(js.vary(scene, "drive.omega", 100.0), n_periods=2, method=dopri8(8000))
    published("SDND100a", 1e6 * run.motion.y[4000::4000, 0] / np.sqrt(2))


@pytest.mark.published
@pytest.mark.full
def test_a_shaken_block_wears(published):
    scene = block_under_friction("blades.k_y=3e-5", "friction.k_d=9e6", "drive.f=1")
    accelerations = {"drive.F_0": [15.0, 1.5, 1.01, 0.99]}
    run = js.sweep(scene, accelerations, n_periods=8, transient=4, method=dopri8(10_000), forces=True)
    published("SDND104a", 10 * run.slip)


@pytest.mark.published
@pytest.mark.full
def test_a_mass_bounces(published):
    scene = mass_at_a_wall("blades.m=1", "blades.k_x=1e-9", "shroud.gap=2", "contact.k=100", "initial.v_x=1")
    falling = js.vary(js.vary(scene, "drive.F_x_mean", 10.0), "drive.f", 10.0)
    run = js.simulate(falling, n_periods=11, method=dopri8(200), events=True)
    published("SDND108a", [*contacts(run), *run.motion.x[[2000, 2200], 0]])


@pytest.mark.published
@pytest.mark.full
def test_a_bilinear_oscillator_is_free(published):
    energy, k, stop, gap = 0.00650108331626, 10.0, 50.0, 0.01
    start = f"initial.x={-np.sqrt(2 * energy / k)}"
    scene = mass_at_a_wall(f"blades.k_x={k}", f"shroud.gap={gap}", f"contact.k={stop}", start)
    run = js.simulate(js.vary(scene, "drive.f", 0.5), n_periods=1, method=dopri8(1000), events=True)
    ours = 1 / contacts(run).sum()
    published("SDND122a", [ours])
    free = (np.pi + 2 * np.arcsin(gap * np.sqrt(k / (2 * energy)))) / np.sqrt(k)
    speed = np.sqrt(2 * energy - k * gap**2)
    omega = np.sqrt(k + stop)
    stopped = 2 * np.arctan2(speed, k * gap / omega) / omega
    assert ours == pytest.approx(1 / (free + stopped), rel=1e-6)


@pytest.fixture(scope="module")
def chain():
    """Eight masses of 10 kg between springs of 1e5 N/m and dampers of 50 N s/m, a force of 1 N on the fourth."""
    ends = lambda outer, inner: str([outer, *[inner] * 6, outer])
    coupling = ("row.coupling.k_x=1e5", "row.coupling.c_x=50", "blades.m=10")
    held = (f"blades.k_x={ends(1e5, 1e-3)}", f"blades.c_x={ends(50, 0)}")
    driven = ("drive.F_0=[0, 0, 0, 1, 0, 0, 0, 0]", "drive.beta=0", "shroud.gap=1")
    return js.load("row_ring12", ["row.blades=8", "row.closed=false", *BLADES, *coupling, *held, *driven]).scene


@pytest.mark.published
@pytest.mark.full
def test_a_chain_of_eight_masses(chain, published):
    published("SDLD02a", [mode.frequency for mode in js.check(chain).modes if mode.contact == "apart"])
    frequencies = {"drive.f": [5.0, 5.5, 40.0]}
    run = js.sweep(chain, frequencies, linear="apart", n_periods=1, transient=0, amplitudes=True)
    published("SDLD21a", 1e6 * np.sqrt(2) * run.x_rms[:, 3])


def beam_modes(bending, mass, free, at):
    """Squares of five natural frequencies of a beam of ten elements, 1 m long, and their shapes at an unknown."""
    length = 0.1
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) * bending / length**3
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * mass * length / 420
    scale = np.diag([1, length, 1, length])
    K, M = np.zeros((2, 22, 22))
    for i in range(0, 20, 2):
        K[i : i + 4, i : i + 4] += scale @ k @ scale
        M[i : i + 4, i : i + 4] += scale @ m @ scale
    squares, shapes = eigh(K[free, free], M[free, free])
    return squares[:5], shapes[at - free.start, :5]


def modal_chain(count, modes, *numbers):
    size = (f"row.blades={count}", *BLADES, "parts.friction=none", "shroud.alpha=90 deg", "drive.F_0=0")
    scene = js.load("row_chain5", [*size, *numbers]).scene
    squares, shape = modes
    phi = np.stack([shape, 0 * shape, 0 * shape])
    blades = js.modal_blades(np.sqrt(squares) / (2 * np.pi), 0.0, phi, blades=count)
    return dataclasses.replace(scene, blades=blades)


@pytest.mark.published
@pytest.mark.full
def test_three_tubes_hit_each_other(published):
    outer, inner = 0.1, 0.09
    tube = 1e10 * np.pi / 4 * (outer**4 - inner**4), 1e8 * np.pi * (outer**2 - inner**2)
    modes = beam_modes(*tube, free=slice(2, 20), at=10)
    scene = modal_chain(3, modes, "shroud.gap=1e-3", "contact.k=1e8", "drive.F_x_mean=[1e6, 0, 0]", "drive.f=1")
    run = js.simulate(scene, n_periods=1, method=dopri8(2000))
    published("SDNL105a", 1e3 * np.concatenate([run.motion.x[-1], run.motion.v_x[-1]]))
    exact = [0.01642647, 0.01116282, 0.0058874]  # by the piecewise linear solution of these modes
    assert_allclose(run.motion.x[-1], exact, rtol=1e-6)
    assert_allclose(run.motion.v_x[-1], [0.02542551, 0.04413354, 0.10456028], rtol=1e-6)


@pytest.mark.published
@pytest.mark.full
def test_a_beam_hits_a_stop(published):
    # A stop is the middle between the beam and its mirror image: twice the gap, half the stiffness.
    bar = 1e10 * np.pi / 4 * 0.1**4, 1e6 * np.pi * 0.1**2
    modes = beam_modes(*bar, free=slice(2, 22), at=20)
    mirrored = ("shroud.gap=2e-4", "contact.k=5e7", "drive.F_x_mean=[1000, -1000]", "drive.f=10")
    run = js.simulate(modal_chain(2, modes, *mirrored), n_periods=2, method=dopri8(2000))
    ours = np.array([-1e6 * run.motion.x[2630, 0], -1e3 * run.motion.v_x[3132, 0]])
    published("SDNL104a", ours)
    assert_allclose(ours, [-1.72226, -4.4839902], rtol=1e-6)  # exact for these modes


def bouncing_bar(count, k, far=1e7):
    """An elastic bar, L = 10, E = 900, density 1, and its mirror image, dropped from 5 on a wall between them, g = 10.

    Gravity acts on the rigid mode alone: it is a spring of 1e-6 1/s^2, 1e7 m from its rest.
    """
    omega = np.array([1e-3, *3 * np.pi * np.arange(1, count)])  # c / L = 3
    phi = np.array([1.0, *[np.sqrt(2.0)] * (count - 1)]) / np.sqrt(10)
    parts = ('parts.motion=["x"]', "parts.friction=none", "shroud.alpha=90 deg", "drive.F_0=0", "drive.f=0.5")
    scene = js.load("table1", [*parts, f"contact.k={k / 2}"]).scene
    blades = js.modal_blades(omega / (2 * np.pi), 0.0, [phi, 0 * phi, 0 * phi])
    begin = np.sqrt(10) * far * np.array([-1.0, 1.0])
    rigid = dataclasses.replace(blades.modes[0], q=begin)
    scene = dataclasses.replace(scene, blades=js.ModalBlades((rigid, *blades.modes[1:])))
    return scene.replace({"shroud.gap": 2 * (5 - far)})


@pytest.mark.full
def test_an_elastic_bar_bounces():
    errors = []
    for count, k, lasts in ((8, 1e3, 0.731), (16, 1e4, 0.680)):
        run = js.simulate(bouncing_bar(count, k), n_periods=4, method=dopri8(1000), events=True)
        t = run.events.t
        assert t[0] == pytest.approx(1.0, abs=1e-6)
        last = np.flatnonzero(np.diff(t) > 1.0)  # of the separations of each bounce: modes chatter before
        duration, two = t[last[0]] - t[0], t[last[1] + 1] - t[0]
        assert duration == pytest.approx(lasts, abs=5e-4)  # 0.731 is that of eight modes by others
        errors.append((abs(duration - 2 / 3), abs(two - 16 / 3)))
    # The exact series: contact lasts 2 L / c, and two bounces take 16/3.
    assert errors[1][0] < 0.25 * errors[0][0]
    assert errors[1][1] < 0.4 * errors[0][1] < 0.04


@pytest.mark.published
@pytest.mark.full
def test_no_reading_of_the_article_meets_all_its_labels(published):
    study = json.loads((ROOT / "tests/studies/reading.json").read_text("utf-8"))
    published("Figs. 10, 12, 14", [study["null"]["all_labels"]["observed"]])


def test_the_page_of_validation_has_every_case_as_others_print_it():
    found = rows()
    assert list(found) == list(CASES)
    for name, row in found.items():
        test = row[-1].strip("`")
        assert row == cells(name, numbers_shown(row[OURS]), test)
        path, _, function = test.partition("::")
        assert "@pytest.mark.published" in (source := (ROOT / "tests" / path).read_text("utf-8"))
        assert f"def {function}(" in source
