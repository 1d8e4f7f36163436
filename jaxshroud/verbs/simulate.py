"""One scene in full: its motion at every step."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxshroud.batch.chatter import chatter
from jaxshroud.batch.extent import STEP, memory_for
from jaxshroud.batch.free import free_status
from jaxshroud.batch.instants import march_with_events, sampled
from jaxshroud.batch.loop import driven
from jaxshroud.batch.periods import Clock, begin_lanes
from jaxshroud.batch.readings import march_with_series
from jaxshroud.batch.resultants import resultants
from jaxshroud.batch.runs import Progress, Tick, Ticker, chunk_by_chunk
from jaxshroud.batch.xla import EachLane, best, compiled
from jaxshroud.march.energy import balance, energy
from jaxshroud.march.events import Counters
from jaxshroud.march.lane import Fixed, Lane, Log, grid
from jaxshroud.march.method import REFERENCE, Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.absent import Scalar, filled, is_absent
from jaxshroud.model.linear import free_motion
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.ready import model
from jaxshroud.model.rhs import Ledger
from jaxshroud.model.state import State
from jaxshroud.results.status import tell_failures
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.door import Asked, Marched, asked, in_shape, marched

BLOCK = 1024  # samples per call
STEPS_AT_ONCE = 1 << 15  # per call, or a single sample: Ctrl-C is heard in between


def simulate(
    scene: Scene | SceneFile,
    state: State | None = None,
    *,
    n_periods: int | None = None,
    steps_per_period: Steps | None = None,
    every: int = 1,
    turns: float = 0.0,
    t: float = 0.0,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
    events: bool = False,
) -> Trajectory:
    """Integrate Eq. (1), stopping inside a step at every contact change.

    Args:
        scene: Blades, shroud, contact, friction, drive and initial motion, in SI units; or many of these, with leading
            axes, which come first in all results; or a scene file, whose [run] counts where an argument is not given.
        state: Where to start; by default `scene.initial`, apart. A start in overlap is an onset at once. One state for
            all scenes, or one for each.
        n_periods: Forcing periods T = 2 pi / omega to run; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        every: Keep every so many steps.
        turns: Phase of the drive at the start [turns]; 0 for t = 0.
        t: Time at the start [s].
        method: How to march; where only steps are given RK4, with events located by bisection.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, see `choose`.
        progress: Called with (samples done, samples in all).
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.
        events: Keep the states on both sides of every contact event too, as `run.events`; of a single scene.

    Returns:
        The initial state and then every `every`-th step of `n_periods * steps_per_period`, with all of the start-up;
        and what contact does then: its forces `N` and `F` [N], `v`, `u` and `contact_point` [m]. A model without
        contact has none of these, one whose blocks do not turn no `contact_point`; without friction `F` is 0.

    Raises:
        ValueError: A count is not a positive integer, what is to be stored would not fit into memory, or `events` are
            asked for of many scenes or of a model without them.
        NumericalError: With `throw`: a lane stopped.

    Source:
        Eq. (1), Sec. 3.1, in SI; not Eq. (21), whose time scaling is inconsistent.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> run = js.simulate(scene, n_periods=1, steps_per_period=200)
        >>> run.t.shape, run.motion.x.shape, run.status
        ((201,), (201, 2), 0)
    """
    count_argument("every", every, 1)
    door = asked(
        scene, n_periods=n_periods, steps_per_period=steps_per_period, method=method, accuracy=accuracy, dims=dims
    )
    if events and (door.shape or door.scene.parts.contact != "spring"):
        raise InputError("Argument `events` keeps those of one scene with located contact; simulate it alone.")
    given = door.lanes
    how = marched(door, given, REFERENCE)
    scenes = in_precision(given, how.method.precision)
    count = door.n_periods * how.steps // every
    memory_for("what is stored of this run", len(scenes.drive.omega) * count * STEP)
    states = door.states(state, scenes)
    index = np.arange(count + 1) * every
    if scenes.parts.contact == "none":
        values = _without_contact(scenes, states, turns, index / how.steps)
    else:
        grid = _Grid(turns, every, count, events)
        values = _run(scenes, states, grid, how, Ticker(len(scenes.drive.omega) * count, progress))
    chatter, met = values.pop("chatter", None), values.pop("events", None)
    times = t + index * (np.asarray(scenes.drive.period, float)[:, None] / how.steps)
    after = float((turns + (index[-1] % how.steps) / how.steps) % 1)
    common = {"turns": after, "every": every, "chatter": chatter, **how.told}
    if met is not None:
        values["events"] = {**met, "t": t + met["t"] * (np.asarray(scenes.drive.period, float)[:, None] / how.steps)}
    lanes = {"omega": scenes.drive.omega, "gap": scenes.shroud.gap, **values, "t": times}
    found = _result(door, in_shape(lanes, door.shape), common)
    tell_failures(found.status, chatter, throw=throw)
    return found


def _result(door: Asked, values: dict[str, Any], common: dict[str, Any]) -> Trajectory:
    told, numbers = door.about(0, common["steps_per_period"])
    times = values.pop("t")
    time = {"units": "s", "long_name": "time"}
    coords: dict[str, Any] = {"blade": [0, 1]} if door.shape else {"time": ("time", times, time), "blade": [0, 1]}
    more = {"t": ((*door.dims, "time"), times, time)} if door.shape else {}
    return Trajectory.from_values(
        {**values, **common}, lanes=door.dims, coords=coords, attrs=told, more={**numbers, **more}
    )


class _Grid(NamedTuple):
    """What is kept of a run."""

    turns: float  # drive phase at the start
    every: int  # steps from sample to sample
    samples: int  # after the first
    events: bool  # both sides of these too


class _Kept(NamedTuple):
    """What some lanes have come to (leading axis)."""

    samples: dict[str, Any]  # then (samples,)
    last: Lane
    gained: np.ndarray  # energy [J]
    events: dict[str, Any] | None


def _run(scenes: Scene, states: State, grid: _Grid, how: Marched, ticker: Ticker) -> dict[str, Any]:
    """Numbers of lanes (leading axis) marched for so many samples."""
    run = lambda chunk, tick: _chunk(chunk[0], chunk[1], grid, how, tick)  # noqa: E731
    samples, last, gained, events = chunk_by_chunk(run, (scenes, states), ticker)
    tally, nothing = jax.tree.map(jnp.asarray, last.tally), np.full(len(scenes.drive.omega), np.nan)
    assert tally.log is not None  # as derivatives are not computed
    finite = np.isfinite(sum(np.asarray(a, float) for a in jax.tree.leaves((tally.integrals, gained))))
    status = np.where((last.status == Status.OK) & ~finite, Status.NOT_FINITE, last.status)
    residual, dropped = nothing, nothing
    gain = tally.integrals.ledger
    if gain is not None and tally.jumps is not None:
        missing = np.asarray(balance(gain, tally.jumps, jnp.asarray(gained)))
        residual = missing / np.where(gain.drive == 0, 1.0, np.abs(gain.drive))
        dropped = np.asarray(filled(tally.jumps.dropped, gain.gross)) / np.where(gain.gross > 0, gain.gross, 1.0)
    return {
        **samples,
        "status": status,
        "counters": {n: np.asarray(a) for n, a in vars(filled(tally.log.counters, last.status)).items()},
        "energy_residual": residual.astype(float),
        "energy_dropped": dropped.astype(float),
        **_works(gain),
        **_shares(tally.log),
        "chatter": _told_chatter(scenes, last, samples["motion"], grid, how),
        "events": events,
    }


def _works(gain: Ledger | None) -> dict[str, np.ndarray]:
    """What the drive did and where it went, over the whole run; nothing where no ledger is kept."""
    if gain is None:
        return {}
    told = {"work_drive": gain.drive, "loss_viscous": gain.viscous, "loss_friction": filled(gain.friction, gain.drive)}
    return {name: np.asarray(a, float) for name, a in told.items()}


def _shares(log: Log) -> dict[str, np.ndarray]:
    """Fractions of the time in each contact state."""
    spent = {name: np.asarray(getattr(log, name), float) for name in ("time_apart", "time_stick", "time_slip")}
    whole = sum(spent.values())
    with np.errstate(invalid="ignore", divide="ignore"):
        return {name: t / whole for name, t in spent.items()}


def _chunk(scenes: Scene, states: State, grid: _Grid, how: Marched, tick: Tick) -> _Kept:
    """What some lanes (leading axis) come to."""
    lanes, first = _begin(scenes, states, how.method)
    held, clock, instants = _energy(scenes, lanes), _clock(grid.turns, how, first.u_s.dtype), None
    args = (clock, grid.every, grid.samples, how.method, tick)
    if how.method.taylor:
        lanes, blocks, instants = march_with_series(scenes, lanes, *args, grid.events)
    elif grid.events:
        lanes, blocks, instants = march_with_events(scenes, lanes, *args)
    else:
        lanes, blocks = _blocks(scenes, lanes, grid, how, clock, tick)
    blocks = [jax.tree.map(lambda a: np.asarray(a)[:, None], first), *blocks]
    whole = jax.tree.map(lambda *a: np.concatenate(a, axis=1), *blocks)
    samples = _stored(scenes, whole, grid.turns + np.arange(grid.samples + 1) * grid.every / how.steps)
    with np.errstate(invalid="ignore"):  # of energies that overflowed
        gained = np.asarray(_energy(scenes, lanes)) - np.asarray(held)
    events = None
    if instants is not None:
        events = _stored(scenes, instants.states, grid.turns + instants.steps / how.steps)
        events |= {"t": instants.steps[None], "after": instants.samples[None]}
    return _Kept(samples, jax.tree.map(np.asarray, lanes), gained, events)


def _blocks(
    scenes: Scene, lanes: Lane, grid: _Grid, how: Marched, clock: Clock, tick: Tick
) -> tuple[Lane, list[State]]:
    """The lanes at the end, and their samples (lanes, samples) but for the first."""
    samples, longest = [], min(max(STEPS_AT_ONCE // grid.every, 1), BLOCK)
    for done in range(0, grid.samples, longest):
        n = min(longest, grid.samples - done)
        kept = np.int32(grid.every), np.int32(n)
        lanes, block = _samples(scenes, lanes, np.int32(how.steps), clock.start, *kept, how.method, best())
        samples.append(jax.tree.map(lambda a, n=n: np.moveaxis(np.asarray(a)[:n], 0, 1), block))
        tick(n)
    return lanes, samples


def _stored(scenes: Scene, states: State, turns: np.ndarray) -> dict[str, Any]:
    """What is stored of states (lanes, samples) at phases of the drive (samples,) [turns]."""
    contact = resultants(scenes, states, turns)._asdict()
    return {
        "motion": states.motion,
        "u_s": np.where(states.mode == Mode.APART, np.nan, states.u_s),
        "mode": states.mode,
        "case": states.case,
        **{name: a for name, a in contact.items() if not is_absent(a)},
    }


def _clock(turns: float, how: Marched, dtype: Any) -> Clock:
    return Clock(jnp.asarray(turns, dtype), jnp.int32(how.steps), jnp.asarray(how.steps, dtype))


def _told_chatter(scenes: Scene, last: Lane, motion: Motion, grid: _Grid, how: Marched) -> str | None:
    done = (np.isfinite(motion.x[..., 0]).sum(axis=-1) - 1) * grid.every // how.steps
    return chatter(scenes, last, done + 1, _clock(grid.turns, how, motion.x.dtype), how.method)


def _without_contact(scenes: Scene, states: State, turns: float, periods: np.ndarray) -> dict[str, Any]:
    """Numbers of lanes (leading axis) sampled after so many `periods`, in closed form."""
    dtype, shape = states.motion.x.dtype, (len(scenes.drive.omega), len(periods))
    motion, status = _free(scenes, states.motion, jnp.asarray(turns, dtype), jnp.asarray(periods, dtype))
    none, zero = np.zeros(shape, np.int32), np.zeros(shape[0])
    return {
        "motion": jax.tree.map(np.asarray, motion),
        "u_s": np.full(shape, np.nan),
        "mode": none,
        "case": none,
        "status": status,
        "counters": dict.fromkeys(Counters.__annotations__, np.zeros(shape[0], int)),
        "energy_residual": zero,
        "energy_dropped": zero,
    }


@jax.jit
def _free(scenes: Scene, first: Motion, turns: Scalar, periods) -> tuple[Motion, Int[Array, " lanes"]]:
    def one(scene: Scene, first: Motion):
        motion = free_motion(scene, first, turns, periods * scene.drive.period)
        return motion, free_status(scene, motion, jnp.max(jnp.abs(motion.theta)))

    return jax.vmap(one)(scenes, first)


@partial(jax.jit, static_argnames="method")
def _begin(scenes: Scene, states: State, method: Choices) -> tuple[Lane, State]:
    lanes, models = begin_lanes(scenes, states, method), jax.vmap(model)(scenes)
    return lanes, jax.vmap(sampled)(lanes, models)


@jax.jit
def _energy(scenes: Scene, lanes: Lane) -> Float[Array, " lanes"]:
    return jax.vmap(lambda scene, lane: energy(lane.state, model(scene)))(scenes, lanes)


@compiled("method", "each")
def _samples(scenes: Scene, lanes: Lane, steps, turns, every, n, method: Choices, each: EachLane) -> tuple[Lane, State]:
    """`n` samples (leading axis, then the lanes), `every` steps apart; the rows beyond are meaningless."""
    models, period = jax.vmap(lambda scene: (model(scene), scene.drive.period))(scenes)
    like = lambda a: jnp.broadcast_to(a, period.shape)  # noqa: E731
    grids = grid(like(turns), like(steps.astype(turns.dtype)), period)

    def one_step(_, lanes):
        return driven(lanes, Fixed(models, grids, lanes.step + 1), steps, method, each)[0]

    def one_sample(lanes, i):
        lanes = lax.fori_loop(0, jnp.where(i < n, every, 0), one_step, lanes)
        return lanes, jax.vmap(sampled)(lanes, models)

    return lax.scan(one_sample, lanes, jnp.arange(BLOCK, dtype=jnp.int32))
