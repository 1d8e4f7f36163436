"""Files appear whole or not at all: full disks, and what killed runs leave behind."""

import fcntl
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from jaxshroud.cli import commands as cli
from jaxshroud.results import drawing
from jaxshroud.results.files import write
from jaxshroud.results.store import read, write_dataset, write_json
from jaxshroud.scene.errors import MachineError, StoreError, WriteError

# Files of at most 10 kB: the system refuses to write on, as on a full disk.
FULL = """
import resource, sys
from pathlib import Path
import numpy as np, xarray as xr
from jaxshroud.scene.errors import StoreError
from jaxshroud.results.store import write_dataset
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
        ("a.png", lambda path: drawing.save(drawing.new_figure("", 1.0, 1.0), path)),
        ("a.toml", lambda path: write(path, b"a = 1\n")),
    ],
)
def test_a_failed_write_keeps_the_old_file(tmp_path, full, name, saved):
    (tmp_path / name).write_text("old")
    with pytest.raises(MachineError, match=f"{name}: cannot be written .No space left on device"):
        saved(tmp_path / name)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "old")]


def test_a_wrong_place_is_no_fault_of_the_machine(tmp_path):
    with pytest.raises(WriteError, match=r"no/such/a\.json") as told:
        write_json({}, tmp_path / "no" / "such" / "a.json")
    assert not isinstance(told.value, MachineError)


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
    code = "import os, signal, sys; from pathlib import Path; from jaxshroud.results.files import write\n"
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
