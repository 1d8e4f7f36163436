"""From how to march, as it was asked, to what runs."""

from functools import partial
from typing import TypedDict, Unpack

from jaxshroud.batch.marches import march_of, require_march
from jaxshroud.march.method import Choices, choices
from jaxshroud.march.stability import steps_for
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.prepared import law_type
from jaxshroud.motion.short_runs import end_states
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.accuracy import EndStates, choose
from jaxshroud.verbs.asked import Asked, MarchPlan
from jaxshroud.verbs.options import ResolvedOptions
from jaxshroud.verbs.setting import Choice, choice_without_trial, is_tried


class Trials(TypedDict, total=False):
    """How methods are tried for an accuracy."""

    periods: float | None
    """Of the run of each lane; by default those of the arguments."""
    ends: EndStates
    """How lanes are marched to try a method; by default by the programs of `run_lanes`."""


def plan_march(resolved: ResolvedOptions, lanes: Scene, usual: Choices, **trials: Unpack[Trials]) -> MarchPlan:
    """The plan by which lanes (leading axis) are marched, from the arguments of `choose_method`.

    Raises:
        InputError: See `choose_method`.
        ValueError: The march would be unstable, or JAX has no float64.
    """
    method, choice = choose_method(resolved, lanes, usual, **trials)
    known = resolved.asked.plan
    if known is None and choice is not None and choice.steps is not None:
        return MarchPlan(choice.steps, method, choice)
    # the method was not chosen for these lanes: is it stable here?
    lanes = in_precision(without_given(lanes), method.precision)
    steps = steps_for(lanes, 1, resolved.asked.given_steps, march_of(lanes).stepping(method))
    return MarchPlan(steps, method, choice)


def choose_method(
    resolved: ResolvedOptions, lanes: Scene, usual: Choices, **trials: Unpack[Trials]
) -> tuple[Choices, Choice | None]:
    """The method by which lanes (leading axis) are marched, and the choice for an accuracy that it comes from, if any.

    Args:
        resolved: The resolved arguments.
        lanes: The scenes.
        usual: The method where only steps are given, with or without a ledger, and for P_d or not.
        trials: See `Trials`.

    Raises:
        InputError: An accuracy is requested for smooth contact or for own laws, or power series for a row.
    """
    asked, law = resolved.asked, law_type(lanes)
    _refuse_accuracy(asked, law)
    if asked.plan is not None:
        method, choice = asked.plan.method, asked.plan.choice
    elif asked.method is not None:
        method, choice = choices(asked.method), None
    elif resolved.accuracy is None:
        method, choice = usual, None
    elif not is_tried(lanes):
        chosen = choice_without_trial(resolved.accuracy, asked.by_argument, lanes)
        method, choice = chosen.method, None if asked.says_nothing else chosen
    else:
        ends = trials.get("ends") or partial(end_states, ledger=usual.ledger, vibration=usual.vibration)
        periods = trials.get("periods")
        periods = resolved.transient + resolved.n_periods if periods is None else periods
        work = len(lanes.drive.omega) * periods
        choice = choose(without_given(lanes), 1, resolved.accuracy, lane_periods=work, ends=ends)
        method = choice.method
    require_march(lanes, method)
    return _recording(method, usual, law), choice


def _refuse_accuracy(asked: Asked, law: type[ContactLaw]) -> None:
    """Raise InputError where an accuracy is asked for that cannot be had."""
    if not law.is_examined and (asked.accuracy is not None or (asked.plan and asked.plan.choice)):
        raise InputError(
            f"An accuracy can be had for located contact, not for {law.called}; give js.RungeKutta(steps=...)."
        )


def _recording(method: Choices, usual: Choices, law: type[ContactLaw]) -> Choices:
    """The method that records what the usual one does, and the energy balance of laws that have no other check."""
    ledger = usual.ledger or law.may_create_energy
    return usual._replace(tableau=method.tableau, locate=method.locate, precision=method.precision, ledger=ledger)
