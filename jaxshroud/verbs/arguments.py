"""The arguments that verbs have in common, resolved: the argument, else the [run] of the scene file, else the default.

Their scenes may have leading axes. What no verb takes is refused at once.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.states import initial_states, own_motion
from jaxshroud.cache.programs import is_traced
from jaxshroud.io.scene_numbers import dimension, scene_differences
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.march.method import Method, StepCount
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.model.prepared import State, law_type
from jaxshroud.scene.checks import DEFAULT_TRANSIENT, InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.layout import NO_CONTACT, require_capability, require_points, require_steps
from jaxshroud.scene.ranges import check_ranges
from jaxshroud.scene.scene import Scene, with_plain_orders
from jaxshroud.scene.schema import RunTable
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.speed import ORDER
from jaxshroud.scene.text import numbers_of, text_of
from jaxshroud.scene.typed import Tree
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.asked import Asked, MethodArgument, accuracy_level

N_PERIODS = 64  # kept periods, unless the argument or the scene file says otherwise
LaneVariable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]  # dimensions, values, attributes


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


class ResolvedOptions(NamedTuple):
    """Scenes, and the resolved values of the arguments that all verbs share."""

    scene: Scene  # as given, with or without leading axes
    shape: tuple[int, ...]  # of the leading axes; () of a single scene
    dims: tuple[str, ...]
    file: SceneFile | None
    n_periods: int
    transient: int
    asked: Asked

    @property
    def accuracy(self) -> float | None:
        """The accuracy that chooses the method: the one given, else the default; None where nothing is chosen."""
        return self.asked.level if _is_examined(self.scene) else None

    @property
    def lanes(self) -> Scene:
        """The scenes with one leading axis."""
        return flatten_lanes(self.scene, len(self.shape))

    @property
    def scenes(self) -> list[Scene]:
        """The scene of each lane, as given."""
        return [jax_lane_arrays(self.scene, lane) for lane in np.ndindex(self.shape)] if self.shape else [self.scene]

    def states(self, state: State | None, lanes: Scene) -> State:
        """The initial states of lanes (leading axis): those given, one for all or one per lane, else the scenes' own.

        Raises:
            InputError: The state has other leading axes than the scenes.
        """
        if state is None:
            return initial_states(lanes)
        of_contact = len(lanes.layout.interface_shape) + (lanes.contact.points is not None)
        without_interfaces = np.ndim(state.u_s) - of_contact
        shape = np.shape(state.u_s)[:without_interfaces]
        precise: State = in_precision(state, "float64" if lanes.drive.omega.dtype == float else "float32")
        if shape and shape != self.shape:
            raise InputError(f"Argument `state` has leading axes {shape}, but the scenes have {self.shape}.")
        flat = flatten_lanes(precise, len(shape))
        lanes_per_state = len(lanes.drive.omega) // max(len(flat.u_s), 1)
        whole = jax.tree.map(lambda a: np.repeat(np.asarray(a), lanes_per_state, axis=0), flat)
        return State(own_motion(whole.motion, lanes), whole.u_s, whole.mode, whole.case)

    def provenance(self, transient: int, steps: int) -> tuple[dict[str, str], dict[str, LaneVariable]]:
        """The attributes that say which scene a result is of, and the numbers in which its scenes differ."""
        run = {"periods": self.n_periods, "transient": transient, **self._march_entry(steps)}
        differences = scene_differences(self.scene, self.shape, self.dims)
        if self.file is None:
            first = jax.tree.map(lambda a: np.asarray(a)[0], self.lanes)
            if dimension(ORDER) in differences:  # where one text is of many engine orders, it gives plain ones
                first = with_plain_orders(first)
            attributes = {"title": "", "scene": text_of(first, run)}
        else:
            attributes = {"title": self.file.title, "scene": self.file.text(run), "source": self.file.name}
        return attributes, differences

    def _march_entry(self, steps: int) -> dict[str, StepCount | float]:
        """The entry of [run] that says how it was marched."""
        if self.accuracy is not None:
            return {"accuracy": self.accuracy}
        return {"steps_per_period": self.asked.steps or steps}


def resolve_options(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    dims: Sequence[str] | None = None,
    of_sweep: bool = False,
    verb: str = "",
) -> ResolvedOptions:
    """Resolve the arguments that all verbs share: the argument, else the file's [run], else the default.

    An accuracy of the file is one of located contact: contact of another kind is marched by "auto" steps.

    Args:
        scene: A scene, scenes with leading axes, or a scene file.
        n_periods: Drive periods kept.
        transient: Drive periods run and discarded first.
        method: How to march: a method, or the accuracy that chooses one.
        dims: Names of the leading axes.
        of_sweep: Take the kept periods from the file's [sweep] keep instead of its [run] periods.
        verb: The verb that is asked; "" where that is known to take the scene.

    Raises:
        InputError: Leading axes disagree, `dims` names a different number of them, or the verb does not know scenes of
            this layout.
        ValueError: A count is too small.
    """
    check_verb(verb, scene)
    file = scene if isinstance(scene, SceneFile) else None
    run = None if file is None else file.sweep_run if of_sweep else file.run
    scenes = scene.scene if isinstance(scene, SceneFile) else scene
    asked = asked_by(method, run)
    if run is not None:
        n_periods = run.periods if n_periods is None else n_periods
        transient = run.transient if transient is None else transient
    n_periods = N_PERIODS if n_periods is None else n_periods
    transient = DEFAULT_TRANSIENT if transient is None else transient
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    shape = leading_axes(scenes)
    check_ranges(scenes)
    require_sector(scenes)
    return ResolvedOptions(scenes, shape, names_of(shape, dims), file, n_periods, transient, asked)


def _is_examined(scene: Scene) -> bool:
    """Whether an accuracy can choose a method for a scene; in closed form there is nothing to choose."""
    law = law_type(scene)
    return law.is_examined and law.has_events


def asked_by(method: MethodArgument, run: RunTable | None = None) -> Asked:
    """How to march as the argument `method` asks, else the [run] of a scene file."""
    if isinstance(method, Asked):
        asked = method
    elif isinstance(method, Method):
        asked = Asked(method=method, steps=method.steps)
    else:
        asked = Asked(None if method is None else _given_level(method))
    if run is None or asked.accuracy is not None or asked.steps is not None or asked.plan is not None:
        return asked
    if asked.method is None:
        level = None if run.accuracy is None else accuracy_level(run.accuracy)
        asked = asked._replace(accuracy=level, by_argument=False)
    return asked._replace(steps=run.steps_per_period)


def _given_level(accuracy: str | float) -> float:
    """The accuracy that the argument `method` asks for; InputError if it is none."""
    try:
        return accuracy_level(accuracy)
    except InputError as error:
        hint = (
            f'; a method of that name is js.RungeKutta("{accuracy}")'
            if isinstance(accuracy, str) and accuracy in TABLEAUS
            else ""
        )
        raise InputError(f"Argument `method` {error}{hint}") from None
