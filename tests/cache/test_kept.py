"""Compiled programs that are kept: the same numbers, never those of another program, whatever happens to the files."""

import fcntl
import logging
import os
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxshroud.cache import key as keys
from jaxshroud.cache import programs as module
from jaxshroud.cache import store as store_module
from jaxshroud.cache.programs import Prefetch, keep_list, keep_programs, kept, prefetch, program_store, stop_prefetch

X = np.linspace(0.0, 1.0, 5)


def function_of(body, *static: str):
    """A kept function of the package's own, as if of a new process."""

    def f(x, power=2):
        return body(x) ** power

    f.__module__, f.__qualname__ = "jaxshroud.programs.example", "f"
    return kept(*static)(f)


def new_process(body=jnp.sin):
    return function_of(body, "power")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder in which programs are kept; the sources count as unchanged though somebody may edit them."""
    monkeypatch.setattr(keys, "source_hash", lambda: "sources")
    keys.surroundings.cache_clear()
    keep_programs(tmp_path)
    yield tmp_path / "programs"
    keep_programs(None)
    keys.surroundings.cache_clear()


def entries(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.program"))


def is_loaded(body=jnp.cos) -> bool:
    """Whether the program of `sin` is taken for a function of that name with another body: only if it is not traced."""
    return bool(np.array_equal(new_process(body)(X), np.sin(X) ** 2))


def test_a_program_is_loaded_and_not_traced(folder):
    first = new_process()(X)
    assert len(entries(folder)) == 1
    assert is_loaded()
    assert_array_equal(new_process()(X), first)
    keep_programs(None)
    assert_array_equal(new_process()(X), first)  # the same bits without
    assert not is_loaded()


def test_what_a_program_is_made_for_is_part_of_its_key(folder):
    f = new_process()
    for x in (X, X[:3], X.astype(np.float32), 2.0, np.float64(2.0)):
        f(x)
    f(X, power=3)
    assert len(entries(folder)) == 6
    for again in (X + 1.0, jnp.asarray(X)):
        f(again)
    f(x=X)
    assert len(entries(folder)) == 6
    f(X, 2)
    assert len(entries(folder)) == 7  # an argument that is given is told from a default


def test_trees_come_back_as_they_are(folder):
    def tree():
        def f(x):
            return {"a": (x, None), "b": keys_like(x)}

        f.__module__, f.__qualname__ = "jaxshroud.programs.example", "tree"
        return kept()(f)

    keys_like = lambda x: [x + 1, {"c": x * 2}]
    first, again = tree()(X), tree()(X)
    assert jax.tree.structure(first) == jax.tree.structure(again)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        assert_array_equal(one, other)


@pytest.mark.parametrize("changed", ["source", "version", "processor", "device", "x64", "flags"])
def test_another_surrounding_is_a_miss(folder, monkeypatch, changed):
    new_process()(X)
    assert is_loaded()
    keys.surroundings.cache_clear()
    context = partial(jax.enable_x64, True)
    match changed:
        case "source":
            monkeypatch.setattr(keys, "source_hash", lambda: "changed")
        case "version":
            monkeypatch.setattr(keys, "version", lambda package: "9.9")
        case "processor":
            monkeypatch.setattr(keys, "processor_features", lambda: "sse2")
        case "device":
            monkeypatch.setattr(jax, "device_count", lambda: 3)
        case "x64":
            context = partial(jax.enable_x64, False)
        case "flags":
            monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    with context():
        assert not is_loaded()


def test_sources_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(keys, "PACKAGE", tmp_path)
    (tmp_path / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(keys.psutil.Process, "create_time", lambda self: time.time() + 60.0)
    first = keys.source_hash()
    assert first == keys.source_hash()
    (tmp_path / "a.py").write_text("x = 2\n")
    second = keys.source_hash()
    (tmp_path / "b.py").write_text("")
    assert len({first, second, keys.source_hash(), None}) == 4
    monkeypatch.setattr(keys.psutil.Process, "create_time", lambda self: time.time() - 60.0)
    assert keys.source_hash() is None  # edited since the process began, which runs the older ones


def test_what_is_not_of_the_package_is_not_kept(folder):
    foreign = kept()(lambda x: 2 * x)  # its source is not part of the key
    assert_array_equal(foreign(X), 2 * X)
    own = lambda x, how: how(x)
    own.__module__ = "jaxshroud.programs.example"
    assert_array_equal(kept("how")(own)(X, how=jnp.negative), -X)  # a function as a static argument
    assert not entries(folder)


def test_a_value_of_the_package_that_cannot_be_described_is_heard(folder, caplog):
    """Every start of every command would be slow, and no result wrong."""

    class Part:
        def __hash__(self):
            return 1

    own = lambda x, how: x
    own.__module__ = "jaxshroud.programs.example"
    with caplog.at_level(logging.WARNING):
        kept("how")(own)(X, how=Part())  # of somebody else
        assert not caplog.records
        Part.__module__ = "jaxshroud.scene.example"
        kept("how")(own)(X, how=Part())
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "not kept, as it depends on Part" in caplog.text
    assert not entries(folder)


def flipped(raw: bytes, at: float) -> bytes:
    place = min(int(len(raw) * at), len(raw) - 1)
    return raw[:place] + bytes([raw[place] ^ 1]) + raw[place + 1 :]


DAMAGES = {
    **{
        f"cut at {share}": lambda raw, share=share: raw[: int(len(raw) * share)] for share in (0, 0.01, 0.3, 0.7, 0.999)
    },
    **{
        f"a bit at {share}": lambda raw, share=share: flipped(raw, share)
        for share in (0, 0.003, 0.02, 0.2, 0.5, 0.9, 1)
    },
    "longer": lambda raw: raw + b"\0",
    "zeros": lambda raw: bytes(len(raw)),
    "twice": lambda raw: raw + raw,
    "of a later version": lambda raw: raw.replace(b"program 1", b"program 2"),
    "no mark": lambda raw: raw[20:],
    "text": lambda raw: b"hello\n",
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_a_miss_and_one_line(folder, caplog, kind):
    new_process()(X)
    (entry,) = entries(folder)
    entry.write_bytes(DAMAGES[kind](entry.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert not is_loaded()
    assert len(caplog.records) == 1
    assert "compiled anew" in caplog.text
    assert np.array_equal(new_process(jnp.sin)(X), np.cos(X) ** 2)  # mended by what was compiled just now


@pytest.mark.parametrize("kind", ["swapped", "link", "fifo", "folder", "writable by others", "unreadable code"])
def test_files_in_the_place_of_an_entry_are_misses(folder, tmp_path, caplog, kind):
    new_process()(X)
    (entry,) = entries(folder)
    match kind:
        case "swapped":
            new_process()(X, power=3)
            (other,) = set(entries(folder)) - {entry}
            entry.write_bytes(other.read_bytes())
        case "link":
            entry.rename(tmp_path / "elsewhere")
            entry.symlink_to(tmp_path / "elsewhere")
        case "fifo":
            entry.unlink()
            os.mkfifo(entry)
        case "folder":
            entry.unlink()
            entry.mkdir()
        case "writable by others":
            entry.chmod(0o666)
        case "unreadable code":  # intact, but not what this version writes
            store = program_store()
            store._path = lambda key: entry  # type: ignore[union-attr,method-assign]
            body = bytes.fromhex(entry.stem) + store_module.zlib.compress(b"no pickle")
            entry.write_bytes(store_module.MARK + store_module.hashlib.sha256(body).digest() + body)
    with caplog.at_level(logging.WARNING):
        assert not is_loaded()
    assert 1 <= len(caplog.records) <= 2  # a folder cannot be replaced, which is said too


@pytest.mark.parametrize("kind", ["open to others", "link", "file"])
def test_a_folder_that_others_may_enter_is_not_used(tmp_path, kind):
    place = tmp_path / "programs"
    match kind:
        case "open to others":
            place.mkdir(mode=0o755)
        case "link":
            (tmp_path / "real").mkdir(mode=0o700)
            place.symlink_to(tmp_path / "real")
        case "file":
            place.write_text("")
    keep_programs(tmp_path)
    assert program_store() is None
    assert not is_loaded()


def test_the_least_recently_used_go(folder, monkeypatch):
    f = new_process()
    for power in range(2, 6):
        f(X, power=power)
    old = entries(folder)
    for i, entry in enumerate(old):
        os.utime(entry, (1e9 + i, 1e9 + i))
    (folder / ("0" * 64 + ".program")).write_text("not ours")
    os.utime(folder / ("0" * 64 + ".program"), (1e9, 1e9))
    (folder / "notes.txt").write_text("mine")
    monkeypatch.setattr(store_module, "MAX_BYTES", int(2.5 * old[0].stat().st_size))
    f(X, power=6)
    left = set(entries(folder))
    assert not left & set(old[:2])
    assert old[3] in left
    assert (folder / "notes.txt").exists()
    assert folder / ("0" * 64 + ".program") in left


def test_what_a_killed_process_left_is_removed_and_what_is_being_written_is_not(folder):
    left, in_use = (folder / f".{'0' * 64}.program.jaxshroud-{c * 32}.partial" for c in "ab")
    other = folder / "jaxshroud-aaaa.partial"
    for path in (left, in_use, other):
        path.write_bytes(b"half")
    os.utime(other, (1e9, 1e9))
    with in_use.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        new_process()(X)
    assert in_use.exists()
    assert other.exists()
    assert not left.exists()


def test_a_program_that_cannot_run_is_compiled_anew(folder, caplog, monkeypatch):
    new_process()(X)

    def failing(leaves):
        raise jax.errors.JaxRuntimeError("NOT_FOUND: Function kernel not found")

    monkeypatch.setattr(module, "_program_of", lambda loaded: failing)
    with caplog.at_level(logging.WARNING):
        assert_array_equal(new_process()(X), np.sin(X) ** 2)
    assert "NOT_FOUND" in caplog.text


def loaded_on_threads(monkeypatch):
    """The threads on which entries are loaded from now on, by the names of the entries."""
    threads, load = {}, module._prefetcher.load

    def told(name):
        threads[name] = threading.current_thread()
        return load(name)

    monkeypatch.setattr(module._prefetcher, "load", told)
    return threads


def test_a_command_loads_what_it_used_last_time_on_a_thread(folder, monkeypatch):
    monkeypatch.setattr(module._prefetcher, "used", {})
    prefetch("example one")
    first = new_process()(X)
    keep_list()
    stop_prefetch()
    (entry,) = (path for path in entries(folder) if path.stem in module._prefetcher.used)
    threads = loaded_on_threads(monkeypatch)
    for command, ahead in {"example two": False, "example one": True}.items():
        prefetch(command)
        for thread in threading.enumerate():
            if thread is not threading.main_thread() and getattr(thread, "_target", None) == module._prefetcher._run:
                thread.join()
        assert_array_equal(new_process(jnp.cos)(X), first)  # loaded, and not traced
        assert (threads[entry.stem] is not threading.main_thread()) is ahead
        stop_prefetch()


def test_a_list_of_programs_that_are_gone_or_damaged_does_no_harm(folder, caplog):
    prefetch("example")
    first = new_process()(X)
    keep_list()
    stop_prefetch()
    for entry in entries(folder):
        if entry.stem in module._prefetcher.used:
            entry.unlink()
    prefetch("example")
    assert_array_equal(new_process()(X), first)
    stop_prefetch()
    for entry in entries(folder):
        entry.write_bytes(entry.read_bytes()[:-1])  # the list too
    with caplog.at_level(logging.WARNING):
        prefetch("example")
        assert_array_equal(new_process()(X), first)
        stop_prefetch()
    assert "compiled anew" in caplog.text


def test_what_fails_on_the_thread_fails_where_it_is_asked_for():
    ahead = Prefetch(lambda name: 1 / int(name))
    ahead.start(["0", "2"])
    with pytest.raises(ZeroDivisionError):
        ahead.take("0")
    assert ahead.take("2") == 0.5
    ahead.stop()


def test_nothing_is_kept_where_it_cannot_be_written(folder, caplog, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_module, "write_whole", full)
    with caplog.at_level(logging.WARNING):
        assert_array_equal(new_process()(X), np.sin(X) ** 2)
    assert "No space left" in caplog.text
    assert not entries(folder)


def test_inside_a_transformation_the_function_is_traced(folder):
    f = new_process()
    assert_allclose(jax.jit(f)(X), np.sin(X) ** 2)
    assert_allclose(jax.grad(f)(0.5), 2 * np.sin(0.5) * np.cos(0.5))
    assert not entries(folder)


LINEAR = """
import sys
from pathlib import Path
import jax.numpy as jnp
import numpy as np
from jaxshroud.cache import key as keys
from jaxshroud.cache.programs import keep_programs, kept

keys.source_hash = lambda: "sources"
keep_programs(Path(sys.argv[1]))
f = lambda a: jnp.linalg.solve(a, jnp.ones(3))
f.__module__, f.__qualname__ = "jaxshroud.programs.example", "f"
print(kept()(f)(2 * np.eye(3)))
"""


@pytest.mark.full
def test_a_loaded_program_finds_the_functions_of_lapack(tmp_path):
    for _ in range(2):  # without them the second process, which traces nothing, crashes
        told = subprocess.run([sys.executable, "-c", LINEAR, str(tmp_path)], capture_output=True, text=True)
        assert (told.returncode, told.stdout) == (0, "[0.5 0.5 0.5]\n"), told.stderr
    assert len(entries(tmp_path / "programs")) == 1


RACE = """
import sys, time
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxshroud as js
js.cache_compilations(sys.argv[1])
while time.time() < float(sys.argv[2]):
    pass
scene = js.load("table1", ['parts.motion=["x"]']).scene
run = js.simulate(scene, n_periods=2, method=js.RungeKutta(steps=100))
print(run.motion.x[-1].tolist(), run.u_s[-5:].tolist())
"""


@pytest.mark.release
@pytest.mark.full
def test_processes_that_race_for_one_cache(tmp_path):
    # Four at once on an empty cache, then four on a full one: all the same numbers, without a word.
    environment = {**os.environ, "JAXSHROUD_CACHE": "on"}
    found = set()
    for _ in range(2):
        command = [sys.executable, "-c", RACE, str(tmp_path), str(time.time() + 8.0)]
        running = [
            subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            for _ in range(4)
        ]
        for process in running:
            out, complaints = process.communicate(timeout=300)
            assert process.returncode == 0, complaints
            assert not complaints
            found.add(out)
    assert len(found) == 1
    assert entries(tmp_path / "programs")
    assert not list((tmp_path / "programs").glob("*.partial"))
