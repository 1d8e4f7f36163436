"""Stores killed (SIGKILL) before every rename of a file of their lives, and gone on with: killed_writes.py FOLDER

Prints how many kills there were, and how many stores ended with other files than one that nothing ended. Nothing is
computed, and processes are forks of this one, which has touched neither JAX nor Zarr's threads.
"""

import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import xarray as xr
import zarr  # noqa: F401  (likewise)

from jaxshroud.io.unfinished_store import BlockRecord, open_unfinished, write_attributes

LANES, SIZE = 4, 2
BLOCKS = [slice(first, first + SIZE) for first in range(0, LANES, SIZE)]  # of lanes, each of which is a part
replace = os.replace


def block(number: int) -> xr.Dataset:
    """The numbers of a block."""
    x = np.arange(6.0).reshape(SIZE, 3) + number
    return xr.Dataset({"x": (("gamma", "period"), x), "status": ("gamma", np.zeros(SIZE, np.int8))})


def store(path: Path) -> None:
    """A store begun, or gone on with, to its end."""
    coords = {"gamma": np.arange(LANES), "period": np.arange(3), "way": ["one", "two"]}
    known = xr.Dataset({"gap": ((), 1.0)}, coords, {"kind": "sweep"})
    with open_unfinished(path, {"of": "a test"}, known, (LANES,), (SIZE,)) as held:
        for number, lanes in enumerate(BLOCKS):
            record = held.begun((lanes,))
            for lane in range(lanes.start if record is None else record.at[0].stop, lanes.stop):
                part = block(number).isel(gamma=[lane - lanes.start])
                done = BlockRecord((slice(lanes.start, lane + 1),), [], [])
                held.write((lanes,), (slice(lane, lane + 1),), part, done)
        held.finish({"complete": 1}, {"jump": xr.Variable("gamma", np.zeros(LANES, np.int8))})
    write_attributes(path, {"title": "a test"})


def ended(path: Path, rename: int = 0) -> int:
    """How often a process had renamed a file when it ended, or killed itself before one; -1: killed."""
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        return -1 if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
    done = [0]

    def replaced(*names: str) -> None:
        done[0] += 1
        if done[0] == rename:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(*names)

    os.replace, status = replaced, 255
    try:
        store(path)
        status = done[0]
    finally:
        os._exit(status)


def files(path: Path) -> dict[str, bytes]:
    """All that a store consists of."""
    return {str(part.relative_to(path)): part.read_bytes() for part in path.rglob("*") if part.is_file()}


def main(out: Path) -> None:
    """Kill stores at every rename."""
    block(0)  # what xarray imports at the first array, forks need not import again
    renames, other = ended(out / "whole"), 0
    whole = files(out / "whole")
    for rename in range(1, renames + 1):
        here = out / f"{rename}"
        if ended(here, rename) != -1 or not 0 <= ended(here) <= renames or files(here) != whole:
            other += 1
        shutil.rmtree(here)
    print(renames, other)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
