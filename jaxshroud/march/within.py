"""What happens inside the steps: how deep contact gets between their ends, and how near a motion comes to grazing."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.events import seat
from jaxshroud.march.locate import Rise
from jaxshroud.model.absent import Scalar
from jaxshroud.model.geometry import touch_rates
from jaxshroud.model.ready import Model
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion


class Within(NamedTuple):
    """Extremes of a lane so far, by the cubic through penetration and its rate at both ends of each trial step."""

    v_max: Scalar  # largest penetration [m]
    fastest: Scalar  # largest closing or opening speed [m/s]
    slowest_onset: Scalar  # closing speed at the gentlest onset [m/s]; infinite where there is none
    nearest_miss: Scalar  # least distance at which the corners turned back without touching [m]; infinite, the same


def nothing_yet(zero: Scalar) -> Within:
    """The extremes before the first step."""
    return Within(zero, zero, zero + jnp.inf, zero + jnp.inf)


def crest(rise: Rise) -> tuple[Scalar, Bool[Array, ""]]:
    """Where the cubic has its local maximum, and whether it has one beyond its start, up to its end."""
    a, b, c = rise.powers
    square = b * b - 3 * a * c
    down = jnp.sqrt(jnp.maximum(square, 0.0)) - b  # the maximum is the root a / down of the derivative
    there = (square > 0) & (down != 0)
    s = a / jnp.where(there, down, 1.0)
    return s, there & (s > 0) & (s <= 1)


def extremes(
    before: Within, held: State, z: Motion, h: Scalar, apart: Bool[Array, ""], onset: Bool[Array, ""], model: Model
) -> Within:
    """The extremes after a trial step of `h` seconds from `held` to the motion `z`, which may end in an `onset`."""
    (v_0, rate_0), (v_1, rate_1) = _penetration(held.motion, held, model), _penetration(z, held, model)
    rise = Rise(v_0, v_1, rate_0 * h, rate_1 * h)
    s, inside = crest(rise)
    top = rise(s)
    deepest = jnp.where(inside, jnp.maximum(top, v_1), v_1)
    missed = apart & inside & (top < 0)
    return Within(
        jnp.where(apart, before.v_max, jnp.maximum(before.v_max, deepest)),
        jnp.maximum(before.fastest, jnp.abs(rate_1)),
        jnp.where(onset, jnp.minimum(before.slowest_onset, rate_1), before.slowest_onset),
        jnp.where(missed, jnp.minimum(before.nearest_miss, -top), before.nearest_miss),
    )


def _penetration(z: Motion, held: State, model: Model) -> tuple[Scalar, Scalar]:
    """V and its rate."""
    _, case, at = seat(z, held, model)
    return at.v, touch_rates(at, z, case, model.reading).v
