"""How large a run may be: more would overflow a counter, take years, or not fit into memory."""

import psutil

from jaxshroud.scene.errors import InputError

MOST_LANE_PERIODS = 10**10  # months on a few cores
LANE, SAMPLE = 4096, 512  # bytes that a sweep takes at its peak for each lane, and for each of its kept periods
STORED, STORED_SAMPLE = 400, 96  # bytes that its results take
STEP = 400  # bytes that `simulate` takes at its peak for each step it stores


def fits(lanes: int, transient: int, kept: int, held: int | None = None) -> None:
    """Raise ValueError if a run of so many lanes and drive periods would be too long or too large.

    Samples are held of `held` lanes at once, by default of all.
    """
    periods = lanes * (transient + kept)
    if periods > MOST_LANE_PERIODS:
        raise InputError(
            f"{periods:.3g} lane-periods (lanes x periods) are more than the {MOST_LANE_PERIODS:.0e} that a run may "
            "have; give fewer periods or values"
        )
    memory_for("this run", memory(lanes, kept, held))


def memory(lanes: int, kept: int, held: int | None = None) -> int:
    """Bytes that a sweep takes at its peak; samples are held of `held` lanes at once, by default of all."""
    return lanes * LANE + (lanes if held is None else held) * kept * SAMPLE


def results_size(lanes: int, kept: int, *, samples: bool) -> int:
    """Bytes that the results of a sweep take, with samples or without."""
    return lanes * (STORED + (kept * STORED_SAMPLE if samples else 0))


def memory_for(what: str, size: int) -> None:
    """Raise ValueError unless `size` bytes for `what` are free."""
    free = psutil.virtual_memory().available
    if size > free:
        raise InputError(
            f"{what} would take some {size / 2**30:.3g} GiB of memory, but {free / 2**30:.3g} GiB are free; "
            "keep fewer periods, steps or values"
        )
