"""Does a sweep that is killed again and again end with the same bits? python tests/studies/kills.py CASE

A sweep of 20,000 lanes is run to its end, then killed (SIGKILL) at 20 moments drawn evenly from the time that took, and
resumed after each; where it comes to its end before, the next kills are those of a new store. `kills.json` tells for
every store whether all its files are those of the run that nothing ended, byte by byte, and how many blocks that had
been finished at a kill were computed again.

Other cases, each with a JSON of its own (`kills_both.json`):

- `both`: 400 values from rest, forward and backward.
- `lyapunov`, `samples`: with exponents; without samples.
- `machines`: each resumes with another number of threads and devices than the one before.
- `renames`: all directions, killed just before one of the last renames of files, those of the last block, of its record
  and of what says that the sweep is complete, instead of at a moment; each kill is that of a store of its own.
- `two`: nothing is killed, but two processes begin the same sweep at once; one is to be refused in one line.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np

KILLS, SEED = 20, 1
LAST = 50  # renames of the last block, and of all that comes after it
# The command in a process that tells every rename of a file, and kills itself just before the nth.
DYING = """
import os, signal, sys
from jaxshroud.cli.commands import main
left, replace = [int(sys.argv.pop(1))], os.replace
def replaced(part, whole):
    print(whole, file=sys.stderr, flush=True)
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(part, whole)
os.replace = replaced
sys.exit(main(sys.argv[1:]))
"""
REFUSED = "another process is writing to it"
AT_WORK = "sweep: at work for"  # a line of progress: on a loaded machine a process is refused after more than 4 s


class Machine(NamedTuple):
    """Processor cores and devices of a process; None: all that there are, and one."""

    cores: int | None = None
    devices: int | None = None

    @property
    def environment(self) -> dict[str, str]:
        """Of the process."""
        flags = f"--xla_force_host_platform_device_count={self.devices}"
        return {**os.environ, **({} if self.devices is None else {"XLA_FLAGS": flags})}

    def confine(self) -> None:
        """This process to so many cores."""
        if self.cores is not None:
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: self.cores])


class Case(NamedTuple):
    """A sweep, and on what it is run."""

    lanes: int
    words: tuple[str, ...] = ()
    machines: tuple[Machine, ...] = (Machine(),)  # one after the other


CASES = {
    "independent": Case(20_000),
    "both": Case(400, ("--direction", "both")),
    "lyapunov": Case(4_000, ("--lyapunov",)),
    "samples": Case(20_000, ("--no-samples",)),
    "machines": Case(20_000, machines=(Machine(cores=1), Machine(devices=2), Machine())),
    "renames": Case(100, ("--direction", "both")),
    "two": Case(2_000),
}
ANY = Machine()


def words(lanes: int, case: str, out: Path) -> list[str]:
    """The sweep, which begins or goes on."""
    run = ["sweep", "table1", "--set", 'parts.motion=["x"]', "--resume"]
    along = ["--along", "contact.gamma", "--start", "1", "--stop", "8", "--num", str(lanes)]
    short = ["--periods", "16", "--transient", "16", "--steps-per-period", "200"]
    return [*run, *along, *short, *CASES[case].words, "--out", str(out)]


def begun(command: Sequence[str], machine: Machine = ANY) -> subprocess.Popen[str]:
    """A process of the sweep."""
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *command], env=machine.environment, preexec_fn=machine.confine, **pipes)


def ran(lanes: int, case: str, out: Path, limit: float | None = None, machine: Machine = ANY) -> bool:
    """Whether the sweep came to its end, or was killed after some time [s]."""
    process = begun(["-m", "jaxshroud", *words(lanes, case, out)], machine)
    try:
        _, error = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        return False
    if process.returncode:
        raise RuntimeError(error)
    return True


def files(out: Path) -> dict[str, bytes]:
    """All that a store consists of."""
    store = out / "sweep.zarr"
    return {str(path.relative_to(store)): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


class Finished(NamedTuple):
    """The finished lanes of a block, along each dimension, and when its record was written [ns]."""

    lanes: list[list[int]]
    when: int


def records(out: Path) -> dict[str, Finished]:
    """What is finished of each block."""
    found = (out / "sweep.zarr" / "resume").glob("[0-9]*.npz")
    lanes = {path: json.loads(str(np.load(path)["about"]))["at"] for path in found}
    return {path.name: Finished(at, path.stat().st_mtime_ns) for path, at in lanes.items()}


def killed(lanes: int, kills: int, random: np.random.Generator, out: Path, case: str = "independent") -> dict:
    """Stores of sweeps that were killed so many times in all, against one that nothing ended."""
    ran(lanes, case, out / "compiled")  # so that what is timed is not compilation
    began = time.perf_counter()
    ran(lanes, case, out / "whole")
    whole, seconds = files(out / "whole"), time.perf_counter() - began
    ends = records(out / "whole")
    machines, stores, moments = cycle(CASES[case].machines), [], []
    while len(moments) < kills:
        here = out / f"store{len(stores)}"
        told: dict = {"kills": [], "computed_again": 0}
        while len(moments) < kills:
            finished, moment = records(here), random.uniform(0, seconds)
            if ran(lanes, case, here, moment, next(machines)):
                break
            now = records(here)
            ended = {name: one for name, one in finished.items() if one.lanes == ends[name].lanes}
            told["computed_again"] += sum(now.get(name) != one for name, one in ended.items())
            told["kills"].append({"after": round(moment / seconds, 3), "blocks": len(now)})
            moments.append(moment)
        ran(lanes, case, here, machine=next(machines))
        stores.append(told | {"identical": files(here) == whole})
        shutil.rmtree(here)
    blocks = len(records(out / "whole"))
    return {"lanes": lanes, "blocks": blocks, "kills": len(moments), "seed": SEED, "stores": stores}


def dying(lanes: int, case: str, out: Path, rename: int) -> list[str]:
    """Files renamed by a process that kills itself before one of them, the last that is told; never before the 0th."""
    process = begun(["-c", DYING, str(rename), *words(lanes, case, out)])
    _, told = process.communicate()
    if process.returncode not in (0, -signal.SIGKILL):
        raise RuntimeError(told)
    return [line for line in told.splitlines() if line.startswith(str(out))]


def renamed(lanes: int, kills: int, random: np.random.Generator, out: Path, case: str = "renames") -> dict:
    """Stores of sweeps, each killed before one of its last renames, against one that nothing ended."""
    renames, whole = len(dying(lanes, case, out / "whole", 0)), files(out / "whole")
    dying(lanes, case, out / "begun", renames - LAST)
    again, stores = len(dying(lanes, case, Path(shutil.copytree(out / "begun", out / "counted")), 0)), []
    for rename in again - random.choice(LAST, kills, replace=False):
        here = Path(shutil.copytree(out / "begun", out / f"store{rename}"))
        last = Path(dying(lanes, case, here, int(rename))[-1]).relative_to(here)
        ran(lanes, case, here)
        stores.append({"killed_before": str(last), "identical": files(here) == whole})
        shutil.rmtree(here)
    return {"lanes": lanes, "blocks": len(records(out / "whole")), "kills": kills, "seed": SEED, "stores": stores}


def at_once(lanes: int, pairs: int, random: np.random.Generator, out: Path, case: str = "two") -> dict:
    """Stores that two processes began at once or nearly so, against one that had a single one."""
    ran(lanes, case, out / "whole")
    whole, stores = files(out / "whole"), []
    for pair in range(pairs):
        here, later = out / f"store{pair}", random.uniform(0, 2)
        first = begun(["-m", "jaxshroud", *words(lanes, case, here)])
        time.sleep(later)
        both = (first, begun(["-m", "jaxshroud", *words(lanes, case, here)]))
        told = [process.communicate()[1] for process in both]
        errors = [[line for line in error.splitlines() if AT_WORK not in line] for error in told]
        refused = [len(lines) == 1 and REFUSED in lines[0] for lines in errors]
        if any(process.returncode != 2 * one for process, one in zip(both, refused, strict=True)):
            raise RuntimeError(" ".join(told))
        stores.append({"later": round(later, 3), "refused": sum(refused), "identical": files(here) == whole})
        shutil.rmtree(here)
    return {"lanes": lanes, "pairs": pairs, "seed": SEED, "stores": stores}


STUDIES = {"renames": renamed, "two": at_once}


def main() -> None:
    """Run the study and write its JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="?", choices=CASES, default="independent")
    parser.add_argument("--lanes", type=int)
    parser.add_argument("--kills", type=int, default=KILLS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as out:
        study, lanes = STUDIES.get(options.case, killed), options.lanes or CASES[options.case].lanes
        found = study(lanes, options.kills, np.random.default_rng(SEED), Path(out), options.case)
    name = "kills.json" if options.case == "independent" else f"kills_{options.case}.json"
    Path(__file__).with_name(name).write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))
    if not all(store["identical"] and not store.get("computed_again") for store in found["stores"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
