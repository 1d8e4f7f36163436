"""Parts of a sweep computed by the workers of Dask distributed, on this machine or on many.

Workers compute, this process writes. A part whose worker is lost is computed by another worker; each part is written
once. Workers may come and go. Each computes as many parts at once as it has threads, and each part on one thread.
"""

import json
import logging
import re
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, no_type_check

from jaxshroud.batch.threads import MachineIdentity, machine_identity, thread_settings
from jaxshroud.scene.checks import InputError, MachineError, StoreError
from jaxshroud.whole_file import open_regular

if TYPE_CHECKING:
    from distributed import Client, Future

LOCAL_SCHEDULER = re.compile(r"local:([1-9]\d*)")


Chain = Generator[Callable[[], Any], Any, None]  # of parts, each of which needs the results of the one before it


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
    local = LOCAL_SCHEDULER.fullmatch(scheduler)
    is_file = scheduler.endswith(".json")
    if not (local or is_file or "://" in scheduler):
        raise InputError(
            "Argument `scheduler` must be an address such as tcp://host:8786, the file of a scheduler (.json) or "
            f"local:N with N workers, but is {scheduler}."
        )
    from distributed import Client

    for name in ("distributed", "distributed.client"):  # the client's logger has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are reported in one line instead
    try:
        if local:
            client = Client(
                n_workers=int(local[1]),
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
                set_as_default=False,
            )
        else:
            address = _address_in_file(scheduler) if is_file else scheduler
            _await_answer(address)
            client = Client(address, set_as_default=False)
        with client:
            if local:
                client.run(_ignore_interrupts)
            yield client
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
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: not the file of a scheduler; `dask scheduler --scheduler-file` writes one") from None


def _await_answer(address: str) -> None:
    """Wait for a scheduler's answer as long as Dask's timeout says; a client would wait without end.

    Raises:
        OSError: What has that address is not there, is no scheduler, or does not answer.
    """
    from dask import config
    from distributed import rpc
    from distributed.utils import LoopRunner

    async def answer() -> None:
        async with rpc(address) as scheduler:
            await scheduler.identity()

    timeout = config.get("distributed.comm.timeouts.connect")
    try:
        LoopRunner().run_sync(answer, callback_timeout=timeout)
    except Exception as error:  # of any type: it depends on what answers
        raise ConnectionError(str(error) or f"no answer within {timeout}") from None


def _ignore_interrupts() -> None:
    """Make a worker ignore Ctrl-C: this process ends its own workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def worker_identity(client: "Client") -> MachineIdentity:
    """The identity that all workers must have: the versions of this process, and the device of the first worker.

    Raises:
        StoreError: The first worker has other versions, or lacks a package.
    """
    own = machine_identity()
    del own["device"]
    return _worker_result(client.submit(_worker_function(), own, pure=False))


def _worker_function() -> Callable[..., Any]:
    """The function that workers run, pickled by value: by reference, it would end a worker that lacks this package.

    The function takes the identity that the worker must have and a pickled part with JAX's settings. It returns what
    the part computes, the worker's identity if there is no part, or a text that says what is wrong with the worker.
    """

    @no_type_check  # type-checking wrappers cannot be pickled
    def at_worker(identity: MachineIdentity, sent: bytes | None = None, settings: Any = None) -> Any:
        try:
            import pickle

            from jaxshroud.batch.compilation_cache import cache_compilations, cache_folder
            from jaxshroud.batch.threads import jax_settings, machine_identity, single_threaded

            own = machine_identity()
        except Exception as error:
            return f"a worker lacks what it needs ({type(error).__name__}: {error})"
        wrong = [f"{name} {own[name]}, not {identity[name]}" for name in identity if own[name] != identity[name]]
        if wrong:
            return f"a worker has {', '.join(wrong)}"
        if sent is None:
            return own
        if not cache_folder():
            cache_compilations()
        with jax_settings(settings), single_threaded():  # unpickled within them: else float64 numbers become float32
            return pickle.loads(sent)()

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

    settings = thread_settings() | {"default_device": None}
    at_worker = _worker_function()
    done = as_completed(loop=client.loop)
    in_progress: dict[Future, Chain] = {}

    def submit(chain: Chain, computed: Any = None) -> None:
        with suppress(StopIteration):
            sent = cloudpickle.dumps(chain.send(computed))
            future = client.submit(at_worker, identity, sent, settings, pure=False)
            in_progress[future] = chain
            done.add(future)

    for chain in chains:
        submit(chain)
    for future in done:
        submit(in_progress.pop(future), _worker_result(future))
