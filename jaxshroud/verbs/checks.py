"""What verbs refuse before they begin."""

import numpy as np

from jaxshroud.model.prepared import State
from jaxshroud.programs.kept import is_traced
from jaxshroud.scene.capabilities import NO_CONTACT, require_capability, require_points
from jaxshroud.scene.checks import InputError, count_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene


def check_verb(verb: str, scene: Scene | SceneFile) -> None:
    """Raise an InputError if the scene has a row of blades, or a pair, which a verb does not know."""
    where = f"{scene.name}: " if isinstance(scene, SceneFile) else ""
    require_capability(f"`{verb}`", scene.layout, where)
    points = scene.tables["contact"].get("points") if isinstance(scene, SceneFile) else scene.contact.points
    if verb:  # what has no name was asked for by another verb
        require_points(verb, points, where)


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


def check_known_period(q: int | None, state: State | None) -> None:
    """Raise an InputError unless a period number that is given is positive and comes with a state near the orbit."""
    if q is None:
        return
    count_argument("q", q, 1)
    if state is None:
        raise InputError("Argument `q` needs a `state` close to the orbit.")


def one_scene(verb: str, scene: Scene | SceneFile) -> Scene:
    """The single scene that a verb takes.

    Raises:
        InputError: There are many scenes, they are traced, or the verb does not know scenes of this layout.
    """
    check_verb(verb, scene)
    scene = scene.scene if isinstance(scene, SceneFile) else scene
    refuse_traced(scene)
    shape = np.shape(scene.drive.omega)
    if shape:
        lanes = " x ".join(map(str, shape))
        raise InputError(f"`{verb}` takes one scene, but was given {lanes} of them; call it for each.")
    return scene
