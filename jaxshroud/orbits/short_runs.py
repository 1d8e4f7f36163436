"""Short runs of scenes from their own starts, by which methods are compared: final states, errors, slopes and costs.

They are marched as all lanes are; scenes without located events by diffrax's adaptive solvers too.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import carried_state, initial_states, motion_rows
from jaxshroud.batch.periods import Sample, sample_of_users
from jaxshroud.batch.plan import Plan, Tick
from jaxshroud.batch.runs import run_lanes, trajectories
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.tangents import direction, run_flow, without_direction
from jaxshroud.cache.programs import kept
from jaxshroud.march.method import Choices
from jaxshroud.model.arithmetic import Scalar, Symbolic, filled
from jaxshroud.model.blade import rate_of_motion
from jaxshroud.model.linear import free_rms_displacement
from jaxshroud.model.prepared import State, initial_state
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import alone, prepared_row, row_rhs
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision

HORIZON = 3  # periods after which states are compared: chaos has hardly multiplied errors yet
MovingState = tuple[Motion, Array | Symbolic]  # motion and slider, with or without an axis of lanes


class ShortRuns(NamedTuple):
    """The runs of lanes by some method."""

    samples: Sample  # (lanes, periods); NaN where a lane has stopped
    steps: int  # per period, on average


def run_from_start(scenes: Scene, periods: int, steps: int, method: Choices) -> ShortRuns:
    """March lanes (leading axis) from the initial states of their scenes."""
    scenes = in_precision(scenes, method.precision)
    runs = run_lanes(scenes, initial_states(scenes), Plan(0, periods, steps, 0.0, method), lambda _: None)
    return ShortRuns(runs.samples, steps)


def gap_slopes(scenes: Scene, periods: int, steps: int, method: Choices) -> np.ndarray:
    """The derivative of each lane's mean power with respect to the gap, (lanes,); NaN where there is none."""
    if method.locate == "none" or method.precision == "float32" or scenes.parts.contact == "none":
        return np.full(len(scenes.drive.omega), np.nan)
    dual = Dual(without_given(scenes), direction(scenes, "shroud.gap"))
    flow = run_flow(dual, without_direction(initial_states(scenes)), periods, steps, as_differentiable(method))
    return flow.tangent.power[:, 0]


def softened(scenes: Scene, width: float) -> Scene:
    """Scenes (leading axis) with smooth contact, `width` in units of their `free_rms_displacement`; 0: unchanged."""
    return jax.vmap(lambda scene: _soft(scene, width))(scenes) if width else scenes


def _soft(scene: Scene, width: float) -> Scene:
    return with_parts(scene, scene.parts._replace(contact="smooth"), width * free_rms_displacement(scene))


class HorizonEnds(NamedTuple):
    """Where lanes are at the horizon, from the scenes' own starts, and the work until then."""

    motions: np.ndarray  # (lanes, 12); NaN where a lane has stopped
    trials: int  # of all lanes: those between events, and one for each event


def _no_tick(lane_periods: float) -> None:
    del lane_periods


def end_states(
    scenes: Scene,
    steps: int,
    method: Choices,
    tick: Tick = _no_tick,
    *,
    ledger: bool = False,
    vibration: bool = False,
) -> HorizonEnds:
    """Where lanes (leading axis) end. `ledger` and `vibration` are those of the programs that march them."""
    scenes = in_precision(scenes, method.precision)
    method = method._replace(ledger=ledger, vibration=vibration)
    runs = run_lanes(scenes, initial_states(scenes), Plan(HORIZON - 1, 1, steps, 0.0, method), tick)
    return HorizonEnds(
        motions_at(runs.samples, 0), _trials(scenes, method.tableau.trials(steps), vars(runs.log.counters))
    )


def trajectory_ends(scenes: Scene, steps: int, method: Choices, tick: Tick = _no_tick) -> HorizonEnds:
    """The same by the compiled programs of `trajectories`, with a ledger."""
    scenes = in_precision(scenes, method.precision)
    method = method._replace(ledger=True)
    grid = SampleGrid(0.0, steps, steps, HORIZON * steps)
    run = trajectories(scenes, initial_states(scenes), grid, method, lambda lane_steps: tick(lane_steps / steps))
    motions = np.concatenate(run.samples["motion"], axis=-1)[:, -1].astype(float)
    return HorizonEnds(motions, _trials(scenes, method.tableau.trials(steps), run.counters))


def _trials(scenes: Scene, between: int, counters: Mapping[str, np.ndarray]) -> int:
    """The trials of lanes to the horizon, of which there are so many in a period between its events."""
    events = sum(int(np.sum(count, dtype=np.int64)) for count in counters.values())
    return HORIZON * between * len(scenes.drive.omega) + events


def motions_at(samples: Sample, period: int) -> np.ndarray:
    """The motions (lanes, 12) at the end of a kept period."""
    return motion_rows(samples.motion)[:, period].astype(float)


def state_errors(computed: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The error of each state, (lanes,): that of positions or of rates, whichever is larger, each over its maximum."""
    error, size = (np.abs(a).reshape(len(a), 2, -1).max(axis=2) for a in (computed - exact, exact))
    return (error / np.where(error == 0, 1.0, size)).max(axis=1)  # a motion that both know to be none is right


def adaptive_samples(
    scenes: Scene, periods: int, solver: str, rtol: float
) -> tuple[Sample, Int[Array, "lanes periods"]]:
    """Samples (lanes, periods) from the scenes' own starts, and the steps of each period.

    Args:
        scenes: Scenes (leading axis) with smooth contact or without contact.
        periods: The number of drive periods.
        solver: The name of a solver of diffrax.
        rtol: Its tolerance relative to each number; for displacements also relative to `free_rms_displacement`.
    """
    moving = jax.vmap(_start)(scenes)
    blocks = []
    for _ in range(periods):
        moving, sample, steps = _one_period(scenes, moving, rtol, solver)
        blocks.append((sample, steps))
    return jax.tree.map(lambda *a: jnp.stack(a, axis=1), *blocks)


def adaptive_runs(scenes: Scene, periods: int, solver: str, rtol: float) -> ShortRuns:
    """Runs of lanes by an adaptive solver; see `adaptive_samples`."""
    samples, steps = adaptive_samples(scenes, periods, solver, rtol)
    return ShortRuns(sample_of_users(samples), round(float(np.asarray(steps).mean())))


def adaptive_gap_slopes(scenes: Scene, periods: int, solver: str, rtol: float) -> np.ndarray:
    """The derivative of each lane's mean power with respect to the gap, (lanes,)."""

    def power(scenes):
        return adaptive_samples(scenes, periods, solver, rtol)[0].power[0].mean(axis=1)

    return np.asarray(jax.jvp(power, (without_given(scenes),), (direction(scenes, "shroud.gap"),))[1])


def _first_state(scene: Scene) -> State:
    """The state of a pair at t = 0, along unrolled axes."""
    return carried_state(initial_state(scene.initial), prepared_row(scene))


def _start(scene: Scene) -> MovingState:
    """The motion and the slider at t = 0."""
    first = _first_state(scene)
    return first.motion, first.u_s


@kept("solver")
def _one_period(
    scenes: Scene, moving: MovingState, rtol: float | Scalar, solver: str
) -> tuple[MovingState, Sample, Int[Array, " lanes"]]:
    return jax.vmap(lambda scene, moving: _lane_period(scene, moving, rtol, solver))(scenes, moving)


def _lane_period(scene: Scene, moving: MovingState, rtol: float | Scalar, solver: str):
    """One period of one lane, from drive phase 0."""
    import diffrax

    model = prepared_row(scene)
    period = scene.drive.period
    omega = scene.drive.omega
    first = _first_state(scene)

    def field(t, y, _):
        z, u_s, _ = y
        wave = jnp.sin(omega * t), jnp.cos(omega * t)
        slope, rates = row_rhs(wave, State(z, u_s, first.mode, first.case), None, model, Recorded(), alone)
        return rate_of_motion(z, slope.acceleration), slope.u_s, rates.power

    no_power = jax.tree.map(jnp.zeros_like, field(0.0, (*moving, None), None)[2])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        getattr(diffrax, solver)(),
        t0=jnp.zeros_like(period),
        t1=period,
        dt0=None,
        y0=(*moving, no_power),
        stepsize_controller=diffrax.PIDController(rtol, rtol * lax.stop_gradient(free_rms_displacement(scene))),
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
        throw=False,
    )
    assert solution.ys is not None
    z, u_s, total = jax.tree.map(lambda a: a[0], solution.ys)
    power = jax.tree.map(lambda a: a / period, total)
    return (z, u_s), Sample(filled(z, power), power), solution.stats["num_steps"]
