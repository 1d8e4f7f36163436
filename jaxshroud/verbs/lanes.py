"""Scenes one by one, for verbs that follow each lane on its own, and what is told of all."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from jaxshroud.batch.states import as_precise
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.state import State, start
from jaxshroud.results.base import Result
from jaxshroud.results.gathered import picked
from jaxshroud.results.scenes import differing
from jaxshroud.results.status import LaneWarning
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.config import SceneFile
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import text_of
from jaxshroud.verbs.accuracy import choose

T = TypeVar("T")
R = TypeVar("R", bound=Result)


class Lanes(NamedTuple):
    """Scenes with how all of them are marched."""

    whole: Scene  # with leading axes, as it was given
    shape: tuple[int, ...]  # of the leading axes; () of a single scene
    dims: tuple[str, ...]
    steps: int
    method: Choices

    @property
    def indices(self) -> list[tuple[int, ...]]:
        """Of each lane, one after the other."""
        return list(np.ndindex(self.shape))

    @property
    def scenes(self) -> list[Scene]:
        """One scene for each lane, as it was given."""
        return [picked(self.whole, lane) if lane else self.whole for lane in self.indices]

    @property
    def precise(self) -> list[Scene]:
        """The scenes in the method's precision."""
        return [in_precision(scene, self.method.precision) for scene in self.scenes]

    def states(self, state: State | None) -> list[State]:
        """Where each lane starts: from its scene's initial motion, from one state for all, or each from its own."""
        scenes = self.precise
        if state is None:
            return [start(scene.initial) for scene in scenes]
        own = np.ndim(state.u_s) > 0
        each = [picked(state, lane) if own else state for lane in self.indices]
        return [as_precise(one, scene) for one, scene in zip(each, scenes, strict=True)]

    def about(self, run: dict[str, Any]) -> dict[str, Any]:
        """What a result tells of the scenes: the first as text, and what differs."""
        attrs = {"title": "", "scene": text_of(self.scenes[0], {**run, "steps_per_period": self.steps})}
        return {"lanes": self.dims, "attrs": attrs, "more": differing(self.whole, self.shape, self.dims)}


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


def told(found: R, lanes: Lanes, throw: bool) -> R:
    """The result of lanes, after a warning of those that failed; with `throw` they are an error."""
    if found.failed and throw:
        raise NumericalError(f"{found!r}")
    if found.failed and lanes.shape:
        warnings.warn(f"{found!r}", LaneWarning, stacklevel=3)
    return found


def lanes_of(
    scene: Scene | SceneFile,
    dims: Sequence[str] | None,
    steps_per_period: Steps | None,
    method: Method | Choices | None,
    accuracy: str | float | None,
) -> Lanes:
    """Scenes, and how they are marched: as asked for, else as the scene file says, else by the default."""
    scene = scene.scene if isinstance(scene, SceneFile) else scene
    shape = np.shape(scene.drive.omega)
    dims = tuple(dims or (("lane",) if len(shape) == 1 else [f"lane_{i}" for i in range(len(shape))]))
    return Lanes(scene, shape, dims, *marching(scene, len(shape), steps_per_period, method, accuracy))


def marching(
    scenes: Scene,
    batch_dims: int,
    steps_per_period: Steps | None,
    method: Method | Choices | None,
    accuracy: str | float | None,
    default: int = 400,
) -> tuple[int, Choices]:
    """Steps per period and static choices of the march, in float64 unless the method itself says otherwise."""
    if accuracy is not None:
        choice = choose(scenes, batch_dims, accuracy)
        return choice.steps, choice.method._replace(precision="float64")
    chosen = choices(FAST if method is None else method)
    steps = default if steps_per_period is None else steps_per_period
    return steps_for(scenes, batch_dims, steps, chosen.tableau), chosen


def one_scene(verb: str, scene: Scene | SceneFile) -> Scene:
    """The one scene that a verb takes.

    Raises:
        ValueError: There are many.
    """
    scene = scene.scene if isinstance(scene, SceneFile) else scene
    shape = np.shape(scene.drive.omega)
    if shape:
        raise ValueError(
            f"`{verb}` takes one scene, but was given {' x '.join(map(str, shape))} of them; call it for each."
        )
    return scene
