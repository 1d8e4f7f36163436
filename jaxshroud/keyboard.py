"""Ctrl-C: the first ends the computation, a second the process."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interruptible(leave: Callable[[], None]) -> Iterator[None]:
    """Within, Ctrl-C raises KeyboardInterrupt, and a second one calls `leave`, which is to end the process.

    Python itself hears signals only between operations of its main thread, and a compilation is one operation: `leave`
    is called from a thread of its own. Outside the main thread, and where Ctrl-C is ignored (`nohup`), nothing changes.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        yield
        return
    heard, told = os.pipe()
    os.set_blocking(told, False)

    def listen() -> None:
        presses = 0
        while number := os.read(heard, 1):
            presses += number[0] == signal.SIGINT
            if presses == 2:
                leave()

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    outer = signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(outer)
        signal.signal(signal.SIGINT, handler)
        os.close(told)
        listener.join()
        os.close(heard)
