"""The arguments that verbs have in common: the leading axes of scenes, and what is refused at once."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import is_traced
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.layout import NO_CONTACT, require_capability, require_points, require_steps
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.text import numbers_of
from jaxshroud.scene.typed import Tree


def check_verb(verb: str, scene: Scene | SceneFile) -> None:
    """Raise an InputError if the scene has a row of blades, or a pair, which a verb does not know."""
    where = f"{scene.name}: " if isinstance(scene, SceneFile) else ""
    require_capability(f"`{verb}`", scene.layout, where)
    points = {"points", "shares"} & {*scene.tables["contact"]} if isinstance(scene, SceneFile) else scene.contact.points
    if verb:  # what has no name was asked for by another verb
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
            "use js.rollout, js.sweep_function or js.period_map there."
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
