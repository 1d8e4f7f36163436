"""One function of one lane on many lanes: fused into one kernel, or by vmap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxshroud import sweep, vary
from jaxshroud.batch import xla
from jaxshroud.batch.xla import best_mapping, fused, vmapped
from jaxshroud.march.method import RungeKutta, Taylor


def mixed(a, b):
    """Results of other types and number than the arguments, one argument unused, one passed on."""
    (x, n), unused = a, b["unused"]
    del unused
    return {"big": x > 2, "y": x * b["factor"], "n": n + 1, "x": x, "half": x / 2, "more": -x}


def test_fused_returns_what_vmap_does():
    a = jnp.arange(1.0, 6.0)
    arguments = (a, jnp.arange(5, dtype=jnp.int32)), {"factor": 3 * a, "unused": a}
    got, expected = (jax.jit(lambda a, b, each=each: each(mixed, a, b))(*arguments) for each in (fused, vmapped))
    jax.tree.map(np.testing.assert_array_equal, got, expected)
    assert jax.tree.structure(got) == jax.tree.structure(expected)


def test_the_fused_way_is_used_on_a_cpu():
    assert best_mapping() is (fused if jax.default_backend() == "cpu" else vmapped)


@pytest.fixture
def asked_again():
    """The probes' answers are forgotten, before and after."""
    for probe in (best_mapping, xla.accepts_options):
        probe.cache_clear()
    yield
    for probe in (best_mapping, xla.accepts_options):
        probe.cache_clear()


@pytest.mark.usefixtures("asked_again")
def test_a_slower_way_is_told_with_its_reason_once(monkeypatch):
    def refused(*_):
        raise RuntimeError("no such\nreduction")

    monkeypatch.setattr(xla, "fused", refused)
    with pytest.warns(RuntimeWarning, match=r"slower: .*cannot be compiled \(no such reduction\)"):
        assert best_mapping() is vmapped
    assert best_mapping() is vmapped  # a second warning would be an error


@pytest.mark.usefixtures("asked_again")
def test_a_kernel_that_computes_other_numbers_is_not_used(monkeypatch):
    # Only one result of many, the last count, is wrong: three operations would not have shown it.
    wrong = lambda f, *args: vmapped(lambda *a: {**(out := f(*a)), "count": out["count"] + 1}, *args)
    monkeypatch.setattr(xla, "fused", wrong)
    with pytest.warns(RuntimeWarning, match="other numbers"):
        assert best_mapping() is vmapped


@pytest.mark.usefixtures("asked_again")
def test_an_option_that_xla_refuses_is_left_out(monkeypatch):
    monkeypatch.setattr(xla, "FOR_SERIES", {"xla_no_such_option": 1})
    doubled = xla.compiled("by")(lambda a, by: by * a)
    with pytest.warns(RuntimeWarning, match="XLA refuses .*xla_no_such_option"):
        assert doubled(jnp.ones(()), by=2) == 2
    assert doubled(jnp.ones(()), by=3) == 3


@pytest.fixture
def compiled():
    """The names of the programs that XLA compiles, the smallest too."""
    names = []
    heard = lambda event, *_, **about: names.append(about.get("fun_name")) if "backend_compile" in event else None
    jax.monitoring.register_event_duration_secs_listener(heard)
    yield names
    jax.monitoring.unregister_event_duration_listener(heard)


@pytest.mark.full
def test_one_compilation_serves_all_sizes(table1, compiled):
    sweep(table1, {"contact.gamma": [1.0, 2.0]}, n_periods=2, method=RungeKutta(steps=100), transient=0)
    compiled.clear()
    sweep(table1, {"shroud.gap": np.linspace(1e-5, 1e-4, 70)}, n_periods=3, transient=1, method=RungeKutta(steps=120))
    assert "jit(run_block)" not in compiled
    # Control: another method, which no other test sweeps by, is another program.
    sweep(table1, {"contact.gamma": [1.0, 2.0]}, n_periods=2, method=RungeKutta("tsit5", 100, "none"), transient=0)
    assert "jit(run_block)" in compiled


@pytest.mark.full
def test_other_values_compile_nothing(table1, compiled):
    # A number of lanes that no other test has is the control.
    how = {"n_periods": 2, "transient": 1, "method": RungeKutta(steps=100)}
    for gap, gammas, nothing in ((2e-5, [1.0, 2.0], None), (3e-5, [1.5, 2.5], True), (3e-5, [1.5] * 37, False)):
        compiled.clear()
        sweep(vary(table1, "shroud.gap", gap), {"contact.gamma": gammas}, **how)
        assert nothing is None or (not compiled) == nothing, compiled


@pytest.mark.full
def test_one_compilation_serves_all_tolerances(table1, compiled):
    def run(tolerance):
        method = Taylor(order=4, tolerance=tolerance)
        return sweep(table1, {"shroud.gap": [1e-5, 2e-5]}, n_periods=1, transient=0, method=method)

    coarse = run(1e-1)
    compiled.clear()
    fine = run(1e-6)
    assert not [name for name in compiled if "large" in name or "run_block" in name]
    assert np.max(np.abs(fine.motion.x - coarse.motion.x)) > 1e-6 * np.max(np.abs(fine.motion.x))  # control: it counts
