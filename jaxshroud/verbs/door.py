"""What all verbs are asked alike, and what counts: the argument, then the scene file's [run], then the default."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import starts, stepper
from jaxshroud.march.method import Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.state import State
from jaxshroud.results.scenes import differing
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import KEYS
from jaxshroud.scene.limits import TRANSIENT
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import numbers_of, text_of
from jaxshroud.verbs.accuracy import Choice, choose

N_PERIODS = 64  # kept, where neither the argument nor the scene file says
ACCURACY = "balanced"  # where neither says anything of steps, method or accuracy


class Asked(NamedTuple):
    """Scenes, and what was asked for: by an argument, else by the scene file."""

    scene: Scene  # as it was given, with leading axes or without
    shape: tuple[int, ...]  # of the leading axes; () of a single scene
    dims: tuple[str, ...]
    file: SceneFile | None
    n_periods: int
    transient: int
    steps: Steps | None
    method: Method | Choices | None
    accuracy: str | float | Choice | None

    @property
    def lanes(self) -> Scene:
        """The scenes with one leading axis."""
        return in_line(self.scene, len(self.shape))

    def states(self, state: State | None, lanes: Scene) -> State:
        """Where lanes (leading axis) start: from their scenes' initial motion, one state for all, or each its own.

        Raises:
            InputError: The state has other leading axes than the scenes.
        """
        if state is None:
            return starts(lanes)
        shape = np.shape(state.u_s)
        state = in_precision(state, "float64" if lanes.drive.omega.dtype == float else "float32")
        if shape and shape != self.shape:
            raise InputError(f"Argument `state` has leading axes {shape}, but the scenes have {self.shape}.")
        flat = in_line(state, len(shape))
        each = len(lanes.drive.omega) // max(len(flat.u_s), 1)  # lanes that start alike
        return jax.tree.map(lambda a: np.repeat(a, each, axis=0), flat)

    def about(self, transient: int, steps: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Attributes that say where a result comes from, and the numbers that differ between its scenes."""
        run = {"periods": self.n_periods, "transient": transient, "steps_per_period": self.steps or steps}
        if self.file is None:
            first = jax.tree.map(lambda a: np.asarray(a)[0], self.lanes)
            told = {"title": "", "scene": text_of(first, run)}
        else:
            told = {"title": self.file.title, "scene": self.file.text(run), "source": self.file.name}
        return told, differing(self.scene, self.shape, self.dims)


class Marched(NamedTuple):
    """How scenes are marched."""

    steps: int
    method: Choices
    choice: Choice | None  # where an accuracy chose it

    @property
    def told(self) -> dict[str, Any]:
        """What results say of it."""
        chosen = {} if self.choice is None else {"accuracy": str(self.choice)}
        return {"steps_per_period": self.steps, "method": str(self.method), **chosen}


def asked(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | Choice | None = None,
    dims: Sequence[str] | None = None,
    of_sweep: bool = False,
) -> Asked:
    """What counts of arguments that all verbs share.

    Args:
        scene: A scene, scenes with leading axes, or a scene file.
        n_periods: Drive periods kept.
        transient: Drive periods discarded before them.
        steps_per_period: Steps in one period, or "auto".
        method: How to march.
        accuracy: What chooses steps and method instead, or has chosen them.
        dims: Names of the leading axes.
        of_sweep: The file's [sweep] keep counts, not its [run] periods.

    Raises:
        InputError: An accuracy comes with steps or a method, leading axes disagree, or their names are not as many.
        ValueError: A count is too small.
    """
    file = scene if isinstance(scene, SceneFile) else None
    run = None if file is None else file.sweep_run if of_sweep else file.run
    if accuracy is not None:
        for name, given in {"steps_per_period": steps_per_period, "method": method}.items():
            if given is not None:
                raise InputError(f"Argument `accuracy` chooses `{name}` itself; give one of them.")
    if run is not None:
        n_periods = run.periods if n_periods is None else n_periods
        transient = run.transient if transient is None else transient
        if accuracy is None and steps_per_period is None:
            steps_per_period = run.steps_per_period
            accuracy = run.accuracy if method is None else None
    n_periods = N_PERIODS if n_periods is None else n_periods
    transient = TRANSIENT if transient is None else transient
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    whole = scene.scene if isinstance(scene, SceneFile) else scene
    shape = leading_axes(whole)
    return Asked(whole, shape, names_of(shape, dims), file, n_periods, transient, steps_per_period, method, accuracy)


def chosen(asked: Asked, lanes: Scene, usual: Choices, *, derivatives: bool = False) -> tuple[Choices, Choice | None]:
    """The method that lanes (leading axis) are marched by, and the choice of an accuracy that it comes from.

    Args:
        asked: What was asked for.
        lanes: The scenes.
        usual: The method where steps alone are given, with a ledger or without.
        derivatives: Float32 only where the method itself says so: an accuracy that it reaches is not one of these.

    Raises:
        InputError: An accuracy is asked for of smooth contact.
    """
    contact, accuracy = lanes.parts.contact, asked.accuracy
    if accuracy is not None and contact in ("smooth", "own"):
        what = "smooth contact" if contact == "smooth" else "own laws"
        raise InputError(f"Argument `accuracy` knows located contact, not {what}; give `steps_per_period`.")
    if accuracy is None and asked.steps is None and asked.method is None and contact == "spring":
        accuracy = ACCURACY
    if accuracy is not None and contact == "spring":
        choice = accuracy if isinstance(accuracy, Choice) else choose(lanes, 1, accuracy)
        method = choice.method._replace(ledger=usual.ledger)
        return method._replace(precision="float64") if derivatives else method, choice
    method = usual if asked.method is None else choices(asked.method, ledger=usual.ledger)
    return method, None


def marched(asked: Asked, lanes: Scene, usual: Choices, *, derivatives: bool = False) -> Marched:
    """How lanes (leading axis) are marched: the same arguments as of `chosen`, and the same errors.

    Raises:
        ValueError: The march would be unstable, or float64 is not to be had.
    """
    method, choice = chosen(asked, lanes, usual, derivatives=derivatives)
    if choice is not None:
        return Marched(choice.steps, method, choice)
    steps = "auto" if asked.steps is None else asked.steps
    lanes = in_precision(lanes, method.precision)
    return Marched(steps_for(lanes, 1, steps, stepper(lanes, method)), method, None)


def leading_axes(scene: Scene) -> tuple[int, ...]:
    """Shape of the leading axes of scenes; () of a single one.

    Raises:
        InputError: Those of its numbers disagree.
    """
    shapes = {key: a.shape[: a.ndim - KEYS[key].pair] for key, a in numbers_of(scene).items()}
    told: dict[tuple[int, ...], str] = {}
    for key, shape in shapes.items():
        told.setdefault(shape, key)
    if len(told) > 1:
        (a, one), (b, other) = list(told.items())[:2]
        raise InputError(
            f"The scenes' numbers disagree in their leading axes: {one} has {a}, but {other} has {b}; "
            "make them with jax.vmap or js.scenes_from, which give all the same."
        )
    return next(iter(told))


def names_of(shape: tuple[int, ...], dims: Sequence[str] | None) -> tuple[str, ...]:
    """Names of leading axes: those given, or `lane`, or `lane_0`, `lane_1`, ...

    Raises:
        InputError: They are not as many, or not different.
    """
    if dims is None:
        return ("lane",) if len(shape) == 1 else tuple(f"lane_{i}" for i in range(len(shape)))
    if len(set(dims)) != len(shape) or len(dims) != len(shape):
        raise InputError(f"Argument `dims` must name {len(shape)} leading axes, each once, but is {tuple(dims)}.")
    return tuple(dims)


def in_line(tree: Any, axes: int) -> Any:
    """A tree of arrays with its leading axes as one; without any, with a new one."""
    return jax.tree.map(lambda a: jnp.asarray(a).reshape(-1, *np.shape(a)[axes:]), tree)


def in_shape(values: Any, shape: tuple[int, ...]) -> Any:
    """Trees of arrays with a leading axis of lanes, which becomes axes of that shape; () drops it."""
    if isinstance(values, dict):
        return {name: in_shape(value, shape) for name, value in values.items()}  # jax.tree would sort them
    return jax.tree.map(lambda a: np.asarray(a).reshape((*shape, *np.shape(a)[1:])), values)
