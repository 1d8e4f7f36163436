"""Foreign files: where results are written among them, and CSV files from anywhere.

Sixty targets of `--out`, single files (of `convert`) and folders (as commands of several files write them), on systems
that have unnamed files, links and locks and on those that lack some; each among a dozen neighbours whose names and
kinds are near to those of temporary files; in half of them, something appears where a result was to be before it is
there. A target is wrong where anything foreign is not as it was, where a result is missing or not whole, where anything
else is left, or where the command does not end as it should.

A hundred CSV files, read as `table` and `fit` read them: cells must come back as they are, or the file must be refused
in one line that names it.

    python tests/studies/foreign_files.py
"""

import argparse
import csv
import errno
import fcntl
import io
import json
import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import numpy as np
import xarray as xr

from jaxshroud.cli.commands import main as command
from jaxshroud.cli.terminal import claim_directory
from jaxshroud.io import files
from jaxshroud.io.measurements import read_measurements
from jaxshroud.io.store import write_dataset
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.csv_text import read_csv

TARGETS, CSV_FILES, SEED = 60, 100, 1
PATIENCE = 60  # seconds after which a case counts as one that hangs
NAMES = ("sweep.nc", "sweep.png", "summary.json")
LACKS = ("nothing", "unnamed files", "links", "locks", "all")


def lacking(what: str) -> Iterator[object]:
    """Patches of a system that lacks something."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    if what in ("unnamed files", "all"):
        yield patch("jaxshroud.whole_file._open_unnamed", lambda *_: None)
    if what in ("links", "all"):
        yield patch.object(os, "link", refuse)
    if what in ("locks", "all"):
        yield patch.object(fcntl, "flock", refuse)


def make_foreign(path: Path, rng: np.random.Generator) -> None:
    """Something foreign at a path: a file, a link, a broken link, a pipe or a folder."""
    kinds: list[Callable[[], object]] = [
        lambda: path.write_bytes(rng.bytes(50)),
        lambda: path.symlink_to(path.parent),
        lambda: path.symlink_to(path.parent / "nowhere"),
        lambda: os.mkfifo(path),
        path.mkdir,
    ]
    kinds[rng.choice(len(kinds), p=[0.5, 0.1, 0.1, 0.2, 0.1])]()


def neighbour_names(target: str, rng: np.random.Generator) -> set[str]:
    """Names near to those of temporary files of a target."""
    stem, suffix = Path(target).stem, Path(target).suffix
    digits = lambda count: rng.bytes(count)[: count // 2 + 1].hex()[:count]
    return {
        f".{stem}-20261125{suffix}",
        f".{stem}-{digits(8)}{suffix}",
        f".{target}.jaxshroud-{digits(31)}.partial",
        f".{target}.jaxshroud-{digits(32).upper()}X.partial",
        f"{target}.jaxshroud-{digits(32)}.partial",
        f".other.{target}.jaxshroud-{digits(32)}.partial",
        f".{stem}.jaxshroud-{digits(32)}.partial",
        f"{stem}.{digits(32)}.partial",
        f"jaxshroud-{digits(8)}.partial",
        f"{target}~",
        f"{stem}-1{suffix}.bak",
        f".{target}.swp",
    }


def state_of(path: Path) -> tuple:
    """What a foreign entry is, to be compared."""
    state = path.lstat()
    content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
    link = os.readlink(path) if path.is_symlink() else ""
    return state.st_ino, state.st_mode, state.st_size, state.st_mtime_ns, content, link


@contextmanager
def patience() -> Iterator[None]:
    """Within, a case that hangs is ended by a TimeoutError."""

    def give_up(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def write_folder(out: Path) -> int:
    """Write the results of a command of several files; its exit status."""
    with files.results_together():
        claim_directory(out, NAMES, force=False)
        for name in NAMES:
            files.write(out / name, name.encode() * 1000)
    return 1 if files.kept_files else 0


def target_fault(folder: Path, source: Path, rng: np.random.Generator) -> str:
    """What is wrong with one target among foreign neighbours; empty: nothing."""
    many, lack, appears = rng.random() < 0.5, LACKS[rng.integers(len(LACKS))], rng.random() < 0.5
    names = NAMES if many else ("run.nc",)
    for name in {name for target in names for name in neighbour_names(target, rng)}:
        make_foreign(folder / name, rng)
    place = files.put_in_place

    def placed() -> None:
        if appears and files._waiting and not os.path.lexists(folder / names[-1]):
            make_foreign(folder / names[-1], rng)
            before[folder / names[-1]] = state_of(folder / names[-1])
        place()

    before = {path: state_of(path) for path in folder.iterdir()}
    with ExitStack() as stack:
        for lacks in lacking(lack):
            stack.enter_context(lacks)
        stack.enter_context(patch.object(files, "put_in_place", placed))
        for redirected in (redirect_stdout, redirect_stderr):
            stack.enter_context(redirected(io.StringIO()))
        status = write_folder(folder) if many else command(["convert", str(source), "--out", str(folder / "run.nc")])
    changed = [path.name for path, state in before.items() if not os.path.lexists(path) or state_of(path) != state]
    new = {path.name for path in folder.iterdir()} - {path.name for path in before}
    beside = {f"{Path(name).stem}-1{Path(name).suffix}" for name in names} if appears else set(names)
    whole = all((folder / name).stat().st_size > 1000 for name in new)
    wrong = {"altered": changed, "files": new != beside, "not whole": not whole, "status": status != int(appears)}
    return ", ".join(f"{name} ({lack})" for name, found in wrong.items() if found)


def hostile_csv(rng: np.random.Generator) -> tuple[str, bytes]:
    """A CSV file, and of which kind it is."""
    separator = ",;\t"[rng.integers(3)]
    words = [
        "1",
        "-2.5",
        "3,4",
        "1e-3",
        " x ",
        "",
        "22 um",
        '=cmd|"/c"!A0',
        "<script>alert(1)</script>",
        "Büchse",
        "\u202e",
    ]
    cell = lambda: words[rng.integers(len(words))]
    rows, columns = rng.integers(1, 30), rng.integers(1, 12)
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator=("\n", "\r\n")[rng.integers(2)])
    writer.writerow([f"c{j}" for j in range(columns)])
    writer.writerows([[cell() for _ in range(columns)] for _ in range(rows)])
    plain = text.getvalue().encode()
    kinds: dict[str, Callable[[], bytes]] = {
        "plain": lambda: plain,
        "with a mark": lambda: b"\xef\xbb\xbf" + plain,
        "Latin-1": lambda: text.getvalue().replace("\u202e", "ü").encode("latin-1") + "ü,ü".encode("latin-1"),
        "UTF-16": lambda: text.getvalue().encode("utf-16"),
        "NUL bytes": lambda: plain + b"\0\n",
        "an open quotation": lambda: plain + b'"1\n2\n',
        "a long cell": lambda: plain + b"1" * int(rng.integers(131_073, 10**6)),
        "many columns": lambda: b",".join(b"c%d" % j for j in range(rng.integers(20_000, 10**6))) + b"\n1\n",
        "ragged": lambda: plain + b",".join([b"1"] * int(columns + 3)) + b"\n1\n",
        "random bytes": lambda: rng.bytes(2000),
        "empty": lambda: b"",
    }
    kind = [*kinds][rng.integers(len(kinds))]
    return kind, kinds[kind]()


def csv_fault(path: Path, content: bytes) -> str:
    """What is wrong with how a file is read; empty: nothing."""
    faults = []
    for read in (read_csv, read_measurements):
        try:
            found = read(path)
        except InputError as error:
            if str(path) not in str(error) or "\n" in str(error):
                faults.append(f"{read.__name__} says {error}")
            continue
        if read is not read_csv:
            continue
        text = content.decode("utf-8-sig")
        separator = max(",;\t", key=text.lstrip("\r\n").partition("\n")[0].count)
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=separator) if row][1:]
        cells = [[column[i] for column in found.columns.values()] for i in range(len(rows))]
        if any(given[: len(row)] != row for given, row in zip(cells, rows, strict=True)):
            faults.append("cells are not as they were")
    return ", ".join(faults)


def special_csv(folder: Path, number: int) -> Path:
    """What is called a CSV file and is no regular file: a pipe, a device, a folder, a link in a circle."""
    path = folder / "a.csv"
    [lambda: os.mkfifo(path), lambda: path.symlink_to("/dev/zero"), path.mkdir, lambda: path.symlink_to(path)][
        number % 4
    ]()
    return path


def outcomes(targets: int, csv_files: int, seed: int) -> Iterator[tuple[str, str, float]]:
    """The kind of each case, what is wrong with it, and the seconds that it took."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as place:
        source = Path(place) / "source.nc"
        values = xr.Dataset(
            {"x": ("time", np.arange(100.0))}, {"time": np.arange(100.0)}, {"version": "1", "title": "a"}
        )
        write_dataset(values, source)
        for number in range(targets + csv_files):
            folder = Path(place) / str(number)
            folder.mkdir()
            if number < targets:
                kind, run = "target", lambda folder=folder: target_fault(folder, source, rng)
            elif number % 10 == 0:
                kind, path = "no file", special_csv(folder, number // 10)
                run = lambda path=path: csv_fault(path, b"")
            else:
                (kind, content), path = hostile_csv(rng), folder / "a.csv"
                path.write_bytes(content)
                run = lambda path=path, content=content: csv_fault(path, content)
            start = time.perf_counter()
            try:
                with patience():
                    fault = run()
            except Exception as error:
                fault = f"{type(error).__name__}: {error}"
            yield kind, fault, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=TARGETS)
    parser.add_argument("--csv-files", type=int, default=CSV_FILES)
    arguments = parser.parse_args()
    found = [*outcomes(arguments.targets, arguments.csv_files, SEED)]
    told = {
        "cases": Counter(kind for kind, _, _ in found),
        "wrong": [f"{kind}: {fault}" for kind, fault, _ in found if fault],
        "longest [s]": round(max(seconds for _, _, seconds in found), 2),
        "seed": SEED,
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n")
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
