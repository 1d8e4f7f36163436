"""Packages that xarray looks for at its first use and when it writes, and whose arrays no result of ours has.

To import them takes longer than most commands. In the process of a command, and only there, xarray does not find them;
everything else does, before and after. A notebook that uses this package keeps them.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

LEFT_OUT = ("dask", "distributed", "pint", "cftime")


def leave_out_packages() -> None:
    """From now on, xarray does not find them in this process."""
    sys.meta_path.insert(0, _XarrayFinder())


@contextmanager
def packages_left_out() -> Iterator[None]:
    """Within, the packages cannot be found, if they are left out in this process and nothing has imported them yet."""
    missing = [name for name in LEFT_OUT if name not in sys.modules] if _is_left_out() else []
    for name in missing:
        sys.modules[name] = None  # type: ignore[assignment]  # as the import system documents
    try:
        yield
    finally:
        for name in missing:
            sys.modules.pop(name, None)


def _is_left_out() -> bool:
    return any(isinstance(finder, _XarrayFinder) for finder in sys.meta_path)


class _XarrayFinder(MetaPathFinder):
    """Finds xarray as usual, to be loaded without the packages."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of xarray; None for all else."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname == "xarray" else None
        if spec is not None and spec.loader is not None:
            spec.loader = _XarrayLoader(spec.loader)
        return spec


class _XarrayLoader(Loader):
    """Loads xarray by its own loader, and uses it once, after which it remembers which packages there are."""

    def __init__(self, loader: Loader):
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """As its own loader does."""
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Load it and use it."""
        with packages_left_out():
            self.loader.exec_module(module)
            some = module.Dataset({"a": ("x", [0.0])})
            module.concat([some, some], "x")["a"].to_numpy()
