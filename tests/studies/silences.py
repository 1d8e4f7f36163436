"""How long is a command silent, and how long does it compile? python tests/studies/silences.py [SCENE ...]

Each verb's command runs on every scene in a terminal, twice: with an empty cache of programs, where the longest
compilation counts, and with what the first start has kept, where the longest time without a word counts, and the
longest in which nothing new is told: a bar that only moves tells nothing. Beside seconds stand the processor seconds of
the command in that time, which other work on the machine prolongs little.

Scenes are files or names, by default one of each layout. `--only VERB` prints one verb, `--cache FOLDER` keeps
programs.
"""

import argparse
import json
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import psutil

SCENES = ("table1", "table1_points", "row_ring12_points")
MOST_SECONDS = 900.0  # after which a command is interrupted
SHORT = ("--periods", "2")
BRIEF = ("--transient", "4", *SHORT)
ALONG = ("--along", "drive.omega", "--start", "500", "--stop", "600")
OVER = ("--over", "friction.mu=0.1:0.6")
COMMANDS = {
    "check": (),
    "explain": (),
    "simulate": (*SHORT, "--out", "run.nc"),
    "plot": ("--out", "run.png"),
    "animate": ("--frames", "4", "--out", "run.gif"),
    "convert": ("--out", "run.csv"),
    "sweep": (*ALONG, "--num", "4", *BRIEF, "--out", "sweep"),
    "table": ("--out", "ranked.csv", *BRIEF),
    "power": (*BRIEF, "--out", "power"),
    "orbit": ("--out", "orbit"),
    "lyapunov": (*BRIEF, "--out", "lyapunov"),
    "diagnose": ("--transient", "4", "--out", "diagnosis"),
    "gradient": ("--wrt", "friction.mu", *BRIEF, "--out", "gradient.json"),
    "tune": (*OVER, *BRIEF, "--out", "tuned"),
    "fit": (*OVER, "--out", "fit"),
    "scatter": ("--tolerance", "shroud.gap=1um", *BRIEF, "--out", "scatter"),
    "report": ("--tolerance", "shroud.gap=1um", *BRIEF, "--out", "report.html"),
    "branch": (*ALONG, "--out", "branch"),
    "response": (*ALONG, "--num", "4", *BRIEF, "--out", "response"),
    "mistune": (*ALONG, "--num", "2", "--sigmas", "0.01", "--n-patterns", "2", *BRIEF, "--out", "mistuned"),
    "attractors": ("--starts", "4", "--out", "attractors"),
    "basins": ("--plane", "x[0],v_x[0]", "--num", "2", "--out", "basins"),
    "trade": (*BRIEF, "--out", "trade"),
    "explore": ("--no-browser",),
}
MEASURED = [f"{t / 4},{math.sin(t / 7):.4f}" for t in range(90)]  # for `fit`
READS_RUN = ("plot", "animate", "convert")  # what `simulate` has written
CHILD = """
import sys, time
from jax import monitoring

import jaxshroud_command

_, log, *words = sys.argv

def tell(event, seconds, **more):
    if event.endswith("backend_compile_duration"):
        with open(log, "a") as file:
            print(time.monotonic() - seconds, time.monotonic(), more.get("fun_name", "?"), file=file)

monitoring.register_event_duration_secs_listener(tell)
sys.argv = ["jaxshroud", *words]
sys.exit(jaxshroud_command.main())
"""
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
WITHOUT_NEWS = re.compile(r"[━╸╺\s]+|\d+:\d\d:\d\d")  # the bar, and the clock


class Stretch(NamedTuple):
    """A time of a command."""

    seconds: float
    processor: float  # [s]
    what: str  # was told before it, or was compiled


class Recording:
    """What a command has told so far, and when."""

    def __init__(self, process: psutil.Process):
        self.process, self.begun = process, time.monotonic()
        self.processor = [(self.begun, 0.0)]  # (time, processor seconds until then)
        self.told, self.last, self.news = "", (self.begun, ""), (self.begun, "")
        self.silence = self.without_news = Stretch(0.0, 0.0, "")

    def sample(self) -> None:
        """Note the processor seconds so far."""
        try:
            times = self.process.cpu_times()
        except psutil.Error:  # it has ended
            return
        self.processor.append((time.monotonic(), times.user + times.system + times.children_user))

    def hear(self, text: str) -> None:
        """Note what was told now; "" at the end."""
        self.sample()
        self.silence = max(self.silence, self.between(self.last[0], time.monotonic(), self.last[1]))
        lines = [line for line in re.split(r"[\r\n]+", CONTROLS.sub("\n", text)) if line.strip()]
        news = WITHOUT_NEWS.sub(" ", lines[-1]).strip() if lines else ""
        self.last = time.monotonic(), news or self.last[1]
        if (news != self.news[1] and news) or not text:
            self.without_news = max(self.without_news, self.between(*self._since(), self.news[1]))
            self.news = time.monotonic(), news

    def _since(self) -> tuple[float, float]:
        return self.news[0], time.monotonic()

    def between(self, start: float, end: float, what: str) -> Stretch:
        """A time of the command."""
        before = [used for at, used in self.processor if at <= start] or [0.0]
        used = [used for at, used in self.processor if at <= end][-1]
        return Stretch(round(end - start, 1), round(used - before[-1], 1), what)


def recorded(words: list[str], cache: Path, log: Path, folder: Path) -> dict[str, Any]:
    """What one start of a command tells, and what it compiles."""
    log.unlink(missing_ok=True)
    ours, theirs = pty.openpty()
    about = {"JAX_COMPILATION_CACHE_DIR": str(cache), "TERM": "xterm", "COLUMNS": "160"}
    process = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(log), *words],
        cwd=folder,
        env=os.environ | about,
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    heard = Recording(psutil.Process(process.pid))
    last = ""
    for text in _outputs(ours, heard):
        heard.hear(text)
        last = (last + text)[-2000:]
        served = words[0] == "explore" and "http://" in text
        if served or time.monotonic() > heard.begun + MOST_SECONDS:
            process.send_signal(signal.SIGINT)
    heard.hear("")
    process.wait()
    os.close(ours)
    compiled = [line.split(maxsplit=2) for line in log.read_text().splitlines()] if log.exists() else []
    compilations = [heard.between(float(start), float(end), name.strip()) for start, end, name in compiled]
    return {
        "status": process.returncode,
        "seconds": round(time.monotonic() - heard.begun, 1),
        "processor": round(heard.processor[-1][1], 1),
        "silence": heard.silence,
        "without news": heard.without_news,
        "compilation": max(compilations, default=Stretch(0.0, 0.0, "")),
        "compiled": round(sum(one.seconds for one in compilations), 1),
        "last": CONTROLS.sub("", last).split("\n")[-2].strip()[:160] if "\n" in last else last,
    }


def _outputs(terminal: int, heard: Recording) -> Iterator[str]:
    """What comes from a terminal, until it is closed."""
    while True:
        ready, _, _ = select.select([terminal], [], [], 0.25)
        if not ready:
            heard.sample()
            continue
        try:
            text = os.read(terminal, 65536)
        except OSError:  # the other end is closed
            return
        if not text:
            return
        yield text.decode("utf-8", "replace")


def words_of(verb: str, scene: str) -> list[str]:
    """The command of a verb on a scene."""
    name, *more = verb.split()
    words = [*more, *COMMANDS[verb]]
    if name in READS_RUN:
        return [name, "run.nc", *words]
    if name == "table":
        return [name, "designs.csv", "--scene", scene, *words]
    return [name, scene, *(["measured.csv"] if name == "fit" else []), *words]


def study(scene: str, verbs: list[str], cache: Path) -> dict[str, dict[str, Any]]:
    """What the commands of verbs tell and compile on a scene."""
    found = {}
    with TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "designs.csv").write_text("friction.mu []\n0.2\n0.4\n", "utf-8")
        (folder / "measured.csv").write_text("\n".join(["t [ms],x_left [mm]", *MEASURED]), "utf-8")
        for verb in verbs:
            for start in ("empty cache", "kept programs"):
                words = [*words_of(verb, scene), *(["--force"] if verb not in ("check", "explain", "explore") else [])]
                found.setdefault(verb, {})[start] = recorded(words, cache, folder / "log", folder)
                print(scene, verb, start, json.dumps(found[verb][start]), flush=True)
    return found


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--only", nargs="*", default=list(COMMANDS))
    parser.add_argument("--cache", type=Path)
    options = parser.parse_args()
    scenes = [str(Path(scene).resolve()) if Path(scene).is_file() else scene for scene in options.scenes]
    with TemporaryDirectory() as empty:
        for scene in scenes:
            study(scene, options.only, options.cache or Path(empty))


if __name__ == "__main__":
    main()
