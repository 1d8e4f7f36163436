"""The arguments that verbs have in common, resolved: the argument, else the [run] of the scene file, else the default.

The method among them becomes what runs, a `MarchPlan`, in one place: `plan_march`. Scenes may have leading axes.
"""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import initial_states, own_motion
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import march_of, require_march
from jaxshroud.io.lane_status import AccuracyWarning
from jaxshroud.io.scene_numbers import dimension, scene_differences
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import FAST, Choices, Method, StepCount, choices, method_as_json, method_of
from jaxshroud.march.method_names import TABLEAUS
from jaxshroud.march.stability import steps_for
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import State, law_type
from jaxshroud.orbits.shooting import CLOSING_TOLERANCE, ShootingOptions
from jaxshroud.orbits.short_runs import end_states
from jaxshroud.results.base import Labels
from jaxshroud.scene.checks import DEFAULT_TRANSIENT, InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.ranges import check_ranges
from jaxshroud.scene.scene import Scene, with_plain_orders, without_given
from jaxshroud.scene.schema import RunTable
from jaxshroud.scene.sector import require_sector
from jaxshroud.scene.speed import ORDER
from jaxshroud.scene.text import text_of
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.accuracy import Choice, accuracy_level
from jaxshroud.verbs.lanes import check_verb, flatten_lanes, leading_axes, names_of
from jaxshroud.verbs.trials import EndStates, choose

ACCURACY = "balanced"  # unless an argument or the scene file says how to march
N_PERIODS = 64  # kept periods, unless the argument or the scene file says otherwise
LaneVariable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]  # dimensions, values, attributes


class MarchPlan(NamedTuple):
    """What runs: a method with what it records, and the steps per period. Beside it stands what it was chosen for."""

    steps: int  # per period
    method: Choices
    choice: Choice | None = None  # where an accuracy chose the method
    in_closed_form: str = ""  # the state in which contact stays, where nothing is marched

    @property
    def tried(self) -> Choice | None:
        """The choice, if its accuracy was tried on the scenes."""
        return self.choice if self.choice is not None and self.choice.promised is not None else None

    def plan(self, transient: int, kept: int, phase: float = 0.0) -> Plan:
        """The plan of a run of so many periods."""
        return Plan(transient, kept, self.steps, phase, self.method)

    @property
    def shooting(self) -> ShootingOptions:
        """The options of a search for orbits."""
        return ShootingOptions(self.steps, CLOSING_TOLERANCE[self.method.precision], self.method)

    @property
    def again(self) -> "Asked":
        """The argument `method` of verbs that march the same way."""
        return Asked(plan=self)

    @property
    def untried(self) -> "MarchPlan":
        """The same for parts of a result, in which the accuracy is not given again."""
        return self._replace(choice=None) if self.tried else self

    @property
    def attributes(self) -> dict[str, int | str]:
        """The attributes of results that describe it."""
        chosen = {} if self.choice is None else {"accuracy": str(self.choice)}
        march = method_as_json(method_of(self.steps, self.method))
        method = f"closed form, {self.in_closed_form}" if self.in_closed_form else str(self.method)
        return {"steps_per_period": self.steps, "method": method, "march": march, **chosen}


class Asked(NamedTuple):
    """How to march as it was asked: by an accuracy, by a method or by steps alone, as another verb does, or not at all.

    It is also the argument `method` by which a verb has another one march the same way.
    """

    accuracy: float | None = None
    method: Method | None = None
    steps: StepCount | None = None  # of the method or of the scene file
    plan: MarchPlan | None = None
    by_argument: bool = True  # rather than by a scene file
    told: Callable[[Scene, MarchPlan], None] | None = None  # what a command says of scenes (leading axis) and what runs

    @property
    def requests_accuracy(self) -> bool:
        """Whether an argument asks for an accuracy."""
        return self.by_argument and self.accuracy is not None

    @property
    def says_nothing(self) -> bool:
        """Whether nothing was asked."""
        return self.accuracy is None and self.method is None and self.steps is None and self.plan is None

    @property
    def level(self) -> float | None:
        """The accuracy that chooses the method, by default `ACCURACY`; None where another thing was asked."""
        if self.plan is not None:
            return None if self.plan.choice is None else self.plan.choice.accuracy
        return accuracy_level(ACCURACY) if self.says_nothing else self.accuracy

    @property
    def given_steps(self) -> StepCount:
        """The steps per period that were requested; "auto" where none were."""
        steps = self.steps if self.plan is None else self.plan.steps
        return "auto" if steps is None else steps


MethodArgument = Method | str | float | Asked | None


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
        law = law_type(self.scene)  # in closed form there is nothing to choose
        return self.asked.level if law.is_examined and law.has_events else None

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

    def with_states(self, scenes: Sequence[Scene], state: State | None, march: MarchPlan) -> list[tuple[Scene, State]]:
        """Scenes in the precision of a march, each with its initial state: see `states`."""
        precise = [in_precision(scene, march.method.precision) for scene in scenes]
        states = self.states(state, jax.tree.map(lambda *a: np.stack(a), *precise))
        return [(scene, jax_lane_arrays(states, (lane,))) for lane, scene in enumerate(precise)]

    def labels(self, march: MarchPlan) -> Labels:
        """Keyword arguments of results that label their lanes: the first scene as text, and the numbers that differ."""
        attrs, more = self.provenance(march.steps)
        return {"lanes": self.dims, "attrs": {**attrs, **march.attributes}, "more": more}

    def provenance(self, steps: int) -> tuple[dict[str, str], dict[str, LaneVariable]]:
        """The attributes that say which scene a result is of, and the numbers in which its scenes differ."""
        run = {"periods": self.n_periods, "transient": self.transient, **self._march_entry(steps)}
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


def warn_missed(missed: np.ndarray, choice: Choice, dropped: np.ndarray | None = None) -> None:
    """Warn of `missed_lanes`, if there are any, at the line that calls the verb.

    Args:
        missed: Whether each lane misses the accuracy.
        choice: The method, with the accuracy.
        dropped: The energy that beginnings of flat contact dropped in each lane, over the gross work of the drive.
    """
    if missed.any():
        runs = f"{missed.sum()} of {missed.size} runs may miss the accuracy of {choice.accuracy:.0e} over three periods"
        text = f"{runs}: statistics of chaos bear it, single values do not"
        share = 0.0 if dropped is None else float(np.max(np.nan_to_num(dropped), initial=0.0))
        dropped_text = (
            f"; where faces became flat, up to {share:.0e} of the drive's gross work was dropped" if share > 0 else ""
        )
        warnings.warn(text + dropped_text, AccuracyWarning, stacklevel=4)


def plan_march(
    resolved: ResolvedOptions,
    lanes: Scene,
    usual: Choices,
    *,
    tangents: bool = False,
    periods: float | int | None = None,
    ends: EndStates | None = None,
) -> MarchPlan:
    """The plan by which lanes (leading axis) are marched, from the arguments of `choose_method`.

    With `tangents` lanes are stepped without contact too.

    Raises:
        InputError: See `choose_method`.
        ValueError: The march would be unstable, or JAX has no float64.
    """
    method, choice = choose_method(resolved, lanes, usual, periods=periods, ends=ends)
    asked = resolved.asked
    if asked.plan is None and choice is not None:
        march = MarchPlan(choice.steps, method, choice)
    else:  # the method was not chosen for these lanes: is it stable here?
        precise = in_precision(without_given(lanes), method.precision)
        state = lanes.parts.contact if is_linear(lanes) else ""
        stepping = method.tableau if tangents and not state else march_of(lanes).stepping(method)
        march = MarchPlan(steps_for(precise, 1, asked.given_steps, stepping), method, choice, state)
    if asked.told is not None:
        asked.told(lanes, march)
    return march


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
        InputError: An accuracy is requested for smooth contact or for own laws, or power series for what they lack.
    """
    asked = resolved.asked
    law = law_type(lanes)
    if is_linear(lanes):
        return usual, None
    if not law.is_examined and (asked.requests_accuracy or (asked.plan and asked.plan.choice)):
        raise InputError(
            f"An accuracy can be had for located contact, not for {law.called}; give js.RungeKutta(steps=...)."
        )
    choice = None
    if asked.plan is not None:
        method = asked.plan.method
        choice = asked.plan.choice
    elif asked.method is not None:
        method = choices(asked.method)
    elif resolved.accuracy is None:
        method = usual
    else:
        ends = ends or partial(end_states, ledger=usual.ledger, vibration=usual.vibration)
        periods = resolved.transient + resolved.n_periods if periods is None else periods
        choice = choose(lanes, 1, resolved.accuracy, lane_periods=len(lanes.drive.omega) * periods, ends=ends)
        method = choice.method
        if choice.promised is None:
            if asked.requests_accuracy and asked.told is None:
                warnings.warn(str(choice), AccuracyWarning, stacklevel=5)
            choice = choice if asked.requests_accuracy else None
    require_march(lanes, method)
    return _recording(method, usual, law), choice


def _recording(method: Choices, usual: Choices, law: type[ContactLaw]) -> Choices:
    """The method that records what the usual one does, and the energy balance of laws that have no other check."""
    ledger = usual.ledger or law.may_create_energy
    chosen = {name: getattr(method, name) for name in ("tableau", "locate", "precision", "flat_return")}
    return usual._replace(**chosen, ledger=ledger)


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
    march = plan_march(resolved, resolved.lanes, FAST)
    return method_of(march.steps, march.method)
