"""The arguments that all verbs share: the argument, else the [run] of the scene file, else the default."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.marches import require_march
from jaxshroud.batch.runs import stepping_method
from jaxshroud.batch.states import initial_states
from jaxshroud.io.scene_numbers import scene_differences
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.march.method import FAST, Choices, Method, RungeKutta, StepCount, choices, method_of
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.march.stability import steps_for
from jaxshroud.model.prepared import State
from jaxshroud.motion.short_runs import end_states
from jaxshroud.programs.kept import is_traced
from jaxshroud.scene.capabilities import NO_CONTACT, require_capability
from jaxshroud.scene.checks import DEFAULT_TRANSIENT, InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.text import numbers_of, text_of
from jaxshroud.scene.typed import Tree, typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.accuracy import Choice, EndStates, accuracy_level, choose
from jaxshroud.verbs.row_accuracy import Accuracy, RowChoice, accuracy_as_number, row_choice

N_PERIODS = 64  # kept periods, unless the argument or the scene file says otherwise
LaneVariable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]  # dimensions, values, attributes
ACCURACY = "balanced"  # unless either of them gives a method


class ResolvedOptions(NamedTuple):
    """Scenes, and the resolved values of the arguments that all verbs share."""

    scene: Scene  # as given, with or without leading axes
    shape: tuple[int, ...]  # of the leading axes; () of a single scene
    dims: tuple[str, ...]
    file: SceneFile | None
    n_periods: int
    transient: int
    steps: StepCount | None
    method: Method | None
    accuracy: Accuracy | None

    @property
    def as_argument(self) -> Method | str | float | None:
        """The argument `method` that makes another verb march the same way."""
        if isinstance(self.accuracy, Choice | RowChoice):
            return method_of(self.accuracy.steps, self.accuracy.method, self.accuracy)
        if self.accuracy is not None or (self.method is None and self.steps is None):
            return self.accuracy
        return (self.method or RungeKutta()).replace(steps=self.steps)

    @property
    def choosing_accuracy(self) -> Accuracy | None:
        """The accuracy that chooses the method: the one given, else the default; None where nothing is chosen."""
        if self.scene.parts.contact != "spring":
            return None
        is_silent = self.accuracy is None and self.method is None and self.steps is None
        return ACCURACY if is_silent else self.accuracy

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
        without_interfaces = np.ndim(state.u_s) - len(lanes.layout.interface_shape)
        shape = np.shape(state.u_s)[:without_interfaces]
        precise: State = in_precision(state, "float64" if lanes.drive.omega.dtype == float else "float32")
        if shape and shape != self.shape:
            raise InputError(f"Argument `state` has leading axes {shape}, but the scenes have {self.shape}.")
        flat = flatten_lanes(precise, len(shape))
        lanes_per_state = len(lanes.drive.omega) // max(len(flat.u_s), 1)
        return jax.tree.map(lambda a: np.repeat(np.asarray(a), lanes_per_state, axis=0), flat)

    def provenance(self, transient: int, steps: int) -> tuple[dict[str, str], dict[str, LaneVariable]]:
        """The attributes that say which scene a result is of, and the numbers in which its scenes differ."""
        run = {"periods": self.n_periods, "transient": transient, **self._march_entry(steps)}
        if self.file is None:
            first = jax.tree.map(lambda a: np.asarray(a)[0], self.lanes)
            attributes = {"title": "", "scene": text_of(first, run)}
        else:
            attributes = {"title": self.file.title, "scene": self.file.text(run), "source": self.file.name}
        return attributes, scene_differences(self.scene, self.shape, self.dims)

    def _march_entry(self, steps: int) -> dict[str, StepCount | float]:
        """The entry of [run] that says how it was marched."""
        accuracy = self.choosing_accuracy
        if accuracy is None:
            return {"steps_per_period": self.steps or steps}
        return {"accuracy": accuracy_as_number(accuracy)}


class MarchPlan(NamedTuple):
    """The method and the steps per period by which scenes are marched."""

    steps: int  # per period
    method: Choices
    choice: Choice | None  # set where the method was chosen for an accuracy
    row_choice: RowChoice | None = None  # set where one of rows was

    @property
    def as_method(self) -> Method:
        """The same as the argument `method` of verbs."""
        of_row = self.row_choice and replace(self.row_choice, steps=self.steps)
        return method_of(self.steps, self.method, self.choice or of_row)

    @property
    def attributes(self) -> dict[str, int | str]:
        """The attributes of results that describe it."""
        told = self.row_choice if self.row_choice is not None and self.row_choice.asked else self.choice
        chosen = {} if told is None else {"accuracy": str(told)}
        return {"steps_per_period": self.steps, "method": str(self.method), **chosen}


def resolve_options(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    method: Method | str | float | None = None,
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
    steps, explicit, accuracy = _method_options(method)
    scenes = scene.scene if isinstance(scene, SceneFile) else scene
    if run is not None:
        n_periods = run.periods if n_periods is None else n_periods
        transient = run.transient if transient is None else transient
        if accuracy is None and steps is None:
            chooses = explicit is None and scenes.parts.contact == "spring"
            steps, accuracy = run.steps_per_period, run.accuracy if chooses else None
    n_periods = N_PERIODS if n_periods is None else n_periods
    transient = DEFAULT_TRANSIENT if transient is None else transient
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    shape = leading_axes(scenes)
    if accuracy is not None and scenes.row is not None and scenes.parts.contact == "spring":
        accuracy = row_choice(accuracy, method is not None)
    return ResolvedOptions(scenes, shape, names_of(shape, dims), file, n_periods, transient, steps, explicit, accuracy)


def _method_options(
    method: Method | str | float | None,
) -> tuple[StepCount | None, Method | None, Accuracy | None]:
    """The steps, the method and the accuracy that the argument `method` gives: at most one of the last two."""
    if method is None:
        return None, None, None
    if not isinstance(method, Method):
        _check_accuracy(method)
        return None, None, method if isinstance(method, str) else float(method)
    return (method.steps, method, None) if method.choice is None else (None, None, method.choice)


def choose_method(
    resolved: ResolvedOptions,
    lanes: Scene,
    usual: Choices,
    *,
    periods: float | int | None = None,
    ends: EndStates | None = None,
) -> tuple[Choices, Choice | None]:
    """The method by which lanes (leading axis) are marched, and the choice for an accuracy that it comes from, if any.

    Args:
        resolved: The resolved arguments.
        lanes: The scenes.
        usual: The method where only steps are given, with or without a ledger, and for P_d or not.
        periods: Of the run of each lane; by default those of the arguments.
        ends: How lanes are marched to try a method; by default by the programs of `run_lanes`.

    Raises:
        InputError: An accuracy is requested for smooth contact or for own laws.
    """
    contact = lanes.parts.contact
    if resolved.accuracy is not None and contact in ("smooth", "own"):
        kind = "smooth contact" if contact == "smooth" else "own laws"
        raise InputError(f"An accuracy can be had for located contact, not for {kind}; give js.RungeKutta(steps=...).")
    if lanes.row is not None:
        return _method_for_rows(resolved, usual), None
    accuracy, lanes = resolved.choosing_accuracy, without_given(lanes)
    if accuracy is not None and not isinstance(accuracy, RowChoice):
        periods = resolved.transient + resolved.n_periods if periods is None else periods
        ends = ends or partial(end_states, ledger=usual.ledger, vibration=usual.vibration)
        work = len(lanes.drive.omega) * periods
        choice = accuracy if isinstance(accuracy, Choice) else choose(lanes, 1, accuracy, lane_periods=work, ends=ends)
        return choice.method._replace(ledger=usual.ledger, vibration=usual.vibration), choice
    ledger = usual.ledger or contact == "own"  # the energy balance is the only check of a user's own law
    method = usual if resolved.method is None else choices(resolved.method)
    return method._replace(ledger=ledger, vibration=usual.vibration), None


def _method_for_rows(resolved: ResolvedOptions, usual: Choices) -> Choices:
    """The method by which rows are marched: that of an accuracy is Dormand-Prince 8, which is not tried on the lanes.

    Raises:
        InputError: The method is a power series.
    """
    if resolved.method is not None:
        method = choices(resolved.method, ledger=usual.ledger)
        require_march(resolved.scene, method)
        return method._replace(vibration=usual.vibration)
    accuracy = resolved.choosing_accuracy
    return (
        usual
        if accuracy is None
        else row_choice(accuracy, False).method._replace(ledger=usual.ledger, vibration=usual.vibration)
    )


def plan_march(resolved: ResolvedOptions, lanes: Scene, usual: Choices, **trials: Any) -> MarchPlan:
    """The plan by which lanes (leading axis) are marched, from the arguments of `choose_method`.

    Raises:
        InputError: See `choose_method`.
        ValueError: The march would be unstable, or JAX has no float64.
    """
    method, choice = choose_method(resolved, lanes, usual, **trials)
    if choice is not None and choice is not resolved.accuracy:
        return MarchPlan(choice.steps, method, choice)
    known = resolved.accuracy if isinstance(resolved.accuracy, RowChoice) else None
    chosen = choice or known
    steps = chosen.steps if chosen is not None else "auto" if resolved.steps is None else resolved.steps
    # the method was not chosen for these lanes: is it stable here?
    lanes = in_precision(without_given(lanes), method.precision)
    return MarchPlan(steps_for(lanes, 1, steps, stepping_method(lanes, method)), method, choice, known)


def _check_accuracy(accuracy: str | float) -> None:
    """Raise an InputError unless it is an accuracy."""
    try:
        accuracy_level(accuracy)
    except InputError as error:
        hint = (
            f'; a method of that name is js.RungeKutta("{accuracy}")'
            if isinstance(accuracy, str) and accuracy in TABLEAUS
            else ""
        )
        raise InputError(f"Argument `method` {error}{hint}") from None


@typed
def method_for(scenes: Scene, accuracy: str | float = ACCURACY) -> Method:
    """The cheapest method that keeps an accuracy, found by trying methods on the scenes; not inside `jax.jit`.

    Verbs choose in the same way: their argument `method` is "fast", "balanced", "reference" or a number (the accuracy
    of the state after three periods), or a `RungeKutta` or `Taylor`; by default it is that of the scene file, else
    "balanced". Pure functions (`rollout`, `sweep_function`, `period_map`) take methods only.

    Args:
        scenes: One scene, or many with leading axes: the stiffest one determines the step.
        accuracy: "fast", "balanced", "reference" or a number from 1e-10 to 1e-2: the error of the state after three
            periods that 95 % of the scenes keep.

    Returns:
        A `RungeKutta` or `Taylor` with its number of steps. Where the accuracy cannot be reached, about the best one.

    Raises:
        ValueError: There is no such accuracy, or the scenes have no located contact.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> print(js.method_for(js.load("table1", ['parts.motion=["x"]']).scene, 1e-3).precision)
        float64
    """
    resolved = resolve_options(scenes, method=accuracy, verb="method_for")
    return plan_march(resolved, resolved.lanes, FAST, periods=math.inf).as_method


def check_verb(verb: str, scene: Scene | SceneFile) -> None:
    """Raise an InputError if the scene has a row of blades, or a pair, which a verb does not know."""
    where = f"{scene.name}: " if isinstance(scene, SceneFile) else ""
    require_capability(f"`{verb}`", scene.layout, where)


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
    reshaped = lambda a: np.reshape(np.asarray(a), (-1, *np.shape(a)[axes:]))  # by NumPy: nothing is compiled
    return jax.tree.map(lambda a: jnp.asarray(reshaped(a)), tree)


def in_shape(values: Any, shape: tuple[int, ...]) -> Any:
    """Trees of arrays whose leading axis of lanes is reshaped to `shape`; () drops it."""
    if isinstance(values, dict):
        return {name: in_shape(value, shape) for name, value in values.items()}  # jax.tree would sort them
    return jax.tree.map(lambda a: np.asarray(a).reshape((*shape, *np.shape(a)[1:])), values)
