"""Files appear whole or not at all: full disks, and what killed runs leave behind."""

import fcntl
import json
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import jaxshroud as js
from jaxshroud.cli import commands as cli
from jaxshroud.io.files import write
from jaxshroud.io.store import read, write_dataset, write_json
from jaxshroud.plotting.style import new_figure, save_figure
from jaxshroud.scene.checks import MachineError, StoreError, WriteError

# Files of at most 10 kB: the system refuses to write on, as on a full disk.
FULL = """
import resource, sys
from pathlib import Path
import numpy as np, xarray as xr
from jaxshroud.scene.checks import StoreError
from jaxshroud.io.store import write_dataset
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    write_dataset(xr.Dataset({"a": ("n", np.arange(10_000.0))}), Path(sys.argv[1]))
except StoreError as error:
    print(error)
"""


def test_a_full_disk_is_one_line_and_nothing_is_left(tmp_path):
    # In a process of its own: HDF5's files used to be left open, and the end of the interpreter to be a fault.
    words = [sys.executable, "-c", FULL, str(tmp_path / "a.nc")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.stdout == f"{tmp_path / 'a.nc'}: cannot be written (File too large); make room and run again\n"
    assert (done.stderr, done.returncode) == ("", 0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_an_output_that_takes_no_more_is_one_line():
    with open("/dev/full", "w") as output:
        words = [sys.executable, "-m", "jaxshroud", "scenes"]
        done = subprocess.run(words, stdout=output, stderr=subprocess.PIPE, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (1, "the machine failed: [Errno 28] No space left on device\n")


def test_a_closed_output_is_no_failure():
    words = f"{sys.executable} -m jaxshroud scenes >&-"
    done = subprocess.run(words, shell=True, stderr=subprocess.PIPE, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def full(monkeypatch):
    """A disk that takes no more."""

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)


@pytest.mark.parametrize(
    ("name", "saved"),
    [
        ("a.nc", lambda path: write_dataset(xr.Dataset({"a": ("n", np.arange(3.0))}), path)),
        ("a.json", lambda path: write_json({"a": 1.0}, path)),
        ("a.png", lambda path: save_figure(new_figure("", 1.0, 1.0), path)),
        ("a.toml", lambda path: write(path, b"a = 1\n")),
    ],
)
def test_a_failed_write_keeps_the_old_file(tmp_path, full, name, saved):
    (tmp_path / name).write_text("old")
    with pytest.raises(MachineError, match=f"{name}: cannot be written .No space left on device"):
        saved(tmp_path / name)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "old")]


def test_a_wrong_place_is_no_fault_of_the_machine(tmp_path):
    with pytest.raises(WriteError, match=r"no/such/a\.json") as error:
        write_json({}, tmp_path / "no" / "such" / "a.json")
    assert not isinstance(error.value, MachineError)


def test_a_picture_on_a_full_disk_is_a_failure_of_the_machine(tmp_path, capsys, full):
    (tmp_path / "power.json").write_text(json.dumps({"n": [], "P_d": [], "P_d_ci": [], "final": {}, "title": ""}))
    assert cli.main(["plot", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["power.json"]


def test_what_killed_runs_have_left_is_removed(tmp_path):
    left, other = tmp_path / ".sweep-0a_b1c2d.nc", tmp_path / ".sweeping-0a_b1c2d.nc"
    left.write_text("half")
    other.write_text("of another file")
    in_use = tmp_path / ".sweep-living00.nc"
    with in_use.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write(tmp_path / "sweep.nc", b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"sweep.nc", other.name, in_use.name}


def test_a_killed_write_leaves_what_the_next_one_removes(tmp_path):
    code = "import os, signal, sys; from pathlib import Path; from jaxshroud.io.files import write\n"
    code += "os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
    code += "write(Path(sys.argv[1]), b'half')"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "sweep.nc")], timeout=300)
    assert done.returncode == -9
    assert [path.name[:7] for path in tmp_path.iterdir()] == [".sweep-"]
    write(tmp_path / "sweep.nc", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.nc"]


def test_what_is_no_file_is_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe.nc")  # which would be waited for without end
    with pytest.raises(StoreError, match="no regular file"):
        read(tmp_path / "pipe.nc")


def not_utf8(file):
    file.attrs.create("title", b"\xff", dtype=h5py.string_dtype("utf-8"))


def not_utf8_within(file):
    file["x"].attrs.create("units", b"m\xff", dtype=h5py.string_dtype("utf-8"))


def without_dimensions(file):
    values = file["x"][:30]
    del file["x"]
    file["x"] = values


def shorter(file):  # with its dimensions, as which it would end in zeros
    values, scales = file["x"][:30], [dim[0].name for dim in file["x"].dims]
    del file["x"]
    file["x"] = values
    for dim, scale in zip(file["x"].dims, scales, strict=True):
        dim.attach_scale(file[scale])


def flat(file):
    values = file["x"][:, 0]
    del file["x"]
    file["x"] = values


UNREADABLE = [not_utf8, not_utf8_within, without_dimensions, shorter]
SHOWN = [(damage, verb) for damage in [*UNREADABLE, flat] for verb in ("animate", "plot")]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A stored run."""
    path = tmp_path_factory.mktemp("run") / "run.nc"
    js.simulate(js.load("table1", ['parts.motion=["x"]']).scene, n_periods=2, method=js.RungeKutta(steps=100)).save(
        path
    )
    return path


@pytest.mark.parametrize(("damage", "verb"), [*SHOWN, *((damage, "convert") for damage in UNREADABLE)])
def test_a_damaged_result_is_one_line(run, tmp_path, capsys, damage, verb):
    path = shutil.copy(run, tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        damage(file)
    if damage in UNREADABLE:
        with pytest.raises(StoreError, match=r"not a complete result file .*; run the command again"):
            js.open(path)
    out = {"animate": "a.gif", "plot": "a.png", "convert": "b.nc"}[verb]
    assert cli.main([verb, str(path), "--out", str(tmp_path / out)]) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert "a.nc: " in printed.err
    assert not (tmp_path / out).exists()


def test_no_warning_of_dimensions_that_are_not_there_is_shown(run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        without_dimensions(file)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        with pytest.raises(StoreError, match="has not the size of its dimensions"):
            read(path)
    assert not shown


@pytest.mark.studies  # studies/kills.py
@pytest.mark.full
def test_a_store_killed_before_any_rename_of_a_file_ends_with_the_same_bytes(tmp_path):
    words = [sys.executable, str(Path(__file__).with_name("killed_writes.py")), str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=True)
    kills, other = map(int, done.stdout.split())
    assert kills > 20
    assert other == 0


def test_a_store_whose_words_are_no_text_is_refused(tmp_path):
    path, scene = tmp_path / "a.zarr", js.load("table1", ['parts.motion=["x"]']).scene
    short = dict(n_periods=2, transient=1, method=js.RungeKutta(steps=100))
    js.sweep(scene, {"contact.gamma": [1.0, 2.0]}, store=path, **short)
    about = path / "zarr.json"
    about.write_text(about.read_text().replace('"kind": "sweep"', '"kind": "sweep", "title": "\\udcff"'))
    with pytest.raises(StoreError, match="not UTF-8"):
        js.open(path)
