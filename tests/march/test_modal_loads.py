"""Loads on modes themselves, and starts in their coordinates."""

import dataclasses
from pathlib import Path

import jax
import modal_reference
import numpy as np
import pytest
import row_reference
from modal_reference import assert_alike, difference
from numpy.testing import assert_allclose, assert_array_equal
from test_modal_blades import BY_BOTH, MODES, PERIODS, N

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.scene.config import parse
from jaxshroud.scene.text import text_of
from jaxshroud.scene.vary import numbers_that_count

CONFIG = Path(__file__).parents[2] / "configs" / "table1.toml"
rng = np.random.default_rng(63)
LOADS = rng.normal(size=(4, N)) + 1j * rng.normal(size=(4, N))  # of the force's size through the shapes
BEGIN = np.stack([1e-6 * rng.normal(size=(4, N)), 1e-3 * rng.normal(size=(4, N))])


def loaded(scene, loads, begin):
    """A scene with loads on its modes beside those on the shrouds, and a start in their coordinates."""
    drive = scene.drive
    shroud = {name: 0 * drive.F_0 for name in ("F_x_im", "F_y_im", "M_im")}
    shroud |= {"F_x_re": drive.F_0 * np.cos(drive.beta), "F_y_re": drive.F_0 * np.sin(drive.beta), "M_re": drive.M_0}
    modal = {f"Q{j}_{part}": a for j, own in enumerate(loads) for part, a in (("re", own.real), ("im", own.imag))}
    one = js.ComplexHarmonic(1, **shroud, modal=modal)
    modes = [dataclasses.replace(mode, q=q, v=v) for mode, q, v in zip(scene.blades.modes, *begin, strict=True)]
    changed = dataclasses.replace(drive, beta=None, F_0=None, M_0=None, harmonic=(one,))
    return dataclasses.replace(scene, drive=changed, blades=js.ModalBlades(tuple(modes)))


def case(kind, loads=1.0, begin=1.0):
    """A row, its modes and its scene, with a share of the loads on modes and of the start."""
    p = row_reference.table1_row(2 if kind == "pair" else N, kind == "ring", 1, M_0=1.0)
    modes = modal_reference.Modes(*(a[..., : p.blades] for a in MODES))
    own = loads * LOADS[:, : p.blades], begin * BEGIN[..., : p.blades]
    return p, modes, loaded(modal_reference.scene_of(p, modes), *own)


@pytest.mark.full
@BY_BOTH
@pytest.mark.parametrize("kind", ["pair", "chain", "ring"])
def test_a_march_is_that_of_a_plain_integrator(kind, method):
    p, modes, scene = case(kind)
    loads, begin = LOADS[:, : p.blades], BEGIN[..., : p.blades]
    wanted, counts = modal_reference.corner_ends(p, modes, PERIODS, own_loads=loads, begin=begin)
    assert_alike(js.simulate(scene, n_periods=PERIODS, method=method), wanted, counts)
    assert sum(map(np.sum, counts.values())) > 0
    # Controls: without the loads, and from rest.
    for other in (case(kind, loads=0.0), case(kind, begin=0.0)):
        assert difference(js.simulate(other[2], n_periods=PERIODS, method=method), wanted) > 1e-4


@pytest.mark.parametrize("kind", ["pair", "chain"])
def test_the_motion_without_contact_is_the_sum_of_the_modes(kind):
    p, modes, scene = case(kind)
    phase, on_shroud = (
        np.exp(1j * np.array(p.phase)),
        np.array([np.array(p.F_0) * np.cos(p.beta), np.array(p.F_0) * np.sin(p.beta), np.array(p.M_0)]),
    )
    force = np.einsum("ajb,ab->jb", modes.shapes, on_shroud) + LOADS[:, : p.blades]
    q = phase * force / (modes.k - p.omega**2 + 1j * p.omega * modes.c)
    wanted = np.einsum("ajb,jb->ab", modes.shapes, q)
    found = np.stack(steady_amplitudes(scene)[1])
    assert_allclose(found, wanted, rtol=1e-12, atol=1e-13 * np.abs(wanted).max())
    # Control: of the shrouds' loads alone.
    alone = np.stack(steady_amplitudes(case(kind, loads=0.0)[2])[1])
    assert np.max(np.abs(alone / found - 1)) > 0.01


def test_a_start_adds_to_that_of_the_shrouds():
    _, modes, scene = case("pair")
    scene = scene.replace({"initial.x": [1e-6, -2e-6], "blades.modes[1].q[0]": 3e-5})
    start = initial_states(scene).motion
    rest = np.array(start.q) - np.array([mode.q for mode in scene.blades.modes])
    assert scene.blades.modes[1].q[0] == 3e-5
    assert_allclose(np.array(start.rate), BEGIN[1][:, :2], rtol=1e-12)
    moved = np.einsum("ajb,jb->ab", modes.shapes, rest)
    assert_allclose(moved, [[1e-6, -2e-6], [0, 0], [0, 0]], rtol=1e-9, atol=1e-16)
    assert not {f"blades.modes[{j}].{name}" for j in range(4) for name in "qv"} & {*numbers_that_count(scene)}


FILE = """
[[drive.harmonic]]
order = 2
F_x_re = 3.0
Q1_re = [0.5, 0.25]
Q1_im = "2 N/kg^0.5"
"""


MODES_OF_FILE = """
[[blades.modes]]
f = 100
phi_x = 3.0
q = 1e-5
[[blades.modes]]
f = 400
phi_y = 2.0
[[blades.modes]]
f = 500
phi_theta = 20.0
"""


def scene_file(folder, text):
    """The scene of Table 1 with modes in the place of its blades, and harmonics in that of its force."""
    tables = CONFIG.read_text("utf-8").replace("gamma = 2.5", "k = 2e5").split("\n[")
    kept = [table for table in tables if not table.startswith(("blades]", "drive]"))]
    path = folder / "loads.toml"
    path.write_text("\n[".join([*kept, "drive]\nomega = 536.0\nphase = 0.0\n"]) + text + MODES_OF_FILE)
    return path


def test_a_file_gives_loads_of_modes(tmp_path):
    scene = js.load(scene_file(tmp_path, FILE), ["drive.harmonic[0].Q1_im=7", "drive.harmonic[0].F_y_re=2"]).scene
    (one,) = scene.drive.harmonic
    given = {name: a.tolist() for name, a in one.modal.items()}
    assert given == {"Q1_re": [0.5, 0.25], "Q1_im": [7.0, 7.0]}
    assert_array_equal(one.F_y_re, 2.0)
    alike = parse(text_of(scene, {"periods": 2}), "text").scene
    assert jax.tree.all(jax.tree.map(np.array_equal, alike, scene))
    assert scene.blades.modes[0].q.tolist() == [1e-5, 1e-5]
    assert_array_equal(scene.replace({"drive.harmonic[0].Q1_re[1]": 4.0}).drive.harmonic[0].modal["Q1_re"], [0.5, 4.0])
    assert js.value_of(scene, "drive.harmonic[0].Q1_im") == 7.0
    with pytest.raises(js.KeyNameError, match=r"no load of its harmonic \[0\] acts on that mode"):
        scene.replace({"drive.harmonic[0].Q3_re": 1.0})
    with pytest.raises(js.SceneError, match="Q3_re"):  # of three modes
        _ = js.load(scene_file(tmp_path, FILE.replace("Q1_re", "Q3_re"))).scene
    with pytest.raises(js.InputError, match="one is rigid"):
        _ = js.load(scene_file(tmp_path, FILE), ['parts.neighbour="rigid"']).scene
    lumped = dataclasses.replace(js.load("table1").scene, drive=scene.drive)
    with pytest.raises(js.InputError, match="but these have 0"):
        js.simulate(lumped, n_periods=1, method=js.RungeKutta(steps=200))
    with pytest.raises(js.InputError, match="acts on a mode of each blade, but these have 3"):
        dataclasses.replace(scene, drive=case("pair")[2].drive)


@pytest.mark.full
def test_derivatives_by_loads_of_modes_are_those_of_sweeps():
    blades = js.modal_blades([160.0, 420.0], 0.1, [[3.0, 1.5], [0.0, 0.0], [0.0, 0.0]])
    base = js.load("table1", ['parts.motion=["x"]', "drive.F_0=60"]).scene
    scene = loaded(dataclasses.replace(base, blades=blades), np.array([[40 + 5j] * 2, [90j] * 2]), np.zeros((2, 2, 2)))
    keys = ["drive.harmonic[0].Q0_re", "drive.harmonic[0].Q1_im"]
    method = js.RungeKutta(steps=400)
    slope = js.gradient(scene, keys, method=method).value
    for key in keys:
        step = 1e-3
        values = js.value_of(scene, key) + step * np.array([-2, -1, 1, 2])
        P_d = js.sweep(scene, {key: values}, n_periods=16, transient=400, method=method).P_d
        wanted = np.array([1, -8, 8, -1]) @ P_d / (12 * step)
        assert slope[key] == pytest.approx(wanted, rel=1e-5)
        assert abs(wanted) > 1e-7


def resting(p, modes, start="static"):
    """Blades that mean loads press on each other with friction, without a drive."""
    scene = modal_reference.scene_of(p, modes).replace({"drive.F_0": 0.0, "drive.M_0": 0.0, "shroud.gap": -4e-5})
    scene = scene.replace({"drive.F_x_mean": np.linspace(20.0, 5.0, p.blades), "drive.F_y_mean": 3.0})
    return dataclasses.replace(scene, start=start)


@pytest.mark.parametrize("kind", ["pair", "ring"])
def test_a_static_start_is_that_of_the_lumped_blades_of_three_modes(kind):
    p = case(kind)[0]
    lumped = resting(p, modal_reference.random_modes(np.random.default_rng(1), 3, p))
    blades = js.load("table1").scene.blades
    modes = modal_reference.modes_of_lumped(jax.tree.map(lambda a: np.full(p.blades, a[0]), blades))
    lumped = dataclasses.replace(lumped, blades=jax.tree.map(lambda a: np.full(p.blades, a[0]), blades))
    wanted = initial_states(lumped).motion
    found = initial_states(resting(p, modes)).motion
    moved = np.einsum("ajb,jb->ab", modes.shapes, np.array(found.q))
    assert_allclose(moved, np.array(wanted[:3]), rtol=1e-9, atol=1e-12 * np.abs(wanted.x).max())
    assert not np.any(np.array(found.rate))
    assert np.abs(wanted.x).min() > 0
    rigid = modes._replace(f=modes.f * [[0.0], [1.0], [1.0]])
    with pytest.raises(js.InputError, match="no static position"):
        initial_states(resting(p, rigid))
    with pytest.raises(js.InputError, match="have no closed form"):
        dataclasses.replace(resting(p, modes), parts=js.Parts(contact="stuck"))


@pytest.mark.full
@pytest.mark.parametrize("start", ["static", "from rest"])
@pytest.mark.parametrize("kind", ["pair", "chain"])
def test_what_starts_in_equilibrium_stays_there(kind, start):
    p, modes, _ = case(kind)
    scene = resting(p, modes, start)
    run = js.simulate(scene, n_periods=1, method=js.RungeKutta(steps=800))
    size = np.abs(run.motion.x).max()
    assert np.ptp(run.motion.x, axis=0).max() < 1e-8 * size
    assert np.all(run.N[0] > 1.0)
    # Control: the same place of the shrouds by the least of coordinates does not stay.
    state = dataclasses.replace(initial_states(scene), motion=js.Motion(*(a[0] for a in run.motion)))
    moved = js.simulate(scene, state=state, n_periods=1, method=js.RungeKutta(steps=800))
    assert np.ptp(moved.motion.x, axis=0).max() > 1e-3 * size
