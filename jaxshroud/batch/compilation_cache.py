"""The cache of compiled programs on disk, shared by later processes."""

import os
from pathlib import Path

import jax

from jaxshroud.cache.programs import keep_programs, program_store
from jaxshroud.cache.store import lead_jax_into, reset_jax_cache
from jaxshroud.scene.checks import InputError, WriteError
from jaxshroud.scene.typed import typed


@typed
def cache_compilations(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep all compiled programs on disk, so that later processes read what was compiled once.

    Commands do this by themselves; in Python this call does. A program is identified by what it computes, not by the
    numbers that it is given. On a CPU, the programs of this package are loaded without being traced again: they are
    identified by the package's sources, the versions of what it is built on, the options of JAX and the processor.
    These and JAX's own entries are kept in the folder `programs` within, which must be the user's own, with mode 700,
    in a folder that others may not write; else nothing is kept, which is said once with the cure. An entry holds code,
    so its checksum is compared before it is used. That finds damage, not malice by somebody with the user's own rights.
    Programs with a user's own laws are traced in each process.

    With JAXSHROUD_CACHE=off in the environment nothing is kept.

    Args:
        folder: Where to keep them; versions of JAX and kinds of processors may share it. By default the folder that JAX
            uses already (JAX_COMPILATION_CACHE_DIR), else `jaxshroud` in the user's cache folder.

    Returns:
        The folder.

    Raises:
        OSError: The folder cannot be written.
        ValueError: JAXSHROUD_CACHE is neither "on" nor "off".

    Example:
        >>> import jaxshroud as js
        >>> js.cache_compilations().name  # doctest: +SKIP
        'jaxshroud'
    """
    place = folder or cache_folder() or _user_folder()
    if not _wanted():
        keep_programs(None)
        return Path(place)
    remote = "://" in str(place)  # as JAX names remote storage
    if not remote:
        _make_folder(Path(place))
    keep_programs(None if remote else Path(place))
    store = program_store()
    checked = store is not None and lead_jax_into(store)
    jax.config.update("jax_compilation_cache_dir", str(place) if remote or checked else None)
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    reset_jax_cache()  # a program compiled before has already fixed that there is no cache
    return Path(place)


def cache_folder() -> str | None:
    """The folder in which JAX keeps compiled programs; None if it does not."""
    return jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]


def _wanted() -> bool:
    """Whether the environment lets programs be kept."""
    word = os.environ.get("JAXSHROUD_CACHE") or "on"
    if word not in ("on", "off"):
        raise InputError(f"JAXSHROUD_CACHE must be on or off, but is {word!r}")
    return word == "on"


def _user_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxshroud"


def _make_folder(folder: Path) -> None:
    """Make a folder for programs unless it exists; WriteError if it cannot be written."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
        why = "it may not be written"
    except OSError as error:
        why = error.strerror
    raise WriteError(f"{folder}: compiled programs cannot be kept there: {why}")
