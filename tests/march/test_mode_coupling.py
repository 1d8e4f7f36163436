"""Coupling between equal modes of neighbours, by one number of each mode."""

import dataclasses

import jax.numpy as jnp
import modal_reference
import numpy as np
import pytest
import row_reference
from modal_reference import assert_alike, difference
from numpy.testing import assert_allclose, assert_array_equal
from test_modal_blades import BY_BOTH, MODES, PERIODS, N

import jaxshroud as js
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.linear_system import free_system

KAPPA = np.array([3e5, 1e6, 0.0, 2e6])  # 0.26, 0.13 and 0.02 of omega^2


def coupled(scene, kappa):
    modes = [dataclasses.replace(mode, kappa=k) for mode, k in zip(scene.blades.modes, kappa, strict=True)]
    return dataclasses.replace(scene, blades=js.ModalBlades(tuple(modes)))


def row_of(kind):
    p = row_reference.table1_row(2 if kind == "pair" else N, kind == "ring", 1, M_0=1.0)
    modes = modal_reference.Modes(*(a[..., : p.blades] for a in MODES))
    each = KAPPA[:, None] * np.linspace(1.0, 1.2, len(p.gap))
    return coupled(modal_reference.scene_of(p, modes), map(jnp.squeeze, each)), p, modes, each


@pytest.mark.full
@BY_BOTH
@pytest.mark.parametrize("kind", ["pair", "chain", "ring"])
def test_a_march_is_that_of_a_plain_integrator(kind, method):
    scene, p, modes, each = row_of(kind)
    wanted, counts = modal_reference.corner_ends(p, modes, PERIODS, each)
    assert_alike(js.simulate(scene, n_periods=PERIODS, method=method), wanted, counts)
    assert sum(map(np.sum, counts.values())) > 0
    # Control: coupling that is 0.1 % off.
    other = js.simulate(coupled(scene, map(jnp.squeeze, 1.001 * each)), n_periods=PERIODS, method=method)
    assert difference(other, wanted) > 1e-6


def test_modes_of_a_pair_are_coupled_one_by_one():
    scene, _, modes, _ = row_of("pair")
    pairs = [np.linalg.eigvalsh([[a + own, -own], [-own, b + own]]) for (a, b), own in zip(modes.k, KAPPA, strict=True)]
    squares = np.linalg.eigvalsh(free_system(scene).stiffness)
    assert_allclose(squares, np.sort(np.ravel(pairs)), rtol=1e-12)


RING = 6
ALIKE = modal_reference.Modes(*(np.repeat(a[..., :1], RING, axis=-1) for a in MODES))


def ring_of_alike_blades():
    p = row_reference.table1_row(RING, True, 2, M_0=1.0, gap=1.0)
    scene = modal_reference.scene_of(p, ALIKE)
    return coupled(scene, [jnp.full(RING, kappa) for kappa in KAPPA]), p


def test_a_ring_vibrates_by_nodal_diameters():
    scene, p = ring_of_alike_blades()
    swept = 4 * np.sin(np.pi * np.arange(RING) / RING) ** 2
    wanted = (ALIKE.k[:, :1] + KAPPA[:, None] * swept).ravel()
    assert_allclose(np.linalg.eigvalsh(free_system(scene).stiffness), np.sort(wanted), rtol=1e-12)
    assert js.largest_frequency(scene) >= np.sqrt(wanted.max())
    # Under engine order h every blade moves as one with these frequencies.
    omega, h = p.omega, 2
    k = ALIKE.k[:, 0] + KAPPA * swept[h]
    loads = [p.F_0[0] * np.cos(p.beta[0]), p.F_0[0] * np.sin(p.beta[0]), p.M_0[0]]
    phi = ALIKE.shapes[..., 0]
    alone = phi @ ((np.array(loads) @ phi) / (k - omega**2 + 1j * omega * ALIKE.c[:, 0]))
    found = np.stack(steady_amplitudes(scene)[1])
    assert_allclose(np.abs(found), np.abs(alone)[:, None] * np.ones(RING), rtol=1e-10)
    # Control: without coupling they are others.
    free = np.stack(steady_amplitudes(coupled(scene, [None] * len(KAPPA)))[1])
    assert np.max(np.abs(np.abs(free) / np.abs(found) - 1)) > 0.05


def test_a_table_has_a_column_and_a_rigid_neighbour_is_refused(tmp_path):
    (tmp_path / "blade.csv").write_text(
        "f [Hz],zeta,phi_x,phi_y,phi_theta,kappa\n178,0.02,3.5,0,0,1e5\n975,0.02,0,3.5,0,\n144,0.02,0,0,20,2e5\n"
    )
    given = [f"blades.modes={tmp_path}/blade.csv", "contact.k=2e5"]
    modes = js.load("table1", given).scene.blades.modes
    assert [None if mode.kappa is None else float(mode.kappa) for mode in modes] == [1e5, None, 2e5]
    ring = js.load("row_chain5", [*given, "blades.modes[0].kappa[1]=3e5"]).scene
    assert_array_equal(ring.blades.modes[0].kappa, [1e5, 3e5, 1e5, 1e5])
    scene = ring.replace({"blades.modes[2].kappa": 4e5})
    assert_array_equal(scene.blades.modes[2].kappa, np.full(4, 4e5))
    with pytest.raises(js.InputError, match="not with a rigid neighbour"):
        _ = js.load("griffin", given).scene
