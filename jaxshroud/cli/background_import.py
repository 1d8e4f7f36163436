"""Imports on a thread of their own, while the caller waits for what needs no Python, such as loading of programs."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Thread

DATASETS = ("xarray", "h5netcdf")
PICTURES = ("jaxshroud.plotting.pictures",)


@contextmanager
def imported_meanwhile(modules: Sequence[str]) -> Iterator[None]:
    """The modules are imported meanwhile, and at the end they are; one that is missing is left to those who need it."""
    thread = Thread(target=_import_all, args=(modules,))
    thread.start()
    try:
        yield
    finally:
        thread.join()


def _import_all(modules: Sequence[str]) -> None:
    with suppress(ImportError):
        for name in modules:
            import_module(name)
