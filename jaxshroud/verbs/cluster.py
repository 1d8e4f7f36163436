"""Blocks of a sweep computed by the workers of Dask distributed, on this machine or on many.

Workers compute, this process writes. A block whose worker is lost is computed by another, one that has come is written
once; workers may come and go. Each computes as many blocks at once as it has threads, and each block on one of them.
"""

import json
import logging
import pickle
import re
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax

from jaxshroud.batch.cache import cache_compilations, cached_in
from jaxshroud.batch.runs import Ticker
from jaxshroud.batch.threads import alone, thread_settings, under
from jaxshroud.scene.errors import InputError, MachineError, StoreError
from jaxshroud.verbs.work import Chain, Computed, Work, answered, computed
from jaxshroud.version import __version__

if TYPE_CHECKING:
    from distributed import Client

AHEAD = 2  # blocks for each thread of a worker: the next is there when one is done
FILE = ".json"  # at the end of the name of what a scheduler writes
LOCAL = re.compile(r"local:([1-9]\d*)")
Machine = dict[str, str]


@contextmanager
def client_of(scheduler: str) -> Iterator["Client"]:
    """A connection to a scheduler of Dask distributed, or to one of this process's own, with workers.

    Args:
        scheduler: Its address, the file that it has written (`.json`), or `local:N`: N processes on this machine.

    Raises:
        InputError: Dask distributed is not installed, or there is no such kind of address.
        MachineError: The scheduler cannot be reached, or was lost.
    """
    if find_spec("distributed") is None:
        raise InputError("A scheduler needs Dask distributed; install it by pip install 'jaxshroud[cluster]'")
    local = LOCAL.fullmatch(scheduler)
    if local is None and not ("://" in scheduler or scheduler.endswith(FILE)):
        raise InputError(
            "Argument `scheduler` must be an address such as tcp://host:8786, the file of a scheduler (.json) or "
            f"local:N with N workers, but is {scheduler}."
        )
    try:
        with ExitStack() as stack:
            address = _in_file(scheduler) if scheduler.endswith(FILE) else scheduler
            yield _connected(stack, address, local and int(local[1]))
    except (OSError, CancelledError) as error:
        if isinstance(error, StoreError):
            raise
        told = " ".join(str(error).split()) or type(error).__name__
        raise MachineError(f"{scheduler}: the scheduler cannot be reached ({told}); start it or give local:2") from None


def _in_file(path: str) -> str:
    """The address that a scheduler has written."""
    try:
        return str(json.loads(Path(path).read_text("utf-8"))["address"])
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: not the file of a scheduler; `dask scheduler --scheduler-file` writes one") from None


def _connected(stack: ExitStack, address: str, workers: int | None) -> "Client":
    """A client as long as the stack is open, and with it so many workers of its own."""
    from distributed import Client, LocalCluster

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told in one line
    if workers is not None:
        own: Any = {"n_workers": workers, "threads_per_worker": 1, "memory_limit": 0, "dashboard_address": None}
        cluster: Any = stack.enter_context(LocalCluster(**own, silence_logs=logging.CRITICAL))
        address = cluster.scheduler_address
    client = Client.__new__(Client)
    try:
        client.__init__(address, set_as_default=False)
    except Exception as error:
        client.status = "closed"  # else its end waits for whoever does not answer, and complains
        if isinstance(error, MemoryError):  # of an answer that is no scheduler's
            raise ConnectionError("what answers is no scheduler") from None
        raise
    stack.enter_context(client)
    if workers is not None:
        client.run(_deaf)
    return client


def _deaf() -> None:
    """Make a worker of this process heed no Ctrl-C, which ends it by way of this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def machine() -> Machine:
    """What the numbers of a sweep depend on, beside what is asked."""
    return {"version": __version__, "jax": jax.__version__, "device": jax.devices()[0].device_kind}


def machine_of(client: "Client") -> Machine:
    """That of the workers, when the first of them is there."""
    return client.submit(machine, pure=False).result()


def on_workers(chains: Iterable[Chain], client: "Client", like: Machine, tick: Callable[[int], None]) -> None:
    """Everything computed by workers, some blocks ahead of each.

    Args:
        chains: Blocks that need each other; where there are many chains, many workers have something to do.
        client: The connection to their scheduler.
        like: What the workers have to be.
        tick: Told how many lanes more are done.

    Raises:
        StoreError: A worker is not as it has to be.
        MachineError: A block has ended several workers.
    """
    import cloudpickle
    from distributed import Future, KilledWorker, as_completed

    threads: Any = client.nthreads
    settings, waiting, done = thread_settings() | {"default_device": None}, iter(chains), as_completed(loop=client.loop)
    under_way: dict[Future, tuple[Chain, Work]] = {}

    def begin(chain: Chain, work: Work | None) -> None:
        if work is not None:
            sent = cloudpickle.dumps(work._replace(wanted=work.wanted._replace(ticker=Ticker(0, None))))
            future = client.submit(_computed, sent, settings, like, pure=False)
            under_way[future] = chain, work
            done.add(future)

    while True:
        room = AHEAD * sum(threads().values()) + 1
        while len(under_way) < room and (chain := next(waiting, None)) is not None:
            begin(chain, next(chain, None))
        if not under_way:
            return
        future = next(done)
        chain, work = under_way.pop(future)
        try:
            found = future.result()
        except KilledWorker as error:
            raise MachineError(f"workers were lost again and again over one block of lanes ({error})") from None
        tick(work.lanes)
        begin(chain, answered(chain, found))


def _computed(sent: bytes, settings: dict[str, Any], like: Machine) -> Computed:
    """A block, by one thread of a worker."""
    if not cached_in():
        cache_compilations()
    if (own := machine()) != like:
        told = ", ".join(f"{name} {own[name]}, not {like[name]}" for name in like if own[name] != like[name])
        raise StoreError(f"a worker has {told}; give all workers the same, and run again")
    with under(settings), alone():  # read only now: without them, numbers of float64 would come as float32
        return computed(pickle.loads(sent))
