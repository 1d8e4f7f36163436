"""Whether the blades of a scene are pressed or bent at rest, and which reduction counts then."""

import numpy as np

from jaxshroud.scene.optional import MEAN_LOADS
from jaxshroud.scene.quantities import RequiredReduction
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import fields_of


def is_preloaded(scene: Scene) -> bool:
    """Whether there is a mean load or interference in a scene, or in some of many."""
    numbers = fields_of(scene)
    loaded = any(np.any(np.asarray(numbers[key])) for key in MEAN_LOADS if key in numbers)
    return loaded or (scene.parts.contact != "none" and bool(np.any(np.asarray(scene.running_shroud.gap) < 0)))


def counted_reduction(scene: Scene) -> RequiredReduction:
    """The reduction that counts where none is asked for: of a preloaded scene that of the vibration about its mean."""
    return "P_d_vibration" if is_preloaded(scene) else "P_d"
