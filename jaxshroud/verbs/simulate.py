"""One scene in full: its motion at every step."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.chatter import chatter
from jaxshroud.batch.extent import STEP, memory_for
from jaxshroud.batch.free import free_status
from jaxshroud.batch.loop import driven
from jaxshroud.batch.periods import Clock
from jaxshroud.batch.runs import stepper
from jaxshroud.batch.states import as_arrays, inside, whole
from jaxshroud.batch.xla import EachLane, alone, best, compiled
from jaxshroud.march.energy import balance, energy
from jaxshroud.march.events import Counters, seat
from jaxshroud.march.lane import Fixed, Lane, begin, grid
from jaxshroud.march.method import REFERENCE, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.absent import Scalar, filled
from jaxshroud.model.friction import stretch
from jaxshroud.model.linear import free_motion
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.ready import Model, model
from jaxshroud.model.state import State, start
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of

BLOCK = 1024  # samples per call
STEPS_AT_ONCE = 1 << 15  # per call, or a single sample: Ctrl-C is heard in between


def simulate(
    scene: Scene,
    state: State | None = None,
    *,
    n_periods: int,
    steps_per_period: Steps = 400,
    every: int = 1,
    turns: float = 0.0,
    t: float = 0.0,
    method: Method | Choices = REFERENCE,
) -> Trajectory:
    """Integrate Eq. (1), stopping inside a step at every contact change.

    Args:
        scene: Blades, shroud, contact, friction, drive and initial motion, in SI units.
        state: Where to start; by default `scene.initial`, apart. A start in overlap is an onset at once.
        n_periods: Forcing periods T = 2 pi / omega to run.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        every: Keep every so many steps.
        turns: Phase of the drive at the start [turns]; 0 for t = 0.
        t: Time at the start [s].
        method: Static choices of the march.

    Returns:
        The initial state and then every `every`-th step of `n_periods * steps_per_period`.

    Raises:
        ValueError: A count is not a positive integer, or what is to be stored would not fit into memory.

    Source:
        Eq. (1), Sec. 3.1, in SI; not Eq. (21), whose time scaling is inconsistent.
    """
    method = choices(method, ledger=True)
    for name, value in dict(n_periods=n_periods, every=every).items():
        count_argument(name, value, 1)
    scene = in_precision(scene, method.precision)
    steps_per_period = steps_for(scene, 0, steps_per_period, stepper(scene, method))
    first_state = start(scene.initial) if state is None else in_precision(state, method.precision)
    total = n_periods * steps_per_period // every
    memory_for("what is stored of this run", total * STEP)
    index = np.arange(total + 1) * every
    period = float(scene.drive.period)
    times = t + index * (period / steps_per_period)
    after = float((turns + (index[-1] % steps_per_period) / steps_per_period) % 1)
    if scene.parts.contact == "none":
        values = _without_contact(scene, first_state, turns, index / steps_per_period)
        return _result(scene, values, times, after, steps_per_period, every, method)
    lane, first = _begin(scene, first_state, method)
    samples = [first]
    steps, phase = np.int32(steps_per_period), np.asarray(turns, first.u_s.dtype)
    held = _energy(scene, lane)
    longest = min(max(STEPS_AT_ONCE // every, 1), BLOCK)
    for done in range(0, total, longest):
        n = min(longest, total - done)
        lane, block = _samples(scene, lane, steps, phase, np.int32(every), np.int32(n), method, best())
        samples.append(jax.tree.map(lambda a, n=n: np.asarray(a)[:n], block))
    whole = jax.tree.map(lambda *a: np.concatenate(a), jax.tree.map(lambda a: np.asarray(a)[None], first), *samples[1:])
    tally, energies = lane.tally, (_energy(scene, lane), held)
    clock = Clock(*map(jnp.asarray, (phase, steps, steps.astype(phase.dtype))))
    residual = dropped = float("nan")
    overflowed = int(lane.status) == Status.OK and not np.isfinite(sum(jax.tree.leaves((tally.integrals, energies))))
    if method.ledger:
        gain = tally.integrals.ledger
        missing = balance(gain, tally.jumps, energies[0] - held)
        residual = float(missing / jnp.where(gain.drive == 0, 1.0, jnp.abs(gain.drive)))
        dropped = float(filled(tally.jumps.dropped, gain.gross) / jnp.where(gain.gross > 0, gain.gross, 1.0))
    values = {
        "motion": whole.motion,
        "u_s": np.where(whole.mode == Mode.APART, np.nan, whole.u_s),
        "mode": whole.mode,
        "case": whole.case,
        "status": Status.NOT_FINITE if overflowed else lane.status,
        "counters": vars(filled(tally.log.counters, jnp.int32(0))),
        "energy_residual": residual,
        "energy_dropped": dropped,
        "chatter": _told_chatter(scene, lane, whole, clock, every, method),
    }
    return _result(scene, values, times, after, steps_per_period, every, method)


def _result(
    scene: Scene, values: dict[str, Any], times: np.ndarray, turns: float, steps: int, every: int, method: Choices
) -> Trajectory:
    run = {"periods": (len(times) - 1) * every // steps, "transient": 0, "steps_per_period": steps}
    common = {"omega": scene.drive.omega, "gap": scene.shroud.gap, "turns": turns, "every": every}
    marched = {"steps_per_period": steps, "method": str(method)}
    coords = {"time": ("time", times, {"units": "s", "long_name": "time"}), "blade": [0, 1]}
    attrs = {"title": "", "scene": text_of(scene, run)}
    return Trajectory.from_values({**values, **common, **marched}, coords=coords, attrs=attrs)


def _told_chatter(scene: Scene, lane: Lane, samples: State, clock: Clock, every: int, method: Choices) -> str | None:
    done = (np.isfinite(samples.motion.x[:, 0]).sum() - 1) * every // int(clock.steps)
    return chatter(alone(scene), alone(lane), np.array([done + 1]), clock, method)


def _without_contact(scene: Scene, state: State, turns: float, periods: np.ndarray) -> dict[str, Any]:
    """Samples after so many `periods`, in closed form."""
    dtype = state.motion.x.dtype
    seconds = jnp.asarray(periods, dtype) * scene.drive.period
    motion, status = _free(scene, state.motion, jnp.asarray(turns, dtype), seconds)
    none = np.zeros(len(periods), np.int32)
    return {
        "motion": jax.tree.map(np.asarray, motion),
        "u_s": np.full(len(periods), np.nan, dtype),
        "mode": none,
        "case": none,
        "status": status,
        "counters": dict.fromkeys(Counters.__annotations__, 0),
        "energy_residual": 0.0,
        "energy_dropped": 0.0,
    }


@jax.jit
def _free(scene: Scene, first: Motion, turns: Scalar, t) -> tuple[Motion, Int[Array, ""]]:
    motion = free_motion(scene, first, turns, t)
    return motion, free_status(scene, motion, jnp.max(jnp.abs(motion.theta)))


@partial(jax.jit, static_argnames="method")
def _begin(scene: Scene, state: State, method: Choices) -> tuple[Lane, State]:
    ready = model(scene)
    lane = begin(inside(state, ready), ready, method)
    return lane, _sample(lane, ready)


@jax.jit
def _energy(scene: Scene, lane: Lane) -> Scalar:
    return energy(lane.state, model(scene))


def _sample(lane: Lane, scene_model: Model) -> State:
    """The lane's state with its slider brought up to date; NaN once the lane has stopped."""
    held = lane.state
    at = seat(held.motion, held, scene_model)[2]
    smooth, held = scene_model.spring.smooth, whole(held)
    u_s = held.u_s if smooth else at.u - stretch(at.v, at.u, held.u_s, held.mode, scene_model.spring)
    motion, u_s = jax.tree.map(lambda a: jnp.where(lane.status == Status.OK, a, jnp.nan), (as_arrays(held.motion), u_s))
    return State(motion, u_s, held.mode, held.case)


@compiled("method", "each")
def _samples(scene: Scene, lane: Lane, steps, turns, every, n, method: Choices, each: EachLane) -> tuple[Lane, State]:
    """`n` samples, `every` steps apart; the rows beyond are meaningless."""
    scene_model = model(scene)
    models, grids = alone((scene_model, grid(turns, steps.astype(turns.dtype), scene.drive.period)))

    def one_step(_, lanes):
        return driven(lanes, Fixed(models, grids, lanes.step + 1), steps, method, each)[0]

    def one_sample(lanes, i):
        lanes = lax.fori_loop(0, jnp.where(i < n, every, 0), one_step, lanes)
        return lanes, _sample(jax.tree.map(lambda a: a[0], lanes), scene_model)

    lanes, samples = lax.scan(one_sample, alone(lane), jnp.arange(BLOCK, dtype=jnp.int32))
    return jax.tree.map(lambda a: a[0], lanes), samples
