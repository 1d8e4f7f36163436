"""The periodic orbit that a scene settles on, or those of many scenes."""

from collections.abc import Sequence

from jaxshroud.batch.runs import Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.orbit import Cycle, none_found
from jaxshroud.motion.shooting import TOLERANCE, Aim, closed_orbit, settled_orbit
from jaxshroud.motion.together import together
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.checks import count_argument, positive_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.lanes import lanes_of, of_all, told


def orbit(
    scene: Scene | SceneFile,
    *,
    q: int | None = None,
    most_periods: int = 1024,
    tolerance: float | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Orbit:
    """The periodic orbit that a scene settles on.

    The scene is run until its samples nearly repeat; then Newton's method closes the orbit. If what it finds is not
    stable, the motion was only passing by, and the run goes on.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        q: The period number where it is known. The given state is then closed at once, without a run, whether or not
            the orbit is stable: so an orbit can be followed from scene to scene.
        most_periods: Give up when the motion has not repeated by then.
        tolerance: Closing error at which Newton's method ends, relative to the largest value of each quantity; by
            default 1e-11 in float64 and 1e-7 in float32.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, in float64.
        state: Where to start, at drive phase 0, one for all lanes or each its own; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops or cannot be solved, rather than flag it.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The orbit or orbits. See their `flags` before using them. A lane that stops or cannot be solved has NaN and a
        flag, and the others are not affected.

    Raises:
        ValueError: A count is too small, the tolerance is not positive, `q` is given without a state, or float64 is
            not to be had.
        NumericalError: With `throw`: a lane stopped.
        LinAlgError: With `throw`, or of a single scene: equations cannot be solved.
        Interrupted: Ctrl-C; its `done` has the lanes that had ended, None where none had.

    Source:
        A fixed point of the map of q drive periods on motion and slider, by Newton's method with the map's Jacobian.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.orbit(scene, steps_per_period=100)
        >>> found.q, found.flags, bool(abs(found.multipliers[0]) < 1)
        (1, (), True)
    """
    count_argument("most_periods", most_periods, 1)
    if tolerance is not None:
        positive_argument("tolerance", tolerance)
    if q is not None:
        count_argument("q", q, 1)
        if state is None:
            raise InputError("Argument `q` needs a `state` close to the orbit.")
    lanes = lanes_of(scene, steps_per_period=steps_per_period, method=method, accuracy=accuracy, dims=dims)
    march = lanes.how
    tolerance = TOLERANCE[march.method.precision] if tolerance is None else tolerance
    aim = Aim(march.steps, tolerance, march.method)
    result = lambda cycles: Orbit.of_cycles(cycles, lanes.shape, **lanes.about)  # noqa: E731
    try:
        begun = lanes.begun(lanes.scenes, state)
        found = result(cycles_of(begun, q, most_periods, aim, progress, throw or not lanes.shape))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result(stopped.done)) from None
    return told(found, throw)


def cycles_of(
    begun: Sequence[tuple[Scene, State]], q: int | None, most: int, aim: Aim, progress: Progress | None, throw: bool
) -> list[Cycle]:
    """The orbit of each scene from its state; flagged where it could not be solved."""
    looked_for = [settled_orbit(*lane, most, aim) if q is None else closed_orbit(*lane, q, aim) for lane in begun]

    def missing(lane: int, flag: str) -> Cycle:
        status = Status.NOT_RUN if flag == "not run" else Status.OK
        return none_found(*begun[lane], flag, 0, aim.steps, aim.method, status)

    return of_all(lambda: together(looked_for, progress, most), missing, throw)
