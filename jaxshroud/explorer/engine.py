"""The process that computes for a tab: killed with its tab, whatever it is doing, as nothing else stops a compiler."""

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, BinaryIO, NamedTuple

from jaxshroud.scene.checks import MachineError

WORKERS: tuple[str, ...] = ("run", "diagram", "verdict", "saves")
ENDED = "the process that computes has ended, perhaps for want of memory; the next change begins another"


class Message(NamedTuple):
    """What goes to an engine, or comes from one."""

    kind: str  # to it: submit, cancel, learn, forget; from it: show, progress, failed, chosen, ended
    worker: str = ""
    number: int = 0  # of the wish
    content: tuple[Any, ...] = ()


class Engine:
    """An engine, as its page has it."""

    def __init__(self, command: Sequence[str]):
        """Start the process: `command` runs `serve` in it."""
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(command, **pipes, start_new_session=True)  # which no Ctrl-C reaches
        self.hear: Callable[[Message], None] = lambda message: None
        self.lock = threading.Lock()

    def listen(self, hear: Callable[[Message], None]) -> None:
        """Call `hear` with each message, in a thread, until the process ends; that is a message too."""
        self.hear = hear
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        try:
            while True:
                self.hear(pickle.load(self.process.stdout))
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            self.hear(Message("ended"))

    def send(self, message: Message) -> None:
        """Send a message; to a process that has ended, nothing."""
        assert self.process.stdin is not None
        with self.lock, suppress(OSError):  # which the thread that listens reports
            self.process.stdin.write(pickle.dumps(message))
            self.process.stdin.flush()

    def close(self) -> None:
        """End the process at once."""
        self.hear = lambda message: None
        self.process.kill()
        self.process.wait()


class Engines:
    """Engines for tabs that come: one is started early, as it takes some seconds."""

    def __init__(self, command: Sequence[str]):
        self.command = command
        self.spare = Engine(command)

    def take(self) -> Engine:
        """An engine that nobody has."""
        engine = self.spare
        self.spare = None
        return engine or Engine(self.command)

    def close(self) -> None:
        """End the one that nobody has taken."""
        if self.spare is not None:
            self.spare.close()


def serve(done: Callable[[], None]) -> None:
    """Compute what standard input asks for, until it is closed: the process ends with the one that started it.

    Args:
        done: Called after each job.
    """
    answers = os.fdopen(os.dup(1), "wb")
    wishes = sys.stdin.buffer
    os.dup2(2, 1)  # what is printed is no answer
    Service(answers, done).serve(wishes)
    os._exit(0)  # at once: what a thread compiles cannot be interrupted


class Service:
    """What an engine does in its process."""

    def __init__(self, answers: BinaryIO, done: Callable[[], None]):
        """Service at rest.

        Args:
            answers: Where messages go.
            done: Called after each job.
        """
        from jaxshroud.explorer.jobs import Methods, Worker

        self.answers = answers
        self.done = done
        self.lock = threading.Lock()
        self.methods = Methods(lambda *chosen: self._answer(Message("chosen", content=chosen)))
        self.workers = {name: Worker(partial(self._failed, name)) for name in WORKERS}
        self.numbers = dict.fromkeys(WORKERS, 0)

    def serve(self, wishes: BinaryIO) -> None:
        """Take messages until there are no more."""
        with suppress(EOFError, OSError):
            while True:
                self._take(pickle.load(wishes))

    def _take(self, message: Message) -> None:
        match message.kind:
            case "submit":
                self.numbers[message.worker] = message.number
                self.workers[message.worker].submit(self._job(message))
            case "cancel":
                self.workers[message.worker].cancel()
            case "learn":
                self.methods.learn(*message.content)
            case "forget":
                self.methods.forget(*message.content)

    def _job(self, message: Message) -> Callable[[Any], None]:
        def answer(kind, *content):
            return self._answer(message._replace(kind=kind, content=content))

        (wish,) = message.content
        inner = wish.job(self.methods, partial(answer, "show"), partial(answer, "progress"), self._is_busy)

        def job(go_on: Callable[[], None]) -> None:
            inner(go_on)
            self.done()

        return job

    def _is_busy(self, name: str) -> bool:
        return self.workers[name].busy

    def _failed(self, name: str, error: Exception) -> None:
        self._answer(Message("failed", name, self.numbers[name], (error,)))

    def _answer(self, message: Message) -> None:
        try:
            content = pickle.dumps(message)
        except Exception:  # an error that holds what cannot be sent
            content = pickle.dumps(message._replace(content=(MachineError(str(message.content[0])),)))
        with self.lock, suppress(OSError):
            self.answers.write(content)
            self.answers.flush()
