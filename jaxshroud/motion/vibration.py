"""The vibration about the mean position: what is left of the power without a static deflection."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.model.geometry import gyration_of_sides
from jaxshroud.model.linear import StaticPosition, about_static, static_position
from jaxshroud.programs.kept import kept
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray


class Positions(NamedTuple):
    """The mean positions of blocks in each of some periods."""

    x: FloatArray  # (lanes, periods, blades that count) [m], as the next three
    y: FloatArray
    sin: FloatArray  # of theta
    versine: FloatArray  # 1 - cos(theta)
    gyration: FloatArray  # (lanes,) polar second moment of a block's area per area, J_A / A [m^2]


def static_positions(scenes: Scene) -> StaticPosition | None:
    """The static positions of the blades that count of scenes (leading axis), (lanes, 1, blades) each."""
    at = _static_positions(without_given(scenes))
    return at and StaticPosition(*(np.asarray(a, float)[:, None, scenes.layout.counting] for a in at))


@kept()
def _static_positions(scenes: Scene) -> StaticPosition | None:
    return jax.vmap(static_position)(scenes)


def positions_of(scenes: Scene, samples: Sample) -> Positions | None:
    """The mean positions in each kept period of scenes (leading axis); None where they were not integrated.

    With mean loads they are those from the static position without contact, as the power is.
    """
    if samples.means is None:
        return None
    sides = (np.asarray(a, float) for a in (scenes.shroud.l_oa, scenes.shroud.l_ab))
    x, y, sine, versine = about_static(samples.means, static_positions(scenes))
    return Positions(x, y, sine, versine, gyration_of_sides(*sides))


def square_about_mean(square: FloatArray, at: Positions) -> FloatArray:
    """The mean square displacement of each period about the mean position over all of them.

    Args:
        square: That about the position of rest, (lanes, periods, blades) [m^2].
        at: The mean positions.

    Returns:
        A series of the same shape. Its mean over the periods is that of <x^2> - <x>^2 + <y^2> - <y>^2 +
        (2 J_A / A) (1 - R), R^2 = <cos theta>^2 + <sin theta>^2, with means over all periods: the square displacement
        averaged over a block that turns about its mean direction.
    """
    X, Y, S, V = (a.mean(axis=1, keepdims=True) for a in at[:4])
    R = np.hypot(1 - V, S)
    tilt = S / (R + 1 - V)  # the tangent of half the mean angle
    turned = S / R * (at.sin - (1 - at.versine) * tilt)
    return square - X * (2 * at.x - X) - Y * (2 * at.y - Y) - 2 * at.gyration[:, None, None] * turned
