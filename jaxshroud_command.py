"""The console script. It comes before the package's imports, which take seconds: Ctrl-C is one line from the start.

A batch system's SIGTERM and the SIGHUP of a terminal that is closed are heeded as Ctrl-C is, each unless it is ignored
at the start, as under `nohup`.
"""

import gc
import os
import signal
import sys
from contextlib import suppress

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> int:
    """Run the command line; see `jaxshroud.cli.commands.main`."""
    heeded = [number for number in END_SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    for number in heeded:
        signal.signal(number, _leave)
    # Equations of motion are many and small: threads of OpenBLAS wait for each other longer than these take to solve.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(20_000, 20, 20)  # imports and tracing make many objects and little garbage: a sixth of the start
    from jaxshroud.cli.commands import main as run
    from jaxshroud.io.left_out import leave_out_packages

    leave_out_packages()
    status = run()
    for number in heeded:
        signal.signal(number, signal.SIG_IGN)  # all is done and said
    if status in (130, 141):  # XLA may still be at it, which the end of the interpreter does not bear
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # nobody reads it
                stream.flush()
        os._exit(status)
    return status


def _leave(*_) -> None:
    os.write(2, b"interrupted; nothing was written\n")
    os._exit(130)
