"""From how to march, as it was asked, to what runs."""

import warnings
from functools import partial

import numpy as np

from jaxshroud.batch.marches import march_of, require_march
from jaxshroud.io.lane_status import AccuracyWarning
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import FAST, Choices, Method, choices, method_of
from jaxshroud.march.stability import steps_for
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import law_type
from jaxshroud.orbits.short_runs import end_states
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import typed
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.arguments import ResolvedOptions, resolve_options
from jaxshroud.verbs.asked import ACCURACY, Asked, Choice, MarchPlan
from jaxshroud.verbs.trials import EndStates, choose


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
    periods: float | None = None,
    ends: EndStates | None = None,
) -> MarchPlan:
    """The plan by which lanes (leading axis) are marched, from the arguments of `choose_method`.

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
        steps = steps_for(precise, 1, asked.given_steps, march_of(precise).stepping(method))
        march = MarchPlan(steps, method, choice, lanes.parts.contact if is_linear(lanes) else "")
    if asked.told is not None:
        asked.told(lanes, march)
    return march


def choose_method(
    resolved: ResolvedOptions,
    lanes: Scene,
    usual: Choices,
    *,
    periods: float | None = None,
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
    _refuse_accuracy(asked, law)
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
            is_requested = asked.by_argument and not asked.says_nothing
            if is_requested and asked.told is None:
                warnings.warn(str(choice), AccuracyWarning, stacklevel=5)
            choice = choice if is_requested else None
    require_march(lanes, method)
    return _recording(method, usual, law), choice


def _refuse_accuracy(asked: Asked, law: type[ContactLaw]) -> None:
    """Raise InputError where an accuracy is requested that cannot be had."""
    is_asked = (asked.by_argument and asked.accuracy is not None) or (asked.plan and asked.plan.choice)
    if is_asked and not law.is_examined:
        raise InputError(
            f"An accuracy can be had for located contact, not for {law.called}; give js.RungeKutta(steps=...)."
        )


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
