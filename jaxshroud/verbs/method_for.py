"""The method for an accuracy."""

import math

from jaxshroud.march.method import FAST, Method, method_of
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.asked import ACCURACY
from jaxshroud.verbs.options import resolve_options
from jaxshroud.verbs.plan import plan_march


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
    march = plan_march(resolved, resolved.lanes, FAST, periods=math.inf)
    return method_of(march.steps, march.method)
