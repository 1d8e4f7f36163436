"""Small commands for the study `snapshots`, on pairs and on rows: what they print and what they write.

`trade`, whose numbers are times, and `explore`, which serves a page, are not among them but for their help.
"""

import contextlib
import csv
import io
import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from jaxshroud.cli import commands as cli
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.version import __version__

Lines = list[str]
QUICK = '--set parts.motion=["x"] --steps-per-period 100'
PAIR = f"table1 {QUICK}"
ROW = f"row_ring12 {QUICK} --set row.blades=3 --set row.closed=false --set drive.engine_order=1 --tableau rk4"
SHORT = "--periods 4 --transient 2"
DESIGNS = "shroud.gap [um],contact.gamma\n20,2\n30,4\n"
# Of the pair, by a march in its 8th, 16th, ... step, rounded.
MEASURED = """t [ms],x_left [um],x_right [um]
0.9378,41.0,-41.0
1.8756,110.2,-110.2
2.8134,91.0,-91.0
3.7512,113.3,-113.3
4.6889,73.5,-73.5
5.6267,61.2,-61.2
6.5645,-59.3,59.3
7.5023,-309.0,309.0
8.4401,-630.1,630.1
9.3779,-809.6,809.6
10.3157,-661.2,661.2
11.2535,-210.6,210.6
12.1913,222.0,-222.0
13.1290,-37.7,37.7
14.0668,-18.7,18.7
15.0046,256.0,-256.0
15.9424,-3.2,3.2
16.8802,18.8,-18.8
17.8180,67.7,-67.7
18.7558,-198.2,198.2
19.6936,-554.8,554.8
20.6314,-803.8,803.8
21.5691,-751.4,751.4
22.5069,-384.2,384.2
23.4447,102.3,-102.3
"""


class Case(NamedTuple):
    """A command whose texts and files are stored."""

    name: str
    words: str  # separated by spaces; those of its scene come first
    needs: str = ""  # the case whose results it reads, in the folder ../NAME
    files: Mapping[str, str] = {}  # that are there when it begins
    status: int = 0


CASES = (
    Case("scenes", "scenes"),
    Case("explain pair", f"explain {PAIR}"),
    Case("explain row", f"explain {ROW}"),
    Case("check pair", "check table1_light --engine-orders 1,2 --stop 3000rpm --out out"),
    Case(
        "check row",
        "check row_chain5 --set row.blades=3 --set row.mistuning=[0,0.01,0] --set shroud.gap=[2e-5,3e-5] --out out",
    ),
    Case("simulate pair", f"simulate {PAIR} --periods 2 --every 5 --events --out run.nc"),
    Case("simulate pair without contact", f"simulate {PAIR} --set parts.contact=none --periods 2 --out run.nc"),
    Case("simulate row", f"simulate {ROW} --periods 2 --every 5 --out run.nc"),
    Case(
        "sweep pair",
        f"sweep {PAIR} {SHORT} --along contact.gamma --values 2,3 --ledger --forces --amplitudes --out out",
    ),
    Case("sweep row", f"sweep {ROW} {SHORT} --along drive.F_0 --start 40 --stop 60 --num 2 --out out"),
    Case("power pair", f"power {PAIR} --periods 16 --transient 16 --forces --amplitudes --out out"),
    Case("power row", f"power {ROW} --periods 16 --transient 16 --out out"),
    Case("diagnose pair", f"diagnose {PAIR} --transient 64 --out out"),
    Case("diagnose row", f"diagnose {ROW} --transient 64 --out out"),
    Case("orbit pair", f"orbit {PAIR} --amplitudes --out out"),
    Case("orbit row", f"orbit {ROW} --out out"),
    Case("gradient pair", f"gradient {PAIR} --wrt shroud.gap,contact.gamma --check --out gradient.json"),
    Case("gradient row", f"gradient {ROW} --wrt shroud.gap --of P_d_worst --out gradient.json"),
    Case("lyapunov pair", f"lyapunov {PAIR} --periods 8 --transient 4 --out out"),
    Case("attractors pair", f"attractors {PAIR} --starts 4 --most-periods 64 --out out"),
    Case("basins pair", f"basins {PAIR} --num 2 --most-periods 64 --out out"),
    Case(
        "branch pair",
        f"branch {PAIR} {SHORT} --along contact.gamma --start 2 --stop 3 --num 2 --most-points 4 --out out",
    ),
    Case(
        "branch row",
        f"branch {ROW} {SHORT} --along drive.omega --start 530 --stop 540 --num 2 --most-points 3 "
        "--doublings 0 --out out",
    ),
    Case("response pair", f"response {PAIR} {SHORT} --start 530 --stop 540 --num 3 --most-points 4 --out out"),
    Case(
        "mistune row",
        f"mistune row_ring12 {QUICK} --set row.blades=4 --set drive.engine_order=1 --along drive.omega "
        "--start 1000 --stop 1400 --num 5 --linear stuck --sigmas 0.02 --n-patterns 3 --out out",
    ),
    Case("scatter pair", f"scatter {PAIR} {SHORT} --tolerance shroud.gap=5um --at-least 10 --samples 4 --out out"),
    Case(
        "tune pair",
        f"tune {PAIR} {SHORT} --over shroud.gap=5um:0.2mm --scan 4 --starts 1 --updates 1 --motions 0 "
        "--map 0 --out out",
    ),
    Case("table pair", f"table designs.csv --scene {PAIR} {SHORT} --out ranked.csv", files={"designs.csv": DESIGNS}),
    Case(
        "fit pair",
        f"fit table1 measured.csv {QUICK} --over shroud.gap=5um:60um --scan 4 --starts 1 --out out",
        files={"measured.csv": MEASURED},
    ),
    Case(
        "report pair",
        f"report {PAIR} {SHORT} --tolerance shroud.gap=5um --at-least 10 --samples 4 --starts 4 --out report.html",
    ),
    Case("plot pair", "plot ../simulate_pair/run.nc --kind loop --out loop.svg", needs="simulate pair"),
    Case("convert pair", "convert ../sweep_pair/out/sweep.nc --out sweep.csv", needs="sweep pair"),
    Case("animate pair", "animate ../simulate_pair/run.nc --periods 1 --out run.gif", needs="simulate pair"),
    Case("refused, a wrong key", "simulate table1 --set shroud.gp=1 --out run.nc", status=2),
    Case("refused, one value", "sweep table1 --along contact.gamma --values 1 --out out", status=2),
    Case("refused, no such option", "power table1 --perods 3 --out out", status=2),
    Case("refused, trade of a row", "trade row_chain5 --out out", status=2),
    Case(
        "refused, a row without contact",
        "sweep row_chain5 --set parts.contact=none --along drive.F_0 --values 1,2 --out out",
        status=2,
    ),
)

# What is not the same in two runs, or is nothing but rounding, and the word in its place.
CHANGING = (
    (re.compile(r"^(seconds +)[\d.]+ *$", re.MULTILINE), r"\1<seconds>"),
    (re.compile(rf"\b{re.escape(__version__)}\b"), "<version>"),
    (re.compile(r"^(compiled programs +).*$", re.MULTILINE), r"\1<folder>"),
    (re.compile(r"\b\d+(\.\d+)?e-(09|[1-9]\d+)\b"), "<tiny>"),
)


def helps() -> dict[str, Callable[[], Lines]]:
    """The entries of help, by their names: that of all commands, and those of each."""
    return {f"help/{name or 'jaxshroud'}": lambda name=name: help_of(name) for name in ("", *COMMANDS)}


def help_of(name: str) -> Lines:
    """Exit status and text of the help of a command, or of all."""
    status, said, _ = outcome([name, "--help"] if name else ["--help"])
    return [f"exit status {status}", *said.splitlines()]


def outcome(words: Lines) -> tuple[int, str, str]:
    """The exit status of a command, and what it prints and tells of errors."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = cli.main(words)
        except SystemExit as end:
            status = int(end.code or 0)
        except Exception as error:  # which no command should let through
            status = -1
            print(f"raised {type(error).__name__}: {error}", file=sys.stderr)
    return status, out.getvalue(), err.getvalue()


def plain(text: str) -> Lines:
    """The lines of a text, with words in the place of what changes from run to run."""
    for pattern, word in CHANGING:
        text = pattern.sub(word, text)
    return [" ".join(line.split()) if "<" in line else line.rstrip() for line in text.splitlines()]


class Commands:
    """Runs commands in a folder, each once, in a folder of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.done: dict[str, tuple[Lines, Any]] = {}

    def run(self, case: Case) -> tuple[Lines, Any]:
        """What a command says, and what it writes: None where it wrote nothing."""
        if case.needs:
            self.run(next(other for other in CASES if other.name == case.needs))
        if case.name not in self.done:
            self.done[case.name] = self._run(case)
        return self.done[case.name]

    def _run(self, case: Case) -> tuple[Lines, Any]:
        place = self.folder / case.name.replace(" ", "_")
        place.mkdir()
        for name, content in case.files.items():
            (place / name).write_text(content, "utf-8")
        with contextlib.chdir(place):
            status, said, errors = outcome(case.words.split())
        last = errors.splitlines()[-1:] if status else []
        if status != case.status:
            print(f"{case.name}: status {status}: {errors[-300:]}", file=sys.stderr)
        return [f"exit status {status}", *plain(said), *plain("".join(last))], written(place, case.files) or None


# What is written


def written(place: Path, given: Mapping[str, str]) -> dict[str, Any]:
    """All files of a folder that were not given, with what they hold."""
    paths = [path for path in sorted(place.rglob("*")) if path.is_file() and path.name not in given]
    return {path.relative_to(place).as_posix(): content(path) for path in paths}


def content(path: Path) -> Any:
    """Names of what a file holds; of pictures and documents nothing."""
    if path.suffix == ".nc":
        groups = xr.open_groups(path, engine="h5netcdf", decode_times=False, mask_and_scale=False)
        with contextlib.ExitStack() as opened:
            return {name: dataset(opened.enter_context(group)) for name, group in groups.items()}
    if path.suffix == ".json":
        return sorted({*keys(json.loads(path.read_text("utf-8")))})
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", newline="") as file:
            return next(csv.reader(line for line in file if not line.startswith("#")))
    return []


def dataset(group: xr.Dataset) -> dict[str, Any]:
    """Variables and coordinates of a dataset, each as one line, and the names of its attributes."""
    lines = lambda variables: {str(name): one_variable(a) for name, a in sorted(variables.items(), key=str)}
    return {
        "variables": lines(group.data_vars),
        "coordinates": lines(group.coords),
        "attributes": sorted(map(str, group.attrs)),
    }


def one_variable(array: xr.DataArray) -> str:
    """Dimensions, type and unit of a variable."""
    kind = "text" if array.dtype.kind in "OSUT" else str(array.dtype)
    return f"({', '.join(map(str, array.dims))}) {kind} [{array.attrs.get('units', '')}]"


def keys(data: Any, above: str = "") -> Lines:
    """All keys of a JSON document, with those above them; a list has the keys of its members."""
    if isinstance(data, list):
        return [key for one in data for key in keys(one, f"{above}[]")]
    if not isinstance(data, dict):
        return []
    inner = [key for name, one in data.items() for key in keys(one, f"{above}{name}.")]
    return [*(f"{above}{name}" for name in data), *inner]
