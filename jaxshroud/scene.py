"""What stays fixed while a scene runs: blades, shroud, contact, friction, drive and the starting motion."""

import math
import re
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxshroud.checks import checked, hint, word_argument

Number = Float[Array, ""]
PerBlade = Float[Array, "2"]  # left blade first

MOTIONS = (("x",), ("x", "y"), ("x", "y", "theta"))
MISPRINTS = ("gap_sign", "friction_components", "M_N2_case1", "M_N1_case2", "M_N1_case4", "levers")


def per_blade(value: Any) -> Any:
    """`value` as one number per blade; a single number means alike blades."""
    if isinstance(value, tuple | list):
        return jnp.stack([jnp.asarray(v, dtype=float) for v in value])
    if isinstance(value, ArrayLike):
        value = jnp.asarray(value, dtype=float)
        return jnp.broadcast_to(value, (2,)) if value.ndim == 0 else value
    return value


def scalar(value: Any) -> Any:
    """`value` as a float array, so that changing it never recompiles."""
    return jnp.asarray(value, dtype=float) if isinstance(value, ArrayLike) else value


def misprints(reading: Any) -> Any:
    """The misprints kept by a `reading`: "consistent", "printed", the name of one, or several names.

    Raises:
        ValueError: There is no such misprint.
    """
    words = isinstance(reading, str)
    names = {"consistent": (), "printed": MISPRINTS}.get(reading, (reading,)) if words else reading
    if not isinstance(names, list | tuple | set | frozenset):
        raise ValueError('must be "consistent", "printed" or a list of misprints')
    for name in names:
        if name not in MISPRINTS:
            known = (*MISPRINTS, "consistent", "printed") if words else MISPRINTS
            raise ValueError(f"names the unknown misprint `{name}`{hint(str(name), known)}")
    return frozenset(names)


def _reading(value: Any) -> Any:
    try:
        return misprints(value)
    except ValueError as error:
        raise ValueError(f"Argument `reading` = {value!r} {error}") from None


class Blades(eqx.Module):
    """Both blades as lumped masses on springs (Sec. 2.1, Table 1).

    One value per blade: `blades.m[0]` is the paper's m_1. A single number means alike blades.
    `m_y` differs from `m` only where Eq. (21) is taken literally.
    """

    m: PerBlade = eqx.field(converter=per_blade)  # mass [kg]
    I: PerBlade = eqx.field(converter=per_blade)  # moment of inertia about z [kg m^2]
    k_x: PerBlade = eqx.field(converter=per_blade)  # bending stiffness [N/m]
    k_y: PerBlade = eqx.field(converter=per_blade)  # bending stiffness [N/m]
    k_T: PerBlade = eqx.field(converter=per_blade)  # torsion stiffness [N m/rad]
    c_x: PerBlade = eqx.field(converter=per_blade)  # damping [N s/m]
    c_y: PerBlade = eqx.field(converter=per_blade)  # damping [N s/m]
    c_T: PerBlade = eqx.field(converter=per_blade)  # damping [N m s/rad]
    m_y: PerBlade | None = eqx.field(converter=per_blade, default=None)  # mass in y [kg]; None: m

    @property
    def inertia_y(self) -> Any:
        """The mass against motion in y [kg]."""
        return self.m if self.m_y is None else self.m_y


class Shroud(eqx.Module):
    """The two alike parallelogram blocks and the gap between them (Sec. 2.1, Fig. 2)."""

    alpha: Number = eqx.field(converter=scalar)  # acute angle of the parallelogram [rad]
    l_oa: Number = eqx.field(converter=scalar)  # side along x [m]
    l_ab: Number = eqx.field(converter=scalar)  # side along the contact face [m]
    gap: Number = eqx.field(converter=scalar)  # initial gap Delta along x [m]; negative: interference


class Contact(eqx.Module):
    """The normal spring, given by `k` or by the stiffness ratio `gamma`; the other is None.

    `reading` holds the misprints of the article that are kept: empty is the consistent reading. `width` is asked for
    by smooth contact alone.
    """

    k: Number | None = eqx.field(converter=scalar)  # impact stiffness [N/m]
    gamma: Number | None = eqx.field(converter=scalar)  # k / k_x of the left blade (Sec. 3.1.1)
    reading: frozenset[str] = eqx.field(static=True, converter=_reading, default=frozenset())
    width: Number | None = eqx.field(converter=scalar, default=None)  # over which smooth contact sets in [m]

    def __check_init__(self):
        if (self.k is None) == (self.gamma is None):
            raise ValueError("Exactly one of `k` and `gamma` must be given.")


class Friction(eqx.Module):
    """The bilinear friction element of Eq. (2). `k_d = 0` or `mu = 0` means no friction."""

    k_d: Number = eqx.field(converter=scalar)  # tangential stiffness [N/m]
    mu: Number = eqx.field(converter=scalar)  # friction coefficient [-]


class Drive(eqx.Module):
    """Aerodynamic force `Q_i = F_0 sin(omega t + phase)` at angle `beta` to x, and moment `M_0 sin(...)` (Sec. 3.1)."""

    omega: Number = eqx.field(converter=scalar)  # circular frequency, common to both blades [rad/s]
    beta: PerBlade = eqx.field(converter=per_blade)  # direction of the force [rad]
    F_0: PerBlade = eqx.field(converter=per_blade)  # force amplitude [N]
    M_0: PerBlade = eqx.field(converter=per_blade)  # moment amplitude [N m]
    phase: PerBlade = eqx.field(converter=per_blade)  # the paper's phi_1, phi_2 [rad]

    @property
    def period(self) -> Number:
        """Forcing period T = 2 pi / omega [s]."""
        return 2 * math.pi / self.omega


class Motion(NamedTuple):
    """Displacements and rates of both blocks, left first; theta is positive clockwise.

    A field is `PerBlade` in a scene or state, a `Pair` in compiled loops, and an array (..., 2) in results.
    """

    x: Any  # [m]
    y: Any  # [m]
    theta: Any  # [rad]
    v_x: Any  # [m/s]
    v_y: Any  # [m/s]
    v_theta: Any  # [rad/s]


AT_REST = Motion(*[(0.0, 0.0)] * 6)


Neighbour = Literal["blade", "rigid"]
FrictionLaw = Literal["bilinear", "none"]
ContactLaw = Literal["spring", "smooth", "none"]


@checked
class Parts(NamedTuple):
    """What the model of a scene consists of; ValueError for a part that is not known.

    What is left out is not in the compiled program.
    """

    motion: tuple[str, ...] = ("x", "y", "theta")  # coordinates of a block, see `MOTIONS`
    neighbour: Neighbour = "blade"  # "rigid": the right block stands still
    friction: FrictionLaw = "bilinear"
    contact: ContactLaw = "spring"

    def __check_init__(self):
        if self.motion not in MOTIONS:
            raise ValueError(f"`motion` must be one of {', '.join(map(str, MOTIONS))}, but is {self.motion}.")
        word_argument("neighbour", self.neighbour, Neighbour)
        word_argument("friction", self.friction, FrictionLaw)
        word_argument("contact", self.contact, ContactLaw)

    def has(self, coordinate: str, blade: int) -> bool:
        """Whether a block (0: left, 1: right) moves in a coordinate."""
        return coordinate in self.motion and (blade == 0 or self.neighbour == "blade")


class Scene(eqx.Module):
    """One physical set-up in SI units; every number is an array leaf, so scenes batch with `jax.vmap`."""

    blades: Blades
    shroud: Shroud
    contact: Contact
    friction: Friction
    drive: Drive
    initial: Motion = eqx.field(converter=lambda z: Motion(*map(per_blade, z)), default=AT_REST)
    parts: Parts = eqx.field(static=True, default=Parts())

    def __check_init__(self):
        if (self.parts.contact == "smooth") != (self.contact.width is not None):
            raise ValueError("A `width` must be given for smooth contact, and only for that.")
        if self.parts.contact == "smooth" and self.contact.reading:
            raise ValueError("Smooth contact has no misprints: its `reading` must be consistent.")

    @property
    def k(self) -> Number:
        """Impact stiffness [N/m], `gamma k_x` of the left blade where `gamma` is given."""
        if self.contact.k is not None:
            return self.contact.k
        assert self.contact.gamma is not None  # Contact has exactly one of them
        return self.contact.gamma * self.blades.k_x[0]


def with_parts(scene: Scene, parts: Parts, width: ArrayLike | None = None) -> Scene:
    """`scene` with its model made of other parts; smooth contact asks for a `width` [m]."""
    c = scene.contact
    contact = Contact(c.k, c.gamma, c.reading, width)  # pyright: ignore[reportArgumentType]
    return Scene(scene.blades, scene.shroud, contact, scene.friction, scene.drive, scene.initial, parts)


KEY = re.compile(r"^(?P<table>[a-z]+)\.(?P<name>\w+)(\[(?P<blade>[01])\])?$")
NUMERIC_KEYS = tuple(
    f"{table}.{field}"
    for table, kind in dict(
        blades=Blades, shroud=Shroud, contact=Contact, friction=Friction, drive=Drive, initial=Motion
    ).items()
    for field in kind.__annotations__
    if field != "reading"
)


def key_parts(key: str) -> tuple[str, str, int | None]:
    """Table, name and blade (None: both, or neither) that a key names.

    Raises:
        KeyError: A scene has no such number.
    """
    match = KEY.match(key)
    if match is None or f"{match['table']}.{match['name']}" not in NUMERIC_KEYS:
        raise KeyError(f"The scene has no number called {key!r}.")
    return match["table"], match["name"], None if match["blade"] is None else int(match["blade"])


def _numbers(scene: Scene, key: str) -> Any:
    """The scene's number or numbers that a key names, before a blade is chosen."""
    table, name, blade = key_parts(key)
    old = scene.blades.inertia_y if name == "m_y" else getattr(getattr(scene, table), name)
    if name == "width" and old is None:
        raise KeyError("The scene's contact is not smooth: it has no width.")
    if blade is not None and (old is None or old.ndim == 0):
        raise KeyError(f"{table}.{name!s} is one number, not one per blade.")
    return old


def vary(scene: Scene, key: str, value: ArrayLike) -> Scene:
    """`scene` with one number replaced.

    Args:
        scene: The scene to start from.
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only.
        value: The new value in SI units; a scalar or, for a per-blade key, one value per blade.

    Returns:
        A new scene. Setting `contact.k` drops `contact.gamma`, and the other way round.

    Raises:
        KeyError: There is no such number.
    """
    (table, name, blade), old = key_parts(key), _numbers(scene, key)
    if blade is not None:
        value = old.at[blade].set(value)
    if name in ("k", "gamma"):
        other = {"k": "gamma", "gamma": "k"}[name]
        contact = Contact(**{name: value, other: None}, reading=scene.contact.reading, width=scene.contact.width)
        return eqx.tree_at(lambda s: s.contact, scene, contact)
    new = jnp.broadcast_to(jnp.asarray(value, dtype=old.dtype), old.shape)
    return eqx.tree_at(lambda s: getattr(getattr(s, table), name), scene, new, is_leaf=lambda x: x is None)


def value_of(scene: Scene, key: str) -> float:
    """One number of a scene, in SI units.

    Raises:
        KeyError: There is no such number, or the blades differ and the key names neither `[0]` nor `[1]`.
    """
    blade, old = key_parts(key)[2], _numbers(scene, key)
    if key == "contact.k":
        old = scene.k
    if key == "contact.gamma":
        old = scene.k / scene.blades.k_x[0]
    values = [float(v) for v in jnp.atleast_1d(old)]
    if blade is None and len(set(values)) > 1:
        raise KeyError(f"{key} differs between the blades; name {key}[0] or {key}[1].")
    return values[blade or 0]
