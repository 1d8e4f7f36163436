"""Programs that a thread loads before they are asked for: those that the same command used last time.

Loading needs little Python and takes about as long as the imports do. A program is used only where it is asked for: a
list that is out of date costs time of a second core, and nothing else.
"""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any


class Ahead:
    """Loads entries by their names on a thread, and notes which ones are asked for."""

    def __init__(self, load: Callable[[str], Any]):
        self.load, self.lock, self.stopped = load, threading.Lock(), threading.Event()
        self.loading: dict[str, Future] = {}  # being loaded, or loaded and not asked for yet
        self.used: dict[str, None] = {}  # in the order in which they were asked for

    def start(self, names: Iterable[str]) -> None:
        """Load the entries of these names, in order."""
        self.stopped.clear()
        threading.Thread(target=self._run, args=(names,)).start()

    def stop(self) -> None:
        """Load no further entry, and forget those that nobody has asked for."""
        self.stopped.set()
        with self.lock:
            self.loading.clear()

    def take(self, name: str) -> Any:
        """What `load` makes of an entry: once it is ready where the thread is at it, else at once."""
        with self.lock:
            self.used[name] = None
            ahead = self.loading.pop(name, None)
        return self.load(name) if ahead is None else ahead.result()

    def _run(self, names: Iterable[str]) -> None:
        for name in names:
            with self.lock:
                if self.stopped.is_set():
                    return
                if name in self.used:
                    continue
                ahead = self.loading[name] = Future()
            try:
                ahead.set_result(self.load(name))
            except BaseException as error:
                ahead.set_exception(error)
