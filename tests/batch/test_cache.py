"""Programs are compiled once: kept on disk where asked."""

import jax
import jax.numpy as jnp
import pytest
from jax.experimental.compilation_cache import compilation_cache

import jaxshroud as js
from jaxshroud.batch.compilation_cache import cache_folder


@pytest.fixture
def as_before():
    """What JAX is told of the cache, afterwards as before."""
    folder, least = cache_folder(), jax.config.jax_persistent_cache_min_compile_time_secs
    yield
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)
    compilation_cache.reset_cache()


@pytest.mark.release
@pytest.mark.full
@pytest.mark.usefixtures("as_before")
def test_compiled_programs_are_kept_where_asked(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", raising=False)
    program = lambda a: jnp.sin(a) + 12345.0
    jax.jit(program)(jnp.zeros(3)).block_until_ready()  # elsewhere, whatever was settled before
    assert js.cache_compilations(tmp_path / "a") == tmp_path / "a"
    jax.clear_caches()
    jax.jit(program)(jnp.zeros(3)).block_until_ready()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["programs"]  # JAX's own entries too
    assert any((tmp_path / "a" / "programs").iterdir())
    assert js.cache_compilations() == tmp_path / "a"  # what JAX is told already


@pytest.mark.usefixtures("as_before")
@pytest.mark.parametrize("damage", ["a byte", "exchanged", "cut"])
def test_an_entry_of_jax_that_is_damaged_is_compiled_anew(tmp_path, caplog, damage):
    # JAX itself would run what the file of a key holds: of another program, say, with other results.
    folder = js.cache_compilations(tmp_path) / "programs"
    results = lambda: [jax.jit(lambda a: jnp.sin(a) + 2.0)(1.0), jax.jit(lambda a, b: (a + b, a - b))(1.0, 2.0)]
    right = results()
    entries = sorted(folder.iterdir())
    contents = [path.read_bytes() for path in entries]
    for i, path in enumerate(entries):
        changed = {
            "a byte": contents[i][:-9] + bytes([contents[i][-9] ^ 1]) + contents[i][-8:],
            "cut": contents[i][:-99],
        }
        path.write_bytes({**changed, "exchanged": contents[i - 1]}[damage])
    jax.clear_caches()
    assert results() == right
    assert caplog.text.count("damaged") >= 2


@pytest.mark.usefixtures("as_before")
@pytest.mark.parametrize(
    ("mode", "within", "cure"), [(0o777, 0o700, "chmod go-w"), (0o755, 0o755, "chmod 700"), (0o755, 0o770, "chmod 700")]
)
def test_a_folder_that_others_may_write_is_not_used_and_told_once(tmp_path, caplog, mode, within, cure):
    place = tmp_path / "cache"
    (place / "programs").mkdir(parents=True)
    for folder, wanted in ((place, mode), (place / "programs", within)):
        folder.chmod(wanted)
    for _ in range(2):
        js.cache_compilations(place)
    assert caplog.text.count(cure) == 1
    jax.jit(lambda a: jnp.cos(a) + 3.0)(1.0)
    assert [path.name for path in place.rglob("*")] == ["programs"]


@pytest.mark.usefixtures("as_before")
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="compiled programs cannot be kept there: Not a directory"):
        js.cache_compilations(tmp_path / "file" / "cache")
