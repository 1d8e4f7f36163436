"""Float64 and strict promotion for every test, and run-time type checks; what runs, and on how many processes."""

import gc
import importlib
import os
import pkgutil
import shutil
import sys
import tempfile
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import jax
import psutil
import published as published_cases
import pytest
from jaxtyping import install_import_hook

MOST_MAPS = 20_000
MADE = None if "JAX_COMPILATION_CACHE_DIR" in os.environ else tempfile.mkdtemp(prefix="compiled-")
if MADE:  # what is compiled once serves all processes of this run: workers, commands and notebooks
    for name, value in {"jax_compilation_cache_dir": MADE, "jax_persistent_cache_min_compile_time_secs": 0.0}.items():
        os.environ[name.upper()] = str(value)
        jax.config.update(name, value)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Types are checked where this asks for it, as that is a third of the time of tracing.
CHECKED = os.environ.get("JAXSHROUD_CHECK_TYPES") == "1"
FOLDERS = ("scene", "model", "linear", "march", "batch", "signals", "orbits", "fitting", "verbs")
COMPUTING = [f"jaxshroud.{folder}" for folder in FOLDERS]
with install_import_hook(COMPUTING, "beartype.beartype") if CHECKED else nullcontext():
    import jaxshroud

    for found in pkgutil.walk_packages(jaxshroud.__path__, "jaxshroud."):  # else imported later, without the checks
        if not found.name.endswith("__main__"):
            importlib.import_module(found.name)
    from jaxshroud.cache.programs import keep_programs
    from jaxshroud.cli import commands
    from jaxshroud.scene.config import load


@pytest.fixture(autouse=True)
def no_kept_programs():
    """Commands load programs without tracing them; what a test calls afterwards is traced, whatever it has patched."""
    yield
    keep_programs(None)


@pytest.fixture(autouse=True)
def no_lines_of_commands(monkeypatch):
    """What commands say of themselves every few seconds depends on the machine."""
    monkeypatch.setattr(commands, "lines_written", nullcontext)


def memory_maps():
    """How many memory maps this process has; 0 where the system does not tell."""
    return Path("/proc/self/maps").read_bytes().count(b"\n") if sys.platform == "linux" else 0


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Each compiled program has memory maps of its own; Linux gives a process 65,530, beyond which XLA crashes."""
    yield
    if memory_maps() > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="run the tests that are left out without this, and only these")
    parser.addoption("--benchmark", action="store_true", help="run the side-by-side timings too")
    parser.addoption("--studies", action="store_true", help="run seeded samples of the studies too")
    parser.addoption("--release", action="store_true", help="run what takes too long for every day too")
    parser.addoption("--write", action="store_true", help="write the rows of docs/validation.md anew")
    parser.addoption("--part", default="1/1", help="run one part of the files, as K/M: files K, K + M, ...")


def pytest_unconfigure():
    if MADE:
        shutil.rmtree(MADE, ignore_errors=True)


def by_name(config):
    """Whether single tests are named, or the mark of some."""
    return bool(config.option.markexpr) or any("::" in word for word in config.args)


@pytest.hookimpl(tryfirst=True)
def pytest_xdist_auto_num_workers(config):
    """One process per core that has 4 GB of memory; none for timings and for single tests."""
    if config.getoption("--benchmark") or by_name(config):
        return 0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores, psutil.virtual_memory().total // 4_000_000_000))


def is_marked(item, mark):
    """Whether a test has a mark; where the mark names parameters by `only`, whether it is of one of these."""
    return any("only" not in one.kwargs or item.callspec.id in one.kwargs["only"] for one in item.iter_markers(mark))


def full_among(items):
    """The tests marked `full`: themselves, or parameters of theirs that are not among those that the mark excepts."""
    found, unknown = set(), {}
    for item in items:
        mark = item.get_closest_marker("full")
        if mark is None:
            continue
        but = mark.kwargs.get("but", ())
        unknown.setdefault(item.nodeid.partition("[")[0], set(but)).discard(but and item.callspec.id)
        if not (but and item.callspec.id in but):
            found.add(item)
    if wrong := {test: ids for test, ids in unknown.items() if ids}:
        raise pytest.UsageError(f"marked full but for parameters that do not exist: {wrong}")
    return found


def pytest_collection_modifyitems(config, items):
    for mark in ("benchmark", "studies", "release"):
        if not config.getoption(f"--{mark}"):
            reason = f"run with --{mark}"
            for item in items:
                if is_marked(item, mark):
                    item.add_marker(pytest.mark.skip(reason=reason))
    if by_name(config):
        return
    full = full_among(items)
    kept = [item for item in items if (item in full) is config.getoption("--full")]
    kept = part_of(kept, *map(int, config.getoption("--part").split("/")))
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept


def share_of(item):
    """What the parts of a run divide: a file, or one parameter of a test whose parameters take long."""
    return str(item.path), item.callspec.id if item.get_closest_marker("by_parameter") else ""


def part_of(items, part, parts):
    """The tests of part 1, 2, ... of so many, by files; the notebooks are in every part."""
    if not 1 <= part <= parts:
        raise pytest.UsageError(f"--part {part}/{parts}: there is no such part")
    shares = sorted({share_of(item) for item in items if item.path.name != "test_notebooks.py"})
    others = {share for i, share in enumerate(shares) if i % parts != part - 1}
    return [item for item in items if share_of(item) not in others]


@pytest.fixture(scope="session")
def table1():
    """Table 1 of the article with Table 2's gap and F_0, gamma = 2.5, consistent reading."""
    return load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene


@pytest.fixture
def published(request):
    """Compare our numbers of a published case with its own, and with the page that shows both."""
    test = request.node.nodeid.partition("[")[0].removeprefix("tests/")
    return partial(published_cases.compare, test=test, write=request.config.getoption("--write"))


@pytest.fixture
def reopened(tmp_path):
    """What a result is once it has been saved and opened again."""

    def call(result):
        result.save(tmp_path / "result.nc")
        return jaxshroud.open(tmp_path / "result.nc")

    return call


@pytest.fixture
def written(monkeypatch):
    """The first lanes of the parts of a store that were written so far."""
    from jaxshroud.io.unfinished_store import Unfinished

    places, write = [], Unfinished.write

    def told(self, block, at, *rest):
        places.append(tuple(lanes.start for lanes in at))
        write(self, block, at, *rest)

    monkeypatch.setattr(Unfinished, "write", told)
    return places
