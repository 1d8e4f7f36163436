"""What alternated where a lane stopped with TOO_MANY_EVENTS, when, and what to try."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import BLOCK, CHUNK, Clock, run_block
from jaxshroud.batch.xla import best
from jaxshroud.march.events import Counters
from jaxshroud.march.lane import Lane
from jaxshroud.march.method import Choices
from jaxshroud.model.absent import filled
from jaxshroud.model.modes import Status
from jaxshroud.scene.scene import Scene


def chatter(scenes: Scene, last: Lane, period: np.ndarray, clock: Clock, method: Choices) -> str | None:
    """One line on the first lane that stopped with TOO_MANY_EVENTS; None if there is none.

    The lane goes on from where it stopped, until it has stopped again: what happens then is what alternates.

    Args:
        scenes: Scenes with a leading lane axis.
        last: The lanes at the end, with the same axis.
        period: The count of the period in which each lane stopped, (lanes,); 0 if that is not known.
        clock: The time grid.
        method: Static choices of the march.
    """
    stopped = np.flatnonzero(np.asarray(last.status) == Status.TOO_MANY_EVENTS)
    if not len(stopped):
        return None
    copies = np.full(1 if len(period) == 1 else CHUNK, stopped[0])  # as many as the program that ran is compiled for
    scene, lane = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[copies]), (scenes, last))
    places = lambda lane: (lane.status, lane.search.events)  # noqa: E731
    again = eqx.tree_at(places, lane, (jnp.zeros_like(lane.status), jnp.zeros_like(lane.search.events)))
    after, _ = run_block(scene, again, clock, jnp.int32(1), method, BLOCK, best())
    counts = [filled(of.tally.log.counters, of.status) for of in (lane, after)]
    more = {n: int(getattr(counts[1], n)[0] - getattr(counts[0], n)[0]) for n in Counters.__annotations__}
    events = ", ".join(f"{n} {name}" for name, n in sorted(more.items(), key=lambda item: -item[1]) if n)
    done = (float(lane.step[0]) + float(lane.search.done[0])) / float(clock.per_period)
    when = f"period {period[stopped[0]]}" if period[stopped[0]] else "a period of the transient"
    cure = 'reading = "consistent", as misprinted forces contradict each other where cases meet'
    if not scene.contact.reading:
        cure = f"{2 * round(float(clock.per_period))} steps a period, or another tableau"
    return f"at {done:.6f} of {when} these events follow each other without an end: {events}; try {cure}"
