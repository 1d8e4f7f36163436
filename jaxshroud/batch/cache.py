"""Compiled programs kept on disk, for all processes to come."""

import os
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache


def cache_compilations(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep compiled programs on disk, of all sizes: what was compiled once is read in every process after.

    Commands do it by themselves; in Python this one call does. Programs are known by what they do, not by the numbers
    they are given.

    Args:
        folder: Where to keep them, for versions of JAX and kinds of processor side by side. By default where JAX is
            told to already (JAX_COMPILATION_CACHE_DIR), else `jaxshroud` in the user's folder for caches.

    Returns:
        The folder.

    Example:
        >>> import jaxshroud as js
        >>> js.cache_compilations().name  # doctest: +SKIP
        'jaxshroud'
    """
    place = folder or cached_in() or _of_user()
    jax.config.update("jax_compilation_cache_dir", str(place))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    compilation_cache.reset_cache()  # else a program that was compiled before has settled where none is kept
    return Path(place)


def cached_in() -> str | None:
    """Where JAX keeps compiled programs; None if it does not."""
    return jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]


def _of_user() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxshroud"
