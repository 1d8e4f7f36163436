"""Calls on one thread per core and on all devices, under the caller's JAX settings; Ctrl-C ends them soon, all of them.

Calls go to the devices in turn: what is computed does not depend on how many there are.
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

from jaxshroud.batch.xla import Tree

Check = Callable[[], None]  # to be called now and then: ends its thread's work once that is no longer wanted
SETTINGS = (  # of JAX that belong to a thread
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
_own = local()  # what is so of the thread at hand


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in the midst of a computation, all of whose threads have ended.

    `done` is what had been finished by then, None if nothing had. Of a `sweep` it is the `SweepResult`, in which the
    other lanes have status `NOT_RUN`.
    """

    def __init__(self, done: Any):
        super().__init__()
        self.done = done


class _Unwanted(Exception):  # noqa: N818  not an error
    """The results of a thread are no longer wanted."""


def cores() -> int:
    """How many threads share the calls of this one: one per core that the process may use."""
    if getattr(_own, "alone", False):
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def alone() -> Iterator[None]:
    """Within, calls of this thread share one thread: others of the process are busy with the like."""
    _own.alone = True
    try:
        yield
    finally:
        _own.alone = False


def in_threads(run: Callable[..., Tree], *columns: Iterable[Any]) -> list[Tree]:
    """`run(check, *row)` of every row of the columns.

    Raises:
        Interrupted: Ctrl-C; `done` has the results in order, None for rows that had not ended.
    """
    unwanted, settings = Event(), thread_settings()

    def check() -> None:
        if unwanted.is_set():
            raise _Unwanted

    def one(device: dict[str, Any], *row: Any) -> Tree:
        check()
        with under(settings | device):
            return run(check, *row)

    devices = _devices()
    pool, calls = ThreadPoolExecutor(max(cores(), len(devices))), []
    try:
        rows = zip(*columns, strict=True)
        calls.extend(pool.submit(one, device, *row) for device, row in zip(cycle(devices), rows, strict=False))
        for call in wait(calls, return_when=FIRST_EXCEPTION).done:
            call.result()
    except KeyboardInterrupt:
        unwanted.set()
        _end(pool)
        raise Interrupted([_result(call) for call in calls]) from None
    finally:
        unwanted.set()
        _end(pool)
    return [call.result() for call in calls]


def in_chunks(run: Callable[[Check, np.ndarray], Tree], lanes: int, width: int) -> Tree:
    """`run` of the numbers of `width` lanes at a time (the last is repeated), all lanes of all results in one tree.

    Raises:
        Interrupted: As in `in_threads`; its `done` has None for chunks that had not ended, and the rest of the results.
    """
    pieces = [np.minimum(np.arange(i, i + width), lanes - 1) for i in range(0, lanes, width)]
    return joined(in_threads(run, pieces), lanes)


def joined(results: list[Tree], lanes: int) -> Tree:
    """Results of chunks as one tree of arrays with a leading axis of so many lanes."""
    return jax.tree.map(lambda *a: np.concatenate(a)[:lanes], *results)


def _devices() -> list[dict[str, Any]]:
    """Settings of each device that takes its turn: all, but where there is one or the caller has chosen one."""
    every = jax.local_devices()
    chosen = len(every) == 1 or thread_settings()["default_device"] is not None
    return [{}] if chosen else [{"default_device": device} for device in every]


def thread_settings() -> dict[str, Any]:
    """The thread's JAX settings."""
    return {name: getattr(jax.config, f"jax_{name}") for name in SETTINGS}


def under(settings: dict[str, Any]) -> ExitStack:
    """The thread's JAX settings made those `settings`, until the end of a `with` statement."""
    stack, own = ExitStack(), thread_settings()
    for name, value in settings.items():
        if own[name] != value:
            stack.enter_context(getattr(jax, name)(value))
    return stack


def _end(pool: ThreadPoolExecutor) -> None:
    """Wait for the calls under way, whatever the keyboard says: threads in XLA must not outlive the interpreter."""
    while True:
        try:
            return pool.shutdown(cancel_futures=True)
        except KeyboardInterrupt:
            continue


def _result(call: "Future[Tree]") -> Tree | None:
    return None if call.cancelled() or call.exception() else call.result()
