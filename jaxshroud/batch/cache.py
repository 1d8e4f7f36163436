"""The cache of compiled programs on disk, shared by later processes."""

import os
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

from jaxshroud.scene.checks import WriteError
from jaxshroud.scene.typed import typed


@typed
def cache_compilations(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep all compiled programs on disk, so that later processes read what was compiled once.

    Commands do this by themselves; in Python this call does. A program is identified by what it computes, not by the
    numbers that it is given.

    Args:
        folder: Where to keep them; versions of JAX and kinds of processors may share it. By default the folder that JAX
            uses already (JAX_COMPILATION_CACHE_DIR), else `jaxshroud` in the user's cache folder.

    Returns:
        The folder.

    Raises:
        OSError: The folder cannot be written.

    Example:
        >>> import jaxshroud as js
        >>> js.cache_compilations().name  # doctest: +SKIP
        'jaxshroud'
    """
    place = folder or cache_folder() or _user_folder()
    if "://" not in str(place):  # as JAX names remote storage
        _make_folder(Path(place))
    jax.config.update("jax_compilation_cache_dir", str(place))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    compilation_cache.reset_cache()  # a program compiled before has already fixed that there is no cache
    return Path(place)


def cache_folder() -> str | None:
    """The folder in which JAX keeps compiled programs; None if it does not."""
    return jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]


def _user_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxshroud"


def _make_folder(folder: Path) -> None:
    """Make a folder for programs unless it exists; WriteError if it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
        why = "it may not be written"
    except OSError as error:
        why = error.strerror
    raise WriteError(f"{folder}: compiled programs cannot be kept there: {why}")
