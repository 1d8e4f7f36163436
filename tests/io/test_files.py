"""Files appear whole or not at all: full disks, and what killed runs leave behind."""

import errno
import fcntl
import gc
import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from command_line import refused, status_of

import jaxshroud as js
from jaxshroud.cli import describe
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.terminal import CommandError, refuse_existing
from jaxshroud.io.files import kept_files, place_of, put_in_place, results_together, write
from jaxshroud.io.store import read, write_dataset, write_json
from jaxshroud.plotting.style import new_figure, save_figure
from jaxshroud.scene.checks import MachineError, StoreError, WriteError

pytestmark = pytest.mark.full

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
    assert status_of(f"plot {tmp_path}") == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["power.json"]


HEX = "0123456789abcdef" * 2
LEFT = f".sweep.nc.jaxshroud-{HEX}.partial"  # as a killed run leaves it


def as_file(path):
    path.write_text("foreign")


def as_link(path):
    path.symlink_to(path.parent / "linked")


# Names and kinds of entries that are near to a leftover, and none.
FOREIGN = {
    "a date": (".sweep-20261125.nc", as_file),
    "a pipe with a date": (".sweep-12345678.nc", os.mkfifo),
    "of another file": (f".sweeping.nc.jaxshroud-{HEX}.partial", as_file),
    "of another suffix": (f".sweep.json.jaxshroud-{HEX}.partial", as_file),
    "a digit short": (f"{LEFT[:-9]}.partial", as_file),
    "more behind": (f"{LEFT}.bak", as_file),
    "a link": (LEFT, as_link),
    "a pipe": (LEFT, os.mkfifo),
    "a folder": (LEFT, os.mkdir),
}


@pytest.mark.parametrize(("name", "made"), FOREIGN.values(), ids=FOREIGN)
def test_no_foreign_file_is_taken_for_a_leftover(tmp_path, name, made):
    made(tmp_path / name)
    before = (tmp_path / name).lstat()
    write(tmp_path / "sweep.nc", b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"sweep.nc", name}
    assert (tmp_path / name).lstat() == before


def test_what_killed_runs_have_left_is_removed(tmp_path):
    (tmp_path / LEFT).write_text("half")
    in_use = tmp_path / LEFT.replace("0", "f")
    with in_use.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write(tmp_path / "sweep.nc", b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"sweep.nc", in_use.name}


KILLED = """
import os, signal, sys
from pathlib import Path
from jaxshroud.io.files import write
setattr(os, sys.argv[2], lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))
write(Path(sys.argv[1]), b"half")
"""


@pytest.mark.parametrize(("step", "left"), [("fsync", []), ("replace", [".sweep."])])
def test_a_killed_write_leaves_nothing_or_what_the_next_one_removes(tmp_path, step, left):
    # A file without a name is gone with its process; for a moment before it replaces another, it has one.
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "sweep.nc"), step], timeout=300)
    assert done.returncode == -9
    assert [path.name[:7] for path in tmp_path.iterdir()] == left
    write(tmp_path / "sweep.nc", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.nc"]


def without_unnamed_files(patch):
    patch.delattr(os, "O_TMPFILE", raising=False)


def without_links(patch):
    def refuse(*_, **__):
        raise OSError(errno.EPERM, "Operation not permitted")

    patch.setattr(os, "link", refuse)


def without_locks(patch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    patch.setattr(fcntl, "flock", refuse)


def without_any(patch):
    for lack in (without_unnamed_files, without_links, without_locks):
        lack(patch)


SYSTEMS = [lambda patch: None, without_unnamed_files, without_links, without_locks, without_any]
SYSTEM_IDS = ["with all", "without unnamed files", "without links", "without locks", "without any"]


@pytest.fixture(params=SYSTEMS, ids=SYSTEM_IDS)
def system(request, monkeypatch):
    """A system or a filesystem that lacks something of what files are written with."""
    request.param(monkeypatch)


@pytest.mark.usefixtures("system")
def test_a_file_is_written_and_replaced_on_any_filesystem(tmp_path):
    path, other = tmp_path / f"{'a' * 250}.nc", tmp_path / "linked"
    for content in (b"first", b"second"):
        write(path, content)
        assert path.read_bytes() == content
    assert path.stat().st_mode & 0o777 == 0o666 & ~os.umask(os.umask(0o22))
    other.write_text("foreign")
    path.unlink()
    path.symlink_to(other)
    write(path, b"third")  # in place of the link, not of what it leads to
    assert (path.read_bytes(), other.read_text()) == (b"third", "foreign")
    assert {part.name for part in tmp_path.iterdir()} == {path.name, "linked"}


@pytest.mark.usefixtures("system")
@pytest.mark.parametrize("appeared", [as_file, as_link, os.mkdir, os.mkfifo])
def test_what_appears_during_a_run_is_kept_and_its_results_lie_beside_together(tmp_path, appeared):
    names = ["sweep.nc", "sweep.png", "summary.json"]
    (tmp_path / "sweep-1.png").write_text("of a run before")
    with results_together():
        for name in names:
            refuse_existing(tmp_path / name, force=False)
        write(tmp_path / "sweep.nc", b"sweep.nc")
        assert not (tmp_path / "sweep.nc").exists()  # before the others
        appeared(tmp_path / "summary.json")
        state = (tmp_path / "summary.json").lstat()
        for name in names[1:]:
            write(tmp_path / name, name.encode())
        assert place_of(tmp_path / "sweep.nc") == tmp_path / "sweep-2.nc"
    assert kept_files == [tmp_path / "summary.json"]
    assert (tmp_path / "summary.json").lstat() == state
    for name, place in zip(names, ["sweep-2.nc", "sweep-2.png", "summary-2.json"], strict=True):
        assert (tmp_path / place).read_text() == name
    assert (tmp_path / "sweep-1.png").read_text() == "of a run before"
    assert len([*tmp_path.iterdir()]) == 5


def test_what_a_command_writes_twice_is_there_once(tmp_path):
    # It once looked for a free name without end, as the first of them took each.
    with results_together():
        refuse_existing(tmp_path / "result.json", force=False)
        for content in (b"one", b"two"):
            write(tmp_path / "result.json", content)
    assert (tmp_path / "result.json").read_bytes() == b"two"
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_what_is_forced_is_replaced_and_what_nobody_claimed_too(tmp_path):
    for name in ("forced.nc", "drawn.png"):
        (tmp_path / name).write_text("old")
    with results_together():
        refuse_existing(tmp_path / "forced.nc", force=True)
        for name in ("forced.nc", "drawn.png"):
            write(tmp_path / name, b"new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"forced.nc": "new", "drawn.png": "new"}


def test_a_result_whose_placing_is_interrupted_is_placed_once(tmp_path, monkeypatch):
    link = os.link

    def interrupted(*names, **more):
        link(*names, **more)
        monkeypatch.setattr(os, "link", link)
        raise KeyboardInterrupt

    @results_together()
    def command():
        for name in ("a.nc", "a.json"):
            refuse_existing(tmp_path / name, force=False)
            write(tmp_path / name, name.encode())
        put_in_place()

    monkeypatch.setattr(os, "link", interrupted)
    with pytest.raises(KeyboardInterrupt):
        command()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.nc": "a.nc", "a.json": "a.json"}


def test_a_broken_link_is_refused_as_any_other_file_is(tmp_path):
    as_link(tmp_path / "a.nc")
    with pytest.raises(CommandError, match="exists and is kept"):
        refuse_existing(tmp_path / "a.nc", force=False)


def test_a_command_whose_place_was_taken_says_so_last_and_fails(tmp_path, capsys, monkeypatch):
    write_sheet = describe._write_sheet

    def taken(sheet, file, options):
        (options.out / "check.png").write_text("foreign")
        write_sheet(sheet, file, options)

    monkeypatch.setattr(describe, "_write_sheet", taken)
    assert status_of(f"check table1 --out {tmp_path}") == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert printed.err.startswith(f"{tmp_path / 'check.png'}: has appeared during the run and is kept; the results ")
    places = {path.name for path in tmp_path.iterdir()}
    assert places == {"check.png", *(name.replace(".", "-1.") for name in COMMANDS["check"].files)}
    assert "check-1.png" in printed.out
    assert (tmp_path / "check.png").read_text() == "foreign"


def test_what_is_no_file_is_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe.nc")  # which would be waited for without end
    with pytest.raises(StoreError, match="no regular file"):
        read(tmp_path / "pipe.nc")


def not_utf8(file):
    file.attrs.create("title", b"\xff", dtype=h5py.string_dtype("utf-8"))


def not_utf8_within(file):
    file["x"].attrs.create("units", b"m\xff", dtype=h5py.string_dtype("utf-8"))


def replace_x(file, values):
    del file["x"]
    file["x"] = values


def without_dimensions(file):
    replace_x(file, file["x"][:30])


def shorter(file):  # with its dimensions, as which it would end in zeros
    scales = [dim[0].name for dim in file["x"].dims]
    without_dimensions(file)
    for dim, scale in zip(file["x"].dims, scales, strict=True):
        dim.attach_scale(file[scale])


def flat(file):
    replace_x(file, file["x"][:, 0])


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
    assert "a.nc: " in refused(capsys, f"{verb} {path} --out {tmp_path}/{out}")
    assert not (tmp_path / out).exists()


def test_a_file_that_fails_within_h5netcdf_ends_without_a_word(run, tmp_path, monkeypatch):
    # Its files that are half open when that fails say so once more when they are collected.
    told, whole, path = [], bytearray(run.read_bytes()), tmp_path / "a.nc"
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: told.append(unraisable.object))
    refused, header = set(), re.compile(b"OHDR")
    for found in [*header.finditer(whole)][:5]:  # the file's own, and those of its first variables
        damaged = bytearray(whole)
        damaged[found.end() + 12] ^= 255
        path.write_bytes(damaged)
        try:
            read(path)
        except StoreError as error:
            refused.add(str(error))
    gc.collect()
    assert any("checksum" in reason for reason in refused)
    assert not told


def test_no_warning_of_dimensions_that_are_not_there_is_shown(run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        without_dimensions(file)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        with pytest.raises(StoreError, match="has not the size of its dimensions"):
            read(path)
    assert not shown


@pytest.mark.release  # studies/kills.py
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
