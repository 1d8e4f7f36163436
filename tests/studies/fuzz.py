"""Hostile scenes, flags and result files through the command line: no traceback, exit status 0 or 2, one line of error.

    python tests/studies/fuzz.py [--inputs 2000] [--seed 0] [--processes 20]

writes `fuzz.json`. Most inputs are refused before anything is compiled; those that are in order run a reduced model.
"""

import argparse
import contextlib
import io
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxshroud import __version__
from jaxshroud.cli import commands as cli
from jaxshroud.scene.config import load

SECONDS = 2.0  # that an input may take
MODEL = ['parts.motion=["x"]', "parts.friction=none", "parts.neighbour=rigid"]
RUN = ["--periods", "2", "--steps-per-period", "100"]
REDUCED = [*(word for value in MODEL for word in ("--set", value)), *RUN]
SWEEP = ["sweep", "table1", *REDUCED, "--along", "contact.gamma", "--values", "1,2,4"]
HUGE = ["9" * 5000, "1" + "0" * 30, "1e20", "-1", "nan", "inf", "1e999", "0x" + "f" * 4000, "99999999999999999999"]
ODD = [
    "",
    " ",
    "\0",
    "a\0b",
    "x" * 5000,
    "\udcff",
    "é" * 40,
    "--",
    "-",
    "'",
    '"',
    "[",
    "{}",
    "=",
    ",",
    ":",
    "%s",
    "%",
    "\n",
]
VALUES = [
    "true",
    "[]",
    "[1, 2, 3]",
    "[[1]]",
    "{}",
    '"1 parsec kg"',
    '"1 mm"',
    '"0x10"',
    '"µ"',
    "1979-05-27",
    "[" * 3000,
]
TABLES = ["[nothing]", "[[blades]]", "[sweep]", "[blades.m]", "a.b.c = 1", "x" * 5000]
WRONG = {
    "--locate": ["cubik", "", "None", "CUBIC "],
    "--tableau": ["rk5", "euler", "dopri", "x" * 5000],
    "--precision": ["float16", "64", "double"],
    "--accuracy": ["banana", "1e-20", "nan", "balancd", "-1", ""],
    "--steps-per-period": ["atuo", "0", "5", "-3", "1.5", *HUGE],
    "--periods": ["0", "-1", "2.0", "many", *HUGE],
    "--set": ["contact.gama=1", "gamma=3", "=", "contact.gamma", "run.periods=10 s", "parts.contact=hertz", *ODD],
}
WRONG_OF = {
    "simulate": {"--every": ["0", "x", *HUGE], "--from": ["nothing.nc", ".", "scene.toml", *ODD[1:6]]},
    "sweep": {
        "--along": ["contact.gama", "run.periods", "blades.m[2]", *ODD],
        "--values": ["1mm,2", "1", "1,1", "a,b", "[1, [2]]", "1,nan", "-1,2", *ODD],
        "--num": ["1", "0", "x", "1.5", *HUGE],
        "--start": ["1 kg", "nan", *ODD],
        "--direction": ["Forward", "up", ""],
        "--phase": ["7", "-1", "nan", "x"],
        "--transient": ["-1", "x", *HUGE],
    },
    "power": {"--tolerance": ["0", "-1", "nan", "x"], "--transient": ["-1", "1.5", *HUGE]},
    "gradient": {
        "--wrt": ["shroud.gaps", "", "run.periods", "contact.k,contact.gamma", *ODD],
        "--of": ["Pd", "", "x"],
        "--sigma": ["0", "-1", "nan", "x"],
        "--pairs": ["1", "x", *HUGE],
    },
    "tune": {
        "--over": ["shroud.gap=1", "shroud.gap=2um:1um", "shroud.gap=1mm:2", "x=1:2", "shroud.gap", *ODD],
        "--range": ["drive.F_0", "drive.F_0=", "drive.F_0=1N,2", "x=1,2", *ODD],
        "--goal": ["wrst", ""],
        "--most-force": ["-1", "1 kg", "x", "0"],
        "--map": ["100000", "-1", *HUGE],
        "--scan": ["0", "x", *HUGE],
    },
    "trade": {"--lanes": ["1", "x", *HUGE], "--seed": ["-1", "x"]},
    "explain": {},
}
NEEDED = {
    "simulate": ["--out", "out.nc"],
    "sweep": ["--along", "contact.gamma", "--values", "1,2,4", "--out", "out"],
    "power": ["--out", "out"],
    "gradient": ["--wrt", "shroud.gap", "--out", "out.json"],
    "tune": ["--over", "shroud.gap=5um:200um", "--out", "out"],
    "trade": ["--out", "out"],
    "explain": [],
}


class Input(NamedTuple):
    """One command with the files that it finds."""

    kind: str
    words: list[str]
    files: dict[str, bytes]


class Outcome(NamedTuple):
    """What came of a command."""

    status: int | str  # exit status, or what was raised
    lines: list[str]  # on standard error
    seconds: float  # of the processor, so that others on the machine do not matter

    @property
    def fault(self) -> str | None:
        """What is wrong with it."""
        if self.status not in (0, 2):
            return f"{self.status}"
        if self.status == 2 and len(self.lines) != 1:
            return f"{len(self.lines)} lines on standard error: {' / '.join(self.lines)[:300]}"
        return None


class Stored(NamedTuple):
    """Results as the verbs write them."""

    scene: str
    run: xr.Dataset
    sweep: xr.Dataset
    grid: xr.Dataset
    json: dict[str, dict]


def stored(folder: Path) -> Stored:
    """Results to be damaged; making them also compiles what inputs in order will run."""
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert cli.main(["simulate", "table1", *REDUCED, "--out", "run.nc"]) == 0
        assert cli.main([*SWEEP, "--out", "sweep"]) == 0
        assert cli.main([*SWEEP, "--along", "shroud.gap", "--values", "1um,2um", "--out", "grid"]) == 0
        run, sweep, grid = (
            xr.load_dataset(p, engine="h5netcdf") for p in ("run.nc", "sweep/sweep.nc", "grid/sweep.nc")
        )
    final = {"P_d": 1.0, "ci": 0.1, "n": 4, "settled": True, "period_number": 1}
    power = {"title": "t", "n": [1, 2, 4], "P_d": [1.0, 1.1, 1.0], "P_d_ci": [None, 0.2, 0.1], "final": final}
    over = {"shroud.gap": [5e-6, 2e-4], "contact.gamma": [0.1, 10.0]}
    drawn = {"first": [5e-6, 1e-4], "second": [0.1, 1.0], "objective": [[1.0, 2.0], [3.0, None]]}
    tune = {"title": "t", "goal": "mean", "design": {"shroud.gap": 1e-5, "contact.gamma": 1.0}, "over": over}
    tune |= {"points": [[[1e-5, 1.0]], [[2e-5, 2.0]]], "scores": [[1.0], [2.0]], "map": drawn}
    row = {"kind": "rk4", "cost": 1e-6, "state_error": 1e-3, "P_d": 0.1, "gradient": 0.1, "period": 1.0, "front": True}
    written = {"power": power, "tune": tune, "trade": {"title": "t", "horizon": 3, "settings": [row, row]}}
    return Stored(load("table1", MODEL).text(), run, sweep, grid, written)


def flags(random: random.Random, of: Stored) -> Input:
    """A command with one or two wrong flags."""
    verb = random.choice(list(NEEDED))
    words = [verb, random.choice(["table1", "table1", "fig09", "fig9", "x" * 5000, "", "."]), *REDUCED, *NEEDED[verb]]
    wrong = WRONG | WRONG_OF[verb]
    for flag in random.sample(list(wrong), random.choice([1, 1, 2])):
        words += [flag, random.choice(wrong[flag])]
    if random.random() < 0.15:
        del words[random.randrange(1, len(words))]
    if random.random() < 0.1:
        words.insert(random.randrange(len(words)), random.choice([*ODD, "--nothing", "-x", "--force", "--check"]))
    return Input("flags", _harmless(words), {"scene.toml": b""})


def _harmless(words: list[str]) -> list[str]:
    """The words, but refused where they may ask for a program that no other input has compiled."""
    costly = words[:1] not in (["simulate"], ["sweep"])
    whole = all(value in words for value in (*MODEL, "--periods", "--steps-per-period"))
    return words if whole and not costly else [*words, "--periods", "0"]


def scenes(random: random.Random, of: Stored) -> Input:
    """A scene file that is damaged."""
    lines = of.scene.splitlines()
    for _ in range(random.choice([1, 1, 1, 2, 4])):
        i = random.randrange(len(lines))
        physics = "parts" not in "".join(lines[:i])[-40:] and not lines[i].startswith(("motion", "[parts", "neighbour"))
        name = lines[i].split("=")[0]
        change = random.choice(["value", "value", "value", "delete", "twice", "odd", "cut", "table"])
        if change == "value" and "=" in lines[i]:
            lines[i] = f"{name}= {random.choice([*VALUES, *HUGE])}"
        elif change == "delete" and physics:
            del lines[i]
        elif change == "twice":
            lines.insert(i, lines[i])
        elif change == "odd":
            at = random.randrange(len(lines[i]) + 1)
            lines[i] = lines[i][:at] + random.choice([o for o in ODD if o != "\udcff"]) + lines[i][at:]
        elif change == "cut":
            lines = lines[: max(i, 1)]
        elif change == "table":
            lines.insert(i, random.choice(TABLES))
    text = "\n".join(lines).encode("utf-8", "surrogatepass")
    if random.random() < 0.05:
        text = random.choice([b"\xff\xfe", b"\0" * 100, b"", b"title = 3", b"[" * 5000, text.replace(b"=", b"")])
    sets = [word for value in (*MODEL, "friction.mu=0.5") for word in ("--set", value)]
    return Input("scene", ["simulate", "scene.toml", *sets, *RUN, "--out", "out.nc"], {"scene.toml": text})


def _damaged(random: random.Random, ds: xr.Dataset) -> xr.Dataset:
    """A dataset with something missing, impossible or of another type."""
    ds = ds.copy(deep=True)
    name, attr = random.choice(list(ds.variables)), random.choice(list(ds.attrs))
    change = random.choice(["drop", "attr", "attr", "no attr", "value", "value", "type", "short", "flip"])
    if change == "drop":
        return ds.drop_vars(name)
    if change == "no attr":
        del ds.attrs[attr]
    if change == "attr":
        ds.attrs[attr] = random.choice([1, -1, 0.5, float("nan"), "", "x,y,z", "x" * 5000, [1, 2], 10**12])
    if change == "value" and ds[name].size and ds[name].dtype.kind in "if":
        whole = ds[name].dtype.kind == "i"
        ds[name][...] = random.choice([7, -1, 5, 3, 120] if whole else [np.nan, np.inf, 0, 1e300, -1e300])
    if change == "type":
        ds[name] = ds[name].astype(random.choice(["float32", "int64", "U5", "bool"]))
    if change == "short":
        ds = ds.isel({random.choice(list(ds.sizes)): slice(0, random.choice([0, 1]))})
    if change == "flip":
        ds = ds.transpose(*reversed(list(ds.sizes)))
    return ds


def results(random: random.Random, of: Stored) -> Input:
    """A result file that is damaged, to be drawn or to go on from."""
    ds = random.choice([of.run, of.run, of.sweep, of.grid])
    for _ in range(random.choice([1, 1, 2])):
        with contextlib.suppress(ValueError, TypeError, KeyError, OverflowError):
            ds = _damaged(random, ds)
    data = bytes(ds.to_netcdf(engine="h5netcdf"))
    if random.random() < 0.15:
        at = random.randrange(len(data))
        data = random.choice([data[:at], b"", data[:at] + b"\xff" + data[at + 1 :]])
    on = ["simulate", "table1", *REDUCED, "--from", "result.nc", "--out", "out.nc"]
    return Input("result", random.choice([["plot", "result.nc"], on, on]), {"result.nc": data})


def summaries(random: random.Random, of: Stored) -> Input:
    """A JSON file that is damaged, to be drawn."""
    name = random.choice(list(of.json))
    data = json.loads(json.dumps(of.json[name]))
    hostile = [None, [], {}, 0, -1, 1e308, "x", True, [None], [[1, 2], [3]], "x" * 5000, 10**400, {"a": 1}]
    for _ in range(random.choice([1, 1, 2])):
        held, key = data, random.choice(list(data))
        while isinstance(held[key], dict | list) and held[key] and random.random() < 0.5:
            held = held[key]
            key = random.choice(list(held)) if isinstance(held, dict) else random.randrange(len(held))
        if isinstance(held, dict) and random.random() < 0.3 and len(held) > 1:
            del held[key]
        else:
            held[key] = random.choice(hostile)
    text = json.dumps(data)
    if random.random() < 0.3:
        deep = random.choice([10, 1000, 100000])
        choices = [
            "null",
            "[1, 2]",
            "3",
            '"x"',
            "[" * deep + "]" * deep,
            '{"a":' * deep,
            "NaN",
            "9" * 5000,
            "",
            "\0",
            "{",
        ]
        text = random.choice([*choices, text[: len(text) // 2]])
    return Input("json", ["plot", f"{name}.json"], {f"{name}.json": text.encode("utf-8", "surrogatepass")})


KINDS: tuple[Callable[[random.Random, Stored], Input], ...] = (flags, flags, scenes, scenes, results, summaries)


def inputs(n: int, seed: int, of: Stored) -> list[Input]:
    """So many inputs of all kinds."""
    draw = random.Random(seed)
    return [KINDS[i % len(KINDS)](draw, of) for i in range(n)]


def _prepare(folder: Path, one: Input) -> None:
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    for name, content in one.files.items():
        (folder / name).write_bytes(content)


def outcome(one: Input, folder: Path) -> Outcome:
    """What `main` makes of an input, in this process."""
    _prepare(folder, one)
    told, began = io.StringIO(), time.process_time()
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
        try:
            status: int | str = cli.main(one.words)
        except SystemExit as stop:
            status = f"SystemExit {stop.code}"
        except Exception as error:
            status = f"{type(error).__name__}: {error}"[:300]
    return Outcome(status, told.getvalue().splitlines(), time.process_time() - began)


def outside(one: Input, folder: Path) -> Outcome:
    """The same in a process of its own."""
    _prepare(folder, one)
    done = subprocess.run(
        [sys.executable, "-m", "jaxshroud.cli", *one.words], cwd=folder, capture_output=True, text=True
    )
    return Outcome(done.returncode, done.stderr.splitlines(), float("nan"))


def main() -> None:
    """Run the study and write its figures."""
    made = argparse.ArgumentParser()
    for name, default in dict(inputs=2000, seed=0, processes=20).items():
        made.add_argument(f"--{name}", type=int, default=default)
    asked = made.parse_args()
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as two:
        of = stored(Path(one))
        tried = inputs(asked.inputs, asked.seed, of)
        found = [outcome(each, Path(two)) for each in tried]
        plain = [each for each in tried if not any(c in "".join(each.words) for c in ("\0", "\udcff"))]
        chosen = random.Random(asked.seed).sample(plain, asked.processes)
        others = [outside(each, Path(two)) for each in chosen]
    faults = [
        {"kind": each.kind, "words": [w[:100] for w in each.words], "fault": got.fault}
        for each, got in zip([*tried, *chosen], [*found, *others], strict=True)
        if got.fault
    ]
    seconds = np.array([got.seconds for got in found])
    figures = {
        "command": f"python tests/studies/fuzz.py --inputs {asked.inputs} --seed {asked.seed}",
        "version": __version__,
        "inputs": Counter(each.kind for each in tried),
        "exit status": Counter(str(got.status) for got in found),
        "in processes of their own": Counter(str(got.status) for got in others),
        "faults": faults,
        "processor seconds": {"median": float(np.median(seconds)), "most": float(seconds.max())},
        f"longer than {SECONDS:g} s": int((seconds > SECONDS).sum()),
        "cores": os.cpu_count(),
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(figures, indent=1) + "\n")
    slow = max(zip(found, tried, strict=True), key=lambda pair: pair[0].seconds)
    print(json.dumps(figures, indent=1), "slowest:", [w[:100] for w in slow[1].words], slow[0].lines, sep="\n")


if __name__ == "__main__":
    main()
