"""Ctrl-C, SIGTERM and SIGHUP, really sent to real processes: what ends, what is kept and what is said."""

import gc
import os
import re
import signal
import subprocess
import sys
import threading
import time

import jax
import numpy as np
import pytest
import xarray as xr
from command_line import read_json, status_of

from jaxshroud import Interrupted, Status, load, sweep
from jaxshroud import open as open_result
from jaxshroud.batch.threads import in_threads
from jaxshroud.cli import sweep as sweep_verb
from jaxshroud.cli.terminal import interruptible
from jaxshroud.march.method import RungeKutta
from jaxshroud_command import END_SIGNALS

pytestmark = pytest.mark.full

SWEEP = "sweep table1 --set parts.motion=[x] --along contact.gamma"
LONG = f"{SWEEP} --start 1 --stop 8 --num 20000 --transient 10 --periods 10".split()
# The command, with a line on standard output after every block instead of a bar; at once, as threads print together.
COMMAND = """
import sys, time
from contextlib import contextmanager
from jaxshroud.cli import computation as verb
import jaxshroud_command

@contextmanager
def told(unit):
    yield lambda done, total: (print(str(done) + chr(10), end="", flush=True), time.sleep({pause}))

verb.progress_bar = told
sys.exit(jaxshroud_command.main())
"""
LIBRARY = """
import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
import jaxshroud as js
scene = js.load("table1", ['parts.motion=["x"]']).scene
values = np.linspace(1, 2, 20000)
told = lambda done, total: print(f"{done} {total}" + chr(10), end="", flush=True)
try:
    js.sweep(scene, {"contact.gamma": values}, n_periods=20, progress=told)
except js.Interrupted as stopped:
    print("OK", (stopped.done.status == js.Status.OK).sum())
"""
# The console script, where the import of JAX never ends.
IMPORTING = """
import sys, time
class Slow:
    def find_spec(self, name, *_):
        if name == "jax":
            print("importing", flush=True)
            time.sleep(600)
sys.meta_path.insert(0, Slow())
import jaxshroud_command
jaxshroud_command.main()
"""

# Also where tests run under nohup.
HEEDING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
"""
SIGNALS = pytest.mark.parametrize("number", END_SIGNALS, ids=[number.name for number in END_SIGNALS])


@pytest.fixture(autouse=True)
def heeding():
    """Ctrl-C and its like mean something to this process, even under nohup."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in END_SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def begun(code, *words):
    """A process that runs `code`, Ctrl-C being heeded."""
    cache = {"JAX_COMPILATION_CACHE_DIR": cache} if (cache := jax.config.jax_compilation_cache_dir) else {}
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", HEEDING + code, *map(str, words)],
        stdout=pipe,
        stderr=pipe,
        text=True,
        env=os.environ | cache,
    )


def until(process, done):
    """Read the process's words until as many lane-periods are done."""
    for line in process.stdout:
        if float(line.split()[0]) >= done:
            return
    raise AssertionError(process.stderr.read())


def ended(process):
    """Exit status and standard error, without what tells that a command is at work; a limit for one that hangs."""
    told = process.communicate(timeout=600)[1].splitlines(keepends=True)
    return process.returncode, "".join(line for line in told if ": at work for " not in line)


@SIGNALS
def test_an_interrupted_sweep_keeps_the_lanes_that_had_ended(tmp_path, number):
    out = tmp_path / "s"
    process = begun(COMMAND.format(pause=0), *LONG, "--out", out)
    until(process, 20 * 64 * 20)  # chunks of 64 lanes, two or more at a time
    process.send_signal(number)
    status, error = ended(process)
    assert status == 130
    assert error.startswith("interrupted; ")
    assert "lanes that had ended" in error
    assert error.count("\n") == 1
    with xr.open_dataset(out / "sweep.nc", engine="h5netcdf") as ds:
        assert ds.attrs["complete"] == 0
        lanes = ds["status"].to_numpy()
        assert set(lanes) == {Status.OK, Status.NOT_RUN}
        assert f"the {(lanes == Status.OK).sum()} of 20000" in error
        np.testing.assert_array_equal(np.isfinite(ds["P_d"]), lanes == Status.OK)
        np.testing.assert_array_equal(np.isfinite(ds["x"]).all(("period", "blade")), lanes == Status.OK)
        assert ds["status"].attrs["flag_meanings"].split()[4] == "NOT_RUN"
    assert read_json(out / "summary.json")["status"]["NOT_RUN"] == (lanes == Status.NOT_RUN).sum()
    assert sorted(p.name for p in out.iterdir()) == ["summary.json", "sweep.nc"]


def test_a_command_whose_reader_has_gone_ends_and_keeps_what_had_ended(tmp_path):
    # As in `| head`: it has nothing to say on standard output before its end, and is not to run on until then.
    out = tmp_path / "s"
    process = begun(COMMAND.format(pause=0).replace("flush", "file=sys.stderr, flush"), *LONG, "--out", out)
    with process.stderr as told:
        for line in told:
            if line[0].isdigit() and float(line) >= 20 * 64 * 20:
                break
        process.stdout.close()
        assert told.readlines()[-1].startswith("interrupted; ")
    assert process.wait(timeout=600) == 141
    assert set(open_result(out / "sweep.nc").status) == {Status.OK, Status.NOT_RUN}


def test_a_second_interrupt_ends_the_process_at_once(tmp_path):
    # The first waits a second for the threads, one of which never ends.
    process = begun(COMMAND.format(pause=600), *LONG, "--out", tmp_path / "s")
    until(process, 1)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.2)
    assert ended(process) == (130, "interrupted; nothing was written\n")


def test_the_library_interrupted_ends_without_a_fault():
    process = begun(LIBRARY)
    until(process, 20 * 64 * 20)
    process.send_signal(signal.SIGINT)
    told, error = process.communicate(timeout=600)
    assert (process.returncode, error) == (0, "")
    assert int(told.splitlines()[-1].removeprefix("OK ")) >= 64


@SIGNALS
def test_an_interrupt_during_imports_is_one_line(number):
    process = begun(IMPORTING, "simulate", "table1", "--out", "a.nc")
    assert process.stdout.readline() == "importing\n"
    process.send_signal(number)
    assert ended(process) == (130, "interrupted; nothing was written\n")


@SIGNALS
def test_a_signal_that_is_ignored_at_the_start_stays_so(number):
    # As under nohup; the others are heeded all the same.
    other = END_SIGNALS[END_SIGNALS.index(number) - 1]
    process = begun(f"signal.signal({number:d}, signal.SIG_IGN)\n{IMPORTING}", "simulate", "table1", "--out", "a.nc")
    assert process.stdout.readline() == "importing\n"
    process.send_signal(number)
    process.send_signal(other)
    assert ended(process) == (130, "interrupted; nothing was written\n")

    signal.signal(number, signal.SIG_IGN)
    calls = []

    def signalled():
        with interruptible(lambda _: calls.append("left")):
            os.kill(os.getpid(), number)
            time.sleep(0.01)
            calls.append("went on")
            os.kill(os.getpid(), other)
            time.sleep(60)

    with pytest.raises(KeyboardInterrupt):
        signalled()
    assert calls == ["went on"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_told_twice_is_one(number):
    # A shell that ends with its terminal repeats what the terminal has sent: what has ended is still written.
    calls = []

    def signalled():
        with interruptible(lambda _: calls.append("left")):
            try:
                os.kill(os.getpid(), number)
                time.sleep(60)
            except KeyboardInterrupt:
                os.kill(os.getpid(), number)
                time.sleep(0.1)
                calls.append("written")
                raise

    with pytest.raises(KeyboardInterrupt):
        signalled()
    assert calls == ["written"]


# The command at a terminal of its own.
AT_TERMINAL = """
import fcntl, os, termios
os.setsid()
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
"""


def test_a_sweep_whose_terminal_is_closed_keeps_the_lanes_that_had_ended(tmp_path):
    terminal, own = os.openpty()
    words = [*LONG, "--out", str(tmp_path / "s")]
    code = AT_TERMINAL + HEEDING + COMMAND.format(pause=0)
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdin=own, stdout=own, stderr=own)
    os.close(own)
    with open(terminal, closefd=True) as told:
        for line in told:
            done = re.match(r"\d+", line)  # other lines are the bar
            if done and int(done[0]) > 20 * 64 * 20:
                break
    assert process.wait(timeout=600) == 130
    assert set(open_result(tmp_path / "s" / "sweep.nc").status) == {Status.OK, Status.NOT_RUN}


def test_an_interrupt_that_python_must_ignore_is_repeated():
    calls = []

    def collected(*_):
        calls.append(1)
        if len(calls) == 1:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)  # handled, and ignored, within the callback

    def collect():
        with interruptible(lambda _: calls.append("left")):
            gc.collect()
            time.sleep(60)

    gc.collect()
    gc.freeze()  # a collection that takes longer than an interrupt may is deaf, as any other call is
    gc.callbacks.append(collected)
    try:
        with pytest.raises(KeyboardInterrupt):
            collect()
    finally:
        gc.callbacks.remove(collected)
        gc.unfreeze()
    assert "left" not in calls


def test_what_was_written_before_an_interrupt_is_told(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep_verb, "draw", interrupted)
    assert status_of(f"{SWEEP} --values 1,2 --periods 2 --out {tmp_path}") == 130
    told = capsys.readouterr().err.splitlines()  # lines of progress come first where it takes long
    assert told[-1] == f"interrupted; {tmp_path / 'sweep.nc'} was written"
    assert open_result(tmp_path / "sweep.nc").complete


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_a_continued_sweep_keeps_the_rows_that_had_ended(direction):
    scene, rows = load("table1", ['parts.motion=["x"]']).scene, np.linspace(1.0, 2.0, 64)

    def stop(done, total):
        if done > total / 2:
            os.kill(os.getpid(), signal.SIGINT)

    along = {"contact.gamma": rows, "drive.F_0": [40.0, 60.0]}
    with pytest.raises(Interrupted) as stopped:
        sweep(scene, along, n_periods=2, method=RungeKutta(steps=100), direction=direction, progress=stop, transient=0)
    status = stopped.value.done.status
    assert status.shape == (64, 2)
    assert set(status.ravel()) == {Status.OK, Status.NOT_RUN}
    first, last = (status[0, 0], status[-1, 0]) if direction != "backward" else (status[-1, 0], status[0, 0])
    assert (first, last) == (Status.OK, Status.NOT_RUN)


DEAF = """
import hashlib, os
from jaxshroud.cli.terminal import interruptible
with interruptible(lambda _: os._exit(77)):
    print("deaf", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 50_000_000)  # some ten seconds in which Python hears nothing
"""


def test_an_interrupt_that_the_main_thread_does_not_hear_ends_the_process():
    process = begun(DEAF)
    assert process.stdout.readline() == "deaf\n"
    time.sleep(0.5)  # into it
    process.send_signal(signal.SIGINT)
    assert ended(process) == (77, "")  # else that of the exception, once it is heard


def test_an_interrupt_does_not_wait_for_what_compiles():
    # A compilation is one call that looks at nothing; here it ends only after the interruption has been told.
    begun, told, ended = threading.Event(), threading.Event(), []

    def run(check, i):
        if i:
            return i
        begun.set()
        ended.append(told.wait(60))

    threading.Thread(target=lambda: (begun.wait(), time.sleep(0.1), os.kill(os.getpid(), signal.SIGINT))).start()
    with pytest.raises(Interrupted) as stopped:
        in_threads(run, [0, 1])
    assert not ended
    told.set()
    assert stopped.value.done == [None, 1]


def test_a_failure_in_one_thread_is_raised_and_ends_the_others():
    ends = []

    def run(check, i):
        if i == 0:
            raise RuntimeError("the first")
        while True:
            time.sleep(0.01)
            try:
                check()
            except BaseException:
                ends.append(i)
                raise

    with pytest.raises(RuntimeError, match="the first"):
        in_threads(run, [1, 0, *range(2, 100)])
    assert set(ends) <= {1, 2}


def test_threads_have_the_settings_of_their_caller():
    read = lambda check, _: (jax.config.jax_enable_x64, str(jax.config.jax_numpy_dtype_promotion.value))
    assert in_threads(read, range(3)) == [(True, "strict")] * 3
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        assert in_threads(read, range(3)) == [(False, "standard")] * 3
