"""A scene with other parts, or with a law of contact of one's own."""

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.laws import FrictionLaw, Laws, NormalLaw, SceneLaw, with_checked_shapes
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
def with_laws(scene: Scene, normal: NormalLaw, friction: FrictionLaw | None = None, z: ArrayLike = 0.0) -> Scene:
    """The `scene` with user laws in place of the contact spring and the friction element.

    Runge-Kutta methods march such scenes, with located onsets, separations and case switches. `contact.k` and
    `friction.k_d` then give the largest stiffness of the laws, on which the check of steps relies. In Python such a
    scene is like any other; files cannot name a law.

    Args:
        scene: The scene; its reading must be consistent.
        normal: `normal(v, v_t) -> (N, energy)`, see `NormalLaw`.
        friction: `friction(z, u_t, N) -> (F, z_t, energy)`, see `FrictionLaw`; None: no friction.
        z: The internal state of friction at each onset, of any shape; a scalar if the law has none.

    Raises:
        InputError: The scene keeps misprints of the article, or a law returns the wrong shapes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]']).scene
        >>> own = js.with_laws(scene, js.Hertz(4e7), js.RegularisedCoulomb(mu=0.3, speed=1e-3))
        >>> js.sweep(own, {"shroud.gap": [22e-6]}, n_periods=2, transient=1, method=js.RungeKutta(steps=400)).status
        array([0], dtype=int32)
    """
    _require_corner(scene)
    contact = Contact(scene.contact.k, scene.contact.gamma, scene.contact.reading)
    parts, laws = scene.parts._replace(contact="own"), with_checked_shapes(Laws(normal, friction, z))
    return _with_contact(scene, contact, parts, laws)


@typed
def with_contact_law(scene: Scene, law: SceneLaw) -> Scene:
    """The `scene` with a law of contact of one's own in place of the contact spring and the friction element.

    Runge-Kutta methods march such scenes, pairs and rows, and power series if it is a `LinearLaw`. In Python such a
    scene is like any other; files cannot name a law.

    Args:
        scene: The scene; its reading must be consistent.
        law: A `ContactLaw` of `jaxshroud.model.contact_law`; its numbers are those of each interface.

    Raises:
        InputError: The scene keeps misprints of the article.
    """
    c = scene.contact
    if isinstance(law, Laws):
        raise InputError("User laws of contact and friction are given by js.with_laws.")
    _require_corner(scene)
    numbers = jax.tree.map(lambda a: jnp.asarray(a, float), law)
    contact, parts = Contact(c.k, c.gamma, c.reading), scene.parts._replace(contact="own")
    return _with_contact(scene, contact, parts, numbers)


def _require_corner(scene: Scene) -> None:
    """Raise an InputError if the faces of a scene have points: own laws are those of a corner so far."""
    if scene.contact.points is not None:
        raise InputError("Own laws of contact do not know contact points yet; drop `contact.points`.")


def _with_contact(scene: Scene, contact: Contact, parts: Parts, laws: SceneLaw | None = None) -> Scene:
    s = scene
    of_row = s.given, s.row, s.coupling, s.aero, s.start
    return Scene(s.blades, s.shroud, contact, s.friction, s.drive, s.initial, parts, laws, *of_row)
