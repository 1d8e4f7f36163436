"""A scene prepared for stepping, with all that can be computed once per lane, and the state that it steps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Scalar
from jaxshroud.model.blade import InverseMasses
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.geometry import Corners, corners
from jaxshroud.model.linear import free_reach, steady_amplitudes
from jaxshroud.model.points_contact import PointsContact
from jaxshroud.model.spring_contact import BilinearContact, NoContact, SmoothContact, SpringContact
from jaxshroud.model.user_contact import Laws
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import SPRUNG, ContactPart, Parts
from jaxshroud.scene.scene import Scene


class State(eqx.Module):
    """The motion and the contact of one lane.

    The fields are scalars in compiled code, and arrays of lanes outside.
    """

    motion: Any  # a `Motion`; of marched rows that of the blades' own coordinates
    u_s: Any  # slider of Eq. (2) [m], meaningful in contact only
    mode: Any  # see `Mode`
    case: Any  # 1-4 (Sec. 2.3), 5 in flat contact, 0 when apart


def initial_state(motion: Motion, points: int = 0) -> State:
    """The state at t = 0: apart. A start with the blocks already overlapping becomes an onset at once.

    `points` is the number of points of contact of a face, 0 where a corner touches.
    """
    of_each = (points,) if points else ()
    return State(motion, jnp.zeros(of_each, motion.x.dtype), jnp.zeros(of_each, jnp.int32), jnp.zeros((), jnp.int32))


class Mobility(NamedTuple):
    """What both blocks oppose to forces."""

    inverse: InverseMasses  # of `Pair`s
    share: Scalar  # I_1 / (I_1 + I_2)
    joint: Scalar  # I_1 I_2 / (I_1 + I_2): inertia against a turn of the blocks towards each other [kg m^2]


class Model(eqx.Module):
    """The contact of two blocks prepared for stepping: everything that can be computed once per lane."""

    block: Corners
    law: ContactLaw
    mobility: Mobility
    reading: frozenset[str] = eqx.field(static=True)
    parts: Parts = eqx.field(static=True)


def prepared_model(scene: Scene) -> Model:
    """The constants of the contact of a pair."""
    reading = scene.contact.reading
    block = corners(scene.running_shroud, reading, scene.contact.points)
    return Model(block, prepared_law(scene), _mobility(scene), reading, scene.parts)


def _mobility(scene: Scene) -> Mobility:
    b, has = scene.resting_blades, scene.parts.has

    def of(name, mass):
        return tuple(1 / mass[i] if has(name, i) else ZERO for i in (0, 1))

    share = b.I[0] / (b.I[0] + b.I[1]) if scene.parts.neighbour == "blade" else jnp.zeros_like(b.I[0])
    joint = b.I[1] * share if scene.parts.neighbour == "blade" else b.I[0]
    return Mobility(InverseMasses(of("x", b.m), of("y", b.inertia_y), of("theta", b.I)), share, joint)


def _spring_contact(scene: Scene) -> ContactLaw:
    k = scene.k
    rubs = scene.parts.friction != "none"
    points = scene.contact.points
    if points is not None:
        shares = tuple(points.shares[m] for m in range(points.number))
        element = _friction_element(k, scene) if rubs else None
        return PointsContact(tuple(_spring_of_share(share, k, element) for share in shares), shares)
    return BilinearContact(k, **_friction_element(k, scene)) if rubs else SpringContact(k)


def _spring_of_share(share: Scalar, k: Scalar, element: dict[str, Scalar] | None) -> ContactLaw:
    """The law of a point with a share of the stiffnesses; the lag is that of the whole."""
    if element is None:
        return SpringContact(share * k)
    return BilinearContact(share * k, **element | {"k_d": share * element["k_d"]})


def _kind_of_spring_contact(scene: Scene) -> type[ContactLaw]:
    if scene.contact.points is not None:
        return PointsContact
    return SpringContact if scene.parts.friction == "none" else BilinearContact


def _smooth_contact(scene: Scene) -> ContactLaw:
    k, width = scene.k, scene.contact.width
    assert width is not None  # which scenes with smooth contact have
    haste = _free_speed(scene) / width
    no_friction = {"k_d": ZERO, "mu": ZERO, "lag": ZERO}
    element = no_friction if scene.parts.friction == "none" else _friction_element(k, scene)
    return SmoothContact(k=k, **element, width=width, haste=haste)


def _own_contact(scene: Scene) -> ContactLaw:
    law = scene.laws
    assert isinstance(law, ContactLaw)
    return law.with_stiffnesses(scene.k, scene.friction.k_d) if isinstance(law, Laws) else law


def _kind_of_own_contact(scene: Scene) -> type[ContactLaw]:
    assert isinstance(scene.laws, ContactLaw)
    return type(scene.laws)


class LawOfPart(NamedTuple):
    """The law of contact of the scenes with one `Parts.contact`."""

    made: Callable[[Scene], ContactLaw]
    kind: Callable[[Scene], type[ContactLaw]]  # which says what it can do


LAWS: dict[ContactPart, LawOfPart] = {
    "none": LawOfPart(lambda _: NoContact(), lambda _: NoContact),
    **dict.fromkeys(SPRUNG, LawOfPart(_spring_contact, _kind_of_spring_contact)),
    "smooth": LawOfPart(_smooth_contact, lambda _: SmoothContact),
    "own": LawOfPart(_own_contact, _kind_of_own_contact),
}


def prepared_law(scene: Scene) -> ContactLaw:
    """The law of contact of a scene."""
    return LAWS[scene.parts.contact].made(scene)


def law_type(scene: Scene) -> type[ContactLaw]:
    """The kind of the law of contact of a scene, or of many: a class that says what the law can do."""
    return LAWS[scene.parts.contact].kind(scene)


def _friction_element(k: Scalar, scene: Scene) -> dict[str, Scalar]:
    """The stiffness k_d, mu and the lag of the friction element, guarded against 0/0."""
    k_d, mu = scene.friction.k_d, scene.friction.mu
    has_friction = (k > 0) & (k_d > 0) & (mu > 0)
    lag = mu * k / jnp.where(has_friction, k_d, 1.0)
    return {"k_d": k_d, "mu": jnp.where(has_friction, mu, 0.0), "lag": jnp.where(has_friction, lag, 0.0)}


def _free_speed(scene: Scene) -> Scalar:
    """The largest approach speed of the free blades, and at least one gap per radian [m/s]."""
    free = steady_amplitudes(scene)
    drive = scene.drive
    x = free_reach(free, "x")
    return drive.frequency(max(free)) * (x[0] + x[1] + jnp.abs(scene.running_shroud.gap))


def has_torsion(model: Model) -> bool:
    """Whether the blocks can turn."""
    return "theta" in model.parts.motion


def touches_at_corners(model: Model) -> bool:
    """Whether the blocks can turn and touch at a corner: contact moves from one to another, or may be flat."""
    return has_torsion(model) and not model.law.has_points
