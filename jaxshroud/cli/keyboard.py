"""Ctrl-C: the first ends the computation, a second the process."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOST = b"\0"  # told in place of a signal's number


@contextmanager
def interruptible(leave: Callable[[], None]) -> Iterator[None]:
    """Within, Ctrl-C raises KeyboardInterrupt, and a second one calls `leave`, which is to end the process.

    Python itself hears signals only between operations of its main thread, and a compilation is one operation: `leave`
    is called from a thread of its own. Where Python must ignore the exception, as in callbacks of its garbage
    collector, it is raised again. Outside the main thread, and where Ctrl-C is ignored (`nohup`), nothing changes.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        yield
        return
    heard, told = os.pipe()
    os.set_blocking(told, False)
    before = sys.unraisablehook

    def ignored(what) -> None:
        if what.exc_type is KeyboardInterrupt:
            os.write(told, LOST)
        else:
            before(what)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    outer = signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    sys.unraisablehook = ignored
    listener = threading.Thread(target=_listen, args=(heard, leave), daemon=True)
    listener.start()
    try:
        yield
    finally:
        sys.unraisablehook = before
        signal.set_wakeup_fd(outer)
        signal.signal(signal.SIGINT, handler)
        os.close(told)
        listener.join()
        os.close(heard)


def _listen(heard: int, leave: Callable[[], None]) -> None:
    presses = 0
    while number := os.read(heard, 1):
        if number == LOST:
            presses -= 1  # the repetition is no press of its own
            time.sleep(0.02)  # main thread out of the callback by then
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        presses += number[0] == signal.SIGINT
        if presses == 2:
            leave()
