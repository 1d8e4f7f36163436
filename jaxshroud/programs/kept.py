"""Functions compiled by `jax.jit` whose programs are kept on disk: a later process loads them and traces nothing.

JAX's own cache of compiled programs is asked only after a function has been traced, which takes longer than all the
rest. Here a program is found by what it depends on, see `key`.
"""

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache

from jaxshroud.programs import key as keys
from jaxshroud.programs.ahead import LoadedAhead
from jaxshroud.programs.store import ProgramStore, entry_name, log, own_folder

_WITHOUT_JAX_CACHE = threading.Lock()
_FOR_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks", "jax_no_tracing")
_store: ProgramStore | None = None
_ahead: LoadedAhead | None = None
Program = Callable[..., Any]


def keep_programs(folder: Path | None) -> None:
    """Keep programs in the folder `programs` within `folder` from now on, if that is safe; None: nowhere."""
    global _store
    place = folder and folder / "programs"
    _store = ProgramStore(place) if place is not None and own_folder(place) else None


def program_store() -> ProgramStore | None:
    """Where programs are kept; None: nowhere."""
    return _store


@contextmanager
def programs_loaded_ahead(label: str) -> Iterator[None]:
    """Within, the large programs that were used under this label before are loaded before they are asked for."""
    global _ahead
    around = keys.surroundings() if _store is not None and jax.default_backend() == "cpu" else None
    if _store is None or around is None:
        yield
        return
    _ahead = LoadedAhead(_store, f"{label}\n{around}", _loaded_by_name)
    try:
        yield
        _ahead.keep_names()
    finally:
        _ahead.close()
        _ahead = None


def where_kept() -> str:
    """Where programs are kept, and how many there are, in words."""
    if _store is None:
        return "not kept"
    sizes = [size for _, size, _ in _store.entries()]
    return f"{len(sizes)} in {_store.folder}, {sum(sizes) / 1e6:.1f} MB"


def is_traced(tree: object) -> bool:
    """Whether any number of a tree is known only while a transformed function runs."""
    return any(isinstance(a, Tracer) for a in jax.tree.leaves(tree))


def kept(*static: str, **options: Any) -> Callable[[Callable], Callable]:
    """A decorator like `jax.jit`, with programs that are kept where `keep_programs` says.

    Args:
        static: The names of static arguments.
        options: Further arguments of `jax.jit`.

    The function has the attributes `jitted`, the function that `jax.jit` makes of it, and `programs`.
    """

    def decorate(f: Callable) -> Callable:
        jitted = jax.jit(f, static_argnames=static, **options)
        programs = Programs(f"{f.__module__}.{f.__qualname__} {sorted(static)} {options}", jitted)
        parameters = signature(f)

        @wraps(f)
        def call(*args: Any, **kwargs: Any) -> Any:
            if _store is None:
                return jitted(*args, **kwargs)
            given = parameters.bind(*args, **kwargs).arguments if args else dict(kwargs)
            fixed = {name: given.pop(name) for name in static if name in given}
            return programs.run(fixed, given)

        call.jitted, call.programs = jitted, programs  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


class Programs:
    """The programs of one function, by their static arguments and the types of the others."""

    def __init__(self, name: str, jitted: Any):
        self.name, self.jitted = name, jitted
        self.found: dict[Any, Program | None] = {}  # None: left to JAX
        self.unproven: set[Any] = set()  # loaded, and not run yet
        self.lock = threading.Lock()

    def __len__(self) -> int:
        """The number of programs in this process."""
        return sum(program is not None for program in self.found.values()) + self.jitted._cache_size()

    def run(self, fixed: dict[str, Any], given: dict[str, Any]) -> Any:
        """The results for static arguments that are `fixed`, and the others."""
        leaves, structure = jax.tree.flatten(given)
        if not all(map(_is_here, leaves)):  # traced as part of another program, or elsewhere
            return self.jitted(**fixed, **given)
        call = (tuple(fixed.items()), structure, tuple(map(jax.typeof, leaves)), keys.settings())
        if call not in self.found:
            with self.lock:  # threads that need the same program wait for it
                if call not in self.found:
                    self.found[call] = self._load_or_compile(call, fixed, given)
        program = self.found[call]
        if program is None:
            return self.jitted(**fixed, **given)
        return self._first_run(call, program, fixed, given) if call in self.unproven else program(**given)

    def _first_run(self, call: Any, program: Program, fixed: dict[str, Any], given: dict[str, Any]) -> Any:
        """The results of a loaded program: what it lacks is found only when it is run."""
        try:
            results = jax.block_until_ready(program(**given))
        except jax.errors.JaxRuntimeError as error:
            _warn_unusable(error)
            self.found[call] = None
            results = self.jitted(**fixed, **given)
        self.unproven.discard(call)
        return results

    def _load_or_compile(self, call: Any, fixed: dict[str, Any], given: dict[str, Any]) -> Program | None:
        key = self._key(fixed, given)
        if key is None or _store is None:
            return None
        name = entry_name(key)
        program, size = _loaded_before(name, given) or _loaded(_store.read(name), given)
        if program is None:
            program, size = self._compiled(name, fixed, given)
        else:
            self.unproven.add(call)
        if _ahead is not None:
            _ahead.note_use(name, size)
        return program

    def _key(self, fixed: dict[str, Any], given: dict[str, Any]) -> str | None:
        """What the program depends on; None if that is not known, or programs are not to be kept."""
        known = self.name.startswith("jaxshroud.")  # its sources are part of the key
        if not known or jax.default_backend() != "cpu" or any(getattr(jax.config, name) for name in _FOR_DEBUGGING):
            return None
        around = keys.surroundings()
        try:
            structure = keys.tree_description(jax.tree.structure(given))
            types = [f"{jax.typeof(a)} {jax.typeof(a).weak_type}" for a in jax.tree.leaves(given)]
            parts = [self.name, keys.description(fixed), structure, *types, str(keys.settings())]
        except keys.UnknownPartError as unknown:
            log.debug("%s: not kept, as it depends on %s", self.name, unknown)
            return None
        return None if around is None else "\n".join([*parts, around])

    def _compiled(self, name: str, fixed: dict[str, Any], given: dict[str, Any]) -> tuple[Program, int]:
        """The program, compiled, and kept if that is possible; and its size in bytes, 0 if it is not."""
        lowered = self.jitted.lower(**fixed, **given)
        with _without_jax_cache():
            program = lowered.compile()
        try:
            content = _serialized(program, given)
        except Exception as error:  # of whatever type JAX may raise for what it cannot serialise
            log.info("%s: not kept (%s)", self.name, error)
            return program, 0
        if _store is not None and keys.source_hash() is not None:
            _store.write(name, content)
        return program, len(content)


def _is_here(leaf: Any) -> bool:
    """Whether a value is known, and on the first device alone or on none."""
    if isinstance(leaf, np.ndarray):
        return True
    return not isinstance(leaf, Tracer) and (not isinstance(leaf, jax.Array) or leaf.devices() == {jax.devices()[0]})


def _serialized(program: Any, given: dict[str, Any]) -> bytes:
    """A program, and the trees of results and arguments with numbers for leaves: structures cannot be stored."""
    executable, _, results = serialize_executable.serialize(program)
    numbered = (jax.tree.unflatten(tree, range(tree.num_leaves)) for tree in (results, jax.tree.structure(given)))
    return pickle.dumps((executable, *numbered))


def _loaded(content: bytes | None, given: dict[str, Any] | None = None) -> tuple[Program | None, int]:
    """The program of an entry that is what was written, and its size; None if this machine cannot load or run it.

    Its arguments have the structure of those that are given, by default of those for which it was compiled.
    """
    if content is None:
        return None, 0
    try:
        executable, results, arguments = pickle.loads(content)
        structure = jax.tree.structure(((), arguments if given is None else given))
        program = serialize_executable.deserialize_and_load(
            executable, structure, jax.tree.structure(results), execution_devices=jax.devices()[:1]
        )
    except Exception as error:  # of whatever type JAX may raise for a program of another machine
        _warn_unusable(error)
        return None, 0
    return program, len(content)


def _loaded_by_name(name: str) -> tuple[Program | None, int]:
    """The program of the entry of that name."""
    return _loaded(None if _store is None else _store.read(name))


def _loaded_before(name: str, given: dict[str, Any]) -> tuple[Any, int] | None:
    """The program of that name and its size, if it was loaded ahead, for arguments of this structure."""
    program, size = (_ahead and _ahead.take(name)) or (None, 0)
    fits = program is not None and program.in_tree == jax.tree.structure(((), given))
    return (program, size) if fits else None


def _warn_unusable(error: Exception) -> None:
    log.warning("a compiled program is not used (%s); it is compiled anew", " ".join(str(error).split())[:200])


@contextmanager
def _without_jax_cache() -> Iterator[None]:
    """JAX's own cache is not asked: a program that comes from it cannot be serialised again."""
    with _WITHOUT_JAX_CACHE:
        before = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
        jax.config.update("jax_enable_compilation_cache", False)
        compilation_cache.reset_cache()
        try:
            yield
        finally:
            jax.config.update("jax_enable_compilation_cache", before)
            compilation_cache.reset_cache()
