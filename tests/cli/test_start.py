"""What a command imports before it is of use: counted in a fresh interpreter, as times depend on the machine."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

LEFT_OUT = {"dask", "distributed", "pint", "cftime"}  # that xarray would look for
HEAVY = {"jax", "numpy", "pydantic", "matplotlib", "pandas", "xarray", "rich", "scipy", "pint"}
# The console script for one list of words after the other; after each its exit status and all that is imported by then.
COMMANDS = """
import json, sys
from jaxshroud_command import main
for words in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    try:
        status = main()
    except SystemExit as stop:
        status = stop.code
    print("IMPORTED", status, *sys.modules)
"""
# What the commands have left out, which can still be imported.
LEFT_OUT_AFTERWARDS = """
import dask.array, distributed, pint
assert dask.array.ones(3).sum().compute() == 3
from jaxshroud.scene.units import to_si
assert to_si("m", "1 inch") == 0.0254
print("IMPORTED", 0, *sys.modules)
"""
FREE = ["simulate", "table1", "--set", 'parts.motion=["x"]', "--set", 'parts.contact="none"', "--periods", "1"]
SHEET = ["check", "table1", "--set", 'parts.motion=["x"]']


def started(code, *words, **environment):
    """What a fresh interpreter prints."""
    cache = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=600,
        env=cache | environment,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def imported(*commands, afterwards=""):
    """Of each command its exit status, and the packages imported by then: its own, and those of the ones before it."""
    told = started(COMMANDS + afterwards, json.dumps([[*map(str, words)] for words in commands]))
    found = [line.split()[1:] for line in told.splitlines() if line.startswith("IMPORTED ")]
    return [(int(status), {name.partition(".")[0] for name in names} | set(names)) for status, *names in found]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A stored run of a made-up motion."""
    n, every = 401, 4
    t = np.arange(n) * every / 100
    x = np.stack([np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)], axis=1) * 1e-5
    data = {"x": (("time", "blade"), x), "v_x": (("time", "blade"), x * 500), "mode": ("time", (x[:, 0] > 0) * 1)}
    about = {"gap": 2e-5, "omega": 2 * np.pi, "steps_per_period": 100, "every": every, "end_turns": 0.0, "title": "a"}
    ds = xr.Dataset(data, {"time": t, "blade": [0, 1]}, about | {"kind": "trajectory"})
    path = tmp_path_factory.mktemp("stored") / "run.nc"
    ds.to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Commands that need JAX, in the order of what they may import, and the folder of their files."""
    out = tmp_path_factory.mktemp("computed")
    commands = {
        "simulate nothing": ["simulate", "nothing", "--out", "a.nc"],
        "check nothing": ["check", "nothing"],
        "check": ["check", "table1"],
        "explain": ["explain", "table1"],
        "simulate": [*FREE, "--out", out / "run.nc"],
        "check --out": [*SHEET, "--out", out / "sheet"],
    }
    told = imported(*commands.values(), afterwards=LEFT_OUT_AFTERWARDS)
    return dict(zip([*commands, "afterwards"], told, strict=True)), out


@pytest.fixture(scope="module")
def drawn(stored, computed, tmp_path_factory):
    """Commands that draw what is stored: a run, a convergence and a data sheet."""
    power, sheet = tmp_path_factory.mktemp("power"), computed[1] / "sheet"
    (power / "power.json").write_text(json.dumps({"n": [], "P_d": [], "P_d_ci": [], "final": {}, "title": ""}))
    told = imported(["plot", stored], ["plot", power], ["plot", sheet, "--out", sheet / "again.png"])
    return dict(zip(("run", "convergence", "sheet"), told, strict=True))


def test_words_are_answered_without_what_computes():
    expected = {"--help": 0, "--version": 0, "simulate --help": 0, "scenes": 0, "simulat": 2, "tune table1": 2}
    told = imported(*map(str.split, expected))
    assert [status for status, _ in told] == [*expected.values()]
    assert not told[-1][1] & HEAVY


@pytest.mark.full
def test_a_stored_run_is_drawn_without_jax(stored, drawn):
    status, packages = drawn["run"]
    assert status == 0
    assert stored.with_suffix(".png").stat().st_size > 10_000
    assert {"xarray", "matplotlib"} <= packages
    assert not packages & {"jax", "jaxlib", "equinox", "diffrax", "pydantic", "matplotlib.pyplot", "rich", *LEFT_OUT}


@pytest.mark.full
@pytest.mark.parametrize("name", ["convergence", "sheet"])
def test_what_is_stored_is_drawn_without_jax(drawn, name):
    status, packages = drawn[name]
    assert status == 0
    assert not packages & {"jax", "jaxlib", "equinox", "diffrax", "pydantic", "rich"}


@pytest.mark.full
def test_a_data_sheet_is_written_and_drawn_again(computed, drawn):
    commands, out = computed
    assert commands["check --out"][0] == drawn["sheet"][0] == 0
    assert (out / "sheet" / "again.png").stat().st_size > 10_000


@pytest.mark.full
def test_a_simulation_imports_what_it_needs(computed):
    # Control: JAX is seen. A scene of another name ends the command where it would begin to compute.
    status, packages = computed[0]["simulate nothing"]
    assert status == 2
    assert {"jax", "pydantic"} <= packages
    assert not packages & {"xarray", "matplotlib", "diffrax", "optax", "scipy.stats", "scipy.special", "rich", "pint"}
    status, packages = computed[0]["check nothing"]
    assert status == 2
    assert "jax" in packages
    assert not packages & {"matplotlib", "diffrax", "optax", "scipy.stats", "pint"}


@pytest.mark.full
@pytest.mark.parametrize("name", ["check", "explain"])
def test_what_computes_no_motion_imports_nothing_that_writes(computed, name):
    status, packages = computed[0][name]
    assert status == 0
    assert not packages & {"xarray", "pandas", "h5py", "matplotlib", "diffrax", "scipy", *LEFT_OUT}


@pytest.mark.full
def test_a_run_is_written_without_what_it_does_not_use(computed):
    commands, out = computed
    status, packages = commands["simulate"]
    assert status == 0
    assert xr.load_dataset(out / "run.nc").sizes["time"] > 1
    assert "xarray" in packages
    assert not packages & {"matplotlib", "diffrax", "optax", "scipy.stats", "scipy.linalg", *LEFT_OUT}


@pytest.mark.full
def test_what_draws_random_numbers_is_not_imported_before_it_draws():
    code = "import sys, jaxshroud; jaxshroud.tune, jaxshroud.report, jaxshroud.scatter; print(*sys.modules)"
    assert not {"scipy.stats", "dask", "pint"} & set(started(code).split())


@pytest.mark.full
def test_what_commands_leave_out_can_still_be_imported(computed):
    commands, _ = computed
    assert commands["afterwards"][1] >= LEFT_OUT - {"cftime"}
    assert not commands["check --out"][1] & LEFT_OUT


IN_A_NOTEBOOK = """
import numpy as np
import xarray as xr
import jaxshroud as js
from jaxshroud.io.store import read, write_dataset
data = xr.Dataset({"a": ("x", np.ones(4))}).chunk({"x": 2})
from pathlib import Path
write_dataset(data, Path("data.nc"))
assert data["a"].chunks == ((2, 2),)
print(float(read("data.nc")["a"].sum()))
"""


@pytest.mark.full
def test_a_notebook_keeps_dask(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert started(IN_A_NOTEBOOK).strip() == "4.0"


CACHE = """
import jax
from jaxshroud.cli import main
assert main(["simulate", "nothing", "--out", "a.nc"]) == 2
config = jax.config
print(config.jax_enable_x64, config.jax_compilation_cache_dir, config.jax_persistent_cache_min_compile_time_secs)
"""


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"XDG_CACHE_HOME": "/a"}, "True /a/jaxshroud 0.0"),
        ({"JAX_COMPILATION_CACHE_DIR": "/b"}, "True /b 0.0"),
        ({"JAX_COMPILATION_CACHE_DIR": "/b", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "2"}, "True /b 2.0"),
    ],
    ids=["the cache of its own", "a given cache", "a given time"],
)
@pytest.mark.full
def test_small_programs_are_cached_wherever_the_cache_is(environment, expected):
    assert started(CACHE, **environment).strip() == expected


@pytest.mark.full
@pytest.mark.full(but=["jaxshroud"])
@pytest.mark.parametrize("module", ["jaxshroud", "jaxshroud.cli"])
def test_the_package_runs_as_a_command(module):
    done = subprocess.run([sys.executable, "-m", module, "plot", "nothing"], capture_output=True, text=True)
    assert done.returncode == 2
    *at_work, told = done.stderr.splitlines()
    assert told == "nothing: no such file; give a result written by jaxshroud"
    assert all(line.startswith("plot: at work for ") for line in at_work)  # every few seconds, on a slow machine


@pytest.mark.full
def test_a_device_that_is_not_there_is_one_line():
    code = "import sys; from jaxshroud_command import main; sys.exit(main())"
    cuda = os.environ | {"JAX_PLATFORMS": "cuda"}
    done = subprocess.run([sys.executable, "-c", code, *SHEET], capture_output=True, text=True, timeout=300, env=cuda)
    told = "JAX_PLATFORMS=cuda: JAX has no such device here; unset it, or set it to cpu\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", told)


@pytest.mark.full
def test_a_home_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    home = str(tmp_path / "file" / "home")
    code = "import sys; from jaxshroud_command import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, *SHEET],
        capture_output=True,
        text=True,
        timeout=600,
        env={name: value for name, value in os.environ.items() if name[:4] not in ("JAX_", "XDG_")} | {"HOME": home},
    )
    assert done.returncode == 0
    told = [line for line in done.stderr.splitlines() if " 0:" not in line]  # without lines of progress
    assert len(told) == 1
    assert "compiled programs cannot be kept there" in told[0]
