"""Linear motions of scenes; of rings of alike blades, those of the smallest ring that moves alike, repeated."""

from typing import cast

import jax
import numpy as np

from jaxshroud.linear.held_contact import LinearState, held_contact
from jaxshroud.linear.linear_motion import LinearMotion, linear_motions, linear_tangents
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import has_period_of_blades, smaller_ring, smallest_ring


def settled_linear_motions(scenes: Scene) -> LinearMotion:
    """The motions of scenes (leading axis) whose contact is asked to stay in one state."""
    ring, copies = smallest_ring(without_given(scenes))
    motion = linear_motions(ring, held_contact(ring, cast(LinearState, scenes.parts.contact)))
    return _copied(motion, copies)


def settled_linear_tangents(scenes: Scene, along: Scene, repeats: int) -> tuple[LinearMotion, LinearMotion]:
    """The motions of scenes (leading axis), each so often, and their derivatives along as many directions.

    A direction along which the sectors become unlike is one of the whole ring.
    """
    ring, copies = smallest_ring(without_given(scenes))
    if copies > 1 and not has_period_of_blades(along, ring.layout.blades):
        ring = without_given(scenes)
        copies = 1
    if copies > 1:
        along = smaller_ring(along, ring.layout.blades)
    value, slopes = linear_tangents(ring, along, repeats)
    return _copied(value, copies), _copied(slopes, copies)


def _copied(motion: LinearMotion, copies: int) -> LinearMotion:
    """The motion of so many copies of a ring as one: the last axis is that of blades or interfaces."""
    if copies == 1:
        return motion
    return jax.tree.map(lambda a: np.tile(a, (*[1] * (np.ndim(a) - 1), copies)), motion)
