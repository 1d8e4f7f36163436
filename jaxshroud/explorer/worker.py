"""A thread that computes what a tab wants last: a new wish ends the work on an earlier one."""

import threading
from collections.abc import Callable

Continue = Callable[[], None]  # to be called regularly: raises `Outdated` once the work is no longer wanted
Job = Callable[[Continue], None]


class Outdated(Exception):  # noqa: N818  not an error
    """The result of this work is no longer wanted."""


class Worker:
    """One thread; of the jobs that it is given while it works, it does the last one."""

    def __init__(self, failed: Callable[[Exception], None]):
        """A worker at rest.

        Args:
            failed: Called in the thread with what a job raises.
        """
        self.failed, self.wakened, self.waiting = failed, threading.Condition(), None
        self.number, self.closed, self.busy = 0, False, False
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def submit(self, job: Job) -> None:
        """Do this next, and end what is being done."""
        with self.wakened:
            self.number += 1
            self.waiting, self.busy = job, True
            self.wakened.notify()

    def cancel(self) -> None:
        """End what is being done."""
        with self.wakened:
            self.number += 1
            self.waiting = None

    def close(self) -> None:
        """End the thread, once what it does has noticed."""
        with self.wakened:
            self.closed = True
            self.number += 1
            self.wakened.notify()

    def _work(self) -> None:
        while True:
            with self.wakened:
                self.busy = self.waiting is not None
                self.wakened.wait_for(lambda: self.closed or self.waiting is not None)
                if self.closed:
                    return
                job, number, self.waiting = self.waiting, self.number, None
            self._do(job, number)

    def _do(self, job: Job | None, number: int) -> None:
        def go_on() -> None:
            if self.number != number:
                raise Outdated

        try:
            if job is not None:
                job(go_on)
        except Outdated:
            pass
        except Exception as error:
            if self.number == number:
                self.failed(error)
