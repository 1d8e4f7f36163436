"""Functions compiled by `jax.jit` whose programs are kept on disk: a later process loads them and traces nothing.

JAX's own cache of compiled programs is asked only after a function has been traced, which takes longer than all the
rest. Here a program is found by what it depends on, see `key`. The programs that the same command used last time are
prefetched by a thread: loading needs little Python and takes about as long as the imports do. A program is used only
where it is requested: a list that is out of date costs time of a second core, and nothing else.
"""

import logging
import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache, wraps
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable

from jaxshroud.activity import compilation
from jaxshroud.cache import key as keys
from jaxshroud.cache.garbage import no_garbage_collected
from jaxshroud.cache.store import ProgramStore, entry_name, lead_jax_into, log, own_folder, reset_jax_cache


class Prefetch:
    """Loads entries by their names on a thread, and notes which ones are requested."""

    def __init__(self, load: Callable[[str], Any]):
        self.load = load
        self.lock = threading.Lock()
        self.stopped = threading.Event()
        self.loading: dict[str, Future] = {}  # being loaded, or loaded and not requested yet
        self.used: dict[str, None] = {}  # in the order in which they were requested

    def start(self, names: Iterable[str]) -> None:
        """Load the entries of these names, in order."""
        self.stopped.clear()
        threading.Thread(target=self._run, args=(names,)).start()

    def stop(self) -> None:
        """Load no further entry, and forget those that nobody has requested."""
        self.stopped.set()
        with self.lock:
            self.loading.clear()

    def take(self, name: str) -> Any:
        """What `load` makes of an entry: once it is ready where the thread is at it, else at once."""
        with self.lock:
            self.used[name] = None
            loading = self.loading.pop(name, None)
        return self.load(name) if loading is None else loading.result()

    @no_garbage_collected()
    def _run(self, names: Iterable[str]) -> None:
        for name in names:
            with self.lock:
                if self.stopped.is_set():
                    return
                if name in self.used:
                    continue
                loading = self.loading[name] = Future()
            try:
                loading.set_result(self.load(name))
            except BaseException as error:
                loading.set_exception(error)


_WITHOUT_JAX_CACHE = threading.Lock()
_FOR_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks", "jax_no_tracing")
_store: ProgramStore | None = None
_prefetched_command = ""  # whose programs are loaded ahead
Program = Callable[[Sequence[Any]], Any]  # of the leaves of its arguments


def keep_programs(folder: Path | None) -> None:
    """Keep programs in the folder `programs` within `folder` from now on, if that is safe; None: nowhere."""
    global _store
    place = folder and folder / "programs"
    _store = ProgramStore(place) if place is not None and own_folder(place) else None
    if _store is None:
        lead_jax_into(None)


def program_store() -> ProgramStore | None:
    """Where programs are kept; None: nowhere."""
    return _store


def where_kept() -> str:
    """Where programs and lists of them are kept, and how many, in words."""
    if _store is None:
        return "not kept"
    sizes = [size for _, size, _ in _store.entries()]
    return f"{len(sizes)} entries in {_store.folder}, {sum(sizes) / 1e6:.1f} MB"


def prefetch(command: str) -> None:
    """Begin to load, on a thread, the programs that a command used last time; see `keep_list`."""
    global _prefetched_command
    _prefetched_command = command
    _prefetcher.used.clear()
    name = _list_name()
    content = None if name is None or _store is None else _store.read(name)
    if content is not None:
        _prefetcher.start(content.decode().splitlines())


def stop_prefetch() -> None:
    """Load no further program ahead."""
    _prefetcher.stop()


def keep_list() -> None:
    """Keep the names of the programs that were used since `prefetch`, for the next run of its command."""
    name = _list_name() if _prefetcher.used else None
    used = "\n".join(_prefetcher.used).encode()
    if name is not None and _store is not None and _store.read(name) != used:
        _store.write(name, used)


def _list_name() -> str | None:
    """The name of the entry that lists the programs of the command; None if that is not known."""
    around = keys.surroundings()
    return None if around is None else entry_name(f"programs of {_prefetched_command}\n{around}")


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
        jitted: Any = jax.jit(f, static_argnames=static, **options)
        programs = Programs(f"{f.__module__}.{f.__qualname__} {sorted(static)} {options}", jitted)
        parameters = signature(f)

        @wraps(f)
        def call(*args: Any, **kwargs: Any) -> Any:
            if _store is None:
                with compilation(jitted._cache_size() == 0):
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
        return self._first_run(call, program, fixed, given) if call in self.unproven else program(leaves)

    def _first_run(self, call: Any, program: Program, fixed: dict[str, Any], given: dict[str, Any]) -> Any:
        """The results of a loaded program: what it lacks is found only when it is run."""
        try:
            results = jax.block_until_ready(program(jax.tree.leaves(given)))
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
        program = _program_of(_prefetcher.take(name))
        if program is None:
            return self._compiled(name, fixed, given)
        self.unproven.add(call)
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
            level = logging.WARNING if isinstance(unknown, keys.OwnPartError) else logging.DEBUG
            log.log(level, "%s: not kept, as it depends on %s", self.name, unknown)
            return None
        return None if around is None else "\n".join([*parts, around])

    def _compiled(self, name: str, fixed: dict[str, Any], given: dict[str, Any]) -> Program:
        """The program, compiled, and kept if that is possible."""
        structure = jax.tree.structure(given)
        with compilation():
            lowered = self.jitted.lower(**fixed, **given)
            with _without_jax_cache():
                compiled = lowered.compile()

        def program(leaves):
            return compiled(**jax.tree.unflatten(structure, leaves))

        try:
            content = _serialized(compiled, structure.num_leaves)
        except Exception as error:  # of whatever type JAX may raise for what it cannot serialise
            log.info("%s: not kept (%s)", self.name, error)
            return program
        if _store is not None and keys.source_hash() is not None:
            _store.write(name, content)
        return program


def _is_here(leaf: Any) -> bool:
    """Whether a value is known, and on the first device alone or on none."""
    if isinstance(leaf, np.ndarray):
        return True
    return not isinstance(leaf, Tracer) and (not isinstance(leaf, jax.Array) or leaf.devices() == {jax.devices()[0]})


def _serialized(compiled: Any, arguments: int) -> bytes:
    """A program, the number of its arguments, and the tree of its results with numbers for leaves.

    Structures of trees cannot be stored. What has types of the package is within bytes of its own.
    """
    executable, _, structure = serialize_executable.serialize(compiled)
    results = pickle.dumps(jax.tree.unflatten(structure, range(structure.num_leaves)))
    return pickle.dumps((executable, arguments, structure.num_leaves, results))


class _Loaded(NamedTuple):
    """A program of flat arguments and results."""

    run: Callable[..., Sequence[Any]]
    results: bytes  # their tree
    uses_lapack: bool


def _loaded(name: str) -> _Loaded | None:
    """The program of an entry; None without a sound one, and if this machine cannot load it. Imports no module."""
    content = None if _store is None else _store.read(name)
    if content is None:
        return None
    try:
        executable, arguments, leaves, results = pickle.loads(content)
        given, found = jax.tree.structure((tuple(range(arguments)), {})), jax.tree.structure(tuple(range(leaves)))
        run = serialize_executable.deserialize_and_load(executable, given, found, execution_devices=jax.devices()[:1])
        return _Loaded(run, results, b"lapack" in executable)
    except Exception as error:  # of whatever type JAX may raise for a program of another machine
        _warn_unusable(error)
        return None


def _program_of(loaded: _Loaded | None) -> Program | None:
    """A loaded program, of whose results the tree is built."""
    if loaded is None:
        return None
    structure = jax.tree.structure(pickle.loads(loaded.results))
    if loaded.uses_lapack:
        _find_lapack()
    return lambda leaves: jax.tree.unflatten(structure, loaded.run(*leaves))


@cache
def _find_lapack() -> None:
    """Let JAX look up the functions of LAPACK, which it does while it traces: a program without them would crash."""
    jax.jit(jax.lax.linalg.lu).lower(jax.ShapeDtypeStruct((1, 1), np.float32))


_prefetcher = Prefetch(_loaded)


def _warn_unusable(error: Exception) -> None:
    log.warning("a compiled program is not used (%s); it is compiled anew", " ".join(str(error).split())[:200])


@contextmanager
def _without_jax_cache() -> Iterator[None]:
    """JAX's own cache is not asked: a program that comes from it cannot be serialised again."""
    with _WITHOUT_JAX_CACHE:
        before = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
        jax.config.update("jax_enable_compilation_cache", False)
        reset_jax_cache()
        try:
            yield
        finally:
            jax.config.update("jax_enable_compilation_cache", before)
            reset_jax_cache()
