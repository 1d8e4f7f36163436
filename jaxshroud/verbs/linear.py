"""Scenes whose contact is asked to stay in one state, or does: their settled motion is linear, and in closed form."""

from dataclasses import replace
from typing import overload

from jaxshroud.batch.held_contact import LinearState
from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import SPRUNG
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.arguments import flatten_lanes, leading_axes
from jaxshroud.verbs.asked import Asked, MethodArgument
from jaxshroud.verbs.settled import kept_state


@overload
def in_state(scene: SceneFile, state: LinearState | None) -> SceneFile: ...
@overload
def in_state(scene: Scene, state: LinearState | None) -> Scene: ...
@overload
def in_state(scene: Scene | SceneFile, state: LinearState | None) -> Scene | SceneFile: ...
def in_state(scene: Scene | SceneFile, state: LinearState | None) -> Scene | SceneFile:
    """The scene with contact that stays in a state; as it is where none is asked for.

    Raises:
        InputError: There is no such state, or contact of this kind has none.
    """
    if state is None:
        return scene
    word_argument("linear", state, LinearState)
    parts = scene.tables["parts"] if isinstance(scene, SceneFile) else scene.parts._asdict()
    if parts["contact"] not in SPRUNG:
        raise InputError(f'Argument `linear` is of contact by springs, not of parts.contact = "{parts["contact"]}".')
    if isinstance(scene, SceneFile):
        return replace(scene, tables={**scene.tables, "parts": {**parts, "contact": state}})
    return with_parts(scene, scene.parts._replace(contact=state))


def default_state(scenes: Scene | SceneFile, method: MethodArgument) -> LinearState | None:
    """The state of contact in which a closed form takes the place of a march; None where it is to march.

    It does where all `scenes` keep one state from their static start on, unless the argument `method` says how to
    march.
    """
    by_file = isinstance(method, Asked) and not method.by_argument
    if method is not None and not by_file:
        return None
    scene = scenes.scene if isinstance(scenes, SceneFile) else scenes
    return kept_state(flatten_lanes(scene, len(leading_axes(scene))))
