"""Programs are compiled once: kept on disk where asked, and never again for other values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

import jaxshroud as js
from jaxshroud.batch.cache import cached_in

SHORT = dict(n_periods=2, transient=1, steps_per_period=100)
COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture
def as_before():
    """What JAX is told of the cache, afterwards as before."""
    folder, least = cached_in(), jax.config.jax_persistent_cache_min_compile_time_secs
    yield
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)
    compilation_cache.reset_cache()


@pytest.mark.usefixtures("as_before")
def test_compiled_programs_are_kept_where_asked(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", raising=False)
    program = lambda a: jnp.sin(a) + 12345.0  # noqa: E731
    jax.jit(program)(jnp.zeros(3)).block_until_ready()  # elsewhere, whatever was settled before
    assert js.cache_compilations(tmp_path / "a") == tmp_path / "a"
    jax.clear_caches()
    jax.jit(program)(jnp.zeros(3)).block_until_ready()
    kept = {path.name for path in (tmp_path / "a").iterdir()}
    assert any(name.startswith("jit__lambda") for name in kept)
    assert js.cache_compilations() == tmp_path / "a"  # what JAX is told already


@pytest.fixture
def compiled():
    """Durations of the compilations so far."""
    found = []

    def told(event, duration, **_):
        if event == COMPILED:
            found.append(duration)

    jax.monitoring.register_event_duration_secs_listener(told)
    yield found
    jax.monitoring.unregister_event_duration_listener(told)


@pytest.mark.full
def test_other_values_compile_nothing(table1, compiled):
    values = np.linspace(1.0, 2.0, 3)
    js.sweep(table1, {"contact.gamma": values}, **SHORT)
    js.simulate(table1, n_periods=1, steps_per_period=100)
    compiled.clear()
    other = js.vary(table1, "drive.F_0", 41.0)
    for key in ("blades.m", "friction.k_d", "shroud.gap", "drive.omega"):
        other = js.vary(other, key, js.value_of(other, key) * 1.01)
    js.sweep(other, {"contact.gamma": 1.1 * values}, **SHORT)
    js.simulate(other, n_periods=1, steps_per_period=100)
    assert not compiled
    jax.jit(lambda a: a * 54321.0)(jnp.zeros(3))  # control: what is new is seen
    assert compiled
