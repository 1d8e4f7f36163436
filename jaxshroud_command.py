"""The console script. It comes before the package's imports, which take seconds: Ctrl-C is one line from the start."""

import gc
import os
import signal
import sys


def main() -> int:
    """Run the command line; see `jaxshroud.cli.commands.main`."""
    heeded = signal.getsignal(signal.SIGINT) != signal.SIG_IGN
    if heeded:
        signal.signal(signal.SIGINT, _leave)
    gc.set_threshold(20_000, 20, 20)  # imports and tracing make many objects and little garbage: a sixth of the start
    from jaxshroud.cli.commands import main as run
    from jaxshroud.io.left_out import leave_out_packages

    leave_out_packages()
    status = run()
    if heeded:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done and said
    if status == 130:  # XLA may still be at it, which the end of the interpreter does not bear
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def _leave(*_) -> None:
    os.write(2, b"interrupted; nothing was written\n")
    os._exit(130)
