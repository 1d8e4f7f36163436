"""A scene with other parts, or with a law of contact of your own."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.laws import SceneLaw
from jaxshroud.scene.layout import SPRUNG, Parts
from jaxshroud.scene.scene import Contact, Scene
from jaxshroud.scene.typed import typed


def with_parts(scene: Scene, parts: Parts, width: ArrayLike | None = None) -> Scene:
    """The `scene` with other model parts; smooth contact requires a `width` [m]."""
    c = scene.contact
    points = c.points if parts.contact in SPRUNG else None
    contact = Contact(c.k, c.gamma, c.reading, width, points)  # pyright: ignore[reportArgumentType]
    return _with_contact(scene, contact, parts)


@typed
def with_contact_law(scene: Scene, law: SceneLaw) -> Scene:
    """The `scene` with a law of contact of your own in place of the contact spring and the friction element.

    Runge-Kutta methods march such scenes, with located events, and power series if the law is a `LinearLaw`. In Python
    such a scene is like any other; files cannot name a law.

    Args:
        scene: The scene; its reading must be consistent.
        law: `Laws` of a normal force and of friction, or any `ContactLaw` of `jaxshroud.model.contact_law`: its numbers
            are those of each interface.

    Raises:
        InputError: The scene keeps misprints of the article, its faces have several points, or it is a row and a number
            of the law, or its internal state, is an array.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> own = js.with_contact_law(scene, js.Laws(js.Hertz(4e7), js.RegularisedCoulomb(mu=0.3, speed=1e-3)))
        >>> js.sweep(own, {"shroud.gap": [22e-6]}, n_periods=2, transient=1, method=js.RungeKutta(steps=400)).status
        array([0], dtype=int32)
    """
    c = scene.contact
    if c.points is not None:
        raise InputError("Own laws of contact do not know contact points yet; drop `contact.points`.")
    numbers = jax.tree.map(lambda a: a if callable(a) else jnp.asarray(a, float), law, is_leaf=callable)
    arrays = [a for a in jax.tree.leaves(numbers) if jnp.ndim(a) > jnp.ndim(scene.drive.omega)]
    if scene.row is not None and arrays:
        raise InputError("The numbers of a law, and its internal state z, must not be arrays in rows of blades.")
    contact = Contact(c.k, c.gamma, c.reading)
    return _with_contact(scene, contact, scene.parts._replace(contact="own"), numbers)


def _with_contact(scene: Scene, contact: Contact, parts: Parts, laws: SceneLaw | None = None) -> Scene:
    return replace(scene, contact=contact, parts=parts, laws=laws)
