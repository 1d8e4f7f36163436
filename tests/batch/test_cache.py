"""Programs are compiled once: kept on disk where asked."""

import jax
import jax.numpy as jnp
import pytest
from jax.experimental.compilation_cache import compilation_cache

import jaxshroud as js
from jaxshroud.batch.cache import cache_folder


@pytest.fixture
def as_before():
    """What JAX is told of the cache, afterwards as before."""
    folder, least = cache_folder(), jax.config.jax_persistent_cache_min_compile_time_secs
    yield
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)
    compilation_cache.reset_cache()


@pytest.mark.usefixtures("as_before")
def test_compiled_programs_are_kept_where_asked(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", raising=False)
    program = lambda a: jnp.sin(a) + 12345.0
    jax.jit(program)(jnp.zeros(3)).block_until_ready()  # elsewhere, whatever was settled before
    assert js.cache_compilations(tmp_path / "a") == tmp_path / "a"
    jax.clear_caches()
    jax.jit(program)(jnp.zeros(3)).block_until_ready()
    kept = {path.name for path in (tmp_path / "a").iterdir()}
    assert any(name.startswith("jit__lambda") for name in kept)
    assert js.cache_compilations() == tmp_path / "a"  # what JAX is told already


@pytest.mark.usefixtures("as_before")
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="compiled programs cannot be kept there: Not a directory"):
        js.cache_compilations(tmp_path / "file" / "cache")
