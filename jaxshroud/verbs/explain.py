"""The parts of a scene's model, their cost in operations and steps, and those that it could do without."""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import numpy as np

from jaxshroud.batch.operation_count import first_trial, operations
from jaxshroud.march.events import EventKind, model_events
from jaxshroud.march.method import FAST, Method, choices
from jaxshroud.march.stability import largest_frequency, step_limits, steps_for
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.prepared import prepared_model
from jaxshroud.results.base import PlainResult
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.parts import MOTIONS, Parts
from jaxshroud.scene.scene import Scene, with_parts
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.lanes import one_scene

EVENTS = {EventKind.LIFT: "contact", EventKind.TURN: "corner pair", EventKind.HEIGHT: "tip", EventKind.RUB: "friction"}


@dataclass(frozen=True)
class Explanation(PlainResult):
    """The model of a scene in numbers."""

    parts: Parts
    numbers: int  # that a lane carries through the march
    events: tuple[str, ...]  # kinds that are detected
    operations: int  # in one trial step; 0 where there is a closed form
    full_operations: int  # in one trial step of the full model
    omega_max: float  # largest frequency [rad/s]
    steps: dict[str, int]  # smallest stable, smallest accurate and automatic number of steps per period
    advice: tuple[str, ...]  # parts that the scene could do without


@typed
def explain(scene: Scene | SceneFile, method: Method | None = None) -> Explanation:
    """The parts of a scene's model and their cost.

    Args:
        scene: One scene, or a scene file.
        method: The method of the march; by default RK4 with events located by the guard's cubic, in float64.

    Returns:
        The counts of numbers and operations, the steps per period, and the parts that the scene could do without.

    Raises:
        ValueError: There are many scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> told = js.explain(js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"']))
        >>> told.events
        ('contact',)
    """
    scene, method_choices = one_scene("explain", scene), FAST if method is None else choices(method)
    closed = scene.parts.contact == "none"
    full = with_parts(scene, Parts())
    lane = first_trial(scene, method_choices)[0]
    omega_max, period = float(largest_frequency(scene)), float(scene.drive.period)
    limits = dict(zip(("stable", "accurate"), step_limits(method_choices.tableau), strict=True))
    steps = {name: int(np.ceil(omega_max * period / limit)) for name, limit in limits.items() if limit < np.inf}
    return Explanation(
        parts=scene.parts,
        numbers=0 if closed else len(jax.tree.leaves(lane)),
        events=tuple(EVENTS[kind] for kind in model_events(prepared_model(scene))),
        operations=0 if closed else operations(scene, method_choices),
        full_operations=operations(full, method_choices),
        omega_max=omega_max,
        steps={} if closed else steps | {"auto": steps_for(scene, 0, "auto", method_choices.tableau)},
        advice=tuple(_advice(scene)),
    )


def _advice(scene: Scene) -> Iterator[str]:
    """The parts that could be left out of the model without changing its motion."""
    parts, friction = scene.parts, scene.friction
    touches = parts.contact == "spring"
    if touches and parts.friction == "bilinear" and (float(friction.mu) == 0 or float(friction.k_d) == 0):
        yield 'mu or k_d is 0: [parts] friction = "none" gives the same motion for less'
    if touches and float(scene.k) == 0:
        yield 'the contact has no stiffness: [parts] contact = "none" gives the motion in closed form'
    if parts.contact != "none" and _never_touches(scene):
        yield 'the gap exceeds the steady free motion: after transients, [parts] contact = "none" may be all it takes'
    if parts.motion == MOTIONS[2] and not np.any(scene.drive.M_0) and touches:
        yield 'M_0 is 0: the blocks are turned by contact only; compare with [parts] motion = ["x", "y"]'


def _never_touches(scene: Scene) -> bool:
    """Whether the corners stay apart in steady free motion, by the sum of all amplitudes."""
    free, s = steady_amplitudes(scene), scene.shroud
    x, y, theta = (float(np.sum(np.abs(a))) for a in free)
    sine = float(np.sin(s.alpha))
    return float(s.gap) * sine > x + y + theta * float(np.hypot(s.l_oa, s.l_ab))
