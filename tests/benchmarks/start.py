"""How long commands take to start, beside `import jax`: `python tests/benchmarks/start.py [rounds]`.

All commands run in turn, round after round, each in a process of its own; the figures are medians. The first round is
not counted: it writes the bytecode, the compiled programs and the file that `plot` draws. `simulate` is told apart into
imports, tracing, loading of compiled programs, the march and the rest (the scene's file, the results' file, the table).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
PLOTTING = "import xarray, h5netcdf, matplotlib.pyplot"
RUN = ["simulate", "fig10b", "--periods", "20", "--force", "--out"]
CODES = {"import jax": "import jax", "import jaxshroud": "import jaxshroud", PLOTTING: PLOTTING}
# Both print what they measure inside a command; their first word is when their process was started.
PLOT = """
import sys, time
from jaxshroud.cli import commands, plot
inside = plot._save
def save(source, draw, picture):
    from jaxshroud.plotting import pictures  # not counted: it is imported before anything is drawn
    began = time.perf_counter()
    inside(source, draw, picture)
    print(time.perf_counter() - began)
plot._save = save
commands.main(sys.argv[2:])
"""
SIMULATE = """
import sys, time
from jaxshroud.cli import commands, simulate
imported = time.time() - float(sys.argv[1])
import jax
spent, loaded, march = [], [], simulate.simulate
def timed(*args, **kwargs):
    began = time.perf_counter()
    found = march(*args, **kwargs)
    spent.append(time.perf_counter() - began)
    return found
simulate.simulate = timed
compiling = lambda name, seconds, **_: loaded.append(seconds) if name.endswith("backend_compile_duration") else None
jax.monitoring.register_event_duration_secs_listener(compiling)
taken = []
for _ in range(2):  # again, with everything traced and loaded
    began = time.perf_counter()
    commands.main(sys.argv[2:])
    taken.append(time.perf_counter() - began)
traced = taken[0] - taken[1] - sum(loaded)
print(imported, traced, sum(loaded), spent[1], taken[1] - spent[1])
"""
PARTS = ("import", "trace", "load", "march", "rest")


def seconds(words: list[str], environment: dict[str, str]) -> tuple[float, float, str]:
    """Elapsed time and processor time of a process, and what it printed."""
    began, before = time.perf_counter(), os.times()
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    elapsed, after = time.perf_counter() - began, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return elapsed, cpu, done.stdout


def measured(rounds: int, folder: Path) -> dict:
    """Medians of everything, in seconds."""
    stored, cache = str(folder / "run.nc"), str(folder / "cache")
    hidden = ("PYTHONDONTWRITEBYTECODE", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    environment["JAX_COMPILATION_CACHE_DIR"] = cache
    script = str(Path(sys.executable).with_name("jaxshroud"))
    commands = {name: [sys.executable, "-c", code] for name, code in CODES.items()}
    commands |= {
        "--help": [script, "--help"],
        "scenes": [script, "scenes"],
        "simulate": [script, *RUN, stored],
        "plot": [script, "plot", stored],
    }
    taken: dict[str, list] = {name: [] for name in commands}
    split, drawn = [], []
    for i in range(rounds + 1):
        found = {name: seconds(words, environment)[:2] for name, words in commands.items()}
        parts = seconds([sys.executable, "-c", SIMULATE, str(time.time()), *RUN, stored], environment)[2]
        inside = seconds([sys.executable, "-c", PLOT, "", "plot", stored], environment)[2]
        if i:
            split.append([float(part) for part in parts.splitlines()[-1].split()])
            drawn.append(float(inside.splitlines()[0]))
            for name, both in found.items():
                taken[name].append(both)
    middle = {name: np.median(both, axis=0) for name, both in taken.items()}
    return {
        "rounds": rounds,
        "elapsed": {name: float(both[0]) for name, both in middle.items()},
        "processor": {name: float(both[1]) for name, both in middle.items()},
        "simulate, told apart": dict(zip(PARTS, np.median(split, axis=0).tolist(), strict=True)),
        "plot, inside draw and save": float(np.median(drawn)),
    }


def main(rounds: int = 10) -> None:
    """Print a table and keep the figures."""
    with tempfile.TemporaryDirectory() as folder:
        found = measured(rounds, Path(folder))
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "start.json").write_text(json.dumps(found, indent=1) + "\n")
    base = found["elapsed"]["import jax"]
    print(f"{'':<46} elapsed  processor  over `import jax`")
    for name, elapsed in found["elapsed"].items():
        print(f"{name:<46} {elapsed:7.2f}  {found['processor'][name]:9.2f}  {elapsed / base:17.2f}")
    print("simulate:", ", ".join(f"{name} {part:.2f}" for name, part in found["simulate, told apart"].items()))
    print(f"plot: inside draw and save {found['plot, inside draw and save']:.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
