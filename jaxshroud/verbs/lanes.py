"""The lanes of verbs that follow each scene separately, and the results and warnings of all of them."""

import warnings
from collections.abc import Callable, Sequence
from itertools import count
from typing import NamedTuple, TypeVar

import jax
import numpy as np

from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.runs import stepping_method
from jaxshroud.batch.threads import Interrupted
from jaxshroud.io.lane_status import LaneWarning
from jaxshroud.io.variable import jax_lane_arrays
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.stability import steps_for
from jaxshroud.model.prepared import State
from jaxshroud.results.base import Labels, Result
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import T
from jaxshroud.scene.valid import in_precision
from jaxshroud.verbs.arguments import ResolvedOptions, check_row, resolve_options
from jaxshroud.verbs.asked import MarchPlan, MethodArgument
from jaxshroud.verbs.plan import plan_march

R = TypeVar("R", bound=Result)


class RequestedLanes(NamedTuple):
    """Scenes, and the plan by which all of them are marched."""

    resolved: ResolvedOptions
    march: MarchPlan

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the leading axes; () for a single scene."""
        return self.resolved.shape

    @property
    def scenes(self) -> list[Scene]:
        """The scene of each lane, as given."""
        return self.resolved.scenes

    def with_states(self, scenes: Sequence[Scene], state: State | None) -> list[tuple[Scene, State]]:
        """Scenes in the method's precision, each with its initial state: see `ResolvedOptions.states`."""
        precise = [in_precision(scene, self.march.method.precision) for scene in scenes]
        states = self.resolved.states(state, jax.tree.map(lambda *a: np.stack(a), *precise))
        return [(scene, jax_lane_arrays(states, (lane,))) for lane, scene in enumerate(precise)]

    @property
    def labels(self) -> Labels:
        """Keyword arguments of results that label their lanes: the first scene as text, and the numbers that differ."""
        attrs, more = self.resolved.provenance(self.resolved.transient, self.march.steps)
        return {"lanes": self.resolved.dims, "attrs": {**attrs, **self.march.attributes}, "more": more}


def request_lanes(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    dims: Sequence[str] | None = None,
    verb: str,
    usual: Choices = FAST,
) -> RequestedLanes:
    """The lanes of a scene, and their march with tangents, from the arguments of `resolve_options`.

    `usual` is the method where only steps are given, with or without a ledger.
    """
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method, dims=dims, verb=verb)
    check_row(resolved.scene)
    return RequestedLanes(resolved, with_tangents(resolved, resolved.lanes, usual))


def with_tangents(resolved: ResolvedOptions, lanes: Scene, usual: Choices = FAST) -> MarchPlan:
    """The plan by which lanes (leading axis) are marched with tangents: in float64 unless the method says otherwise."""
    if resolved.asked.method is None and resolved.asked.plan is None:
        in_precision(lanes, "float64")  # raises before any method is tried
    march = plan_march(resolved, lanes, usual)
    if is_linear(lanes) or stepping_method(lanes, as_differentiable(march.method)) is not None:
        return march
    # tangents are marched without contact too
    return march._replace(steps=steps_for(lanes, 1, resolved.asked.given_steps, march.method.tableau))


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
