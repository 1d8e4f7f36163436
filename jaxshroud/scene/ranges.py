"""Whether the numbers of a scene are in their ranges: an error where they are known, a truth value where traced."""

from functools import reduce
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.scene.derived_inputs import check_order
from jaxshroud.scene.keys import ALL_KEYS, ROW_KEYS, key_in
from jaxshroud.scene.point_numbers import places_hold, shares_hold
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.speed import ORDER
from jaxshroud.scene.valid import check_number
from jaxshroud.scene.vary import fields_of, inputs_of


def check_ranges(scene: Scene) -> None:
    """Raise an InputError unless all numbers of a scene, or of many, are in their ranges.

    A scene is checked when it is made; what was replaced in it by other means, such as `eqx.tree_at`, is not.
    """
    tables = scene.blades, scene.shroud, scene.contact, scene.friction, scene.drive, scene.coupling, scene.aero
    for table in tables:
        table.__check_init__()
    if scene.row is not None:
        check_number(ROW_KEYS["row.mistuning"], scene.row.mistuning, scene.layout)
    scene.__check_init__()
    check_order(inputs_of(scene))


def ranges_hold(scene: Scene) -> Bool[Array, ""]:
    """Whether all numbers of one scene are in their ranges, inside JAX's transformations: what `check_ranges` asks."""
    given = inputs_of(scene)
    hold: list[Any] = [
        key_in(ALL_KEYS[key], scene.layout).range.holds(value) for key, value in {**fields_of(scene), **given}.items()
    ]
    if (points := scene.contact.points) is not None:
        hold += [shares_hold(points.shares), places_hold(points.lengths(scene.shroud.l_ab), scene.shroud.l_ab)]
    if ORDER in given and "drive.speed" in given:
        hold.append(given[ORDER] > 0)
    if scene.depends_on_speed:
        hold.append(given[ORDER] != 0)
    if (modes := scene.mode_numbers) is not None:
        hold += [k >= 0 for k in modes.stiffness]
    elif scene.blades.grow:
        blades = scene.mistuned_blades
        hold += [blades.k_x > 0, blades.k_y > 0, blades.k_T > 0]
    return reduce(jnp.logical_and, map(jnp.all, hold))
