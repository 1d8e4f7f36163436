"""The scenes of a verb: what no verb takes is refused at once, their leading axes, and the results of all lanes."""

import warnings
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.threads import Interrupted
from jaxshroud.cache.programs import is_traced
from jaxshroud.io.lane_status import LaneWarning
from jaxshroud.model.prepared import State
from jaxshroud.results.base import Result
from jaxshroud.scene.checks import InputError, NumericalError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.layout import NO_CONTACT, require_capability, require_points, require_steps
from jaxshroud.scene.ranges import check_ranges
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.text import numbers_of
from jaxshroud.scene.typed import T, Tree

R = TypeVar("R", bound=Result)


def check_verb(verb: str, scene: Scene | SceneFile) -> None:
    """Raise an InputError if a verb does not know the layout or the contact of the scene."""
    where = f"{scene.name}: " if isinstance(scene, SceneFile) else ""
    require_capability(f"`{verb}`", scene.layout, where)
    points = {"points", "shares"} & {*scene.tables["contact"]} if isinstance(scene, SceneFile) else scene.contact.points
    if verb:  # without a name, another verb calls
        require_points(verb, points, where)
        parts = scene.tables["parts"]["contact"] if isinstance(scene, SceneFile) else scene.parts.contact
        require_steps(parts, verb, where)


def check_row(scene: Scene, **asked: bool) -> None:
    """Raise an InputError where a row of blades lacks contact, or an argument asks for what its layout lacks."""
    if scene.parts.contact == "none":
        require_capability(NO_CONTACT, scene.layout)
    for name in filter(asked.get, asked):
        require_capability(f"Argument `{name}`", scene.layout)


def refuse_traced(tree: object) -> None:
    """Raise an InputError if scenes or values are traced: verbs run outside JAX's transformations."""
    if is_traced(tree):
        raise InputError(
            "A verb was given numbers that jax.jit, jax.grad or jax.vmap traces, within which no verb runs: "
            "use js.rollout, js.sweep_function or js.period_map there, or js.gradient for derivatives of P_d."
        )


def check_known_period(q: int | None, state: State | None) -> None:
    """Raise an InputError unless a period number that is given is positive and comes with a state near the orbit."""
    if q is None:
        return
    count_argument("q", q, 1)
    if state is None:
        raise InputError("Argument `q` needs a `state` close to the orbit.")


def one_scene(verb: str, scene: Scene | SceneFile) -> Scene:
    """The single scene that a verb takes.

    Raises:
        InputError: There are many scenes, they are traced, or the verb does not know scenes of this layout.
    """
    check_verb(verb, scene)
    scene = scene.scene if isinstance(scene, SceneFile) else scene
    refuse_traced(scene)
    check_ranges(scene)
    require_sector(scene)
    shape = np.shape(scene.drive.omega)
    if shape:
        lanes = " x ".join(map(str, shape))
        raise InputError(f"`{verb}` takes one scene, but was given {lanes} of them; call it for each.")
    return scene


def leading_axes(scene: Scene) -> tuple[int, ...]:
    """The shape of the leading axes of scenes; () for a single scene.

    Raises:
        InputError: The numbers disagree in their leading axes, or one of these is empty.
    """
    refuse_traced(scene)
    ranks = {key: len(number_shape(ALL_KEYS[key], scene.layout)) for key in numbers_of(scene)}
    shapes = {key: a.shape[: a.ndim - ranks[key]] for key, a in numbers_of(scene).items()}
    first_keys: dict[tuple[int, ...], str] = {}
    for key, shape in shapes.items():
        first_keys.setdefault(shape, key)
    if len(first_keys) > 1:
        (a, one), (b, other) = list(first_keys.items())[:2]
        raise InputError(
            f"The scenes' numbers disagree in their leading axes: {one} has {a}, but {other} has {b}; "
            "make them with jax.vmap or js.scenes_from, which give all the same."
        )
    (shape,) = first_keys
    if 0 in shape:
        raise InputError(f"There are no scenes: their leading axes are {shape}.")
    return shape


def names_of(shape: tuple[int, ...], dims: Sequence[str] | None) -> tuple[str, ...]:
    """The names of leading axes: those given, else `lane`, or `lane_0`, `lane_1`, ... for several.

    Raises:
        InputError: The number of names is wrong, or two are equal.
    """
    if dims is None:
        return ("lane",) if len(shape) == 1 else tuple(f"lane_{i}" for i in range(len(shape)))
    if len(set(dims)) != len(shape) or len(dims) != len(shape):
        raise InputError(f"Argument `dims` must name {len(shape)} leading axes, each once, but is {tuple(dims)}.")
    return tuple(dims)


def flatten_lanes(tree: Tree, axes: int) -> Tree:
    """A tree of arrays with its leading axes joined into one, or with a new one where it has none."""

    def reshaped(a):
        return np.reshape(np.asarray(a), (-1, *np.shape(a)[axes:]))  # by NumPy: nothing is compiled

    return jax.tree.map(lambda a: jnp.asarray(reshaped(a)), tree)


def in_shape(values: Any, shape: tuple[int, ...]) -> Any:
    """Trees of arrays whose leading axis of lanes is reshaped to `shape`; () drops it."""
    if isinstance(values, dict):
        return {name: in_shape(value, shape) for name, value in values.items()}  # jax.tree would sort them
    return jax.tree.map(lambda a: np.asarray(a).reshape((*shape, *np.shape(a)[1:])), values)


def results_of_all(
    run: Callable[[], Sequence[T | Exception | None]], missing: Callable[[int, str], T], throw: bool
) -> list[T]:
    """The results of all lanes.

    Args:
        run: Returns the outcome of each lane: its result, the exception that ended it, or None if it was not run.
        missing: Called with the lane and a flag, "failed" or "not run", for the placeholder of a missing result.
        throw: Raise the first exception among the outcomes.

    Raises:
        NumericalError, LinAlgError: With `throw`: the exception that ended the first of the lanes that failed.
        Interrupted: Ctrl-C; its `done` has the results, with placeholders for the lanes that had not ended.
    """

    def result(lane: int, outcome: T | Exception | None) -> T:
        if isinstance(outcome, Exception) and throw:
            raise outcome
        if outcome is None or isinstance(outcome, Exception):
            return missing(lane, "not run" if outcome is None else "failed")
        return outcome

    try:
        return list(map(result, count(), run()))
    except Interrupted as stopped:
        raise Interrupted(stopped.done and list(map(result, count(), stopped.done))) from None


def warn_failed(result: R, throw: bool) -> R:
    """The result, after a warning of the lanes that failed.

    Raises:
        NumericalError: With `throw`: a lane failed.
    """
    if result.failed and throw:
        raise NumericalError(f"{result!r}")
    if result.failed:
        warnings.warn(f"{result!r}", LaneWarning, stacklevel=4)
    return result
