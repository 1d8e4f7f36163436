"""Do two devices, and two workers, do as much as two processes? python tests/studies/throughput.py

4,096 lanes are swept, round by round one after the other in the same minutes: as halves by two processes of one thread
each that know nothing of each other, by one process with two XLA CPU devices, and, in stores, as halves by two such
processes and by two workers of Dask distributed. All have compiled before. `throughput.json` tells the lanes per second
of every round and per second of processor time, and the medians of the ratios to the two processes of the same round;
those of processor time stand where others use the machine, those of rounds where nobody does. All have to find the
same P_d, to the last bit.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Sequence
from pathlib import Path

import psutil

LANES, ROUNDS = 4096, 5
DEVICES = "--xla_force_host_platform_device_count=2"
# Where results go, and who sweeps: words of a child, for each of the processes that share the lanes.
WAYS = {
    "two processes": ("memory", ["alone 0 2", "alone 1 2"]),
    "two devices": ("memory", ["devices 0 1"]),
    "two processes, stored": ("store", ["alone 0 2", "alone 1 2"]),
    "two workers, stored": ("store", ["workers 0 1"]),
}
AGAINST = {"two devices": "two processes", "two workers, stored": "two processes, stored"}


def child(lanes: int, overrides: list[str], who: str, part: str, parts: str) -> None:
    """Sweep part of the lanes for every line that comes in, which says where to, and say when it is done."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    import jaxshroud as js
    from jaxshroud.batch.threads import single_threaded

    js.cache_compilations()
    values = np.linspace(0.5, 8.0, lanes)[int(part) :: int(parts)]
    scene = js.load("table1", overrides).scene

    def once(place: str, out: str, **more) -> str:
        kept = {} if place == "memory" else {"store": f"{out}/a.zarr"}
        keeps = dict(n_periods=32, transient=32, method=js.RungeKutta(steps=400), **kept, **more)
        P_d = js.sweep(scene, {"contact.gamma": values}, **keeps).P_d
        halves = P_d.reshape(-1, 2 // int(parts)).T
        return " ".join(f"{zlib.crc32(np.ascontiguousarray(half).tobytes()):08x}" for half in halves)

    def serve(**more) -> None:
        for line in sys.stdin:
            with tempfile.TemporaryDirectory() as out:
                print("done", once(line.strip(), out, **more), flush=True)

    if who == "workers":
        from distributed import LocalCluster

        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", memory_limit=0) as cluster:
            serve(scheduler=cluster.scheduler_address)
    elif who == "alone":
        with single_threaded():
            serve()
    else:
        serve()


def started(lanes: int, overrides: Sequence[str], words: str) -> subprocess.Popen:
    """A child."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {DEVICES if words.startswith('devices') else ''}"
    sets = [word for override in overrides for word in ("--set", override)]
    command = [sys.executable, __file__, "--lanes", str(lanes), *sets, "--child", *words.split()]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    return subprocess.Popen(command, env=os.environ | {"XLA_FLAGS": flags.strip()}, **pipes)


def busy(children: list[subprocess.Popen]) -> float:
    """Processor time that they and their workers have taken [s]."""
    own = [psutil.Process(child.pid) for child in children]
    workers = [worker for process in own for worker in process.children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in own + workers)


def seconds(place: str, children: list[subprocess.Popen]) -> tuple[float, float, str]:
    """What they take together: time, and processor time; and checksums of what they find."""
    began, before = time.perf_counter(), busy(children)
    for process in children:
        process.stdin.write(f"{place}\n")
    lines = [process.stdout.readline().split() for process in children]
    if not all(line[:1] == ["done"] for line in lines):
        raise RuntimeError("a process has failed")
    return time.perf_counter() - began, busy(children) - before, " ".join(word for line in lines for word in line[1:])


def measured(lanes: int, rounds: int, overrides: Sequence[str] = ()) -> dict:
    """Lanes per second of every way and round, and ratios; of Table 1 with other numbers or parts."""
    asked = dict.fromkeys(words for _, some in WAYS.values() for words in some)
    every = {words: started(lanes, overrides, words) for words in asked}
    ways = {way: (place, [every[words] for words in some]) for way, (place, some) in WAYS.items()}
    try:
        for place, children in ways.values():
            seconds(place, children)  # compiles
        found: dict[str, list[tuple[float, float, str]]] = {way: [] for way in ways}
        for _ in range(rounds):
            for way, (place, children) in ways.items():
                found[way].append(seconds(place, children))
    finally:
        for process in every.values():
            process.communicate()
    same = len({sums for each in found.values() for _, _, sums in each}) == 1
    told: dict = {"lanes": lanes, "cores": os.cpu_count(), "same results": same}
    for number, kind in enumerate(("second", "processor second")):
        rates = {way: [round(lanes / times[number], 1) for times in each] for way, each in found.items()}
        ratios = {way: [a / b for a, b in zip(rates[way], rates[other], strict=True)] for way, other in AGAINST.items()}
        medians = {way: round(statistics.median(each), 3) for way, each in ratios.items()}
        told[f"lanes per {kind}"] = rates | {"median ratios": medians}
    return told


def main() -> None:
    """Run the study and write its JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lanes", type=int, default=LANES)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        return child(options.lanes, options.set, *options.child)
    found = measured(options.lanes, options.rounds, options.set)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
