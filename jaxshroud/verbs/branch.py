"""Branches of periodic orbits over one number of a scene, stable or not."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.lanes import in_scene_precision, initial_states
from jaxshroud.batch.plan import Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.batch.xla import one_lane
from jaxshroud.io.lane_status import AccuracyWarning
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.march.method import FOR_P_D
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import StagedProgress, run_alone
from jaxshroud.orbits.branch import BranchPoint, ContinuationProblem, continuation_problem, first_point
from jaxshroud.orbits.branch_continuation import ContinuedBranch, branches_from, with_errors
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import ShootingOptions, closed_orbit, settled_orbit
from jaxshroud.orbits.travelling_wave import whole_parts
from jaxshroud.results.branch import Branch
from jaxshroud.scene.checks import InputError, NumericalError, count_argument
from jaxshroud.scene.drive_orders import check_continuous
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.scene.vary import value_of, with_numbers
from jaxshroud.verbs.arguments import MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.lanes import check_known_period, check_row, one_scene


@typed
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
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Branch:
    """Follow the periodic orbit that a scene settles on along one of its numbers, past folds, stable or not.

    The orbit is found at the scene's own value of the number and followed both ways by pseudo-arclength continuation
    of the map over whole drive periods. Where a multiplier crosses the unit circle, the orbit is solved for together
    with that condition; from flips the orbits of twice the period are followed too. Travelling waves of a ring
    of alike blades are judged by the map over a part of the period and the shift back, and where their shift breaks
    ("localisation") the branch that begins is followed too.

    Args:
        scene: One scene, or a scene file, whose [run] and [sweep] count where an argument is not given.
        along: The number, as for `vary`.
        start: One end of its range, in SI units.
        stop: The other end.
        at: The value at which the first orbit is found; by default the scene's own.
        q: The period number, if it is known. Newton's method then starts from the given state, without a run, and
            closes the orbit whether or not it is stable.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart. Needed with `q`: a state close to
            the orbit.
        most_points: Largest number of points of a branch in one direction.
        doublings: How many times in succession orbits of twice the period are followed from flips, and broken ones
            from localisation.
        most_periods: Drive periods after which the search ends if the motion has not repeated.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`. Steps in a ring of alike
            blades are rounded up to a multiple of the parts into which a travelling wave divides the period.
        progress: Called with (drive periods done, drive periods in all), as far as it is known what is to be done; the
            latter is 0 while it is not.

    Returns:
        The branches, point by point, including their special points; each point is closed to 1e-9 (float64). This
        closing error is not the error of the march: where a multiplier crosses the unit circle, `special` says how far
        a march with half the step, a tenth of the tolerance and a quarter of `flat_return` shifts that point, with a
        warning where it is much.

    Raises:
        InputError: The range is empty or does not hold the value, there are many scenes, or `q` is given without a
            state.
        NumericalError: The scene settles on no periodic orbit there; give another value, or a state with its `q`.
        Interrupted: Ctrl-C.

    Source:
        Keller's pseudo-arclength continuation of fixed points of the stroboscopic map. A slider that stays wherever it
        starts (permanent stick) is kept fixed: its multiplier of 1 is not a fold.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.branch(scene, "contact.gamma", 2.0, 3.0, method=js.RungeKutta(steps=100))
        >>> bool(found.stable.all()), bool(found.residual.max() < 1e-9)
        (True, True)
    """
    for name, count, least in (("most_points", most_points, 2), ("doublings", doublings, 0)):
        count_argument(name, count, least)
    low, high = range_of(scene, along, start, stop)
    begin = BranchStart(at, q, state, most_periods)
    found = continued(scene, along, (low, high), begin, most_points, doublings, method, progress)
    result = Branch.of_branches(found.branches, along, (low, high), found.attributes)
    if result.doubts:
        warnings.warn("; ".join(result.doubts), AccuracyWarning, stacklevel=3)
    return result


class BranchStart(NamedTuple):
    """Where the first orbit of a branch is sought; see `branch`."""

    at: float | None = None
    q: int | None = None
    state: State | None = None
    most_periods: int = 1024


class FoundBranches(NamedTuple):
    """The branches of a scene with the problem that they solve, and the attributes of their result."""

    problem: ContinuationProblem
    branches: list[ContinuedBranch]
    attributes: dict[str, object]


def continued(
    scene: Scene | SceneFile,
    along: str,
    ends: tuple[float, float],
    begin: BranchStart,
    most_points: int,
    doublings: int,
    method: MethodArgument,
    progress: Progress | None,
) -> FoundBranches:
    """The branches of a scene; the arguments and the errors are those of `branch`."""
    at, q, state, most_periods = begin
    check_known_period(q, state)
    low, high = ends
    numbered = with_numbers(one_scene("branch", scene), [along])
    value = value_of(numbered, along) if at is None else float(at)
    if not low <= value <= high:
        raise InputError(f"{along} = {value:g} is outside of its range, {low:g} to {high:g}; say where with `at`.")
    resolved = resolve_options(scene, method=method)
    check_row(numbered)
    march = plan_march(
        resolved, scenes_at(numbered, [along], np.array([[low], [value], [high]])), FOR_P_D, tangents=True
    )
    march = march._replace(steps=whole_parts(march.steps, numbered))
    shooting = march.shooting
    here = jax_lane_arrays(scenes_at(numbered, [along], np.array([[value]])), (0,))
    try:
        initial = _initial_orbit(in_precision(here, march.method.precision), state, q, most_periods, shooting)
        problem, first = _first_point(initial, along, low, high, value, shooting)
        stages = StagedProgress(progress)
        branches = branches_from(problem, first, most_points, doublings, stages)
        finer = ShootingOptions(2 * march.steps, shooting.tolerance, march.method.finer())
        branches = with_errors(branches, problem._replace(aim=finer), stages)
    except Interrupted:
        raise Interrupted(None) from None
    provenance, _ = resolved.provenance(march.steps)
    return FoundBranches(problem, branches, {**provenance, **march.attributes})


def range_of(scene: Scene | SceneFile, along: str, start: float | None, stop: float | None) -> tuple[float, float]:
    """The ends of the number's range: those given, else those of the file's [sweep].

    Raises:
        InputError: The number is one of the initial motion, an end is missing, or the range is empty.
    """
    if along.startswith("initial."):
        advice = "follow a number of the scene, or vary starts by `sweep` and `basins`"
        raise InputError(f"{along} is where a run starts, and an orbit does not depend on it: {advice}.")
    check_continuous(along, scene.scene if isinstance(scene, SceneFile) else scene)
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


def _initial_orbit(
    scene: Scene, state: State | None, q: int | None, most_periods: int, shooting: ShootingOptions
) -> PeriodicOrbit:
    """The orbit at which the branch begins.

    Raises:
        NumericalError: There is none.
    """
    if state is None:
        state = jax_lane_arrays(initial_states(one_lane(scene)), (0,))
    start = in_scene_precision(state, scene)
    algorithm = (
        settled_orbit(scene, start, most_periods, shooting) if q is None else closed_orbit(scene, start, q, shooting)
    )
    orbit = run_alone(algorithm)
    if not orbit.found or "not converged" in orbit.flags:
        raise NumericalError(f"no periodic orbit to begin with ({', '.join(orbit.flags)}): give another value `at`")
    return orbit


def _first_point(
    orbit: PeriodicOrbit, along: str, low: float, high: float, value: float, shooting: ShootingOptions
) -> tuple[ContinuationProblem, BranchPoint]:
    """The continuation problem along the number, and the first point of the branch.

    Raises:
        NumericalError: The orbit does not close there.
    """
    problem = run_alone(continuation_problem(orbit, along, low, high, shooting))
    first = run_alone(first_point(problem, orbit.start, value, orbit.q))
    if first is None:
        raise NumericalError(f"the orbit at {along} = {value:g} does not close to 1e-9: give another value `at`")
    return problem, first
