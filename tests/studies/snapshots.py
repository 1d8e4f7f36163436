"""Do commands say, write and compile what is stored? python tests/studies/snapshots.py

`--store` makes all entries with the code at hand and writes them to `snapshots.json`. Without it they are made again
and compared; what differs is printed, entry by entry, and the exit status is 1 if anything does.

| entries | hold |
|---|---|
| help/COMMAND | exit status and text of `--help` |
| command/NAME | a small command of `snapshot_commands`: exit status, text and, if it fails, its last line of errors |
| variables/NAME | the files that it writes: variables, dimensions, types and units, keys, columns; no numbers |
| lowered/NAME | a program of `snapshot_programs` as XLA receives it: a hash of it, and its operations, counted |

Times, versions, folders and the like are replaced by words in angle brackets. Other versions of Python, JAX or
Matplotlib than those that are stored may give other texts, and other processors may round the last digits differently.

`--only PREFIX` looks at the entries whose names begin so, and stores only these.
"""

import argparse
import difflib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import snapshot_commands
import snapshot_programs

import jaxshroud as js

FILE = Path(__file__).with_suffix(".json")
TERMINAL = {"COLUMNS": "100", "NO_COLOR": "1"}  # in the environment of commands
Entries = dict[str, Any]  # name -> lines, or a table of names and numbers


def entries(only: str = "", folder: Path | None = None) -> Iterator[tuple[str, Any]]:
    """All entries whose names begin so, one after the other; commands write into a folder, else into one of the day."""
    for name, make in {**snapshot_commands.helps(), **snapshot_programs.programs()}.items():
        if name.startswith(only):
            yield timed(name, lambda make=make: made_or_raised(make))
    wanted = [case for case in snapshot_commands.CASES if wants(only, case.name)]
    with TemporaryDirectory() as made:
        commands = snapshot_commands.Commands(folder or Path(made))
        for case in wanted:
            said, written = timed(case.name, lambda case=case: commands.run(case))[1]
            for name, found in ((f"command/{case.name}", said), (f"variables/{case.name}", written)):
                if name.startswith(only) and found is not None:
                    yield name, found


def wants(only: str, case: str) -> bool:
    """Whether one of the entries of a command is wanted."""
    return any(f"{kind}/{case}".startswith(only) for kind in ("command", "variables"))


def made_or_raised(make: Callable[[], Any]) -> Any:
    """What is made, or the error: the other entries are compared all the same."""
    try:
        return make()
    except Exception as error:
        return [f"raised {type(error).__name__}: {' '.join(str(error).split())[:300]}"]


def timed(name: str, make: Callable[[], Any]) -> tuple[str, Any]:
    """The name, and what is made; how long that takes is said."""
    began = time.perf_counter()
    made = make()
    if (took := time.perf_counter() - began) > 1:
        print(f"{name}: {took:.0f} s", file=sys.stderr, flush=True)
    return name, made


def versions() -> dict[str, str]:
    """What texts and programs depend on beside the package."""
    return {"python": platform.python_version(), "jax": jax.__version__, "machine": platform.machine()}


def stored() -> Entries:
    """The entries of the file."""
    return json.loads(FILE.read_text("utf-8"))["entries"] if FILE.exists() else {}


def store(only: str) -> None:
    """Make entries and write them; those that are not asked for stay as they are."""
    kept = {name: entry for name, entry in stored().items() if not name.startswith(only)}
    found = dict(sorted((kept | dict(entries(only))).items()))
    content = {"command": "python tests/studies/snapshots.py --store", **versions(), "entries": found}
    FILE.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", "utf-8")


def as_lines(entry: Any) -> list[str]:
    """An entry as lines that can be compared; None is none."""
    if entry is None:
        return []
    return entry if isinstance(entry, list) else json.dumps(entry, indent=1, ensure_ascii=False).splitlines()


def difference(name: str, now: Any, then: Any) -> str:
    """The unified difference of an entry from what is stored of it; empty where there is none."""
    lines = difflib.unified_diff(as_lines(then), as_lines(now), f"stored {name}", f"now {name}", lineterm="", n=1)
    return "\n".join(lines)


def compare(only: str = "") -> dict[str, str]:
    """The differences of all entries that have any, and of those that are missing on either side."""
    then, now = {name: entry for name, entry in stored().items() if name.startswith(only)}, dict(entries(only))
    names = sorted(then.keys() | now.keys())
    found = {name: difference(name, now.get(name), then.get(name)) for name in names}
    return {name: text for name, text in found.items() if text}


def other_versions() -> list[str]:
    """What is not as it was where the entries were stored."""
    then = json.loads(FILE.read_text("utf-8"))
    return [f"{name} {now}, stored by {then[name]}" for name, now in versions().items() if then[name] != now]


def main() -> int:
    """Store, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", action="store_true", help="write what the code at hand gives")
    parser.add_argument("--only", default="", metavar="PREFIX", help="entries whose names begin so")
    options = parser.parse_args()
    os.environ.update(TERMINAL)
    jax.config.update("jax_enable_x64", True)
    if options.store:
        store(options.only)
        return 0
    for line in other_versions():
        print(f"note: {line}: differences may come from that", file=sys.stderr)
    found = compare(options.only)
    for text in found.values():
        print(text, end="\n\n")
    names = [name for name in stored() if name.startswith(options.only)]
    print(f"{len(found)} differ of {len(names)} entries, version {js.__version__}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
