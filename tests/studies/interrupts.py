"""Does a command on a ring end soon, whatever it is doing, and lose nothing? python tests/studies/interrupts.py

Rings of 12 and 36 light blades, whose periods take seconds, are swept, continued and diagnosed; each command is sent
SIGINT, SIGTERM or SIGHUP after some seconds: while it imports, compiles, chooses its steps, tries or marches. Files of
others are in its folder. `interrupts.json` tells for every run how long it took to end, with which status and words,
and whether what lies in its folder is whole and what lay there before is as it was.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from itertools import cycle, islice, product
from pathlib import Path
from typing import Any

import xarray as xr

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DELAYS = (2.0, 6.0, 12.0, 25.0, 45.0)  # seconds before a signal
LONGEST = 3.0  # seconds from a signal to the end
SPEEDS = ("--along", "drive.omega", "--start", "400", "--stop", "700", "--num", "16")
VERBS = {
    "sweep": ("sweep", *SPEEDS),
    "sweep to a store": ("sweep", *SPEEDS, "--store", "zarr"),
    "sweep on": ("sweep", *SPEEDS, "--direction", "forward"),
    "simulate": ("simulate", "--periods", "20"),
    "power": ("power",),
    "diagnose": ("diagnose",),
    "orbit": ("orbit",),
    "gradient": ("gradient", "--wrt", "shroud.gap"),
}
ONE_FILE = {"simulate": "ring.nc", "gradient": "ring.json"}  # of commands that write no folder
FOREIGN = {"notes.txt": b"of somebody else", ".run-20261125.nc": b"hidden"}
HEEDING = """
import signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # also where this study runs under nohup
    signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
import jaxshroud_command
sys.exit(jaxshroud_command.main())
"""


def interrupted(verb: str, blades: int, number: signal.Signals, delay: float, folder: Path) -> dict[str, Any]:
    """What became of a command that was sent a signal."""
    out = folder / "out"
    out.mkdir(parents=True)
    for name, content in FOREIGN.items():
        (out / name).write_bytes(content)
    name, *words = VERBS[verb]
    ring = ("row_ring12", "--set", f"row.blades={blades}", "--set", "drive.engine_order=3")
    place = out / ONE_FILE.get(name, "")
    command = [sys.executable, "-c", HEEDING, name, *ring, *words, "--out", str(place)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(delay)
    running = process.poll() is None
    began = time.perf_counter()
    process.send_signal(number)
    error = process.communicate()[1]
    return {
        "verb": verb,
        "blades": blades,
        "signal": number.name,
        "after": delay,
        "ran": running,
        "seconds": round(time.perf_counter() - began, 2),
        "status": process.returncode,
        "words": error.strip().splitlines()[-1][:200].replace(str(folder), "") if error.strip() else "",
        "whole": all(map(is_whole, out.rglob("*.nc"))),
        "foreign kept": all((out / name).read_bytes() == content for name, content in FOREIGN.items()),
        "partial": [str(path.relative_to(out)) for path in out.rglob("*.partial")],
    }


def is_whole(path: Path) -> bool:
    """Whether a file is a result that opens, or one of somebody else."""
    if path.name in FOREIGN:
        return True
    try:
        xr.load_dataset(path, engine="h5netcdf")
    except Exception:  # of whatever type a damaged file may raise
        return False
    return True


def is_well(run: dict[str, Any]) -> bool:
    """Whether a run ended soon, as an interrupted one, and left nothing that is not whole."""
    ended = run["status"] == (130 if run["ran"] else 0)
    return ended and run["seconds"] <= LONGEST and run["whole"] and run["foreign kept"] and not run["partial"]


def cases(count: int) -> Iterable[tuple[str, int, signal.Signals, float]]:
    """So many runs: each command in turn, with all signals, delays and sizes."""
    pairs = cycle(product(DELAYS, SIGNALS))
    return islice(((v, n, s, d) for (v, n), (d, s) in zip(cycle(product(VERBS, (12, 36))), pairs, strict=False)), count)


def study(count: int) -> list[dict[str, Any]]:
    """The runs, told as they end."""
    runs = []
    for case in cases(count):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(interrupted(*case, Path(folder)))
        print(json.dumps(runs[-1]), flush=True)
    return runs


def main() -> int:
    """Run the study."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    runs = study(count)
    told = {
        "command": "python tests/studies/interrupts.py",
        "runs": len(runs),
        "well": sum(map(is_well, runs)),
        "longest": max(run["seconds"] for run in runs),
        "cores": os.cpu_count(),
        "each": runs,
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")
    return 0 if told["well"] == told["runs"] else 1


if __name__ == "__main__":
    sys.exit(main())
