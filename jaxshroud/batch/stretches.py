"""Marches with samples, stretch by stretch: what is kept of them, and where the displacements of the last steps lie."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.cubics import RunningAmplitudes, SampledAmplitudes
from jaxshroud.batch.sampling import EventStates, SampleGrid, Stretch, concatenated_events
from jaxshroud.batch.states import final_states, shroud_motion
from jaxshroud.march.accumulator import ContactTimes
from jaxshroud.march.observables import ContactForces
from jaxshroud.model.arithmetic import ZERO, is_zero
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.modes import Mode
from jaxshroud.model.points_contact import by_point, interface_mode
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Ledger
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene


class SampledRun(NamedTuple):
    """The result of a march with samples."""

    lanes: Any  # at the end
    samples: Any  # (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    events: EventStates | None  # None unless they are kept


class EnergyBalance(NamedTuple):
    """The energy balance of lanes (leading axis) over a run [J]."""

    works: Ledger  # of all blades; friction of each interface, where users see an axis of them
    of_blades: dict[str, np.ndarray]  # works on each blade of a row, (lanes, blades), by the names of results
    residual: np.ndarray
    dropped: np.ndarray  # by beginnings of flat contact


class SampledLanes(NamedTuple):
    """Lanes (leading axis) that were marched step by step, with samples."""

    samples: dict[str, Any]  # as of `Trajectories`, and so are the amplitudes and the events
    amplitudes: SampledAmplitudes | None
    last: Any  # the lanes at the end
    energies: tuple[np.ndarray, np.ndarray]  # stored before and after [J]
    events: dict[str, Any] | None


class Trajectories(NamedTuple):
    """The trajectories of lanes (leading axis)."""

    samples: dict[str, Any]  # name -> values (lanes, 1 + samples, ...)
    amplitudes: SampledAmplitudes | None  # over the steps that count; None if there are none
    status: np.ndarray  # (lanes,)
    counters: dict[str, np.ndarray]  # numbers of events by their names
    energy: dict[str, np.ndarray]  # what is told of the energy balance, by the names of results
    loads: ContactLoads | None = None  # None unless they were requested
    times: ContactTimes | None = None  # in each state of contact; None in closed form, as are the next two
    last: Any = None  # the lanes at the end
    events: dict[str, Any] | None = None  # samples of both sides of every event, with `t` [steps] and `after`


def march_in_stretches(
    march: Callable[[Any, Stretch], Any],
    scenes: Scene,
    lanes: Any,
    first: Any,
    grid: SampleGrid,
    motion_of: Callable[[Any], Motion] = lambda states: states.motion,
) -> SampledRun:
    """March lanes, or rows (leading axis), over the grid.

    Args:
        march: Marches lanes over a stretch: the lanes at its end, its samples, and its events.
        scenes: The scenes.
        lanes: Where they start.
        first: The first sample.
        grid: The time grid, and what is kept.
        motion_of: The motion in samples.
    """
    blocks, events, running = [jax.tree.map(lambda a: np.asarray(a)[:, None], first)], [], None
    for stretch in grid.stretches(len(lanes.status)):
        counts = stretch.first >= grid.length - grid.counted
        if counts and running is None:
            start = shroud_motion(final_states(lanes.state).motion, scenes)
            running = RunningAmplitudes(start, grid.step_lengths(scenes))
        lanes, states, some = march(lanes, stretch)
        if running is not None:
            running.add(motion_of(states))
        kept = stretch.kept(grid)
        blocks.append(jax.tree.map(lambda a, kept=kept: a if len(kept) == a.shape[1] else a[:, kept], states))
        events += [] if some is None else [some]
    samples = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    amplitudes = None if running is None else running.amplitudes
    return SampledRun(lanes, samples, amplitudes, concatenated_events(events) if events else None)


def values_by_name(states: State, forces: ContactForces) -> dict[str, Any]:
    """What is told of states and forces, by the names of results; what a model lacks is left out."""
    of_face = {name: a for name, a in forces._replace(points=ZERO)._asdict().items() if not is_zero(a)}
    slider, states_of_points = np.where(states.mode == Mode.APART, np.nan, states.u_s), {}
    if not is_zero(forces.points):
        of_each = {"mode": states.mode, "u_s": slider, **forces.points._asdict()}
        states_of_points = {f"point_{name}": a for name, a in of_each.items()}
    return {
        "motion": states.motion,
        **({} if states_of_points else {"u_s": slider}),
        "mode": np.asarray(interface_mode(by_point(states.mode, states.case))),
        "case": states.case,
        **of_face,
        **states_of_points,
    }
