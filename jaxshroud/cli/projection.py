"""What a long run will take, told before it begins."""

import sys
from datetime import timedelta

from jaxshroud.batch.size_limits import results_size, sweep_memory
from jaxshroud.batch.threads import cores

LONG_RUN_STEPS = 10**9  # steps of all lanes together, which take minutes
GIB = 2**30  # bytes


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
    spent = timedelta(seconds=round(cpu))
    wall_text = "" if wall is None else f", {timedelta(seconds=round(wall))} h on {cores()} core{'s' * (cores() > 1)}"
    memory = sweep_memory(lanes, kept, lanes_held, blades) / GIB
    size = results_size(lanes, kept, samples=samples, blades=blades) / GIB
    print(
        f"{lanes} lanes: some {spent} h of processor time{wall_text}, {memory:.3g} GiB of memory, "
        f"{size:.3g} GiB of results{place}",
        file=sys.stderr,
    )
