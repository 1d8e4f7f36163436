"""The large programs of a process, loaded before they are asked for: those that were used under its label before."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from jaxshroud.programs.store import ENTRY_NAME, ProgramStore, entry_name

LARGE_PROGRAM = 300_000  # bytes of a program, which take some 50 ms to load; XLA rebuilds all that it was compiled from


class LoadedAhead:
    """Programs that a thread of its own loads, in the order in which they were used before."""

    def __init__(self, store: ProgramStore, label: str, load: Callable[[str], Any]):
        self.store, self.list_name = store, entry_name(f"names of large programs\n{label}")
        self.before, self.used = self._names_before(), []
        self.thread = ThreadPoolExecutor(1)
        self.loading: dict[str, Future[Any]] = {name: self.thread.submit(load, name) for name in self.before}

    def _names_before(self) -> list[str]:
        lines = (self.store.read(self.list_name) or b"").decode("ascii", "replace").split()
        return [name for name in lines if ENTRY_NAME.fullmatch(f"{name}.program")]

    def take(self, name: str) -> Any:
        """The program of that name, once it is loaded; None if that has not begun, or has failed."""
        future = self.loading.pop(name, None)
        return None if future is None or future.cancel() else future.result()

    def note_use(self, name: str, size: int) -> None:
        """Take note that a program of so many bytes is used."""
        if size >= LARGE_PROGRAM and name not in self.used:
            self.used.append(name)

    def keep_names(self) -> None:
        """Keep the names of the programs that were used for later processes."""
        if self.used != self.before:
            self.store.write(self.list_name, "\n".join(self.used).encode())

    def close(self) -> None:
        """Load no further program."""
        self.thread.shutdown(wait=False, cancel_futures=True)
