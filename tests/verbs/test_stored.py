"""Sweeps in stores: ended at any moment, damaged or used twice, they end with the numbers of one that nothing ended."""

import fcntl
import os
import shutil
import signal
import uuid
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from command_line import read_json, refused, status_of
from command_line import run as run_command
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch import runs as continuation
from jaxshroud.cli import projection
from jaxshroud.cli import sweep as sweep_verb
from jaxshroud.io import unfinished_store
from jaxshroud.verbs import stored

pytestmark = pytest.mark.full

SHORT = dict(n_periods=2, transient=1, method=js.RungeKutta(steps=100))
GAMMA = np.linspace(1.0, 2.0, 200)
LINE = {"contact.gamma": GAMMA}
GRID = {"contact.gamma": GAMMA[:10], "drive.F_0": [40.0, 60.0]}
WAYS = {"independent": LINE, "forward": GRID, "backward": GRID, "both": {"contact.gamma": GAMMA[:7]}}
VALUES = {"forward": 10, "backward": 10, "both": 2 * 7}  # that follow each other


class Killed(BaseException):
    """What nothing catches, as nothing catches SIGKILL."""


@pytest.fixture(scope="module", autouse=True)
def small():
    """Blocks of 64 lanes, or of all continued values, each of which is a part."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored, "STRETCH_SECONDS", 0.0)
        patch.setattr(stored, "MIN_PART_LANES", 64)
        yield


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", ['parts.motion=["x"]']).scene


@pytest.fixture(scope="module")
def whole(scene, small, tmp_path_factory):
    """Stores of sweeps that nothing has ended, by their direction, each made when it is first asked for."""
    out = tmp_path_factory.mktemp("whole")
    return cache(lambda way: run(scene, way, out / f"{way}.zarr"))


def run(scene, way, path, **more):
    return js.sweep(scene, WAYS[way], direction=way, store=path, **SHORT, **more)


def kept(whole, way="independent"):
    """Where the store of a sweep is."""
    return Path(whole(way).data.encoding["source"])


@pytest.fixture
def path(whole, tmp_path):
    """A copy of the store of independent lanes."""
    return shutil.copytree(kept(whole), tmp_path / "a.zarr")


@pytest.fixture
def goes_on(scene, whole):
    """A store that is gone on with ends with the bits of one that nothing ended."""
    return lambda path, way="independent": same(run(scene, way, path, resume=True), whole(way))


def same(found, exact):
    """Bit by bit, coordinates and all that is said of them too."""
    assert found.data.identical(exact.data)
    for name, variable in exact.data.variables.items():
        assert_array_equal(found.data[name].to_numpy().view(np.uint8), variable.to_numpy().view(np.uint8))


@pytest.mark.release(only=["forward"])
@pytest.mark.parametrize("way", WAYS)
def test_a_store_has_the_numbers_of_a_sweep_in_memory(scene, whole, way):
    exact = js.sweep(scene, WAYS[way], direction=way, **SHORT).data.drop_vars("jump", errors="ignore")
    found = whole(way).data  # which does not run lanes between values: it has the steep steps alone
    assert set(found.variables) == set(exact.variables)
    assert found.attrs == exact.attrs
    for name, variable in exact.variables.items():
        assert found[name].dtype == variable.dtype
        xr.testing.assert_identical(
            found[name].variable, variable
        )  # chunks are the same programs in blocks of any size


@pytest.mark.full(but=["both"])
@pytest.mark.parametrize("way", WAYS)
def test_a_run_killed_anywhere_goes_on_to_the_same_bits(scene, whole, way, tmp_path, monkeypatch, written, goes_on):
    whole(way)  # before what is counted
    written.clear()
    left, setitem, savez, run_lanes = [0], zarr.Array.__setitem__, np.savez, continuation.run_lanes
    computed: list[int] = []  # values that follow each other, one after the other

    def counted(*words):
        if len(words) == 5:
            computed.append(1)
        return run_lanes(*words)

    monkeypatch.setattr(continuation, "run_lanes", counted)

    def dying(inner):
        def call(*words, **more):
            left[0] -= 1
            if not left[0]:
                raise Killed
            return inner(*words, **more)

        return call

    monkeypatch.setattr(zarr.Array, "__setitem__", dying(setitem))
    monkeypatch.setattr(np, "savez", dying(savez))
    # At a value, while coordinates are written, within the first block, about its end, within another.
    kills = (2, 6, 23, 42, 73)
    for number in kills:
        left[0] = number
        with pytest.raises(Killed):
            run(scene, way, tmp_path / "a.zarr", resume=True)
    left[0] = -1
    goes_on(tmp_path / "a.zarr", way)
    again = len(written) - len(set(written))
    assert again <= len(kills)  # those under way
    assert len(computed) <= VALUES.get(way, 0) + len(kills)  # from the last that was finished
    before = len(written)
    goes_on(tmp_path / "a.zarr", way)
    assert len(written) == before


def test_an_interrupted_store_tells_what_ended_and_goes_on(scene, tmp_path, written, goes_on):
    before, sent = signal.signal(signal.SIGINT, signal.default_int_handler), []

    def stop(done, total):
        if done > total / 2 and len(written) > 1 and not sent:  # a second one ends at once
            sent.append(os.kill(os.getpid(), signal.SIGINT))

    try:
        with pytest.raises(js.Interrupted) as stopped:
            run(scene, "independent", tmp_path / "a.zarr", progress=stop)
    finally:
        signal.signal(signal.SIGINT, before)
    status = stopped.value.done.status
    assert set(status) == {js.Status.OK, js.Status.NOT_RUN}
    assert_array_equal(np.isfinite(stopped.value.done.P_d), status == js.Status.OK)
    goes_on(tmp_path / "a.zarr")


def test_an_interrupted_sweep_in_all_directions_keeps_those_that_had_ended(scene, whole):
    def stop(done, total):
        if done > total / 3 + 3:  # within the second value of the second direction
            raise KeyboardInterrupt

    with pytest.raises(js.Interrupted) as stopped:
        js.sweep(scene, WAYS["both"], direction="both", progress=stop, **SHORT)
    found = stopped.value.done
    assert not found.complete
    assert found.steep is None  # unknown until all have run
    ran = found.status == js.Status.OK
    assert ran.sum(axis=1).tolist() == [7, 1, 0]
    assert_array_equal(found.P_d[ran], whole("both").P_d[ran])
    assert np.isnan(found.P_d[~ran]).all()


def flip(path: Path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def swap(path: Path):
    """Exchange a block's file with the next block's: each is what it was, checksum and all, in the other's place."""
    other = path.with_name({"1": "2", "64.npz": "128.npz"}[path.name])
    held = path.with_name("held")
    path.rename(held)
    other.rename(path)
    held.rename(other)


ONE = [(64,)]
DAMAGES = {
    "a flipped bit": ("P_d/c/1", flip, ONE),
    "a cut chunk": ("x/c/1/0/0", lambda path: os.truncate(path, 10), ONE),
    "a lost chunk": ("status/c/1", Path.unlink, ONE),
    "swapped chunks": ("P_d/c/1", swap, [(64,), (128,)]),
    "a lost record": ("resume/64.npz", Path.unlink, ONE),
    "a damaged record": ("resume/64.npz", lambda path: os.truncate(path, 100), ONE),
    "an empty record": ("resume/64.npz", np.savez, ONE),
    "swapped records": ("resume/64.npz", swap, [(64,), (128,)]),
    # What is not of one block is written again with the first.
    "a lost description": ("P_d/zarr.json", Path.unlink, [(0,)]),
    "a damaged description": ("P_d/zarr.json", flip, [(0,)]),
    "a lost array": ("P_d", shutil.rmtree, [(0,), (64,), (128,), (192,)]),
    "a lost description of the whole": ("zarr.json", Path.unlink, [(0,)]),
    "a lost coordinate": ("gamma", shutil.rmtree, [(0,)]),
    "a damaged coordinate": ("gamma/c/0", flip, [(0,)]),
}


@pytest.mark.full(but=["a damaged record"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_refused_and_computed_again(whole, tmp_path, written, capsys, damage, path, goes_on):
    written.clear()
    place, done, again = DAMAGES[damage]
    done(path / place)
    with pytest.raises(
        js.StoreError, match=r"a.zarr: (damaged .*; --resume of the same sweep computes it anew|no such .*)$"
    ):
        js.open(path)
    for words in (f"plot {path}", f"convert {path} --out {tmp_path}/a.csv"):
        refused(capsys, words)
    goes_on(path)
    assert written == again
    same(js.open(path), whole("independent"))
    assert files(path) == files(kept(whole))


def files(path):
    """All that a store consists of."""
    return {part.relative_to(path): part.read_bytes() for part in path.rglob("*") if part.is_file()}


def test_what_is_told_of_all_directions_is_not_lost_in_silence(whole, tmp_path, goes_on):
    exact = kept(whole, "both")
    path = shutil.copytree(exact, tmp_path / "a.zarr")
    shutil.rmtree(path / "steep")
    with pytest.raises(js.StoreError, match=r"damaged \(a description"):
        js.open(path)
    goes_on(path, "both")
    assert files(path) == files(exact)


@pytest.mark.parametrize("damage", [np.savez, flip, lambda path: shutil.copy(path, path.with_name("4-0.npz"))])
def test_what_is_not_the_beginning_of_a_block_is_not_taken(scene, tmp_path, damage, goes_on):
    path = tmp_path / "a.zarr"
    with pytest.raises(js.Interrupted) as stopped:
        run(scene, "forward", path, progress=interrupt_at(0.4))
    assert 0 < (stopped.value.done.status == js.Status.OK).sum() < 20
    damage(path / "resume" / "0-0.npz")
    goes_on(path, "forward")


def interrupt_at(share):
    """Progress that ends in Ctrl-C."""

    def stop(done, total):
        if done > share * total:
            raise KeyboardInterrupt

    return stop


def test_a_store_that_grows_tells_of_what_is_finished(scene, whole, tmp_path):
    path = tmp_path / "a.zarr"
    with pytest.raises(js.Interrupted):
        run(scene, "independent", path, progress=interrupt_at(0.6))
    part = js.open(path)
    assert set(part.status) == {js.Status.OK, js.Status.NOT_RUN}
    for name in ("gamma", "gap"):  # of all lanes from the beginning
        assert_array_equal(part.data[name], whole("independent").data[name])
    (path / "P_d" / "c" / "0").unlink()
    with pytest.raises(js.StoreError, match=r"resume/0\.npz or this record is missing or has another checksum"):
        js.open(path)


def test_a_store_of_something_else_is_refused_with_the_difference(scene, tmp_path, whole):
    path = kept(whole)
    other = js.vary(scene, "shroud.gap", 3e-5)
    with pytest.raises(js.StoreError, match=r"shroud.gap was 2.2\d*e-05, is 3e-05; choose another"):
        run(other, "independent", path, resume=True)
    with pytest.raises(js.StoreError, match=r"along contact.gamma was 200 values from 1 to 2 .*, is 9 values"):
        js.sweep(scene, {"contact.gamma": GAMMA[:9]}, store=path, resume=True, **SHORT)
    with pytest.raises(js.StoreError, match="exists and is kept"):
        run(scene, "independent", path)
    about = path / "resume" / "zarr.json"
    told = about.read_text()
    about.write_text(told.replace(f'"version": "{js.__version__}"', '"version": "0.0.9"'))
    try:
        with pytest.raises(js.StoreError, match=f"version was 0.0.9, is {js.__version__}"):
            run(scene, "independent", path, resume=True)
    finally:
        about.write_text(told)
    zarr.create_group(tmp_path / "b.zarr")
    with pytest.raises(js.StoreError, match=r"holds 'zarr\.json', which is not of a store that a sweep has begun"):
        run(scene, "independent", tmp_path / "b.zarr", resume=True)


def test_a_second_writer_is_refused_while_the_first_lives(scene, tmp_path, goes_on):
    path = tmp_path / "a.zarr"
    (path / "resume").mkdir(parents=True)
    with (path / "resume" / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(js.StoreError, match="another process is writing"):
            run(scene, "independent", path, resume=True)
    goes_on(path)  # closed as by the end of a process


@pytest.fixture
def words(tmp_path):
    """A small sweep as a command."""
    asked = "sweep table1 --set parts.motion=[x] --along contact.gamma --start 1 --stop 2 --num 200"
    return f"{asked} --periods 2 --transient 1 --steps-per-period 100 --store zarr --out {tmp_path}/s"


def test_the_command_stores_resumes_and_draws(words, tmp_path, capsys):
    run_command(words)
    out = tmp_path / "s"
    assert {path.name for path in out.iterdir()} == {"sweep.zarr", "sweep.png", "summary.json"}
    assert js.open(out / "sweep.zarr").complete
    assert "contact.gamma" not in read_json(out / "summary.json")
    assert "--resume to go on with it, or --force" in refused(capsys, words)
    flip(out / "sweep.zarr" / "P_d" / "c" / "0")
    assert "--resume of the same sweep" in refused(capsys, f"plot {out}/sweep.zarr")
    run_command(f"{words} --resume")
    run_command(f"convert {out}/sweep.zarr --out {tmp_path}/a.csv")
    assert "shroud.gap was 2.2e-05, is 0.0001" in refused(capsys, f"{words} --resume --set shroud.gap=0.1mm")


@pytest.mark.parametrize(
    ("error", "status", "cure"),
    [((28, "No space left on device"), 1, "make room"), ((30, "Read-only"), 2, "another --out")],
)
def test_what_cannot_be_written_is_one_line_and_can_be_gone_on_with(
    words, tmp_path, capsys, monkeypatch, error, status, cure
):
    setitem, left = zarr.Array.__setitem__, [130]

    def refuse(*given):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(*error)
        setitem(*given)

    monkeypatch.setattr(zarr.Array, "__setitem__", refuse)
    assert status_of(words) == status
    (told,) = capsys.readouterr().err.splitlines()
    assert "sweep.zarr: cannot be written" in told
    assert cure in told
    found = js.open(tmp_path / "s" / "sweep.zarr")  # still readable
    assert not found.complete
    assert (found.status == js.Status.OK).sum() >= 64
    monkeypatch.undo()
    run_command(f"{words} --resume")
    assert js.open(tmp_path / "s" / "sweep.zarr").complete


def test_an_accuracy_is_kept_and_what_misses_it_is_marked(words, tmp_path):
    run_command(words.replace("--steps-per-period 100", "--accuracy fast"))
    found = js.open(tmp_path / "s" / "sweep.zarr")
    assert found.accuracy.startswith("accuracy 1e-03")
    assert found.inaccurate.shape == found.P_d.shape
    summary = read_json(tmp_path / "s" / "summary.json")
    assert summary["inaccurate"]["runs"] == found.inaccurate.sum()
    assert found.accuracy == f"accuracy {summary['accuracy']}"


def test_an_interrupted_command_says_how_to_go_on(words, tmp_path, capsys, monkeypatch, whole):
    done = whole("independent")

    def stop(*_, **__):
        raise js.Interrupted(done)

    monkeypatch.setattr(js, "sweep", stop)
    assert status_of(words) == 130
    store = tmp_path / "s" / "sweep.zarr"
    known = f"interrupted; {store} with the 200 of 200 lanes that had ended was written"
    assert capsys.readouterr().err == f"{known}; the same command with --resume goes on\n"


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("--store nc", "leave out --store nc"),
        ("--scheduler nowhere", "must be an address such as"),
    ],
)
def test_what_a_store_cannot_do_is_refused(words, capsys, more, told):
    assert told in refused(capsys, f"{words} --resume {more}")


def test_only_large_results_are_stores_by_default(words, monkeypatch, tmp_path):
    words = words.replace("--store zarr", "")
    run_command(words)
    assert (tmp_path / "s" / "sweep.nc").exists()
    monkeypatch.setattr(sweep_verb, "MOST_IN_FILE", 1)
    run_command(f"{words} --force")
    assert (tmp_path / "s" / "sweep.zarr").exists()


def test_scenes_and_numbers_without_samples_are_stored_too(scene, tmp_path):
    scenes = js.scenes_from({"shroud.gap": [2e-5, 3e-5, 4e-5]}, scene)
    keeps = dict(keep_samples=False, **SHORT)
    exact = js.sweep(scenes, {"contact.gamma": GAMMA[:50]}, **keeps)
    found = js.sweep(scenes, {"contact.gamma": GAMMA[:50]}, store=tmp_path / "a.zarr", **keeps)
    assert set(found.data.variables) == set(exact.data.variables)
    assert_allclose(found.P_d, exact.P_d, rtol=1e-9)
    assert_array_equal(found.data["gap"], exact.data["gap"])


@pytest.mark.parametrize(
    ("long", "more", "told"),
    [
        (0, "", "200 runs: about "),
        (1e9, "", None),
        (0, "--num 20 --direction forward", "20 runs: about "),
        (0, "--num 20 --direction both", "60 runs: about "),
    ],
)
def test_a_long_run_says_first_what_it_will_take(words, capsys, monkeypatch, long, more, told):
    announced = partial(projection.print_projection_of_long_run, long=long)
    monkeypatch.setattr(sweep_verb, "print_projection_of_long_run", announced)
    run_command(f"{words} {more}")
    lines = [line for line in capsys.readouterr().err.splitlines() if " runs: about " in line]
    assert bool(lines) == bool(told)
    if told:
        assert lines[0].startswith(told)
        assert "MiB of memory" in lines[0]
        assert lines[0].endswith("sweep.zarr")


FOREIGN = {
    "zarr v2": {".zgroup": '{"zarr_format": 2}', "data/0": "numbers"},
    "a folder": {"mydata/thesis.txt": "years of work"},
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_what_no_sweep_has_written_stays(scene, tmp_path, kind):
    path = tmp_path / "c3.zarr"
    for name, text in FOREIGN[kind].items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_text(text)
    before = files(path)
    for take in (lambda: run(scene, "independent", path, resume=True), lambda: unfinished_store.remove_store(path)):
        with pytest.raises(js.StoreError, match="stays as it is"):
            take()
        assert files(path) == before


def test_what_lies_beside_the_arrays_of_a_store_stays(scene, path, goes_on):
    (path / "mydata").mkdir()
    (path / "mydata" / "thesis.txt").write_text("years of work")
    (path / "zarr.json").unlink()  # as if killed before it was a store
    goes_on(path)
    (path / "resume" / "zarr.json").unlink()
    with pytest.raises(js.StoreError, match="stays as it is"):
        run(scene, "independent", path, resume=True)
    assert (path / "mydata" / "thesis.txt").read_text() == "years of work"
    assert (path / "status").is_dir()


@pytest.mark.parametrize("more", ["ledger", "forces"])
def test_what_is_kept_belongs_to_a_store(scene, more, path):
    # Without them a store would go on with NaN for the blocks that are there.
    with pytest.raises(js.StoreError, match=f"{more} was False, is True"):
        run(scene, "independent", path, resume=True, **{more: True})


def left_of(path):
    """What a killed process leaves of a file."""
    return path.with_name(f".{path.name}.jaxshroud-{uuid.uuid4().hex}.partial")


def zarrs_left_of(path):
    """What a killed process leaves of a chunk or an array's description."""
    return path.with_suffix(f".{uuid.uuid4().hex}.partial")


def test_what_kills_have_left_is_removed_and_nothing_else(whole, path, goes_on):
    ours = [left_of(path / name) for name in ("zarr.json", "resume/0.npz", "resume/zarr.json")]
    ours += [zarrs_left_of(path / name) for name in ("P_d/zarr.json", "P_d/c/1", "x/c/1/0/0")]
    others = [left_of(path / name) for name in ("notes", "P_d/notes", "P_d/0", "resume/0.nc")]
    others += [path / "P_d" / "c" / name for name in ("1.partial", "1.0123.partial")]
    for part in ours:
        part.write_bytes(b"half")
    for other in others:
        other.write_text("years of work")
    same(js.open(path), whole("independent"))  # warnings are errors here
    goes_on(path)
    assert not any(part.exists() for part in ours)
    assert {other.read_text() for other in others} == {"years of work"}


def test_no_foreign_file_within_a_store_is_removed_with_it(path):
    for name in ("notes.txt", "P_d/notes.txt", "P_d/c/notes.txt", "resume/notes.txt"):
        (path / name).write_text("years of work")
        with pytest.raises(js.StoreError, match=f"holds '{name}', which is not of a store"):
            unfinished_store.remove_store(path)
        assert (path / name).read_text() == "years of work"
        (path / name).unlink()
    unfinished_store.remove_store(path)
    assert not path.exists()


def test_a_kill_while_an_array_is_described_can_be_gone_on_with(whole, path, goes_on):
    shutil.rmtree(path / "P_d")
    (path / "zarr.json").unlink()  # before it was a store
    (path / "P_d").mkdir()
    for left in (left_of(path / "zarr.json"), zarrs_left_of(path / "P_d" / "zarr.json")):
        left.write_text("half")
    goes_on(path)
    assert files(path) == files(kept(whole))


def test_a_store_removed_by_another_process_is_not_written_to(monkeypatch, path):

    def late(*_):  # between the opening of the lock and its being had
        shutil.rmtree(path)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(js.StoreError, match="another process is writing"):
        unfinished_store.remove_store(path)


def test_a_large_store_has_few_files_and_opens_lazily_by_xarray(tmp_path, scene):
    path, many = tmp_path / "a.zarr", {"contact.gamma": np.linspace(1.0, 2.0, 2000)}
    run_many = partial(js.sweep, scene, many, store=path, **SHORT)
    with pytest.raises(js.Interrupted):
        run_many(progress=interrupt_at(0.6))
    with xr.open_zarr(path, chunks=None, consolidated=False) as found:  # warnings are errors here
        assert not found["P_d"].variable._in_memory
        assert found["P_d"].encoding["chunks"][0] > 64  # several parts
        ran = found["status"] == js.Status.OK
        assert set(np.unique(found["status"])) == {js.Status.OK, js.Status.NOT_RUN}
        assert np.isnan(found["P_d"].where(~ran)).all()
        assert (found["status"].dtype, found["flat"].dtype) == (np.int8, np.int32)
    whole = run_many(resume=True)
    assert len(files(path)) <= 512
    same(whole, js.sweep(scene, many, store=tmp_path / "b.zarr", **SHORT))
