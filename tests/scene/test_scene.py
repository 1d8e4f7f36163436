"""Scenes as data: numbers per blade, the two ways to give the impact stiffness, and one number replaced."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxshroud.scene.blades import Blades
from jaxshroud.scene.fields import per_blade
from jaxshroud.scene.layout import MISPRINTS
from jaxshroud.scene.optional import WITHOUT_EFFECT
from jaxshroud.scene.scene import Contact, Friction
from jaxshroud.scene.speed import UNTWIST
from jaxshroud.scene.vary import NUMERIC_KEYS, vary


def test_one_number_means_alike_blades():
    for value in (3, 3.0, np.float64(3.0), jnp.asarray(3.0)):
        pair = per_blade(value)
        assert pair.dtype == jnp.float64
        assert_array_equal(pair, [3.0, 3.0])


@pytest.mark.parametrize("pair", [(1, 2.5), [1.0, 2.5], np.array([1.0, 2.5])])
def test_a_pair_is_left_before_right(pair):
    assert_array_equal(per_blade(pair), [1.0, 2.5])


def test_what_is_no_number_passes_through():
    marker = object()  # tree transformations put such things in place of arrays
    assert per_blade(marker) is marker
    assert per_blade(None) is None


def test_the_inertia_in_y_is_the_mass_unless_given(table1):
    assert_array_equal(table1.blades.inertia_y, table1.blades.m)
    own = eqx.tree_at(lambda b: b.m_y, table1.blades, jnp.array([1.0, 2.0]), is_leaf=lambda x: x is None)
    assert_array_equal(own.inertia_y, [1.0, 2.0])
    assert isinstance(Blades(*[1.0] * 8), Blades)


@pytest.mark.parametrize(("k", "gamma"), [(None, None), (1e5, 2.5)])
def test_a_contact_has_exactly_one_of_k_and_gamma(k, gamma):
    with pytest.raises(ValueError, match="Exactly one of `k` and `gamma` must be given"):
        Contact(k, gamma)


def test_an_unknown_misprint_is_named():
    with pytest.raises(ValueError, match="names the unknown misprint `gap_sing`; did you mean `gap_sign`"):
        Contact(1e5, None, frozenset({"gap_sing"}))
    assert Contact(1e5, None, frozenset(MISPRINTS)).reading == set(MISPRINTS)


def test_gamma_is_told_in_the_left_blades_k_x(table1):
    scene = vary(vary(table1, "blades.k_x", jnp.array([2e5, 7e5])), "contact.gamma", 3.0)
    assert_allclose(scene.k, 6e5, rtol=1e-15)


def test_k_and_gamma_drive_each_other_out(table1):
    stiff = vary(table1, "contact.k", 4e5)
    assert stiff.contact.gamma is None
    assert float(stiff.k) == 4e5
    soft = vary(stiff, "contact.gamma", 2.0)
    assert soft.contact.k is None
    assert_allclose(soft.k, 2e5, rtol=1e-15)
    printed = eqx.tree_at(lambda s: s.contact, table1, Contact(1.0, None, frozenset(MISPRINTS)))
    assert vary(printed, "contact.gamma", 2.0).contact.reading == set(MISPRINTS)


def leaves(scene) -> dict[str, np.ndarray]:
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(scene)}


@pytest.mark.parametrize(
    "key",
    [key for key in NUMERIC_KEYS if key not in ("contact.k", "contact.width", "blades.m_y", *UNTWIST, *WITHOUT_EFFECT)],
)
def test_one_number_is_replaced_and_no_other(table1, key):
    table, name = key.split(".")
    before, after = leaves(table1), leaves(vary(table1, key, 0.123))
    assert before.keys() == after.keys()
    changed = [path for path in before if not np.array_equal(before[path], after[path])]
    assert changed == [f".{table}.{name}"]
    assert_array_equal(after[changed[0]], np.broadcast_to(0.123, before[changed[0]].shape))
    assert after[changed[0]].dtype == np.float64


@pytest.mark.parametrize(("member", "want"), [("[0]", [7.0, 0.08]), ("[1]", [0.08, 7.0])])
def test_one_blade_alone(table1, member, want):
    assert_array_equal(vary(table1, f"blades.m{member}", 7.0).blades.m, want)
    # ... and where m_y is not given, from the mass it stands for.
    assert_array_equal(vary(table1, f"blades.m_y{member}", 7.0).blades.m_y, want)
    assert table1.blades.m_y is None


def test_a_pair_and_the_starting_motion(table1):
    assert_array_equal(vary(table1, "drive.phase", jnp.array([0.1, 0.2])).drive.phase, [0.1, 0.2])
    assert_array_equal(vary(table1, "blades.m_y", 0.5).blades.m_y, [0.5, 0.5])
    assert_array_equal(vary(table1, "initial.v_theta[1]", 3.0).initial.v_theta, [0.0, 3.0])


@pytest.mark.parametrize("key", ["contact.gamma", "contact.k", "blades.m_y[1]", "initial.theta", "shroud.gap"])
def test_many_values_are_one_batch(table1, key):
    values = jnp.array([1.0, 2.0, 3.0])
    batch = jax.jit(jax.vmap(lambda value: vary(table1, key, value)))(values)
    for lane, value in enumerate(values):
        one = jax.tree.map(lambda leaf, lane=lane: leaf[lane], batch)
        for got, want in zip(jax.tree.leaves(one), jax.tree.leaves(vary(table1, key, value)), strict=True):
            assert_array_equal(got, want)


def test_the_drive_period(table1):
    assert_allclose(table1.drive.period, 2 * np.pi / 536.0, rtol=1e-15)


def test_numbers_are_arrays_so_that_changing_one_never_recompiles():
    friction = Friction(1, 0.5)
    assert all(isinstance(leaf, jax.Array) and leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(friction))
