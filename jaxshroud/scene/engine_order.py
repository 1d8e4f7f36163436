"""The engine order of a scene: the drive periods in one revolution of the rotor."""

from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene


def engine_order_of(scene: Scene | SceneFile) -> float | None:
    """The engine order that a scene tells; None where it only tells the frequency of the drive."""
    return scene.tables["drive"].get("engine_order") if isinstance(scene, SceneFile) else None
