"""Sweeps on workers of Dask distributed: the same bits, whoever comes and goes, and one line where nobody is there."""

import json
import logging
import os
import signal
import socket
import subprocess
import sys

import cloudpickle
import dask
import numpy as np
import psutil
import pytest
from command_line import refused, status_of
from command_line import run as run_command
from distributed import Client, LocalCluster
from test_stored import GAMMA, LINE, SHORT, same

import jaxshroud as js
from jaxshroud.scene.checks import MachineError
from jaxshroud.verbs import cluster, stored

GRID = {"contact.gamma": GAMMA[:10], "drive.F_0": np.linspace(40.0, 60.0, 100)}
WAYS = {"independent": LINE, "backward": GRID}
NOBODY = "tcp://127.0.0.1:9"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Blocks of 64 lanes, or of continued values of which each is a part."""
    monkeypatch.setattr(stored, "MIN_SENT_LANES", 64)
    monkeypatch.setattr(stored, "MAX_SENT_PARTS", 10**6)
    monkeypatch.setattr(stored, "STRETCH_SECONDS", 0.0)


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", ['parts.motion=["x"]']).scene


def run(scene, way, path, **more):
    return js.sweep(scene, WAYS[way], direction=way, store=path, **SHORT, **more)


@pytest.fixture
def here():
    """The address of workers within this process."""
    quiet = dict(dashboard_address=":0", silence_logs=False)
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, **quiet) as own:
        yield own.scheduler_address


@pytest.mark.full(but=["independent"])
@pytest.mark.parametrize("way", WAYS)
def test_workers_find_the_bits_of_one_process(scene, here, tmp_path, written, way):
    ticks = []
    found = run(scene, way, tmp_path / "a.zarr", scheduler=here, progress=lambda *done: ticks.append(done))
    assert len(set(written)) == len(written) == (4 if way == "independent" else 20)
    assert ticks[-1] == (found.status.size * 3,) * 2
    same(found, run(scene, way, tmp_path / "alone.zarr"))


@pytest.mark.full
def test_what_workers_began_is_gone_on_with_without_them_and_the_other_way_round(scene, here, tmp_path, written):
    path = tmp_path / "a.zarr"
    whole = run(scene, "independent", path, scheduler=here)
    for lost, more in {"0": {}, "128": {"scheduler": here}}.items():
        (path / "resume" / f"{lost}.npz").unlink()
        written.clear()
        same(run(scene, "independent", path, resume=True, **more), whole)
        assert written == [(int(lost),)]


def test_a_worker_of_other_versions_than_this_process_is_refused(scene, here, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "machine_identity", lambda: {"version": "0.0.1", "jax": "0.0.2", "device": "cpu"})
    told = r"^a worker has version \S+, not 0.0.1, jax \S+, not 0.0.2; give all workers the same, and run again$"
    with pytest.raises(js.StoreError, match=told):
        run(scene, "independent", tmp_path / "a.zarr", scheduler=here)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("lacking", ["jaxshroud.batch.threads", "jaxshroud.batch.compilation_cache"])
def test_a_worker_says_what_it_lacks(monkeypatch, lacking):
    asked = cloudpickle.loads(cloudpickle.dumps(cluster._worker_function()))
    monkeypatch.setitem(sys.modules, lacking, None)
    assert asked({}).startswith("a worker lacks what it needs (ModuleNotFoundError: ")


@pytest.mark.full
def test_what_is_sent_names_no_module_of_this_package():
    # By its name, a worker without the package or without jax would end while it reads it, in silence.
    told = "print(cloudpickle.dumps(cluster._worker_function()).hex())"
    sent = f"import cloudpickle; from jaxshroud.verbs import cluster; {told}"
    made = subprocess.run([sys.executable, "-c", sent], capture_output=True, text=True, check=True).stdout.strip()
    lacking = "import pickle, sys; sys.modules |= dict.fromkeys(['jax', 'jaxshroud'])"
    subprocess.run([sys.executable, "-c", f"{lacking}; pickle.loads(bytes.fromhex('{made}'))"], check=True)


def test_each_worker_is_looked_at_before_its_first_block():
    asked, like = cluster._worker_function(), cluster.machine_identity()
    assert asked(like) == like
    assert asked({**like, "jax": "0.0.2"}, b"never read", {}).endswith(", not 0.0.2")


def test_a_block_that_cannot_be_read_is_one_line():
    class Unread:
        def result(self):
            raise RuntimeError("Error during deserialization of the task graph. This frequently occurs if ...")

    with pytest.raises(js.StoreError, match=r"^a worker cannot read what it is sent: .*; give all workers the same"):
        cluster._worker_result(Unread())


def test_the_logs_of_dask_say_nothing_in_between():
    soon = dask.config.set({"distributed.comm.timeouts.connect": "0.2s"})
    with pytest.raises(MachineError), soon, cluster.connected_client(NOBODY):
        pass
    assert not logging.getLogger("distributed.client").isEnabledFor(logging.ERROR)


def test_a_mute_server_is_one_line_after_the_timeout_of_dask():
    soon = dask.config.set({"distributed.comm.timeouts.connect": "0.5s"})
    told = r"^tcp://\S+: the scheduler cannot be reached \(((T|t)imed out .*|no answer within) 0.5 ?s.*\); start it"
    with socket.create_server(("127.0.0.1", 0)) as mute, soon, pytest.raises(MachineError, match=told):
        cluster.connected_client(f"tcp://127.0.0.1:{mute.getsockname()[1]}").__enter__()


@pytest.mark.release
@pytest.mark.full
def test_workers_that_are_lost_and_added_change_nothing(scene, tmp_path, written):
    # One of two processes is killed (SIGKILL) when a third is done, and one comes when half is.
    whole = run(scene, "backward", tmp_path / "whole.zarr")
    written.clear()
    quiet = dict(dashboard_address=":0", silence_logs=50, memory_limit=0)
    with LocalCluster(n_workers=2, threads_per_worker=1, **quiet) as own, Client(own) as client:
        pids, did = client.run(os.getpid), []

        def disturb(done, total):
            if done > total / 3 and not did:
                os.kill(next(iter(pids.values())), signal.SIGKILL)
                did.append("killed")
            if done > total / 2 and len(did) == 1:
                own.scale(3)
                did.append("added")

        found = run(scene, "backward", tmp_path / "a.zarr", scheduler=own.scheduler_address, progress=disturb)
        assert did == ["killed", "added"]
    assert len(set(written)) == len(written) == 20  # nothing lost, nothing twice
    same(found, whole)


@pytest.fixture
def words(tmp_path):
    """A small sweep as a command."""
    asked = "sweep table1 --set parts.motion=[x] --along contact.gamma --start 1 --stop 2 --num 200"
    return f"{asked} --periods 2 --transient 1 --steps-per-period 100 --out {tmp_path}/s"


@pytest.fixture
def impatient():
    with dask.config.set({"distributed.comm.timeouts.connect": "0.2s"}):
        yield


@pytest.mark.full
@pytest.mark.usefixtures("impatient")
def test_a_scheduler_that_is_not_there_is_one_line_and_the_store_is_kept(words, tmp_path, capsys):
    run_command(f"{words} --store zarr")
    (tmp_path / "gone.json").write_text(json.dumps({"address": NOBODY}))
    capsys.readouterr()
    for where in (NOBODY, tmp_path / "gone.json", tmp_path / "none.json"):
        assert status_of(f"{words} --resume --scheduler {where}") == 1
        (told,) = capsys.readouterr().err.splitlines()
        assert told.startswith(f"{where}: the scheduler cannot be reached (")
        assert told.endswith("start it or give local:2")
        assert js.open(tmp_path / "s" / "sweep.zarr").complete


@pytest.mark.parametrize(
    ("where", "told"),
    [("local:0", "local:N with N workers, but is local:0"), ("a.json", "not the file of a scheduler")],
)
def test_what_is_no_scheduler_is_refused(words, tmp_path, monkeypatch, capsys, where, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.json").write_text("{}")
    assert told in refused(capsys, f"{words} --scheduler {where}")


def test_what_a_scheduler_needs_is_told(scene, words, monkeypatch, capsys):
    with pytest.raises(js.InputError, match="needs a `store`"):
        js.sweep(scene, LINE, scheduler=NOBODY, **SHORT)
    assert "leave out --store nc" in refused(capsys, f"{words} --scheduler {NOBODY} --store nc")
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    told = refused(capsys, f"{words} --scheduler {NOBODY}")
    assert told.endswith("install it by pip install 'jaxshroud[cluster]'")


@pytest.mark.full
@pytest.mark.usefixtures("impatient")
def test_a_scheduler_that_is_lost_leaves_a_store_to_go_on_with(scene, tmp_path, written):
    path, lost = tmp_path / "a.zarr", []

    def lose(done, total):
        if not lost:
            lost.append(own.close())

    with LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as own:
        where = dict(scheduler=own.scheduler_address, progress=lose)
        with pytest.raises(MachineError, match=r"inproc.*: the scheduler cannot be reached"):
            run(scene, "independent", path, **where)
    assert not js.open(path).complete
    assert 0 < len(set(written)) == len(written) < 4
    whole = run(scene, "independent", path, resume=True)
    assert len(set(written)) == len(written) == 4
    assert whole.complete


@pytest.mark.full
def test_workers_of_ones_own_listen_on_this_machine_only():
    with cluster.connected_client("local:1"):
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        sockets = [at for process in processes for at in process.net_connections("inet") if at.status == "LISTEN"]
    assert sockets
    assert {at.laddr.ip for at in sockets} <= {"127.0.0.1", "::1"}
