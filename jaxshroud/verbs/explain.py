"""The parts of a scene's model, their cost in operations and steps, and those that it could do without."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np

from jaxshroud.batch.operation_count import TrialSize, size_of_trial
from jaxshroud.batch.runs import march_of, stepping_method
from jaxshroud.cache.programs import kept
from jaxshroud.march.events import model_events
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import step_limits, steps_for, stiffest
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.linear import Amplitudes, free_reach, steady_amplitudes
from jaxshroud.model.prepared import Model, prepared_model
from jaxshroud.model.row import pair_at
from jaxshroud.results.base import PlainResult
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import COORDINATES, MOTIONS, Parts
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene, Shroud
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.lanes import check_row, one_scene


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
    blades: int = 2
    interfaces: int = 1  # each of which has events of all `events`


@typed
def explain(scene: Scene | SceneFile, method: Method | None = None) -> Explanation:
    """The parts of a scene's model and their cost.

    Args:
        scene: One scene, or a scene file.
        method: The method of the march; by default RK4 with events located by the guard's cubic, in float64.

    Returns:
        The counts of numbers and operations, the steps per period, and the parts that the scene could do without. Of a
        row of blades, numbers and operations are those of all blades and interfaces together; they grow as N, where
        blocks turn with a small part that grows as N^2, for the clusters of blocks that are flat on each other.

    Raises:
        ValueError: There are many scenes, a row without contact, or a method that does not know the contact.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> model = js.explain(js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"']))
        >>> model.events
        ('contact',)
    """
    scene = replace(one_scene("explain", scene), start="motion")  # a static start adds nothing to a trial step
    method_choices = FAST if method is None else choices(method)
    check_row(scene)
    stepping = stepping_method(scene, method_choices)
    size, full_size = _trial_sizes(scene, method_choices)
    omega_max, period = stiffest(scene, 0)
    limits = dict(zip(("stable", "accurate"), step_limits(method_choices.tableau), strict=True))
    steps = {name: int(np.ceil(omega_max * period / limit)) for name, limit in limits.items() if limit < np.inf}
    return Explanation(
        parts=scene.parts,
        numbers=size.numbers,
        events=tuple(event.label for event in model_events(jax.eval_shape(_model_of_contact, scene))),
        operations=size.operations,
        full_operations=full_size.operations,
        omega_max=omega_max,
        steps={} if stepping is None else steps | {"auto": steps_for(scene, 0, "auto", method_choices.tableau)},
        advice=tuple(_advice(scene)),
        blades=scene.layout.blades,
        interfaces=scene.layout.interfaces,
    )


def _model_of_contact(scene: Scene) -> Model:
    """The constants of the pair at the first interface."""
    return prepared_model(pair_at(scene, 0))


def _trial_sizes(scene: Scene, method: Choices) -> tuple[TrialSize, TrialSize]:
    """The sizes of a trial step of the scene, 0 in closed form, and of the full model."""

    def size(scene):
        return size_of_trial(scene, method) if march_of(scene).steps else TrialSize(0, 0)

    full = size(with_parts(scene, Parts()))
    return full if scene.parts == Parts() else size(scene), full


def _advice(scene: Scene) -> Iterator[str]:
    """The parts that could be left out of the model without changing its motion."""
    parts, friction = scene.parts, scene.friction
    touches = parts.contact == "spring"

    def none(a):
        return not np.any(np.asarray(a))  # at any interface

    if touches and parts.friction == "bilinear" and (none(friction.mu) or none(friction.k_d)):
        yield 'mu or k_d is 0: [parts] friction = "none" gives the same motion for less'
    if scene.row is None:
        yield from _advice_on_contact(scene, touches)
    if parts.motion == MOTIONS[2] and _has_no_moment(scene) and touches:
        yield 'M_0 is 0: the blocks are turned by contact only; compare with [parts] motion = ["x", "y"]'


def _advice_on_contact(scene: Scene, touches: bool) -> Iterator[str]:
    """Whether a pair could do without contact; a row cannot."""
    free, k = jax.tree.map(np.asarray, _free_motion(scene))
    if touches and k == 0:
        yield 'the contact has no stiffness: [parts] contact = "none" gives the motion in closed form'
    if scene.parts.contact != "none" and _never_touches(free, scene.running_shroud):
        yield 'the gap exceeds the steady free motion: after transients, [parts] contact = "none" may be all it takes'


@kept()
def _free_motion(scene: Scene) -> tuple[dict[int, Amplitudes], Scalar]:
    """The amplitudes of the free blades, and the stiffness of the contact [N/m]."""
    return steady_amplitudes(scene), scene.k


def _has_no_moment(scene: Scene) -> bool:
    return not any(np.any(np.asarray(one.M_0)) for one in scene.drive.harmonics().values())


def _never_touches(free: dict[int, Amplitudes], s: Shroud) -> bool:
    """Whether the corners stay apart in steady free motion, by the sum of all amplitudes."""
    x, y, theta = (float(np.sum(free_reach(free, name))) for name in COORDINATES)
    sine = float(np.sin(s.alpha))
    return float(s.gap) * sine > x + y + theta * float(np.hypot(s.l_oa, s.l_ab))
