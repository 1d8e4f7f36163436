"""The vibration about the mean position: what is left of the power without a static deflection."""

from typing import Any, NamedTuple

import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.model.geometry import gyration_of_sides
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray

TOLD_DIFFERENCE = 1.0  # percentage points: where P_d and P_d_vibration differ by more, both are told


class Positions(NamedTuple):
    """The mean positions of blocks in each of some periods."""

    x: FloatArray  # (lanes, periods, blades) [m]: the left blade of a pair, or all of a row; so are the next three
    y: FloatArray
    sin: FloatArray  # of theta
    versine: FloatArray  # 1 - cos(theta)
    gyration: FloatArray  # (lanes,) polar second moment of a block's area per area, J_A / A [m^2]


def positions_of(scenes: Scene, samples: Sample) -> Positions | None:
    """The mean positions in each kept period of scenes (leading axis); None where they were not integrated."""
    if samples.means is None:
        return None
    x, y, sine, versine = (
        np.stack(a, axis=-1) if isinstance(a, tuple) else np.asarray(a)[..., None] for a in samples.means
    )
    sides = (np.asarray(a, float) for a in (scenes.shroud.l_oa, scenes.shroud.l_ab))
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


def vibration_square(square: Any, means: Any, gyration: Any) -> Any:
    """The mean of `square_about_mean` from means over all periods alone; it has derivatives.

    Args:
        square: The mean square displacement about the position of rest, (blades,) [m^2].
        means: The means of x, y [m], sin(theta) and 1 - cos(theta), (4, blades).
        gyration: Polar second moment of a block's area per area [m^2].
    """
    X, Y, S, V = means
    R = ((1 - V) ** 2 + S**2) ** 0.5
    return square - X**2 - Y**2 - 2 * gyration * S**2 / (R + 1 - V)


def told_difference(P_d: Any, P_d_vibration: Any, counted: str = "P_d") -> str:
    """One sentence where a static deflection makes P_d differ from that of the vibration alone; else empty.

    Args:
        P_d: By Eq. (22), of one lane or of many, of which the one that differs the most is told [%].
        P_d_vibration: About the mean position [%]; None where it is not known.
        counted: Which of them counted: "P_d", "P_d_worst" or "P_d_vibration".
    """
    if P_d_vibration is None:
        return ""
    with_deflection, alone = (np.ravel(np.asarray(a, float)) for a in (P_d, P_d_vibration))
    apart = np.nan_to_num(np.abs(with_deflection - alone), nan=0.0)
    differing = int(np.sum(apart > TOLD_DIFFERENCE))
    if not differing:
        return ""
    at = int(np.argmax(apart))
    where = f", most of {differing} that differ" if len(apart) > 1 else ""
    return (
        f"P_d is {with_deflection[at]:.2f} %, with the static deflection that Eq. (22) counts as vibration, and "
        f"P_d_vibration, of the vibration alone, {alone[at]:.2f} %{where}; {counted} counted"
    )
