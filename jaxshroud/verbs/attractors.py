"""The motions that coexist in one scene, from random starts."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from jaxshroud.batch.runs import Progress, Ticker
from jaxshroud.batch.threads import Interrupted
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.state import State
from jaxshroud.motion.attractors import Found, attractors_of
from jaxshroud.motion.random_starts import SPREAD, random_starts
from jaxshroud.motion.shooting import TOLERANCE, Aim
from jaxshroud.results.attractors import Attractors, rows_of_attractors
from jaxshroud.scene.checks import count_argument, positive_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.door import asked
from jaxshroud.verbs.lanes import one_scene, with_tangents
from jaxshroud.verbs.simulate import simulate

SMOOTH = 300  # steps a period of curves that are drawn


def attractors(
    scene: Scene | SceneFile,
    starts: int = 256,
    *,
    spread: float = SPREAD,
    seed: int = 0,
    most_periods: int = 1024,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    progress: Progress | None = None,
) -> Attractors:
    """The motions that a scene can end on, from random starts, and how many of these lead to each.

    Starts are apart, at drive phase 0, each displacement uniform within `spread` times the amplitude that it would have
    without contact plus the gap (of angles: the turn that moves a corner by the gap), each rate within omega times
    that. Overlapping blocks are drawn again.

    Args:
        scene: One scene, or a scene file.
        starts: How many.
        spread: Of the starts, in what they would reach without contact.
        seed: Of their random numbers.
        most_periods: Drive periods after which a motion that has not settled on an orbit counts as aperiodic.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the scene needs.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number.
        progress: Called with (lane-periods done, at most).

    Returns:
        The attractors, the most frequent first. Periodic ones are closed by Newton's method and told apart by the
        distance between their orbits; orbits that differ by the place of a slider that never slips are one family.
        Aperiodic motions are told apart by the sets that they fill in 512 periods. A start whose motion cannot be
        assigned is undecided.

    Raises:
        InputError: A count is too small, or there are many scenes.
        Interrupted: Ctrl-C.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.attractors(scene, 8, steps_per_period=100)
        >>> found.period_number.tolist(), found.share.tolist()
        ([1], [1.0])
    """
    count_argument("starts", starts, 1)
    positive_argument("spread", spread)
    one, aim, about = aimed("attractors", scene, most_periods, steps_per_period, method, accuracy)
    states = random_starts(one, starts, seed, spread)
    found = found_from(one, states, most_periods, aim, progress)
    values = rows_of_attractors(found, paths(found, one, aim)) | {"initial": states.motion}
    values |= {"spread": spread, "seed": seed}
    return Attractors.of_values(values, ("start",), about)


def aimed(
    verb: str,
    scene: Scene | SceneFile,
    most_periods: int,
    steps_per_period: Steps | None,
    method: Method | Choices | None,
    accuracy: str | float | None,
) -> tuple[Scene, Aim, Mapping[str, Any]]:
    """One scene, how it is marched, and what results tell of it."""
    count_argument("most_periods", most_periods, 64)
    one = one_scene(verb, scene)
    request = asked(scene, steps_per_period=steps_per_period, method=method, accuracy=accuracy)
    how = with_tangents(request, alone(one))
    attrs, _ = request.about(request.transient, how.steps)
    aim = Aim(how.steps, TOLERANCE[how.method.precision], how.method)
    return in_precision(one, how.method.precision), aim, {**attrs, **how.told}


def found_from(scene: Scene, states: State, most: int, aim: Aim, progress: Progress | None) -> Found:
    """What a scene ends on from states (leading axis)."""
    states = jax.tree.map(np.asarray, states)
    try:
        return attractors_of(scene, states, most, aim, Ticker(len(states.u_s) * most, progress))
    except Interrupted:
        raise Interrupted(None) from None


def paths(found: Found, scene: Scene, aim: Aim) -> list[np.ndarray]:
    """The left blade's x and v_x along each attractor, (n, 2): one orbit, or eight periods of an aperiodic one."""
    told = []
    for one in found.attractors:
        steps = aim.steps * -(-SMOOTH // aim.steps)
        run = simulate(scene, one.state, n_periods=one.q or 8, steps_per_period=steps, method=aim.method)
        told.append(np.stack([run.motion.x[:, 0], run.motion.v_x[:, 0]], axis=-1))
    return told
