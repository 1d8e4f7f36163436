"""Scenes one by one, for verbs that follow each lane on its own, and what is told of all."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import FAST
from jaxshroud.march.stability import steps_for
from jaxshroud.model.state import State
from jaxshroud.results.base import Result
from jaxshroud.results.gathered import picked
from jaxshroud.results.status import LaneWarning
from jaxshroud.scene.errors import InputError, NumericalError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.door import Asked, Marched, asked, marched

T = TypeVar("T")
R = TypeVar("R", bound=Result)


class Lanes(NamedTuple):
    """Scenes, and how all of them are marched."""

    asked: Asked
    how: Marched

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the leading axes; () of a single scene."""
        return self.asked.shape

    @property
    def scenes(self) -> list[Scene]:
        """One scene for each lane, as it was given."""
        whole = self.asked.scene
        return [picked(whole, lane) for lane in np.ndindex(self.shape)] if self.shape else [whole]

    def begun(self, scenes: Sequence[Scene], state: State | None) -> list[tuple[Scene, State]]:
        """Scenes in the method's precision, and where they start: see `Asked.states`."""
        precise = [in_precision(scene, self.how.method.precision) for scene in scenes]
        states = self.asked.states(state, jax.tree.map(lambda *a: np.stack(a), *precise))
        return [(scene, picked(states, (lane,))) for lane, scene in enumerate(precise)]

    @property
    def about(self) -> dict[str, Any]:
        """What a result tells of the scenes: the first as text, and what differs."""
        attrs, more = self.asked.about(self.asked.transient, self.how.steps)
        return {"lanes": self.asked.dims, "attrs": {**attrs, **self.how.told}, "more": more}


def lanes_of(scene: Scene | SceneFile, **asked_for: Any) -> Lanes:
    """Scenes, and how they are marched with tangents, from the arguments of `asked`."""
    request = asked(scene, **asked_for)
    return Lanes(request, with_tangents(request, request.lanes))


def with_tangents(asked: Asked, lanes: Scene) -> Marched:
    """How lanes (leading axis) are marched for derivatives: in float64 unless the method says otherwise."""
    if asked.method is None:
        in_precision(lanes, "float64")  # refused before anything is tried
    how = marched(asked, lanes, FAST, derivatives=True)
    if lanes.parts.contact != "none":
        return how
    steps = "auto" if asked.steps is None else asked.steps  # for tangents, which are marched there too
    return how._replace(steps=steps_for(lanes, 1, steps, how.method.tableau))


def of_all(found: Callable[[], Sequence[Any]], missing: Callable[[int, str], T], throw: bool) -> list[T]:
    """What lanes gave, with what is `missing` told of those that failed, or that were not run before Ctrl-C.

    Raises:
        NumericalError, LinAlgError: What ended the first of the lanes that failed, with `throw`.
        Interrupted: Ctrl-C; `done` has the same.
    """

    def known(lane: int, one: Any) -> T:
        if isinstance(one, Exception) and throw:
            raise one
        return missing(lane, "failed" if one else "not run") if one is None or isinstance(one, Exception) else one

    try:
        return [known(lane, one) for lane, one in enumerate(found())]
    except Interrupted as stopped:
        raise Interrupted(stopped.done and [known(lane, one) for lane, one in enumerate(stopped.done)]) from None


def told(found: R, throw: bool) -> R:
    """The result of lanes, after a warning of those that failed; with `throw` they are an error."""
    if found.failed and throw:
        raise NumericalError(f"{found!r}")
    if found.failed:
        warnings.warn(f"{found!r}", LaneWarning, stacklevel=3)
    return found


def one_scene(verb: str, scene: Scene | SceneFile) -> Scene:
    """The one scene that a verb takes.

    Raises:
        InputError: There are many.
    """
    scene = scene.scene if isinstance(scene, SceneFile) else scene
    shape = np.shape(scene.drive.omega)
    if shape:
        many = " x ".join(map(str, shape))
        raise InputError(f"`{verb}` takes one scene, but was given {many} of them; call it for each.")
    return scene
