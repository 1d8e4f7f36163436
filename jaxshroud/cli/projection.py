"""What a long run will take, projected from short trials of some of its lanes, and printed before it begins."""

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from time import perf_counter, process_time

import jax
import numpy as np

from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.limits import results_size, sweep_memory
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Plan, Progress, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.threads import cores
from jaxshroud.cli.progress import progress_bar
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.scene.layout import PAIR, Direction
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.valid import in_precision

PROJECTED_PERIODS = 16  # of the transient, and of the kept part, of the sampled lanes
MAX_SAMPLED_CHUNKS = 16  # that are timed
TRIAL_SECONDS = 10.0  # after which a trial ends wherever it is: of rows a single period may take longer
TRIAL_SHARE = 0.1  # of a run, after which its trial ends as well
LONG_RUN_STEPS = 10**9  # steps of all lanes together, which take minutes
LONG_ROW_STEPS = 2 * 10**8  # of single blades of rows, which take a minute
EVENT_STEPS = 10**4  # of a row for the events of each of its blades in a period where blocks turn, and faces chatter
LANES_PER_LONE_LANE = 16  # a lane that runs alone takes as long as this many lanes of a chunk
MIB, GIB = 2**20, 2**30  # bytes
DURATIONS = (("days", 86400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0))  # units with their seconds
LEAST_UNITS = 1.7  # of the largest unit in which a time is given


class _EnoughError(Exception):
    """A trial has run for long enough."""


def projected_seconds(
    scenes: Scene, plan: Plan, seed: int = 0, *, beside: int | None = None, progress: Progress | None = None
) -> float:
    """The processor time that lanes will take [s], from randomly drawn chunks.

    The chunks are those of the run: the lanes of a chunk wait for each other, and neighbours do so less than others. A
    first run compiles the program of all lanes.

    Args:
        scenes: The lanes.
        plan: The plan of the run.
        seed: The seed of the draw.
        beside: How many lanes are run at once where values are continued one by one; None: all.
        progress: Called with (lane-periods done, lane-periods in all) of this measurement.
    """
    count = len(scenes.drive.omega)
    chunk = lanes_per_call(scenes.layout)
    width = beside or chunk
    starting = np.arange(0, count, width)
    brief = replace(plan, transient=PROJECTED_PERIODS, kept=PROJECTED_PERIODS)
    places = min(len(starting), MAX_SAMPLED_CHUNKS, max(MAX_SAMPLED_CHUNKS * chunk // width, 1))
    firsts = np.random.default_rng(seed).choice(starting, places, replace=False)
    some = [np.arange(first, min(first + width, count)) for first in firsts]
    pieces = [np.concatenate(some)] if beside is None else some
    whole = count * (plan.transient + plan.kept)
    ticker = Ticker(sum(map(len, pieces)) * (brief.transient + brief.kept), progress)
    _processor_seconds(scenes, pieces[0][:2], replace(plan, transient=0, kept=1), Ticker(0, None), 0.0, 0.0)
    taken = 0.0
    for i, piece in enumerate(pieces, 1):
        most = TRIAL_SECONDS / len(pieces), TRIAL_SHARE * whole * i / len(pieces)
        taken += _processor_seconds(scenes, piece, brief, ticker, *most)
    return taken / ticker.done * whole


def _processor_seconds(
    scenes: Scene, some: np.ndarray, plan: Plan, ticker: Ticker, seconds: float, lane_periods: float
) -> float:
    """The processor time that some of the lanes take [s], in so many seconds at most, or until so much is done."""
    lanes = jax.tree.map(lambda a: np.asarray(a)[some], scenes)
    began = process_time()
    end = perf_counter() + seconds

    def tick(more: int | float) -> None:
        ticker(more)
        if ticker.done > 0 and (perf_counter() > end or ticker.done >= lane_periods):
            raise _EnoughError

    with suppress(_EnoughError):
        run_lanes(lanes, initial_states(lanes), plan, tick)
    return process_time() - began


def duration(seconds: float) -> str:
    """A time in words, as exactly as a projection knows it."""
    name, size = next((unit for unit in DURATIONS if seconds >= LEAST_UNITS * unit[1]), DURATIONS[-1])
    return f"{seconds / size:.2g} {name}" if seconds < 10 * size else f"{round(seconds / size)} {name}"


def print_projection(
    lanes: int,
    kept: int,
    cpu: float,
    wall: float | None,
    *,
    lanes_held: int | None = None,
    samples: bool = False,
    place: str = "",
    blades: int = 2,
) -> None:
    """Print what a run will take on standard error.

    Args:
        lanes: Lanes of the run.
        kept: Periods that each keeps.
        cpu: Processor time [s].
        wall: Time on this machine's cores [s]; None: the run is elsewhere.
        lanes_held: Lanes whose samples are in memory at once; None: all.
        samples: Whether results hold samples.
        place: Where results are stored.
        blades: Blades of each lane.
    """
    free = f"{cores()} free core{'s' * (cores() > 1)}"
    time = f"{duration(cpu)} of processor time" if wall is None else f"{duration(wall)} on {free}"
    memory = size_text(sweep_memory(lanes, kept, lanes_held, blades))
    size = size_text(results_size(lanes, kept, samples=samples, blades=blades))
    print(f"{lanes} runs: about {time}, {memory} of memory, {size} of results{place}", file=sys.stderr)


def size_text(size: float) -> str:
    """A size in bytes, in words."""
    return f"{size / MIB:.0f} MiB" if size < GIB else f"{size / GIB:.3g} GiB"


def print_projection_of_long_run(
    scenes: Scene,
    plan: Plan,
    directions: Sequence[Direction],
    lanes_per_value: int,
    *,
    repeats: float = 1.0,
    elsewhere: bool = False,
    lanes_held: int | None = None,
    samples: bool = False,
    place: str = "",
    long: int = LONG_RUN_STEPS,
) -> None:
    """Print what a sweep will take that is long, by short trials.

    Args:
        scenes: The lanes of one direction (leading axis), those of one value next to each other.
        plan: How long each runs.
        directions: The single directions of the sweep.
        lanes_per_value: The lanes of one value, which run at once where values are continued.
        repeats: How often the work of these lanes is done, in all.
        elsewhere: Whether the run is on other machines.
        lanes_held: Lanes whose samples are in memory at once; None: all.
        samples: Whether results hold samples.
        place: Where results are stored.
        long: The steps of all lanes of pairs together beyond which it is long.
    """
    lanes = len(scenes.drive.omega) * len(directions)
    periods = plan.transient + plan.kept
    slowness = 1 if directions == ("independent",) else max(LANES_PER_LONE_LANE // lanes_per_value, 1)
    if not _is_long(round(slowness * lanes * repeats), periods, plan.steps_per_period, scenes, long):
        return
    scenes = in_precision(scenes, plan.method.precision)
    cpu, wall = _projected_times(scenes, plan, directions, lanes_per_value)
    kept, blades = plan.kept, scenes.layout.blades
    wall_told = None if elsewhere else repeats * wall
    held = {"lanes_held": lanes_held, "samples": samples, "place": place, "blades": blades}
    print_projection(lanes, kept, repeats * cpu, wall_told, **held)


def _is_long(lanes: int, periods: int, steps: int, scenes: Scene, long: int) -> bool:
    """Whether a run of lanes takes so long that it is projected.

    Args:
        lanes: Lanes of the run; those of rows take as long as full chunks.
        periods: Drive periods of each.
        steps: Steps in a period.
        scenes: Their scenes.
        long: The steps of all lanes of pairs beyond which it does.
    """
    layout = scenes.layout
    if is_linear(scenes):
        return False
    if layout == PAIR:
        return lanes * periods * steps > long
    trials = steps + (EVENT_STEPS * layout.blades if "theta" in scenes.parts.motion else 0)
    width = lanes_per_call(layout)
    full = lanes if lanes == 1 else -(-lanes // width) * width
    return full * periods * layout.blades * trials > LONG_ROW_STEPS


def _projected_times(
    scenes: Scene, plan: Plan, directions: Sequence[Direction], lanes_per_value: int
) -> tuple[float, float]:
    """Processor time and wall time of a run [s], from short trials."""

    def at_once(way):
        return None if way == "independent" else lanes_per_value

    seconds = {}
    for lanes in {at_once(way) for way in directions}:
        with progress_bar("lane-periods of a trial") as report:
            seconds[lanes] = projected_seconds(scenes, plan, beside=lanes, progress=report)
    cpu = [seconds[at_once(way)] for way in directions]

    def together(way):
        return len(scenes.drive.omega) if way == "independent" else lanes_per_value

    width = lanes_per_call(scenes.layout)
    busy = [min(cores(), -(-together(way) // width)) for way in directions]
    return sum(cpu), sum(each / n for each, n in zip(cpu, busy, strict=True))
