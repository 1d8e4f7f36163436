"""Imports on a thread of their own, while programs are loaded and scenes are marched, which needs little Python."""

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from threading import Thread

DATASETS = ("xarray", "h5netcdf")
STATISTICS = ("scipy.special",)
PICTURES = ("jaxshroud.plotting.pictures",)
PDF_PICTURES = ("matplotlib.backends.backend_pdf",)


def import_in_background(modules: Sequence[str]) -> None:
    """Import modules, if they exist, meanwhile: an import statement of one of them waits until it has been imported."""
    Thread(target=_import_all, args=(modules,)).start()


def _import_all(modules: Sequence[str]) -> None:
    with suppress(ImportError):
        for name in modules:
            import_module(name)
