"""Calls on one thread per core and on all devices, with the caller's JAX settings, which Ctrl-C ends soon.

The calls go to the devices in turn; the results do not depend on the number of devices.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from itertools import cycle
from threading import Event, local
from typing import Any

import jax
import numpy as np

from jaxshroud.scene.typed import Tree
from jaxshroud.version import __version__

MachineIdentity = dict[str, str]
Check = Callable[[], None]  # to be called regularly: ends the work of its thread once the result is no longer wanted
SECONDS_TO_END = 1.0  # after Ctrl-C, for calls that are running: one to the device takes less
JAX_SETTINGS = (  # those that are local to a thread
    "enable_x64",
    "numpy_dtype_promotion",
    "numpy_rank_promotion",
    "default_device",
    "default_matmul_precision",
    "debug_nans",
    "debug_infs",
    "disable_jit",
    "log_compiles",
)
_thread_flags = local()  # flags of the current thread


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a computation, all of whose threads have ended.

    `done` is the finished part, or None. For a `sweep` it is the `SweepResult`, in which the other lanes have the
    status `NOT_RUN`.
    """

    def __init__(self, done: Any):
        super().__init__()
        self.done = done


@contextmanager
def changing_what_is_done(change: Callable[[Any], Any]) -> Iterator[None]:
    """A context in which an interruption carries the finished part, if there is one, as changed."""
    try:
        yield
    except Interrupted as stopped:
        raise Interrupted(stopped.done and change(stopped.done)) from None


class _Unwanted(Exception):  # noqa: N818  not an error
    """The results of a thread are no longer wanted."""


def machine_identity() -> MachineIdentity:
    """The versions and the kind of device, on which numbers depend besides what is computed."""
    return {"version": __version__, "jax": jax.__version__, "device": jax.devices()[0].device_kind}


def cores() -> int:
    """The number of threads that share the calls of this one: one per core that the process may use."""
    if getattr(_thread_flags, "alone", False):
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def single_threaded() -> Iterator[None]:
    """A context in which calls of this thread run one by one, as other processes or threads are busy as well."""
    _thread_flags.alone = True
    try:
        yield
    finally:
        _thread_flags.alone = False


def in_threads(run: Callable[..., Tree], *columns: Iterable[Any]) -> list[Tree]:
    """The results of `run(check, *row)` for every row of the columns.

    Raises:
        Interrupted: On Ctrl-C; `done` has the results in order, with None for rows that had not ended. What compiles
            cannot be interrupted: its thread is left to end by itself.
    """
    unwanted = Event()
    settings = thread_settings()

    def check() -> None:
        if unwanted.is_set():
            raise _Unwanted

    def one(device: dict[str, Any], *row: Any) -> Tree:
        check()
        with jax_settings(settings | device):
            return run(check, *row)

    devices = _devices()
    pool = ThreadPoolExecutor(max(cores(), len(devices)))
    calls = []
    try:
        rows = zip(*columns, strict=True)
        calls.extend(pool.submit(one, device, *row) for device, row in zip(cycle(devices), rows, strict=False))
        for call in wait(calls, return_when=FIRST_EXCEPTION).done:
            call.result()
    except KeyboardInterrupt:
        unwanted.set()
        _despite_interrupts(lambda: wait(calls, SECONDS_TO_END))
        pool.shutdown(wait=False, cancel_futures=True)
        raise Interrupted([_result_or_none(call) for call in calls]) from None
    except BaseException:
        unwanted.set()
        _despite_interrupts(lambda: pool.shutdown(cancel_futures=True))
        raise
    pool.shutdown()
    return [call.result() for call in calls]


def in_chunks(run: Callable[[Check, np.ndarray], Tree], lanes: int, width: int) -> Tree:
    """The results of `run(check, numbers)` for chunks of `width` lanes, filled up with the last, as one tree.

    Raises:
        Interrupted: As in `in_threads`; `done` has the results of the chunks, with None for those that had not ended.
    """
    pieces = [np.minimum(np.arange(i, i + width), lanes - 1) for i in range(0, lanes, width)]
    return concatenated_lanes(in_threads(run, pieces), lanes)


def concatenated_lanes(results: list[Tree], lanes: int) -> Tree:
    """The results of chunks as one tree of arrays with a leading axis of `lanes` lanes."""
    return jax.tree.map(lambda *a: np.concatenate(a)[:lanes], *results)


def _devices() -> list[dict[str, Any]]:
    """The settings of each device in use: of all devices, unless there is only one or the caller has chosen one."""
    every = jax.local_devices()
    chosen = len(every) == 1 or thread_settings()["default_device"] is not None
    return [{}] if chosen else [{"default_device": device} for device in every]


def thread_settings() -> dict[str, Any]:
    """The JAX settings of this thread."""
    return {name: getattr(jax.config, f"jax_{name}") for name in JAX_SETTINGS}


def jax_settings(settings: dict[str, Any]) -> ExitStack:
    """A context with these JAX `settings` for this thread."""
    stack = ExitStack()
    own = thread_settings()
    for name, value in settings.items():
        if own[name] != value:
            stack.enter_context(getattr(jax, name)(value))
    return stack


def _despite_interrupts(wait_for: Callable[[], object]) -> None:
    """Wait, despite further Ctrl-C."""
    while True:
        try:
            wait_for()
            return
        except KeyboardInterrupt:
            continue


def _result_or_none(call: "Future[Tree]") -> Tree | None:
    return None if not call.done() or call.cancelled() or call.exception() else call.result()
