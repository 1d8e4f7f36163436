"""Parts of a sweep computed by the workers of Dask distributed, on this machine or on many.

Workers compute, this process writes. A part whose worker is lost is computed by another worker; each part is written
once. Workers may come and go. Each computes as many parts at once as it has threads, and each part on one thread.
"""

import json
import logging
import re
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, no_type_check

import jax

from jaxshroud.batch.plan import Ticker
from jaxshroud.batch.threads import thread_settings
from jaxshroud.scene.checks import InputError, MachineError, StoreError
from jaxshroud.verbs.sweep_block import Chain, ComputedPart, SweepTask, next_part
from jaxshroud.version import __version__
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    from distributed import Client, Future

GRACE_SECONDS = 1.0  # beyond Dask's own timeout, in which it reports that nobody answers
FILE_SUFFIX = ".json"  # of the file that a scheduler writes
LOCAL_SCHEDULER = re.compile(r"local:([1-9]\d*)")
MachineIdentity = dict[str, str]


@contextmanager
def connected_client(scheduler: str) -> Iterator["Client"]:
    """A connection to a scheduler of Dask distributed, or to one of this process's own, with workers.

    Args:
        scheduler: Its address, the file that it has written (`.json`), or `local:N` for N processes on this machine.

    Raises:
        InputError: Dask distributed is not installed, or the address is malformed.
        MachineError: The scheduler cannot be reached, or was lost.
    """
    if find_spec("distributed") is None:
        raise InputError("A scheduler needs Dask distributed; install it by pip install 'jaxshroud[cluster]'")
    local_match = LOCAL_SCHEDULER.fullmatch(scheduler)
    if local_match is None and not ("://" in scheduler or scheduler.endswith(FILE_SUFFIX)):
        raise InputError(
            "Argument `scheduler` must be an address such as tcp://host:8786, the file of a scheduler (.json) or "
            f"local:N with N workers, but is {scheduler}."
        )
    try:
        with ExitStack() as stack:
            address = _address_in_file(scheduler) if scheduler.endswith(FILE_SUFFIX) else scheduler
            yield _new_client(stack, address, local_match and int(local_match[1]))
    except (OSError, CancelledError) as error:
        if isinstance(error, StoreError):
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MachineError(
            f"{scheduler}: the scheduler cannot be reached ({reason}); start it or give local:2"
        ) from None


def _address_in_file(path: str) -> str:
    """The address in the file that a scheduler has written."""
    try:
        with open_regular(Path(path)) as file:
            return str(json.load(file)["address"])
    except FileNotFoundError:
        raise
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{path}: not the file of a scheduler; `dask scheduler --scheduler-file` writes one") from None


def _new_client(stack: ExitStack, address: str, workers: int | None) -> "Client":
    """A client that lives as long as the stack is open, as do its own `workers` if their number is given.

    Dask's timeout is applied to the first answer too, for which Dask would wait without end.

    Raises:
        ConnectionError: What has that address is not there, is no scheduler, or does not answer.
    """
    from dask import config
    from dask.utils import parse_timedelta
    from distributed import Client, LocalCluster

    for name in ("distributed", "distributed.client"):  # the client's logger has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are reported in one line instead
    if workers is not None:
        options: Any = {"memory_limit": 0, "dashboard_address": None, "silence_logs": logging.CRITICAL}
        cluster: Any = LocalCluster(n_workers=workers, threads_per_worker=1, **options)
        address = stack.enter_context(cluster).scheduler_address
    client = Client.__new__(Client)
    raised: list[Exception] = []

    def connect() -> None:
        try:
            client.__init__(address, set_as_default=False)
        except Exception as error:
            raised.append(error)

    limit = parse_timedelta(config.get("distributed.comm.timeouts.connect"))
    waiting = Thread(target=connect, daemon=True)
    waiting.start()
    waiting.join(limit + GRACE_SECONDS)
    if waiting.is_alive():
        raised.append(TimeoutError(f"Timed out waiting for an answer after {limit:g} s"))
    if raised:
        client.status = "closed"  # else its destructor waits for an answer, and complains
        raise ConnectionError(str(raised[0]) or type(raised[0]).__name__) from None
    stack.enter_context(client)
    if workers is not None:
        client.run(_ignore_interrupts)
    return client


def _ignore_interrupts() -> None:
    """Make a worker ignore Ctrl-C: this process ends its own workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def machine_identity() -> MachineIdentity:
    """The versions and the kind of device, on which the numbers of a sweep depend besides the sweep itself."""
    return {"version": __version__, "jax": jax.__version__, "device": jax.devices()[0].device_kind}


def worker_identity(client: "Client") -> MachineIdentity:
    """The identity that all workers must have: the versions of this process, and the device of the first worker.

    Raises:
        StoreError: The first worker has other versions, or lacks a package.
    """
    own = {name: version for name, version in machine_identity().items() if name != "device"}
    return own | _worker_result(client.submit(_worker_function(), own, pure=False))


def _worker_function() -> Callable[..., Any]:
    """The function that workers run, pickled by value: by reference, it would end a worker that lacks this package.

    The function takes the identity that the worker must have and a pickled part with JAX's settings. It returns the
    computed part, the worker's device if there is no part, or a text that says what is wrong with the worker.
    """

    @no_type_check  # type-checking wrappers cannot be pickled
    def at_worker(identity: MachineIdentity, sent: bytes | None = None, settings: Any = None) -> Any:
        try:
            import jax

            from jaxshroud.version import __version__

            device = jax.devices()[0].device_kind
        except Exception as error:
            return f"a worker lacks what it needs ({type(error).__name__}: {error})"
        own = {"version": __version__, "jax": jax.__version__, "device": device}
        wrong = [f"{name} {own[name]}, not {identity[name]}" for name in identity if own[name] != identity[name]]
        if wrong:
            return f"a worker has {', '.join(wrong)}"
        if sent is None:
            return {"device": device}
        from jaxshroud.verbs.sweep_block import compute_pickled

        return compute_pickled(sent, settings)

    return at_worker


def _worker_result(future: "Future") -> Any:
    """The answer of a worker.

    Raises:
        StoreError: The worker has the wrong identity, or cannot unpickle the task.
        MachineError: The task has ended several workers.
    """
    from distributed import KilledWorker

    try:
        answer = future.result()
    except KilledWorker as error:
        raise MachineError(f"workers were lost again and again over one block of lanes ({error})") from None
    except RuntimeError as error:
        if "deserializ" not in str(error):
            raise
        answer = "a worker cannot read what it is sent: its Python or its Dask is another"
    if isinstance(answer, str):
        raise StoreError(f"{answer}; give all workers the same, and run again")
    return answer


def compute_on_workers(chains: Iterable[Chain], client: "Client", identity: MachineIdentity) -> None:
    """Compute all chains on workers; parts of different chains are computed at the same time.

    Args:
        chains: Chains of parts.
        client: The connection to the scheduler.
        identity: The identity that the workers must have.

    Raises:
        StoreError: A worker has another identity.
        MachineError: A part has ended several workers.
    """
    import cloudpickle
    from distributed import as_completed

    jax_settings = thread_settings() | {"default_device": None}
    compute_remotely = _worker_function()
    done = as_completed(loop=client.loop)
    in_progress: dict[Future, tuple[Chain, SweepTask]] = {}

    def submit(chain: Chain, before: ComputedPart | None = None) -> None:
        part = next_part(chain, before)
        if part is not None:
            task, handover = part
            silent = task._replace(settings=task.settings._replace(ticker=Ticker(0, None)))
            sent = cloudpickle.dumps((silent, handover))
            future = client.submit(compute_remotely, identity, sent, jax_settings, pure=False)
            in_progress[future] = chain, task
            done.add(future)

    for chain in chains:
        submit(chain)
    for future in done:
        chain, task = in_progress.pop(future)
        computed = _worker_result(future)
        task.tick(task.lanes)
        submit(chain, computed)
