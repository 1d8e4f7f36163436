"""What every command takes until it has answered, beside `import jax`: `python tests/benchmarks/start.py --help`.

All commands run in turn, round after round, each in a process of its own; the figures are medians. The first round is
not counted: it writes the bytecode, the compiled programs and the file that `plot` draws. With `--cold` every process
has an empty cache; with `--against` another checkout runs every command as well, right after this one or before it.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

RESULTS = Path(__file__).parent / "results" / "start.json"
HERE = Path(__file__).parents[2]
# Variables that would give processes another cache than their own, or none.
HIDDEN = ("PYTHONDONTWRITEBYTECODE", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
BASE = "import jax"


class Case(NamedTuple):
    """The words of a command, and its budgets by the clock; None where none is set."""

    words: str
    budget: float | None = None  # warm, in times `import jax`
    cold: float | None = None  # over the time of the other checkout


CASES = {
    "--help": Case("--help"),
    "scenes": Case("scenes"),
    "check": Case("check fig09_best", 2.2),
    "explain": Case("explain fig09_best", 3.0),
    "simulate": Case("simulate fig09_best --periods 20 --force --out run.nc", 3.5, cold=0.7),
    "plot": Case("plot run.nc", 2.5),
    "power": Case("power fig09_best --force --out power", 4.5),
    "sweep": Case(
        "sweep fig09_best --along contact.gamma --start 0 --stop 8 --num 64 --periods 64 --transient 0 "
        "--force --out sweep",
        4.5,
    ),
    "diagnose": Case("diagnose fig09_best --force --out diagnose", 10.0),
}
FIRST = {"first": Case("sweep fig09_best --force --out first", cold=0.75)}  # the first command of README
MORE_CASES = {
    "gradient": Case("gradient fig10b --wrt shroud.gap,contact.gamma --force --out gradient.json", 8.0),
    "tune": Case(
        "tune table1 --set drive.M_0=10 --over shroud.gap=5um:200um --scan 16 --starts 2 --updates 4 --motions 0 "
        "--map 0 --periods 16 --transient 16 --force --out tune",
        12.0,
    ),
    "attractors": Case("attractors fig10b --starts 16 --force --out attractors", 11.0),
    "basins": Case("basins fig10b --num 8 --force --out basins", 13.0),
    "branch": Case(
        "branch fig09 --set drive.M_0=0.1 --along contact.gamma --start 0.1 --stop 4 --num 0 --most-points 20 "
        "--force --out branch",
        14.0,
    ),
    "report": Case(
        "report fig09_best --tolerance shroud.gap=10um --at-least 35 --samples 16 --starts 8 --periods 32 "
        "--transient 32 --force --out report.html",
        40.0,
    ),
    "scatter": Case(
        "scatter fig09_best --tolerance shroud.gap=10um --samples 16 --periods 32 --transient 32 --force --out scatter",
        8.0,
    ),
}
ALL_CASES = CASES | FIRST | MORE_CASES


class Checkout(NamedTuple):
    """A tree of sources whose commands are run, and the folder of their results and caches."""

    source: Path
    folder: Path

    def seconds(self, name: str, cold: bool) -> tuple[float, float]:
        """Elapsed time and processor time [s] of a command, or of `import jax`."""
        code = ["-c", BASE] if name == BASE else ["-m", "jaxshroud", *ALL_CASES[name].words.split()]
        with tempfile.TemporaryDirectory() as empty:
            kept = {key: value for key, value in os.environ.items() if key not in HIDDEN}
            places = {"PYTHONPATH": str(self.source), "XDG_CACHE_HOME": empty if cold else str(self.folder / "cache")}
            began, before = time.perf_counter(), _children_seconds()
            done = subprocess.run(
                [sys.executable, *code], env=kept | places, cwd=self.folder, capture_output=True, text=True
            )
            elapsed, used = time.perf_counter() - began, _children_seconds() - before
        if done.returncode:
            raise RuntimeError(f"{name} of {self.source} ended with {done.returncode}: {done.stderr[-1000:]}")
        return elapsed, used


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(names: list[str], rounds: int, cold: bool, sources: dict[str, Path]) -> dict[str, dict]:
    """Medians [s] of each command, for each of the checkouts: elapsed and of the processor."""
    with tempfile.TemporaryDirectory() as folder:
        checkouts = {label: Checkout(source, Path(folder) / label) for label, source in sources.items()}
        for checkout in checkouts.values():
            checkout.folder.mkdir()
        taken: dict[str, dict[str, list]] = {label: {name: [] for name in names} for label in checkouts}
        for i in range(rounds + 1):
            for name in names:
                for label, checkout in list(checkouts.items())[:: (-1) ** i]:
                    both = checkout.seconds(name, cold)
                    if i:
                        taken[label][name].append(both)
    middle = lambda all_rounds: dict(zip(("elapsed", "processor"), np.median(all_rounds, axis=0).tolist(), strict=True))
    return {label: {name: middle(both) for name, both in of.items()} for label, of in taken.items()}


def print_measured(found: dict[str, dict], cold: bool) -> None:
    """A line for each command: times, ratios to `import jax`, its budget, and ratios to the other checkout."""
    here, other = found["here"], found.get("against")
    heads = ("elapsed", "processor", f"/ {BASE}", *(("/ other's", "processor") if other else ()), "budget")
    print(f"{'':<12}" + "".join(f"{head:>14}" for head in heads))
    for name, times in here.items():
        case, ratios = ALL_CASES.get(name, Case("")), [times["elapsed"] / here[BASE]["elapsed"]]
        ratios += [times[kind] / other[name][kind] for kind in times] if other else []
        cells = [*(f"{value:.2f}" for value in (*times.values(), *ratios)), budget_text(case, cold, ratios)]
        print(f"{name:<12}" + "".join(f"{cell:>14}" for cell in cells))


def budget_text(case: Case, cold: bool, ratios: list[float]) -> str:
    """The budget of a case, and whether it is exceeded by its ratios: to `import jax`, and to the other checkout."""
    budget, held_against = (case.cold, ratios[1:]) if cold else (case.budget, ratios)
    if budget is None or not held_against:
        return ""
    return f"{budget:g}{'' if held_against[0] <= budget else ' (over)'}"


def main(words: list[str] | None = None, results: Path = RESULTS) -> None:
    """Print a table and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="only these commands; `plot` draws what `simulate` has stored")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--all", action="store_true", help="small cases of the commands that take long, too")
    parser.add_argument("--cold", action="store_true", help="an empty cache for every process")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="another checkout, run in turn with this one")
    options = parser.parse_args(words)
    names = options.names or [*CASES, *(FIRST if options.cold else ()), *(MORE_CASES if options.all else ())]
    sources = {"here": HERE} | ({"against": options.against.resolve()} if options.against else {})
    found = measured([BASE, *names], options.rounds, options.cold, sources)
    print_measured(found, options.cold)
    kept = json.loads(results.read_text()) if results.exists() else {}
    about = {"rounds": options.rounds, "machine": platform.machine(), "cores": os.cpu_count()}
    kept["cold" if options.cold else "warm"] = about | found
    results.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
