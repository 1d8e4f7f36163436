"""JAX's own cache of compiled programs, led into the store of this package: an entry is checked before JAX loads it.

JAX reads its entries unchecked: a damaged one, or one that was exchanged with another, fails when it is run. It has no
public way to be given another cache; where the private one is not as it was, JAX keeps nothing.
"""

import platform

from jax._src import compilation_cache

from jaxshroud.programs.key import processor_features
from jaxshroud.programs.store import ProgramStore, entry_name

_cache: "CheckedCache | None" = None


class CheckedCache:
    """What JAX asks for the entry of a key, and gives one to keep."""

    def __init__(self, store: ProgramStore):
        self.store, self.machine = store, f"{platform.machine()}\n{processor_features()}"
        self._path = store.folder  # which JAX tells in its log

    def get(self, key: str) -> bytes | None:
        """The entry of a key; None if there is none, or it is not as it was written, here."""
        return self.store.read(self._name(key))

    def put(self, key: str, value: bytes) -> None:
        """Keep an entry."""
        self.store.write(self._name(key), value)

    def _name(self, key: str) -> str:
        return entry_name(f"of JAX\n{key}\n{self.machine}")


def lead_jax_into(store: ProgramStore | None) -> bool:
    """Let JAX keep its entries in a store from now on; None: wherever JAX is told. Whether that could be done."""
    global _cache
    _cache = None if store is None or not hasattr(compilation_cache, "_cache") else CheckedCache(store)
    reset_jax_cache()
    return store is None or _cache is not None


def reset_jax_cache() -> None:
    """Let JAX ask anew whether it has a cache, and where."""
    compilation_cache.reset_cache()
    if _cache is not None:
        compilation_cache._cache = _cache  # pyright: ignore[reportAttributeAccessIssue]
