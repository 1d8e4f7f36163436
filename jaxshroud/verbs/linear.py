"""Scenes whose contact is asked to stay in one state: their settled motion is linear, and in closed form."""

from dataclasses import replace
from typing import overload

from jaxshroud.batch.held_contact import LinearState
from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import SPRUNG
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene


@overload
def in_state(scene: SceneFile, state: LinearState | None) -> SceneFile: ...
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
