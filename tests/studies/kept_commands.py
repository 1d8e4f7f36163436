"""Does every program of every command stay on disk? python tests/studies/kept_commands.py

Each command of `snapshot_commands` starts twice, in processes of its own: with an empty cache, and with what the first
start has kept. `kept_commands.json` has, for each command, how many programs XLA compiled in both, how many were traced
and lowered in the second, and which functions were not kept, and why. A program that is lowered again makes every start
of a command slow, and nothing else shows it.

`--only NAME` prints one command.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import snapshot_commands
from snapshot_commands import Case

from jaxshroud.version import __version__

FILE = Path(__file__).with_suffix(".json")
# Runs a command as a new process does, and prints, as a last line of errors, what it compiled and did not keep.
CHILD = """
import json, logging, sys
from jax import monitoring
from jaxshroud.cli import commands

lost, compiled, loaded, lowered = [], [], [], []
handler = logging.Handler()
handler.emit = lambda record: lost.append(record.getMessage()) if "not kept" in record.getMessage() else None
log = logging.getLogger("jaxshroud.programs")
log.addHandler(handler)
log.setLevel(logging.DEBUG)
count = lambda event, seconds, **_: compiled.append(event) if event.endswith("backend_compile_duration") else None
monitoring.register_event_duration_secs_listener(count)
trace = lambda event, seconds, **_: lowered.append(event) if event.endswith("to_mlir_module_duration") else None
monitoring.register_event_duration_secs_listener(trace)
monitoring.register_event_listener(lambda event, **_: loaded.append(event) if event.endswith("cache_hits") else None)
status = commands.main(sys.argv[1:])
told = {"status": status, "compiled": len(compiled) - len(loaded), "lowered": len(lowered), "not kept": lost}
print(json.dumps(told), file=sys.stderr)
"""


def cases() -> list[Case]:
    """The commands that end well, in an order in which none needs a later one."""
    return [case for case in snapshot_commands.CASES if not case.status]


def found(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The counts of commands, by their names, with one cache for all; those whose results they read run before."""
    known = {case.name: case for case in cases()}
    wanted = list(dict.fromkeys(name for case in map(known.get, names) if case for name in (case.needs, case.name)))
    with TemporaryDirectory() as folder:
        return {name: _of_command(known[name], Path(folder)) for name in wanted if name}


def _of_command(case: Case, folder: Path) -> dict[str, Any]:
    first, again = (_start(case, folder, start) for start in ("first", "again"))
    assert first["status"] == again["status"] == 0, case.name
    lost = sorted({*first["not kept"], *again["not kept"]})
    return {
        "compiled first": first["compiled"],
        "compiled again": again["compiled"],
        "lowered again": again["lowered"],
        "not kept": lost,
    }


def _start(case: Case, folder: Path, start: str) -> dict[str, Any]:
    """What one process counts; its results lie where those that need them look, of the first start."""
    place = folder / (case.name if start == "first" else f"{case.name} again").replace(" ", "_")
    place.mkdir()
    for name, content in case.files.items():
        (place / name).write_text(content, "utf-8")
    surroundings = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "HOME": str(folder)}
    surroundings.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-c", CHILD, *case.words.split()]
    done = subprocess.run(command, cwd=place, env=surroundings, capture_output=True, text=True, check=True)
    return json.loads(done.stderr.splitlines()[-1])


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    only = parser.parse_args().only
    results = found([only] if only else [case.name for case in cases()])
    for name, counts in results.items():
        print(f"{name:32} {counts}")
    if not only:
        FILE.write_text(json.dumps({"version": __version__, "commands": results}, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
