"""The scene: blades, shroud, contact, friction, drive and the initial motion."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.blades import Aero, Blades, Coupling
from jaxshroud.scene.checks import InputError, type_argument, word_argument
from jaxshroud.scene.drive import Drive
from jaxshroud.scene.fields import PerBlade, per_blade, scalar
from jaxshroud.scene.keys import (
    ALL_KEYS,
    AT_REST,
    MAX_BLADES,
    MIN_BLADES,
    ROW_KEYS,
    Motion,
    key_in,
)
from jaxshroud.scene.laws import Number, SceneLaw
from jaxshroud.scene.layout import (
    AERO_FORCES,
    COORDINATES,
    COUPLED_WITHOUT_CONTACT,
    SECTOR_OF_CHAIN,
    SPRUNG,
    Layout,
    Parts,
    Sector,
    Start,
    layout_with,
    misprints,
    require_capability,
    require_parts,
    row_layout,
)
from jaxshroud.scene.modes import ModalBlades, ModeNumbers
from jaxshroud.scene.points import ContactPoints
from jaxshroud.scene.speed import ORDER, check_speed, untwisted_gap
from jaxshroud.scene.typed import short_repr, typed
from jaxshroud.scene.valid import KEYS_BY_TABLE, check_number, check_numbers, check_shape


def _motion_per_blade(motion: Any) -> Any:
    """A motion with one number per blade in each field."""
    return Motion._make(map(per_blade, motion)) if isinstance(motion, Motion) else motion


def _given(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Inputs as arrays, like numbers of a scene."""
    type_argument("given", inputs, Mapping, '{"drive.speed": 150.0}')
    for key in inputs:
        word_argument("given", key, ALL_KEYS)
    return {
        key: None if value is None else per_blade(value) if ALL_KEYS[key].pair else scalar(value)
        for key, value in inputs.items()
    }


def _reading(value: Any) -> Any:
    try:
        return misprints(value)
    except ValueError as error:
        raise InputError(f"Argument `reading` = {value!r} {error}") from None


class Shroud(eqx.Module):
    """The two equal parallelogram blocks and the gap between them (Sec. 2.1, Fig. 2)."""

    alpha: Number = eqx.field(converter=scalar)  # acute angle of the parallelogram [rad]
    l_oa: Number = eqx.field(converter=scalar)  # side along x [m]
    l_ab: Number = eqx.field(converter=scalar)  # side along the contact face [m]
    gap: Number = eqx.field(converter=scalar)  # initial gap Delta along x [m]; negative: interference
    gap_at: Number | None = eqx.field(converter=scalar, default=None)  # at a speed, by which it changes [m]; None: gap
    gap_at_speed: Number | None = eqx.field(converter=scalar, default=None)  # the speed [rad/s]

    def __check_init__(self):
        check_numbers("shroud", self)


class Contact(eqx.Module):
    """The normal spring, given by `k` or by the stiffness ratio `gamma`; the other is None.

    `reading` is the set of misprints of the article that are kept; it is empty for the consistent reading. Only smooth
    contact has a `width`.
    """

    k: Number | None = eqx.field(converter=scalar)  # impact stiffness [N/m]
    gamma: Number | None = eqx.field(converter=scalar)  # k / k_x of the left blade (Sec. 3.1.1)
    reading: frozenset[str] = eqx.field(static=True, converter=_reading, default=frozenset())
    width: Number | None = eqx.field(converter=scalar, default=None)  # over which smooth contact sets in [m]
    points: ContactPoints | None = None  # of the faces; None: a corner touches

    def __check_init__(self):
        if self.points is not None:
            type_argument("points", self.points, ContactPoints, "ContactPoints(2)")
        if (self.k is None) == (self.gamma is None):
            raise InputError("Exactly one of `k` and `gamma` must be given.")
        check_numbers("contact", self)


class Friction(eqx.Module):
    """The bilinear friction element of Eq. (2). `k_d = 0` or `mu = 0` means no friction."""

    k_d: Number = eqx.field(converter=scalar)  # tangential stiffness [N/m]
    mu: Number = eqx.field(converter=scalar)  # friction coefficient [-]

    def __check_init__(self):
        check_numbers("friction", self)


class Row(eqx.Module):
    """A row of blades in place of the pair: an open chain, or a ring, whose last blade touches the first.

    Interface j is between blades j and j + 1. In a scene with a row, numbers per blade have the shape (..., blades),
    and those of an interface (`Key.per_interface`) the shape (..., interfaces).
    """

    blades: int = eqx.field(static=True)
    closed: bool = eqx.field(static=True)
    mistuning: PerBlade  # relative deviation of the stiffnesses k_x, k_y and k_T of each blade
    sector: Sector = eqx.field(static=True)  # "auto": a ring is marched by the fewest blades after which it repeats

    def __init__(self, blades: int, closed: Any = False, mistuning: Any = 0.0, sector: Sector = "whole"):
        if not isinstance(blades, int) or isinstance(blades, bool) or not MIN_BLADES <= blades <= MAX_BLADES:
            raise InputError(f"A row has from {MIN_BLADES} to {MAX_BLADES} blades, not {short_repr(blades)}.")
        if not isinstance(closed, bool | np.bool_):
            raise InputError(f"Argument `closed` of a row must be True or False, but is {short_repr(closed)}.")
        if np.ndim(mistuning) > 1:
            raise InputError(f"A row has one mistuning for each blade, but its shape is {np.shape(mistuning)}.")
        word_argument("sector", sector, Sector)
        if sector != "whole" and not closed:
            raise InputError(SECTOR_OF_CHAIN)
        self.blades = blades
        self.closed = bool(closed)
        self.sector = sector
        check_number(ROW_KEYS["row.mistuning"], mistuning, self.layout)
        self.mistuning = jnp.full(blades, mistuning, float) if np.ndim(mistuning) == 0 else per_blade(mistuning)

    @property
    def layout(self) -> Layout:
        """The layout of its blades."""
        return row_layout(self.blades, self.closed)

    @property
    def interfaces(self) -> int:
        """The number of interfaces: as many as blades in a ring, one less in a chain."""
        return self.layout.interfaces


TABLE_CLASSES = {
    "blades": Blades | ModalBlades,
    "shroud": Shroud,
    "contact": Contact,
    "friction": Friction,
    "drive": Drive,
}


class Scene(eqx.Module):
    """One physical set-up in SI units. Every number is an array leaf, so that scenes batch with `jax.vmap`.

    A scene may be `given` by frequencies, damping ratios or speeds, from which some of its numbers were worked out, see
    `jaxshroud.scene.derived_inputs`. Only `vary` and what varies numbers look at them; a model does not.
    """

    blades: Blades | ModalBlades
    shroud: Shroud
    contact: Contact
    friction: Friction
    drive: Drive
    initial: Motion = eqx.field(converter=_motion_per_blade, default=AT_REST)
    parts: Parts = eqx.field(static=True, default=Parts())
    laws: SceneLaw | None = None  # a user's law of contact
    given: dict[str, Any] = eqx.field(converter=_given, default_factory=dict)  # inputs by their keys
    row: Row | None = None  # None: the pair
    coupling: Coupling = Coupling()  # between neighbours
    aero: Aero = Aero()  # of the flow, in rows alone
    # "motion": at `initial`, apart; "static": in the equilibrium of mean loads and contact without friction, with the
    # sliders where the faces then are; "from rest": where slowly applied mean loads leave blades that rub
    start: Start = eqx.field(static=True, default="motion")

    def __check_init__(self):
        kinds = {**TABLE_CLASSES, "initial": Motion, "parts": Parts, "coupling": Coupling, "aero": Aero}
        for name, kind in kinds.items():
            type_argument(name, getattr(self, name), kind, f"that of another scene, scene.{name}")
        if (self.parts.contact == "own") != (self.laws is not None):
            raise InputError("Own laws of contact are given in Python, by js.with_contact_law; no file can name them.")
        if (self.parts.contact == "smooth") != (self.contact.width is not None):
            raise InputError("A `width` must be given for smooth contact, and only for that.")
        if self.parts.contact == "smooth" and self.contact.reading:
            raise InputError("Smooth contact has no misprints: its `reading` must be consistent.")
        if self.parts.contact == "own" and self.contact.reading:
            raise InputError("Own laws have no misprints: the scene's `reading` must be consistent.")
        if self.contact.points is not None and (self.contact.reading or self.parts.contact not in SPRUNG):
            other = "misprints (`reading`)" if self.contact.reading else f'contact = "{self.parts.contact}"'
            raise InputError(f"Contact points go with located contact in the consistent reading, not with {other}.")
        if self.contact.points is not None:
            self.contact.points.check_on(self.shroud.l_ab)
        if self.row is not None:
            type_argument("row", self.row, Row, "Row(12, closed=True)")
        require_parts(self.parts, self.contact.reading, self.layout)
        if isinstance(self.blades, ModalBlades):
            self._check_modes(self.blades)
        if self.aero.exists:
            require_capability(AERO_FORCES, self.layout)
        if self.is_coupled and self.parts.contact == "none":
            raise InputError(COUPLED_WITHOUT_CONTACT)
        word_argument("start", self.start, Start)
        if self.start != "motion" or self.parts.contact in SPRUNG[1:]:
            self._require_equilibrium()
        check_numbers("initial", self.initial)
        self._check_shapes()
        for key, value in self.given.items():
            if value is not None:
                check_number(key_in(ALL_KEYS[key], self.layout), value, self.layout)
        self._check_speed()

    @typed
    def replace(self, values: Mapping[str, ArrayLike | Sequence[ArrayLike]]) -> "Scene":
        """The scene with numbers replaced, and with them those that are worked out from them.

        Args:
            values: Key -> the new value in SI units; a scalar or, for a per-blade key, one value per blade. A key is
                `table.name`, or `table.name[0]`, `table.name[1]` for one blade only, as `--set` takes it: a number of
                the scene, or another way to give one, such as `drive.speed` for a scene with an engine order, or
                `blades.f_x`. In a row any blade or interface may be named.

        Returns:
            A new scene, as if its file gave these values: `contact.k` drops `contact.gamma` and vice versa,
            `blades.f_x` drops `blades.k_x`; and a scene that is given by frequencies keeps these where its masses
            change.

        Raises:
            KeyNameError: There is no such number, two keys are one, or the scene has no engine order for a speed.
            SceneError: A value is out of its range; traced values are not checked.
        """
        return import_module("jaxshroud.scene.vary").with_checked(self, values)  # which itself imports this module

    def _require_equilibrium(self) -> None:
        """Raise an InputError unless static equilibria of such a scene are known."""
        what = ""
        if self.contact.reading:
            what = "misprints (`reading`), whose contact has no energy"
        elif self.parts.contact not in (*SPRUNG, "none"):
            what = f'contact = "{self.parts.contact}"'
        elif isinstance(self.blades, ModalBlades) and self.parts.contact in SPRUNG[1:]:
            what = "blades by modes, which start so but have no closed form"
        if what:
            raise InputError(f"Static starts and closed forms are of located contact so far, not of {what}.")

    def _check_modes(self, blades: ModalBlades) -> None:
        """Raise an InputError where a scene whose blades are given by modes asks for what these have not."""
        blades.check_moves(self.parts)
        self.check_modal_loads()
        if blades.numbers().kappa and self.parts.neighbour != "blade":
            raise InputError("Modes are coupled, by `kappa`, with those of a blade, not with a rigid neighbour.")
        if self.contact.reading or self.parts.contact == "none":
            other = "misprints (`reading`)" if self.contact.reading else 'contact = "none"; give a large shroud.gap'
            raise InputError(f"Blades by modes do not go with {other}.")

    def check_modal_loads(self) -> None:
        """Raise an InputError unless the blades have the modes on which the drive acts."""
        count = len(self.blades.modes) if isinstance(self.blades, ModalBlades) else 0
        for one in self.drive.harmonic or ():
            for name in getattr(one, "modal", ()):
                if int(name[1:-3]) >= count or self.parts.neighbour != "blade":
                    raise InputError(f"`{name}` acts on a mode of each blade, but these have {count}, or one is rigid.")

    def _check_shapes(self) -> None:
        for key, value in self._named_numbers().items():
            check_shape(ALL_KEYS[key], value, self.layout)

    def _named_numbers(self) -> dict[str, Any]:
        """The numbers of the tables by their keys, those of lists of tables among them."""
        named = {
            key.name: getattr(part, name, None)
            for table, keys in KEYS_BY_TABLE.items()
            for part in (getattr(self, table),)
            for name, key in keys
        }
        named |= {f"drive.{name}": value for name, value in self.drive.of_harmonics().items()}
        if isinstance(self.blades, ModalBlades):
            named |= {f"blades.{entry}": value for entry, value in self.blades.by_entry().items()}
        return {key: value for key, value in named.items() if value is not None}

    def _check_speed(self) -> None:
        numbers = self._numbers_of_speed()
        if not is_traced((numbers, self.given)):
            check_speed(numbers, self.given, self.layout.blades)

    def _numbers_of_speed(self) -> dict[str, Any]:
        """The numbers that depend on the speed, or give it, by their keys."""
        named = {key: a for key, a in self._named_numbers().items() if key.startswith(("blades.", "shroud."))}
        named["drive.omega"] = self.drive.omega
        return named if self.row is None else {**named, "row.mistuning": self.row.mistuning}

    @property
    def depends_on_speed(self) -> bool:
        """Whether stiffnesses or the gap depend on the speed of the rotor."""
        return self.blades.grow or self.shroud.gap_at is not None

    @property
    def k(self) -> Number:
        """The impact stiffness [N/m], in a row (..., interfaces); `gamma k_x` of the left blade if `gamma` is given."""
        if self.contact.k is not None:
            return self.contact.k
        assert self.contact.gamma is not None  # exactly one of them is given
        return self.contact.gamma * self.left_k_x

    @property
    def left_k_x(self) -> Any:
        """The k_x [N/m] of the blade on the left of each interface, without mistuning, to which `gamma` refers."""
        return self.layout.at_interfaces(self.resting_blades.k_x[..., : self.layout.interfaces])

    @property
    def resting_blades(self) -> Blades:
        """The lumped blades at rest, or those that stand for blades by modes, without mistuning."""
        return self.blades if isinstance(self.blades, Blades) else self.blades.numbers().equivalent()

    @property
    def _speed_square(self) -> Any:
        """The square of the speed [rad^2/s^2], where something depends on it."""
        return (self.drive.omega / self.given[ORDER]) ** 2

    def _at_speed(self, factor: Any = 1.0) -> Blades:
        """The lumped blades at the scene's speed, with their stiffnesses at rest times a factor."""
        b = self.blades
        if isinstance(b, ModalBlades):
            return self._mode_numbers(b, factor).equivalent()
        if not isinstance(factor, float):
            stiffnesses = b.k_x, b.k_y, b.k_T
            b = eqx.tree_at(lambda b: (b.k_x, b.k_y, b.k_T), b, tuple(factor * k for k in stiffnesses))
        return b.at_speed(self._speed_square[..., None]) if b.grow else b

    def _mode_numbers(self, blades: ModalBlades, factor: Any) -> ModeNumbers:
        return blades.numbers(factor, self._speed_square[..., None] if blades.grow else None)

    @property
    def running_blades(self) -> Blades:
        """The blades with their stiffness at the scene's speed, without mistuning; of modes see `equivalent`."""
        return self._at_speed()

    @property
    def running_shroud(self) -> Shroud:
        """The shroud with the gap that it has at the scene's speed."""
        s = self.shroud
        if s.gap_at is None or s.gap_at_speed is None:
            return s
        share = (self._speed_square / s.gap_at_speed**2)[(..., *(None for _ in self.layout.interface_shape))]
        gap = untwisted_gap(s.gap, s.gap_at, share)
        return Shroud(s.alpha, s.l_oa, s.l_ab, gap)

    @property
    def mistuned_blades(self) -> Blades:
        """The blades with the mistuning of their row, and their stiffness at the scene's speed."""
        return self._at_speed(self._mistuning)

    @property
    def _mistuning(self) -> Any:
        """The factor of the stiffnesses at rest of each blade."""
        return 1.0 if self.row is None else 1 + self.row.mistuning

    @property
    def mode_numbers(self) -> ModeNumbers | None:
        """The modes of the blades with their mistuning, at the scene's speed; None: lumped blades."""
        return self._mode_numbers(self.blades, self._mistuning) if isinstance(self.blades, ModalBlades) else None

    @property
    def running_modes(self) -> ModalBlades:
        """Blades by modes with the frequencies and damping ratios of the scene's speed, without mistuning."""
        assert isinstance(self.blades, ModalBlades)
        return self._mode_numbers(self.blades, 1.0).as_blades()

    @property
    def layout(self) -> Layout:
        """The layout of the blades: that of the row, or the pair."""
        return layout_with(self.row)

    @property
    def is_coupled(self) -> bool:
        """Whether blades act on each other without contact too."""
        return self.coupling.exists or self.aero.exists

    @property
    def points(self) -> int:
        """The number of points of contact of a face; 0 where a corner touches."""
        return 0 if self.contact.points is None else self.contact.points.number

    @property
    def sliders(self) -> int:
        """How many sliders a state has: one at each interface, or at each of its points."""
        return self.layout.interfaces * max(self.points, 1)

    @property
    def coordinates(self) -> int:
        """How many coordinates a blade has: x, y and theta, or one of each mode."""
        return len(self.blades.modes if isinstance(self.blades, ModalBlades) else COORDINATES)

    @property
    def state_size(self) -> int:
        """How many numbers a state has: the coordinates of each blade and their rates, and the sliders."""
        return 2 * self.coordinates * self.layout.blades + self.sliders


def without_given(scene: Scene) -> Scene:
    """The numbers of a scene alone, which are all that its motion depends on: one program marches all scenes.

    The engine order is kept where its speed matters.
    """
    kept = {ORDER: scene.given[ORDER]} if scene.depends_on_speed else {}
    numbers = with_plain_orders(scene)
    return eqx.tree_at(lambda s: s.given, numbers, kept, is_leaf=lambda part: isinstance(part, dict))


def with_plain_orders(scene: Scene) -> Scene:
    """The same scene, whose harmonics keep their orders whatever becomes of the engine order."""
    drive = scene.drive.with_orders([one.order for one in scene.drive.harmonic or ()], by_engine_order=False)
    return eqx.tree_at(lambda s: s.drive, scene, drive, is_leaf=lambda part: isinstance(part, Drive))
