"""Does a sweep that is killed again and again end with the same bits? python tests/studies/kills.py

A sweep of 20,000 lanes is run to its end, then killed (SIGKILL) at 20 moments drawn evenly from the time that took, and
resumed after each; where it comes to its end before, the next kills are those of a new store. `kills.json` tells for
every store whether all its files are those of the run that nothing ended, byte by byte, and how many blocks that had
been finished at a kill were computed again.

`--direction both` does so with a sweep of 400 values from rest, forward and backward (`kills_both.json`).
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
from pathlib import Path

import numpy as np

LANES, KILLS, SEED = {"independent": 20_000, "both": 400}, 20, 1


def command(lanes: int, direction: str, out: Path) -> list[str]:
    """The sweep, which begins or goes on."""
    run = [sys.executable, "-m", "jaxshroud", "sweep", "table1", "--set", 'parts.motion=["x"]', "--resume"]
    along = ["--along", "contact.gamma", "--start", "1", "--stop", "8", "--num", str(lanes)]
    short = ["--periods", "16", "--transient", "16", "--steps-per-period", "200"]
    return [*run, *along, *short, "--direction", direction, "--out", str(out)]


def ran(lanes: int, direction: str, out: Path, limit: float | None = None) -> bool:
    """Whether the sweep came to its end, or was killed after some time [s]."""
    words = command(lanes, direction, out)
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
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


def records(out: Path) -> dict[str, int]:
    """When each finished block was written [ns]."""
    finished = (p for p in (out / "sweep.zarr" / "resume").glob("*.npz") if not p.stem.endswith(".begun"))
    return {path.name: path.stat().st_mtime_ns for path in finished}


def killed(lanes: int, kills: int, random: np.random.Generator, out: Path, direction: str = "independent") -> dict:
    """Stores of sweeps that were killed so many times in all, against one that nothing ended."""
    ran(lanes, direction, out / "compiled")  # so that what is timed is not compilation
    began = time.perf_counter()
    ran(lanes, direction, out / "whole")
    whole, seconds = files(out / "whole"), time.perf_counter() - began
    stores, moments = [], []
    while len(moments) < kills:
        here = out / f"store{len(stores)}"
        told: dict = {"kills": [], "computed_again": 0}
        while len(moments) < kills:
            finished, moment = records(here), random.uniform(0, seconds)
            if ran(lanes, direction, here, moment):
                break
            now = records(here)
            told["computed_again"] += sum(now.get(name) != when for name, when in finished.items())
            told["kills"].append({"after": round(moment / seconds, 3), "blocks": len(now)})
            moments.append(moment)
        ran(lanes, direction, here)
        stores.append(told | {"identical": files(here) == whole})
        shutil.rmtree(here)
    blocks = len(records(out / "whole"))
    return {"lanes": lanes, "blocks": blocks, "kills": len(moments), "seed": SEED, "stores": stores}


def main() -> None:
    """Run the study and write its JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lanes", type=int)
    parser.add_argument("--direction", choices=LANES, default="independent")
    parser.add_argument("--kills", type=int, default=KILLS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as out:
        lanes, way = options.lanes or LANES[options.direction], options.direction
        found = killed(lanes, options.kills, np.random.default_rng(SEED), Path(out), way)
    name = "kills.json" if way == "independent" else f"kills_{way}.json"
    Path(__file__).with_name(name).write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))
    if not all(store["identical"] and not store["computed_again"] for store in found["stores"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
