"""How lanes are run, by stepping or in closed form: all at once, along an axis, or with trajectories.

Where scenes ask for it, rings are marched by their sector: a smaller ring in their place, whose results are given as
those of the whole one. It stays in motions that repeat from sector to sector. Whatever does not start so is marched
whole, and so are tangents along directions that do not repeat, by which stability is judged.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.activity import counted
from jaxshroud.batch.closed_form import closed_form_runs, free_trajectories, settled_runs
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.lanes import final_states, initial_states
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Plan, Runs, Tick, Ticker, both, completed_runs
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stepped_runs import (
    chunk_by_chunk,
    sampled_motions_of,
    select_lanes,
    stepped_runs,
    stepped_trajectories,
)
from jaxshroud.batch.stretches import Trajectories
from jaxshroud.batch.threads import Interrupted, changing_what_is_done
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tableau import Tableau, TaylorOptions
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State, law_type
from jaxshroud.model.spring_contact import NoContact
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import (
    COUPLED_WITHOUT_CONTACT,
    NO_CONTACT,
    PAIR,
    Direction,
    require_capability,
    require_steps,
)
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import asks_for_sector, has_period_of_blades, sector_blades, smaller_ring, whole_ring
from jaxshroud.scene.typed import Tree


class March(NamedTuple):
    """How lanes are run. Numbers of blades have an axis `blades` in results, numbers of contact one of `interfaces`."""

    run: Callable[[Scene, State, Plan, Tick, np.ndarray], Runs]
    """The whole periods of a plan; see `runs.run_lanes`."""
    trajectories: Callable[[Scene, State, SampleGrid, Choices, Tick], Trajectories]
    """Samples at instants with all quantities of results; see `runs.trajectories`."""
    steps: bool
    """Whether it takes steps, or has a closed form."""

    def stepping(self, method: Choices) -> Tableau | TaylorOptions | None:
        """The method by which it steps; None in closed form."""
        return method.tableau if self.steps else None


STEPPED = March(stepped_runs, stepped_trajectories, steps=True)
# Blades that never touch have a closed form; where tangents or motions alone are wanted, they are marched.
WITHOUT_CONTACT = March(closed_form_runs, free_trajectories, steps=False)
# Contact that is asked to stay in one state has a closed form too, of its settled motion.
LINEAR = March(settled_runs, stepped_trajectories, steps=False)


def march_of(scenes: Scene) -> March:
    """The march of scenes, by their layout and their contact."""
    if is_linear(scenes):
        return LINEAR
    return WITHOUT_CONTACT if scenes.layout == PAIR and scenes.parts.contact == "none" else STEPPED


def require_march(scenes: Scene, method: Choices) -> None:
    """Raise InputError unless the march of scenes and the stepper of the method know their contact and each other."""
    require_steps(scenes.parts.contact)
    stepper = stepper_for(method)
    law = law_type(scenes)
    if law is NoContact:
        if scenes.is_coupled:
            raise InputError(COUPLED_WITHOUT_CONTACT)
        require_capability(NO_CONTACT, scenes.layout)
    if not stepper.knows(law):
        raise InputError(f"The method taylor knows located contact, not {law.called}; take a Runge-Kutta method.")


SAME_STATE = 1e-12  # of the largest number of its kind: by which states of equal blades may differ
TOTALS_OF_PERIODS = ("work", "gross", "viscous", "dropped", "residual")  # of a `Sample`, summed over the row
TOTALS_OF_RUNS = ("work_drive", "loss_viscous")  # of the energies of `Trajectories`


def stepping_method(scene: Scene, method: Choices) -> Tableau | TaylorOptions | None:
    """The method that steps through a scene; None where there is a closed form.

    Raises:
        InputError: The march of the scene, or the stepper of the method, does not know its contact.
    """
    if not is_linear(scene):
        require_march(scene, method)
    return march_of(scene).stepping(method)


def run_lanes(scenes: Scene, states: State, plan: Plan, ticker: Tick, arrived: np.ndarray | None = None) -> Runs:
    """Run all lanes (leading axis) over their periods.

    Args:
        scenes: The scenes.
        states: Their states at drive phase 0.
        plan: The plan of the run.
        ticker: Called with numbers of lane-periods as they are done.
        arrived: Which lanes start at the phase of the plan instead (lanes,); by default none.

    Raises:
        Interrupted: On Ctrl-C; `done` has the lanes that had ended, and the others with status NOT_RUN.
    """
    scenes, states, copies = folded(without_given(scenes), states)
    arrived = np.zeros(len(scenes.drive.omega), bool) if arrived is None else arrived
    lane_periods = len(scenes.drive.omega) * (plan.transient + plan.kept)
    with counted("lane-periods", lane_periods) as count, changing_what_is_done(partial(unfolded_runs, copies=copies)):
        return unfolded_runs(march_of(scenes).run(scenes, states, plan, both(count, ticker), arrived), copies)


def trajectories(scenes: Scene, states: State, grid: SampleGrid, method: Choices, ticker: Tick) -> Trajectories:
    """The trajectories of lanes (leading axis), by the march of their scenes.

    Args:
        scenes: The scenes.
        states: The states in which they start.
        grid: The time grid, and which states are kept.
        method: The options of the march.
        ticker: Called with the number of steps done, if there are steps.

    Raises:
        Interrupted: On Ctrl-C, without results.
    """
    scenes, states, copies = folded(scenes, states)
    with counted("steps", len(scenes.drive.omega) * grid.length) as count:
        marched = march_of(scenes).trajectories(scenes, states, grid, method, both(count, ticker))
    return unfolded_trajectories(marched, copies)


def sampled_motions(scenes: Scene, states: State, grid: SampleGrid, method: Choices) -> Motion:
    """The motions of `trajectories` alone, (lanes, 1 + samples, blades) each, which takes fewer compiled programs.

    They are marched step by step without contact too.
    """

    def run(chunk, tick):
        return sampled_motions_of(chunk[0], chunk[1], grid, method, tick)

    motions = chunk_by_chunk(run, (scenes, states), lambda _: None, lanes_per_call(scenes.layout))
    return jax.tree.map(lambda a: np.asarray(a, float), motions)


@jax.tree_util.register_dataclass
@dataclass
class SweepHandover:
    """The states of lanes that are continued from value to value, handed from one block of values to the next."""

    state: State | None = None  # at the end of the previous value; None at the first
    arrived: np.ndarray | None = None  # which lanes reached it; the others start afresh
    history: "list[SweepHandover] | None" = None  # from each value so far to the next; None: not kept


def independent_runs(
    scenes: Scene, shape: tuple[int, ...], plan: Plan, ticker: Ticker, states: State | None = None
) -> Runs:
    """Run all lanes at once, each from the start of its scene or from `states` with the same leading axes.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    flat, begin = jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(shape) :]), (scenes, states))

    def shaped(runs):
        return jax.tree.map(lambda a: a.reshape(*shape, *a.shape[1:]), runs)

    with changing_what_is_done(shaped):
        return shaped(run_lanes(flat, initial_states(flat) if begin is None else begin, plan, ticker))


def continued_runs(
    scenes: Scene,
    shape: tuple[int, ...],
    plan: Plan,
    ticker: Ticker,
    states: State | None = None,
    *,
    direction: Direction,
    relay: SweepHandover | None = None,
) -> Runs:
    """Run the lanes along the first axis one after the other, each from the final state of the previous one.

    Args:
        scenes: The scenes, with leading axes of that `shape`.
        shape: The shape of the grid.
        plan: How long to run.
        ticker: Called with the number of lane-periods done.
        states: The initial states; by default those of the scenes.
        direction: "forward", from the first value to the last, or "backward".
        relay: Where the previous values have ended; updated to where these end.

    Raises:
        Interrupted: As in `run_lanes`.
    """
    order = range(shape[0]) if direction == "forward" else range(shape[0] - 1, -1, -1)

    def concatenate(runs):
        return jax.tree.map(lambda *a: np.stack(a).reshape(*shape, *a[0].shape[1:]), *runs)

    runs: list[Runs | None] = [None] * shape[0]
    relay = relay or SweepHandover()
    for i in order:
        here, begin = jax.tree.map(lambda a, i=i: a[i].reshape(-1, *a.shape[len(shape) :]), (scenes, states))
        fresh = initial_states(here) if begin is None else begin
        try:
            runs[i] = run = run_lanes(here, fresh if relay.state is None else relay.state, plan, ticker, relay.arrived)
        except Interrupted as stopped:
            runs[i] = stopped.done
            raise Interrupted(completed_runs(runs, concatenate)) from None
        arrived = run.last.status == Status.OK  # a lane that has stopped starts afresh
        relay.state = select_lanes(arrived, final_states(run.last.state), fresh)
        relay.arrived = arrived
        if relay.history is not None:
            relay.history.append(SweepHandover(relay.state, relay.arrived))
    return concatenate(runs)


class Folded(NamedTuple):
    """Lanes (leading axis) as they are marched."""

    scenes: Any  # a `Scene`, or a `Dual` of two, on whose directions the states do not depend
    states: State
    copies: int  # of their rings that make the ring of the scenes; 1: it is whole


def folded(scenes: Scene, states: State) -> Folded:
    """Lanes (leading axis) as they are marched: by their sector, where that is requested and the states repeat so."""
    if not asks_for_sector(scenes):
        return Folded(scenes, states, 1)
    if is_linear(scenes):  # closed forms are folded themselves
        return Folded(scenes, states, 1)
    blades = scenes.layout.blades
    n = sector_blades(scenes)
    if n == blades or not _repeat_after(n, states):
        return Folded(whole_ring(scenes), states, 1)
    return Folded(smaller_ring(scenes, n), jax.tree.map(lambda a: a[:, :n], states), blades // n)


def _repeat_after(blades: int, states: State) -> bool:
    """Whether states, whose second axis is that of blades or interfaces, repeat after so many of them."""

    def repeats(a):
        real = np.asarray(a, float)
        return np.all(np.abs(np.roll(real, -blades, axis=1) - real) <= SAME_STATE * np.max(np.abs(real), initial=0.0))

    return all(map(repeats, jax.tree.leaves(states)))


def folded_tangents(scenes: Dual, states: State) -> Folded:
    """Lanes with derivatives as they are marched: as `folded`, where the directions of all repeat as well."""
    small = folded(scenes.value, states)
    blades = small.scenes.layout.blades
    if small.copies == 1 or not has_period_of_blades(scenes.tangent, blades):
        return Folded(scenes, states, 1)
    return Folded(Dual(small.scenes, smaller_ring(scenes.tangent, blades)), small.states, small.copies)


def unfolded_flow(flow: Dual, copies: int) -> Dual:
    """What flows with tangents of so many copies of a ring integrate, given for all blades."""
    if copies == 1:
        return flow

    def tiled(part: Any) -> Any:
        numbers = {name: _tiled(getattr(part, name), copies, -1) for name in ("power", "moments", "means")}
        return part._replace(**numbers)

    return Dual._make(map(tiled, flow))


def unfolded_runs(runs: Runs, copies: int) -> Runs:
    """The runs of so many copies of a ring as one."""
    if copies == 1:
        return runs
    samples = _tiled(runs.samples, copies, 2)
    log = (_tiled(part, copies, 1) for part in (runs.before, runs.log))
    totals = {name: getattr(samples, name) for name in TOTALS_OF_PERIODS}
    samples = samples._replace(**{name: None if a is None else copies * a for name, a in totals.items()})
    before, after = log
    return replace(runs, samples=samples, before=before, log=after, last=_unfolded_lanes(runs.last, copies))


def unfolded_trajectories(found: Trajectories, copies: int) -> Trajectories:
    """The trajectories of so many copies of a ring as one."""
    if copies == 1:
        return found
    energy = _tiled(found.energy, copies, 1)
    return found._replace(
        samples=_tiled(found.samples, copies, 2),
        amplitudes=_tiled(found.amplitudes, copies, 1),
        counters=_tiled(found.counters, copies, 1),
        energy=energy | {name: copies * energy[name] for name in TOTALS_OF_RUNS if name in energy},
        loads=_tiled(found.loads, copies, 1),
        times=_tiled(found.times, copies, 1),
        last=_unfolded_lanes(found.last, copies),
    )


def _unfolded_lanes(lanes: Any, copies: int) -> Any:
    """The lanes at the end of a march, as compiled loops carry them: blades and interfaces are their last axis."""
    tiled = _tiled(lanes, copies, -1)
    if lanes.accumulator.jumps is None:
        return tiled
    return eqx.tree_at(lambda lane: lane.accumulator.jumps.dropped, tiled, copies * lanes.accumulator.jumps.dropped)


def _tiled(tree: Tree, copies: int, axis: int) -> Tree:
    """A tree of arrays with that axis repeated; those without it, of whole rings, stay as they are."""
    least = axis + 1 if axis > 0 else 2

    def tiled(a):
        return a if np.ndim(a) < least else np.concatenate([a] * copies, axis=axis)

    return jax.tree.map(tiled, tree)
