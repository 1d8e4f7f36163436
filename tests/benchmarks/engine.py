"""jaxshroud itself behind the peers' interface: chunk after chunk in the calling thread."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from problem import PERIODS, Problem

from jaxshroud.batch.lanes import begin_lanes, initial_states, lane_models
from jaxshroud.batch.periods import LANES_PER_CALL, Clock, at_start_of_period, one_call, run_block
from jaxshroud.batch.xla import FOR_SERIES, best_mapping
from jaxshroud.march.carry import Fixed, Lane, running
from jaxshroud.march.method import Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.model.row import at_only_interface
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud
from jaxshroud.scene.valid import in_precision

SERIES_STEPS = (200, 4000)  # by which only flat contact and chatter are told, for loose and tight tolerances
STEPS = {"rk4": (100, 200, 500, 1000, 2000), "tsit5": (50, 75, 100, 150, 250, 400), "dopri8": (50, 75, 100, 150, 250)}
METHODS = {f"jaxshroud {name}": (Choices(tableau(name), "cubic", False), steps) for name, steps in STEPS.items()} | {
    "jaxshroud rk4, bisection": (Choices(locate="bisection", ledger=False), (200, 500, 1000)),
    "jaxshroud rk4, no location": (Choices(locate="none", ledger=False), (200, 500, 1000)),
    "jaxshroud rk4 float32": (Choices(locate="cubic", ledger=False, precision="float32"), (50, 100, 200, 500)),
    "jaxshroud tsit5 float32": (Choices(tableau("tsit5"), "cubic", False, "float32"), (50, 75, 100, 150)),
}

SERIES = {  # orders for tolerances, chosen on other lanes than those of the benchmarks
    **{1e-3: 6, 1e-4: 8, 3e-5: 8, 1e-5: 10, 3e-6: 10, 1e-6: 10, 3e-7: 12, 1e-7: 12, 3e-8: 12, 1e-8: 14, 3e-9: 14},
    **{1e-9: 14, 3e-10: 16, 1e-10: 16, 3e-11: 16, 1e-11: 16, 1e-12: 18},
}
TRIED = {6: (3, 4, 5), 8: (3, 4, 5, 6), 10: (4, 5, 6, 7), 12: (5, 7, 8, 9), 14: (6, 8, 9, 10), 16: (8, 10, 11, 12)}


def scenes_of(p: Problem) -> Scene:
    """One scene for each stiffness ratio."""
    drive = Drive(p.omega, p.beta, p.F_0, p.M_0, p.phase)
    blades = Blades(p.m, p.I, p.k_x, p.k_y, p.k_T, p.c_x, p.c_y, p.c_T)
    shroud, friction = Shroud(p.alpha, p.l_oa, p.l_ab, p.gap), Friction(p.k_d, p.mu)
    make = lambda gamma: Scene(blades, shroud, Contact(None, gamma), friction, drive)
    return jax.vmap(make)(jnp.asarray(p.gamma))


def motions(lanes: Lane) -> np.ndarray:
    """(lanes, 12) in the order of the peers."""
    return np.concatenate([np.stack(pair, axis=-1) for pair in lanes.state.motion], axis=-1).astype(float)


def prepare_series(p: Problem) -> Callable[[float], np.ndarray]:
    """A function of a tolerance of `SERIES` that gives the final motions by power series."""
    runs = {at: prepare(p, series(order, at)) for at, order in SERIES.items()}
    return lambda tolerance: runs[tolerance](series_steps(tolerance))


def series_steps(tolerance: float) -> int:
    """Flat contact that begins sooner errs by the cube of a step, about."""
    least, most = SERIES_STEPS
    return int(np.clip(least * np.cbrt(1e-6 / tolerance), least, most))


def series(order: int, tolerance: float) -> Choices:
    """The march by power series."""
    return Choices(TaylorOptions(order, tolerance), "series", False)


def trials(p: Problem, method: Choices, steps: int) -> tuple[float, float]:
    """Trials and events of a lane in a period, on average."""
    scenes = scenes_of(p)
    clock = Clock.of_steps(steps)
    model, periods = lane_models(scenes)
    fixed = Fixed(model, clock.grids(periods), jnp.full(len(p.gamma), steps, jnp.int32))
    on_its_way = lambda lanes: running(lanes, fixed.stop)

    def one(pair):
        lanes, made = pair
        return stepper_for(method).trial(lanes, fixed, method, best_mapping()), made + on_its_way(lanes)

    @partial(jax.jit, compiler_options=FOR_SERIES)
    def period(lanes, made):
        lanes, made = lax.while_loop(lambda pair: jnp.any(on_its_way(pair[0])), one, (lanes, made))
        return eqx.tree_at(lambda lanes: lanes.step, lanes, jnp.zeros_like(lanes.step)), made

    lanes, made = begin_lanes(scenes, initial_states(scenes), method), jnp.zeros(len(p.gamma), jnp.int32)
    for _ in range(PERIODS):
        lanes, made = period(lanes, made)
    counters = vars(at_only_interface(lanes.accumulator.log.counters))
    events = sum(np.sum(np.asarray(a)) for name, a in counters.items() if name != "grazing")
    return float(np.mean(made)) / PERIODS, float(events) / len(p.gamma) / PERIODS


def prepare(
    p: Problem, method: Choices, chunk: int = LANES_PER_CALL, periods: int = PERIODS
) -> Callable[[int], np.ndarray]:
    """A function of the steps per period that gives the final motions."""
    return prepare_scenes(scenes_of(p), method, chunk, periods)


def prepare_scenes(scenes: Scene, method: Choices, chunk: int, periods: int) -> Callable[[int], np.ndarray]:
    """The same for scenes (leading axis)."""
    scenes = in_precision(scenes, method.precision)
    pieces = [jax.tree.map(lambda a, i=i: a[i : i + chunk], scenes) for i in range(0, len(scenes.drive.omega), chunk)]
    begun = [begin_lanes(piece, initial_states(piece), method) for piece in pieces]

    def march(steps: int) -> np.ndarray:
        clock = Clock.of_steps(steps)
        limits = one_call(periods)
        ends = [
            run_block(s, at_start_of_period(a), clock, limits, method, periods, best_mapping())[0]
            for s, a in zip(pieces, begun, strict=True)
        ]
        return np.concatenate([motions(end.lanes) for end in ends])

    return march
