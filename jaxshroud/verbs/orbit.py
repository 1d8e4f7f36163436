"""The periodic orbit that a scene settles on, and the Lyapunov exponents of its motion."""

from collections.abc import Sequence

import jax
import numpy as np

from jaxshroud.batch.plan import Plan, Progress
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import FAST, FOR_P_D
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import run_together
from jaxshroud.orbits.lyapunov import MAX_ALIGNMENT_PERIODS, Exponents, lyapunov_exponents, state_places
from jaxshroud.orbits.orbit import PeriodicOrbit, no_orbit
from jaxshroud.orbits.shooting import ShootingOptions, closed_orbit, settled_orbit
from jaxshroud.orbits.travelling_wave import TravellingWave, travelling_wave
from jaxshroud.results.diagnosis import Lyapunov
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.checks import count_argument, positive_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.signals.amplitudes import amplitude_values
from jaxshroud.verbs.arguments import MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.lanes import check_known_period, check_row, results_of_all, warn_failed


@typed
def orbit(
    scene: Scene | SceneFile,
    *,
    q: int | None = None,
    most_periods: int = 1024,
    tolerance: float | None = None,
    amplitudes: bool = False,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Orbit:
    """The periodic orbit that a scene settles on.

    The scene is run until its samples nearly repeat; then Newton's method closes the orbit. If that orbit is not
    stable, the motion was only passing by it, and the run continues.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        q: The period number, if it is known. Newton's method then starts from the given state, without a run, and
            closes the orbit whether or not it is stable: an orbit can so be followed from scene to scene.
        most_periods: Drive periods after which the search ends if the motion has not repeated.
        tolerance: Closing error at which Newton's method ends, relative to the largest value of each quantity; by
            default 1e-11 in float64 and 1e-7 in float32.
        amplitudes: March each orbit once more, for the amplitudes of x, y and theta.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0: one state for all lanes, or one for each; by default `scene.initial`,
            apart. Needed with `q`: a state close to the orbit.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops or cannot be solved, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The orbit or orbits; see their `flags` before using them. That of a row of blades has the
        multipliers of the reduced map of travelling waves too where a ring has alike blades. A lane that stops or
        cannot be solved has NaN and a flag; the others are not affected.

    Raises:
        ValueError: A count is too small, the tolerance is not positive, `q` is given without a state, or JAX has no
            float64.
        NumericalError: With `throw`: a lane stopped.
        LinAlgError: With `throw`, or for a single scene: the equations of the orbit cannot be solved.
        Interrupted: Ctrl-C; its `done` has the lanes that had ended, None where none had.

    Source:
        A fixed point of the map of q drive periods on motion and slider, by Newton's method with the map's Jacobian.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.orbit(scene, method=js.RungeKutta(steps=100))
        >>> found.q, found.flags, bool(abs(found.multipliers[0]) < 1)
        (1, (), True)
    """
    count_argument("most_periods", most_periods, 1)
    if tolerance is not None:
        positive_argument("tolerance", tolerance)
    check_known_period(q, state)
    resolved = resolve_options(scene, method=method, dims=dims, verb="orbit")
    check_row(resolved.scene)
    march = plan_march(resolved, resolved.lanes, FOR_P_D, tangents=True)
    shooting = march.shooting if tolerance is None else march.shooting._replace(tolerance=tolerance)

    def result_of(cycles, kept=None):
        return Orbit.of_cycles(cycles, resolved.shape, kept, **resolved.labels(march))

    try:
        starts = resolved.with_states(resolved.scenes, state, march)
        cycles = cycles_of(starts, q, most_periods, shooting, progress, throw or not resolved.shape)
        more = orbit_amplitudes(cycles) if amplitudes else {}
        orbits = result_of(cycles, more | _wave_values(cycles) if resolved.scene.layout.closed else more)
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result_of(stopped.done)) from None
    return warn_failed(orbits, throw)


def _wave_values(cycles: Sequence[PeriodicOrbit]) -> dict[str, np.ndarray]:
    """What an `Orbit` of a ring says of travelling waves, (lanes, ...) each."""
    waves = run_together([travelling_wave(cycle) for cycle in cycles])
    found = [wave if isinstance(wave, TravellingWave) else None for wave in waves]
    none = np.full(len(cycles[0].multipliers), np.nan + 0j)
    return {
        "wave_parts": np.array([0 if wave is None else wave.symmetry.parts for wave in found]),
        "wave_residual": np.array([np.nan if wave is None else wave.residual for wave in found]),
        "wave_multipliers": np.array([none if wave is None else wave.multipliers for wave in found]),
    }


def orbit_amplitudes(cycles: Sequence[PeriodicOrbit]) -> dict[str, np.ndarray]:
    """The values of `WithAmplitudes` of orbits, (lanes, blades) each; NaN where there is none."""
    scenes, states = jax.tree.map(lambda *a: np.stack(a), *((cycle.scene, cycle.start) for cycle in cycles))
    numbers = np.array([cycle.q for cycle in cycles])
    first = cycles[0]
    method = first.method._replace(amplitudes=True, vibration=False)
    plan = Plan(0, max(int(numbers.max()), 1), first.steps_per_period, 0.0, method)
    runs = run_lanes(scenes, states, plan, lambda _: None)
    values = amplitude_values(scenes, runs.samples, numbers)
    return {name: np.where(numbers[:, None] > 0, a, np.nan) for name, a in values.items()}


def cycles_of(
    lanes: Sequence[tuple[Scene, State]],
    q: int | None,
    max_periods: int,
    shooting: ShootingOptions,
    progress: Progress | None,
    throw: bool,
) -> list[PeriodicOrbit]:
    """The orbit of each lane, from its scene and initial state; flagged where it could not be solved."""
    algorithms = [
        settled_orbit(*lane, max_periods, shooting) if q is None else closed_orbit(*lane, q, shooting) for lane in lanes
    ]

    def missing(lane: int, flag: str) -> PeriodicOrbit:
        status = Status.NOT_RUN if flag == "not run" else Status.OK
        return no_orbit(*lanes[lane], flag, 0, shooting.steps, shooting.method, status)

    return results_of_all(lambda: run_together(algorithms, progress, max_periods), missing, throw)


@typed
def lyapunov(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Lyapunov:
    """The Lyapunov exponents of the motion that a scene settles on.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        n_periods: Drive periods kept; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0: one state for all lanes, or one for each; by default `scene.initial`,
            apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops before its end, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        As many exponents as the scene has states: two of each coordinate in which a blade moves, and one of the slider
        at each interface. That of a slider which the motion sets anew in some period, by an onset or by slip, is -inf;
        that of a slider which sticks for good is 0. NaN, "not resolved": in some period less than 1e-12 of the largest
        growth is left, which rounding hides. They come from QR factors of the product of the Jacobians of the periods.
        After the transient the tangents start in random directions; the average begins when two frames of them grow
        alike, or 64 periods later (where directions grow equally fast, no order emerges). They do not start earlier:
        along a motion that still changes they may take an order other than that of the settled motion, and keep it for
        long. The interval is from batch means.

    Raises:
        ValueError: A count is too small, or JAX has no float64.
        NumericalError: With `throw`: a lane stopped.
        Interrupted: Ctrl-C; its `done` has the lanes that had ended, None where none had.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.lyapunov(scene, n_periods=8, transient=8, method=js.RungeKutta(steps=100))
        >>> bool(found.exponents[0] < 0)
        True
    """
    resolved = resolve_options(
        scene,
        n_periods=n_periods,
        transient=transient,
        method=method,
        dims=dims,
        verb="lyapunov",
    )
    check_row(resolved.scene)
    march = plan_march(resolved, resolved.lanes, FAST, tangents=True)
    kept, scenes = resolved.n_periods, resolved.scenes
    starts = resolved.with_states(scenes, state, march)
    algorithms = [lyapunov_exponents(*lane, kept, resolved.transient, march.steps, march.method) for lane in starts]

    def missing(lane: int, flag: str) -> Exponents:
        status = Status.NOT_RUN if flag == "not run" else Status.NOT_FINITE
        nan = np.full(len(state_places(scenes[lane]).all), np.nan)
        return Exponents(nan, nan, np.empty((0, len(nan))), False, status, starts[lane][1])

    def result_of(exponents):
        return Lyapunov.of_exponents(exponents, resolved.shape, scenes, **resolved.labels(march))

    max_periods = resolved.transient + MAX_ALIGNMENT_PERIODS + kept
    try:
        exponents = results_of_all(
            lambda: run_together(algorithms, progress, max_periods), missing, throw or not resolved.shape
        )
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result_of(stopped.done)) from None
    return warn_failed(result_of(exponents), throw)
