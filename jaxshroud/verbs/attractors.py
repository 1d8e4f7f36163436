"""The motions that coexist in one scene, from random starts, and their basins in a plane of starts."""

from collections.abc import Mapping, Sequence

import jax
import numpy as np

from jaxshroud.batch.lanes import final_states, initial_states, shroud_motion
from jaxshroud.batch.plan import Progress, Ticker
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.threads import Interrupted
from jaxshroud.batch.xla import one_lane, repeat_lane
from jaxshroud.io.scene_numbers import dimension, key_attrs
from jaxshroud.march.method import FOR_P_D, method_of
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.attractors import FoundAttractors, attractors_of
from jaxshroud.orbits.shooting import ShootingOptions
from jaxshroud.orbits.starts import START_SPREAD, random_starts, start_range
from jaxshroud.results.attractors import (
    ATTRACTOR_KINDS,
    STOPPED,
    UNDECIDED,
    Attractors,
    Basins,
    attractor_values,
    share_interval,
)
from jaxshroud.results.sweep import SweepResult, swept_motions
from jaxshroud.scene.checks import InputError, count_argument, positive_argument, seed_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.keys import key_parts
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.orbit_distance import SweptMotion, number_motions, set_distance
from jaxshroud.verbs.arguments import MarchPlan, MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.lanes import one_scene
from jaxshroud.verbs.simulate import simulate
from jaxshroud.verbs.sweep import sweep

DRAWN_STEPS = 300  # least steps per period of curves that are drawn


@typed
def attractors(
    scene: Scene | SceneFile,
    starts: int = 256,
    *,
    spread: float = START_SPREAD,
    seed: int = 0,
    most_periods: int = 1024,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Attractors:
    """The motions that a scene can settle on, from random starts, and the share of starts that lead to each.

    Starts are apart, at drive phase 0. Each displacement is uniform within `spread` times its amplitude without contact
    plus the gap (for angles: the rotation that moves a corner by the gap), each rate within omega times that. Starts
    with overlapping blocks are drawn again. Rows start with random rates alone, as the gaps of a ring add up to what
    they are.

    Args:
        scene: One scene, or a scene file.
        starts: The number of starts.
        spread: Of the starts, relative to the amplitudes without contact plus the gap.
        seed: Seed of the starts.
        most_periods: Drive periods after which a motion that has not settled on an orbit is treated as aperiodic.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (lane-periods done, lane-periods at most).

    Returns:
        The attractors, in the order of their period, then of P_d from the largest; aperiodic ones are last. Periodic
        ones are closed by Newton's method and told apart by the distance between their orbits; orbits that differ only
        in the position of a slider that never slips are one family. In a ring the copies of a motion that begin at
        another blade are motions of their own. Aperiodic motions are told apart by the sets that they fill in 512
        periods, and count if a longer run is judged chaotic or quasi-periodic, as by `diagnose`. A start that leads to
        none of these, such as one whose transient is not over, is undecided.

    Raises:
        InputError: A count is too small, or there are many scenes.
        Interrupted: Ctrl-C.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.attractors(scene, 8, method=js.RungeKutta(steps=100))
        >>> found.period_number.tolist(), found.share.tolist()
        ([1], [1.0])
    """
    seed_argument(seed)
    count_argument("starts", starts, 1)
    positive_argument("spread", spread)
    single, shooting, attributes = _single_scene("attractors", scene, most_periods, method)
    states = random_starts(single, starts, seed, spread)
    found = _attractors_from(single, states, most_periods, shooting, progress)
    values = attractor_values(found, _drawn_paths(found, single, shooting))
    values |= {"initial": shroud_motion(states.motion, single), "spread": spread, "seed": seed}
    return Attractors.of_values(values, ("start",), attributes, single.layout)


def _single_scene(
    verb: str,
    scene: Scene | SceneFile,
    most_periods: int,
    method: MethodArgument,
) -> tuple[Scene, ShootingOptions, dict[str, int | str]]:
    """The single scene in the precision of its march, the options of Newton's method, and the attributes of results."""
    count_argument("most_periods", most_periods, 64)
    single = one_scene(verb, scene)
    resolved = resolve_options(scene, method=method)
    march = plan_march(resolved, one_lane(single), FOR_P_D, tangents=True)
    provenance, _ = resolved.provenance(march.steps)
    return in_precision(single, march.method.precision), march.shooting, {**provenance, **march.attributes}


def _attractors_from(
    scene: Scene, states: State, max_periods: int, shooting: ShootingOptions, progress: Progress | None
) -> FoundAttractors:
    """The attractors that a scene reaches from states (leading axis)."""
    states = jax.tree.map(np.asarray, states)
    try:
        return attractors_of(scene, states, max_periods, shooting, Ticker(len(states.u_s) * max_periods, progress))
    except Interrupted:
        raise Interrupted(None) from None


def _drawn_paths(found: FoundAttractors, scene: Scene, shooting: ShootingOptions) -> list[np.ndarray]:
    """The first blade's x and v_x along each attractor, (n, 2): one orbit, or eight periods of an aperiodic one."""
    curves = []
    steps = shooting.steps * -(-DRAWN_STEPS // shooting.steps)
    for attractor in found.attractors:
        run = simulate(scene, attractor.state, n_periods=attractor.q or 8, method=method_of(steps, shooting.method))
        curves.append(np.stack([run.motion.x[:, 0], run.motion.v_x[:, 0]], axis=-1))
    return curves


@typed
def basins(
    scene: Scene | SceneFile,
    plane: Sequence[str] = ("x[0]", "v_x[0]"),
    *,
    ranges: Sequence[tuple[float, float] | None] | None = None,
    num: int = 100,
    most_periods: int = 512,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Basins:
    """The basins of attraction in a plane: the coexisting motion that each start in it leads to.

    Args:
        scene: One scene, or a scene file; its initial motion gives all numbers of the starts but the two of the plane.
        plane: Two numbers of the initial motion, such as "x[0]" and "v_x[0]".
        ranges: The range of each, in SI units; None: the range from which `attractors` draws its starts.
        num: The number of values of each.
        most_periods: Drive periods after which a motion that has not settled on an orbit is treated as aperiodic.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (lane-periods done, lane-periods at most).

    Returns:
        The attractors, as from `attractors`, and that of each start. In a start with overlapping blocks contact begins
        at once.

    Raises:
        InputError: The plane is not of two numbers of the initial motion, or a count is too small.
        Interrupted: Ctrl-C.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.basins(scene, num=3, method=js.RungeKutta(steps=100)).label.shape
        (3, 3)
    """
    count_argument("num", num, 2)
    keys = [f"initial.{name.removeprefix('initial.')}" for name in plane]
    if len(set(keys)) != 2:
        raise InputError(f"Argument `plane` must name two numbers of the initial motion, but is {', '.join(plane)}.")
    for key in keys:
        _check_moves(key, one_scene("basins", scene))
    single, shooting, attributes = _single_scene("basins", scene, most_periods, method)
    given_ranges = (None, None) if ranges is None else ranges
    if len(given_ranges) != 2:
        raise InputError(f"Argument `ranges` must give two ranges, each None or a pair, but gives {len(given_ranges)}.")
    names = single.layout.names
    axes = {key: _plane_values(single, key, ends, num) for key, ends in zip(keys, given_ranges, strict=True)}
    grid = grid_of_scenes(single, axes)
    states = initial_states(jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), grid))
    found = _attractors_from(single, states, most_periods, shooting, progress)
    values = attractor_values(found, _drawn_paths(found, single, shooting))
    values |= {name: np.asarray(values[name]).reshape(num, num) for name in ("label", "status")}
    dims = {key: dimension(key, names) for key in axes}
    lines = {dims[key]: (dims[key], line, key_attrs(key, names)) for key, line in axes.items()}
    return Basins.of_values(values, tuple(dims.values()), attributes, single.layout, lines)


def _check_moves(key: str, scene: Scene) -> None:
    """Raise InputError unless the model has the number of the initial motion."""
    _, name, blade = key_parts(key, scene.layout)
    displacement = name.removeprefix("v_")
    sides = range(scene.layout.blades) if blade is None else (blade,)
    if not any(scene.parts.has(displacement, side) for side in sides):
        of_blade = "" if displacement not in scene.parts.motion else f" of blade {blade}"
        moves = ", ".join(scene.parts.motion)
        raise InputError(f"Argument `plane`: there is no {displacement}{of_blade} in this model, which has {moves}.")


def _plane_values(scene: Scene, key: str, ends: tuple[float, float] | None, num: int) -> np.ndarray:
    """The values of one number of the initial motion."""
    _, name, blade = key_parts(key, scene.layout)
    default_range = start_range(scene)
    reach = getattr(default_range, name)
    largest = START_SPREAD * float(np.max(reach) if blade is None else reach[blade])
    low, high = (-largest, largest) if ends is None else sorted(map(float, ends))
    if not low < high:
        raise InputError(f"The range of {key} is empty: {low:g} to {high:g}.")
    return np.linspace(low, high, num)


def row_motions(scene: Scene, starts: int, seed: int, march: MarchPlan, transient: int, n_periods: int) -> Attractors:
    """The motions on which a row settles from random starts, and the share of starts that lead to each.

    Starts are at rest, with random rates. A start that has not settled after the transient is undecided.

    Args:
        scene: A row of blades.
        starts: The number of starts.
        seed: Of the starts.
        march: How to march.
        transient: Drive periods run first, at least one.
        n_periods: Drive periods over which motions are compared and averaged.
    """
    lanes = in_precision(without_given(repeat_lane(scene, starts)), march.method.precision)
    states = random_starts(jax.tree.map(lambda a: a[0], lanes), starts, seed, START_SPREAD)
    before = march.plan(max(transient - 1, 0), 1)
    last = run_lanes(lanes, states, before, lambda _: None).last
    status = np.asarray(last.status)
    running = np.flatnonzero(status == Status.OK)
    label = np.where(status == Status.OK, UNDECIDED, STOPPED)
    attrs = march.attributes
    of_starts = {"label": label, "status": status, "spread": START_SPREAD, "seed": seed}
    if not running.size:
        return _found(of_starts | dict.fromkeys(("share", "P_d_least"), np.empty(0)), scene, attrs)
    arrived: State = jax.tree.map(lambda a: np.asarray(a)[running], final_states(last.state))
    settled = repeat_lane(scene, len(running))
    how = {"n_periods": n_periods, "transient": 0, "method": march.again}
    run = sweep(settled, state=arrived, forces=True, amplitudes=True, **how)
    motions = swept_motions(run.data)
    numbers = _most_frequent_first(np.where(run.status == Status.OK, number_motions(motions), UNDECIDED))
    label[running] = np.where(run.status == Status.OK, numbers, STOPPED)
    return _found(of_starts | {"label": label} | _motion_values(run, motions, numbers, starts), scene, attrs)


def _found(values: Mapping[str, object], scene: Scene, attrs: dict[str, int | str]) -> Attractors:
    return Attractors.of_values(values, ("start",), attrs, scene.layout)


def _most_frequent_first(numbers: np.ndarray) -> np.ndarray:
    """The numbers of motions, renumbered by how many lanes have them."""
    known, counts = np.unique(numbers[numbers >= 0], return_counts=True)
    rank = {int(number): i for i, number in enumerate(known[np.argsort(-counts, kind="stable")])}
    return np.array([rank.get(int(number), UNDECIDED) for number in numbers])


def _motion_values(run: SweepResult, motions: list[SweptMotion], numbers: np.ndarray, starts: int) -> dict[str, object]:
    """The values of each motion, by the names of `Attractors`."""
    groups = [np.flatnonzero(numbers == number) for number in range(numbers.max(initial=-1) + 1)]
    first = [int(group[0]) for group in groups]

    def over(reduce, values):
        return np.array([reduce(np.asarray(values)[group]) for group in groups])

    counts = over(len, numbers)
    low, high = share_interval(counts, starts)
    period_number = np.asarray(run.period_number)[first]
    return {
        "kind": np.where(period_number > 0, *map(ATTRACTOR_KINDS.index, ("periodic", "aperiodic"))),
        "period_number": period_number,
        "starts": counts,
        "share": counts / starts,
        "share_low": low,
        "share_high": high,
        "P_d": over(np.mean, run.P_d),
        "P_d_ci": over(np.max, run.P_d_ci),
        "P_d_vibration": over(np.mean, run.P_d_vibration),
        "P_d_least": over(np.min, run.P_d),
        "P_d_most": over(np.max, run.P_d),
        "P_d_worst": over(np.min, run.P_d_worst),
        "distance": _distances([motions[i].orbit for i in first]),
        "x_peak": run.x_peak[first],
        "x_free": run.x_free[first],
        "N_max": over(np.max, run.N_max),
        "v_max": over(np.max, run.v_max),
    }


def _distances(orbits: list[np.ndarray]) -> np.ndarray:
    """The distance of each motion from the nearest other one; infinite where it is alone."""

    def others(i):
        return (set_distance(orbits[i], orbit) for j, orbit in enumerate(orbits) if j != i)

    return np.array([min(others(i), default=np.inf) for i in range(len(orbits))])
