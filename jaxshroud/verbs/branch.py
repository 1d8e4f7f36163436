"""Branches of periodic orbits over one number of a scene, stable or not."""

from collections.abc import Sequence

import numpy as np

from jaxshroud.batch.runs import Progress, starts
from jaxshroud.batch.threads import Interrupted
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.state import State
from jaxshroud.motion.branch import Line, Point, first_point, line_through
from jaxshroud.motion.branches import branches_from
from jaxshroud.motion.gradient import with_numbers
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.shooting import TOLERANCE, Aim, closed_orbit, settled_orbit
from jaxshroud.motion.together import alone_found
from jaxshroud.results.branch import Branch
from jaxshroud.results.gathered import picked
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError, NumericalError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of
from jaxshroud.verbs.door import asked
from jaxshroud.verbs.lanes import one_scene, with_tangents


def branch(
    scene: Scene | SceneFile,
    along: str,
    start: float | None = None,
    stop: float | None = None,
    *,
    at: float | None = None,
    q: int | None = None,
    state: State | None = None,
    most_points: int = 400,
    doublings: int = 1,
    most_periods: int = 1024,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    progress: Progress | None = None,
) -> Branch:
    """Follow the periodic orbit that a scene settles on along one of its numbers, past folds, stable or not.

    The orbit is sought at the scene's own value of the number and followed both ways by pseudo-arclength continuation
    on the map of whole drive periods. Where a multiplier passes the unit circle, the orbit is solved for together with
    that condition; from flips the orbits of twice the period are followed too.

    Args:
        scene: One scene, or a scene file, whose [run] and [sweep] count where an argument is not given.
        along: The number, as for `vary`.
        start: Where its range begins, in SI units.
        stop: Where it ends.
        at: The value at which the orbit is sought; by default the scene's own.
        q: The period number where it is known. The given state is then closed at once, stable or not.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        most_points: Points of a branch in one direction at most.
        doublings: How often orbits of twice the period are followed from flips.
        most_periods: Give up when the motion has not repeated by then.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest value needs.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number.
        progress: Called with (drive periods done, at most).

    Returns:
        The branches, point by point, with special points among them; each point is closed to 1e-9 (float64).

    Raises:
        InputError: The range is empty or does not hold the value, or there are many scenes.
        NumericalError: The scene settles on no periodic orbit there; give another value, or a state with its `q`.
        Interrupted: Ctrl-C.

    Source:
        Keller's pseudo-arclength continuation of fixed points of the stroboscopic map. A slider that stays wherever it
        starts (permanent stick) is held in its place: its multiplier of 1 is no fold.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.branch(scene, "contact.gamma", 2.0, 3.0, steps_per_period=100)
        >>> bool(found.stable.all()), bool(found.residual.max() < 1e-9)
        (True, True)
    """
    for name, count, least in (("most_points", most_points, 2), ("doublings", doublings, 0)):
        count_argument(name, count, least)
    if q is not None and state is None:
        raise InputError("Argument `q` needs a `state` close to the orbit.")
    low, high = _range(scene, along, start, stop)
    one = with_numbers(one_scene("branch", scene), [along])
    value = value_of(one, along) if at is None else float(at)
    if not low <= value <= high:
        raise InputError(f"{along} = {value:g} is outside of its range, {low:g} to {high:g}; say where with `at`.")
    request = asked(scene, steps_per_period=steps_per_period, method=method, accuracy=accuracy)
    how = with_tangents(request, scenes_at(one, [along], np.array([[low], [value], [high]])))
    aim = Aim(how.steps, TOLERANCE[how.method.precision], how.method)
    here = in_precision(picked(scenes_at(one, [along], np.array([[value]])), (0,)), how.method.precision)
    try:
        found = _sought(here, state, q, most_periods, aim)
        line, first = _first(found, along, low, high, value, aim)
        followed = branches_from(line, first, most_points, doublings, progress)
    except Interrupted:
        raise Interrupted(None) from None
    attrs, _ = request.about(request.transient, how.steps)
    return Branch.of_branches(followed, along, (low, high), {**attrs, **how.told})


def _range(scene: Scene | SceneFile, along: str, start: float | None, stop: float | None) -> tuple[float, float]:
    """The ends of the number's range: those given, else those of the file's own sweep."""
    own: Sequence[float] = ()
    if isinstance(scene, SceneFile):
        own = next((np.asarray(axis.values).tolist() for axis in scene.axes if axis.key == along), ())
    ends = [end if end is not None else pick(own) if own else None for end, pick in ((start, min), (stop, max))]
    if None in ends:
        raise InputError(f"The range of {along} is not known: give `start` and `stop`.")
    low, high = sorted(float(end) for end in ends if end is not None)
    if not low < high:
        raise InputError(f"The range of {along} is empty: `start` and `stop` are {low:g}.")
    return low, high


def _sought(scene: Scene, state: State | None, q: int | None, most_periods: int, aim: Aim) -> Cycle:
    """The orbit to begin with."""
    begin = picked(starts(alone(scene)), (0,)) if state is None else state
    looked_for = settled_orbit(scene, begin, most_periods, aim) if q is None else closed_orbit(scene, begin, q, aim)
    found = alone_found(looked_for)
    if not found.found or "not converged" in found.flags:
        raise NumericalError(f"no periodic orbit to begin with ({', '.join(found.flags)}): give another value `at`")
    return found


def _first(found: Cycle, along: str, low: float, high: float, value: float, aim: Aim) -> tuple[Line, Point]:
    line = alone_found(line_through(found, along, low, high, aim))
    first = alone_found(first_point(line, found.start, value, found.q))
    if first is None:
        raise NumericalError(f"the orbit at {along} = {value:g} does not close to 1e-9: give another value `at`")
    return line, first
