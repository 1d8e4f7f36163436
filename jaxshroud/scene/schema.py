"""What a scene file may hold: tables, keys, units and ranges.

pydantic checks structure and ranges, pint converts strings with units.
"""

import functools
import math
import re
from decimal import Decimal
from typing import Annotated, Any, Literal, TypeVar, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from jaxshroud.scene.checks import MOST_COUNT
from jaxshroud.scene.limits import MOST_AUTO
from jaxshroud.scene.parts import MOTIONS, ContactLaw, Direction, FrictionLaw, Neighbour, misprints

T = TypeVar("T")

# What messages call a unit; where two are alike in dimension, the first names what the user gave.
KINDS = {
    "": "a pure number",
    "rad": "an angle",
    "m": "a length",
    "kg": "a mass",
    "s": "a time",
    "N": "a force",
    "m/s": "a speed",
    "rad/s": "a circular frequency",
    "kg m^2": "a moment of inertia",
    "N/m": "a stiffness",
    "N s/m": "a damping",
    "N m": "a moment",
    "N m/rad": "a torsion stiffness",
    "N m s/rad": "a torsion damping",
}
QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)\s*([^\d\s].{0,60})?")


@functools.cache
def _registry() -> Any:
    """Pint's units, imported when the first string is met; decimal, so that "0.022 mm" is exactly 2.2e-5."""
    import pint

    return pint.UnitRegistry(non_int_type=Decimal)  # pyright: ignore[reportArgumentType]


def _units(text: str) -> Any:
    """The pint units called `text`, or a ValueError."""
    registry = _registry()  # what keeps pint from being imported is no fault of the text
    try:
        units = registry.parse_units(f"1{text}" if text.startswith("/") else text)
        registry.Quantity(Decimal(1), units).to_root_units()  # refuses decibels and the like
    except Exception:  # pint's parser raises a dozen types on malformed text
        raise ValueError(f"has an unknown unit `{text}`") from None
    return units


def _to_si(unit: str, value: Any) -> Any:
    """`value` with every string in it converted to the SI `unit`; numbers pass as they are."""
    if isinstance(value, list | tuple):
        return [_to_si(unit, v) for v in value]
    if not isinstance(value, str):
        return value
    match = QUANTITY.fullmatch(value)
    if match is None:
        raise ValueError("is not a number with a unit")
    given = _units(match[2] or "")
    needed = _units(unit)
    if given.dimensionality != needed.dimensionality:
        kind = next((k for u, k in KINDS.items() if _units(u).dimensionality == given.dimensionality), None)
        raise ValueError(f"is {kind or f'of dimension {given.dimensionality}'}, but {KINDS[unit]} is needed")
    if unit == "rad/s" and "hertz" in str(given):  # pint would take 1 Hz for 1 rad/s
        raise ValueError("is a frequency, but a circular frequency is needed")
    return float(_registry().Quantity(Decimal(match[1]), given).to(needed).magnitude)


def si(unit: str) -> BeforeValidator:
    """Accept numbers in SI or strings in any unit of the same dimension as `unit`."""
    return BeforeValidator(functools.partial(_to_si, unit))


def _pair(value: Any) -> Any:
    if isinstance(value, list) and len(value) != 2:
        raise ValueError("must be one number or a pair [left, right]")
    return value if isinstance(value, list) else (value, value)


def key(meaning: str, example: Any, **kwargs: Any) -> Any:
    """What messages say about a key."""
    return Field(description=meaning, examples=[example], **kwargs)


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
FaceAngle = Annotated[Number, Field(gt=0, le=math.pi / 2)]
Whole = Annotated[int, Field(strict=True, ge=0, le=MOST_COUNT)]
Count = Annotated[Whole, Field(ge=1)]
Steps = Annotated[Count, Field(le=MOST_AUTO)]
PerBlade = Annotated[tuple[T, T], BeforeValidator(_pair)]
Misprints = Annotated[frozenset[str], BeforeValidator(misprints)]


class Table(BaseModel):
    """One table of a scene file, in SI units."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class BladesTable(Table):
    """Both blades; `m_y` is `m` unless given."""

    m: Annotated[PerBlade[Positive], si("kg"), key("mass", "0.08 kg")]
    I: Annotated[PerBlade[Positive], si("kg m^2"), key("moment of inertia", "2.46e-3 kg m^2")]
    k_x: Annotated[PerBlade[Positive], si("N/m"), key("bending stiffness in x", "1e5 N/m")]
    k_y: Annotated[PerBlade[Positive], si("N/m"), key("bending stiffness in y", "3e6 N/m")]
    k_T: Annotated[PerBlade[Positive], si("N m/rad"), key("torsion stiffness", "2000 N m/rad")]
    c_x: Annotated[PerBlade[NonNegative], si("N s/m"), key("damping in x", "3.57 N s/m")]
    c_y: Annotated[PerBlade[NonNegative], si("N s/m"), key("damping in y", "19.6 N s/m")]
    c_T: Annotated[PerBlade[NonNegative], si("N m s/rad"), key("torsion damping", "0.506 N m s/rad")]
    m_y: Annotated[PerBlade[Positive], si("kg"), key("mass against motion in y", "0.08 kg")]

    @model_validator(mode="before")
    @classmethod
    def _alike(cls, table: Any) -> Any:
        return {"m_y": table["m"], **table} if isinstance(table, dict) and "m" in table else table


class ShroudTable(Table):
    """The two alike blocks and the gap between them."""

    alpha: Annotated[FaceAngle, si("rad"), key("acute angle of the block, at most pi/2", "60 deg")]
    l_oa: Annotated[Positive, si("m"), key("side along x", "50 mm")]
    l_ab: Annotated[Positive, si("m"), key("side along the contact face", "35 mm")]
    gap: Annotated[Number, si("m"), key("initial gap along x; negative: interference", "0.022 mm")]


class ContactTable(Table):
    """The normal spring, by `k` or by `gamma`, and the misprints kept."""

    k: Annotated[NonNegative | None, si("N/m"), key("impact stiffness", "2.5e5 N/m")] = None
    gamma: Annotated[NonNegative | None, si(""), key("stiffness ratio k / k_x", 2.5)] = None
    reading: Annotated[Misprints, key("misprints kept", "consistent")] = frozenset()
    width: Annotated[Positive | None, si("m"), key("width of smooth contact", "0.1 um")] = None

    @model_validator(mode="after")
    def _one_stiffness(self) -> "ContactTable":
        if (self.k is None) == (self.gamma is None):
            fault = "lacks a stiffness; add" if self.k is None else "gives both `k` and `gamma`; keep"
            raise ValueError(f"{fault} one of them, e.g. gamma = 2.5 (gamma = k / k_x of the left blade)")
        return self


class FrictionTable(Table):
    """The bilinear friction element."""

    k_d: Annotated[NonNegative, si("N/m"), key("tangential stiffness", "1e6 N/m")]
    mu: Annotated[NonNegative, si(""), key("friction coefficient", 0.5)]


class DriveTable(Table):
    """Force and moment on the blades."""

    omega: Annotated[Positive, si("rad/s"), key("circular frequency, 2 pi times the frequency", "536 rad/s")]
    beta: Annotated[PerBlade[Number], si("rad"), key("direction of the force", "30 deg")]
    F_0: Annotated[PerBlade[Number], si("N"), key("force amplitude", "60 N")]
    M_0: Annotated[PerBlade[Number], si("N m"), key("moment amplitude", "100 N m")]
    phase: Annotated[PerBlade[Number], si("rad"), key("phases of the drive", ["0 deg", "180 deg"])]


class InitialTable(Table):
    """Motion at t = 0, at rest unless given."""

    x: Annotated[PerBlade[Number], si("m"), key("displacement in x", "0.01 mm")] = (0.0, 0.0)
    y: Annotated[PerBlade[Number], si("m"), key("displacement in y", "0.01 mm")] = (0.0, 0.0)
    theta: Annotated[PerBlade[Number], si("rad"), key("torsion angle, clockwise", "0.1 deg")] = (0.0, 0.0)
    v_x: Annotated[PerBlade[Number], si("m/s"), key("velocity in x", "0.01 m/s")] = (0.0, 0.0)
    v_y: Annotated[PerBlade[Number], si("m/s"), key("velocity in y", "0.01 m/s")] = (0.0, 0.0)
    v_theta: Annotated[PerBlade[Number], si("rad/s"), key("torsion rate", "0.1 rad/s")] = (0.0, 0.0)


def _coordinates(value: Any) -> Any:
    if not isinstance(value, list | tuple) or tuple(value) not in MOTIONS:
        raise ValueError('must be ["x"], ["x", "y"] or ["x", "y", "theta"]')
    return tuple(value)


class ModelTable(Table):
    """What the model of the scene consists of; the full model unless given."""

    motion: Annotated[tuple[str, ...], BeforeValidator(_coordinates), key("coordinates of a block", ["x", "y"])] = (
        MOTIONS[-1]
    )
    neighbour: Annotated[Neighbour, key("the right block: a blade, or at rest", "rigid")] = "blade"
    friction: Annotated[FrictionLaw, key("law of friction", "none")] = "bilinear"
    contact: Annotated[ContactLaw, key("law of contact", "smooth")] = "spring"


class Run(Table):
    """How long and how finely to integrate."""

    periods: Annotated[Count, key("forcing periods kept", 100)]
    transient: Annotated[Whole, key("periods discarded before them", 300)] = 0
    steps_per_period: Annotated[Steps | Literal["auto"], key("integration steps in one forcing period", 400)]


class SweepTable(Table):
    """One or two keys to vary; with two, every entry is a list of two."""

    along: Annotated[list[str], Field(min_length=1, max_length=2), key("key to vary", "contact.gamma")]
    start: Annotated[list[Any] | None, key("first value", 0.0)] = None
    stop: Annotated[list[Any] | None, key("last value", 8.0)] = None
    num: Annotated[list[Annotated[int, Field(strict=True)]] | None, key("number of values", 500)] = None
    values: Annotated[list[list[Any]] | None, key("the values", [0.3, 2.5, 4.2, 7.5])] = None
    direction: Annotated[Direction, key("order of the values", "forward")] = "independent"
    keep: Annotated[Count | None, key("periods kept in a sweep, instead of run.periods", 100)] = None

    @model_validator(mode="before")
    @classmethod
    def _as_lists(cls, table: Any) -> Any:
        if not isinstance(table, dict) or not isinstance(table.get("along"), str):
            return table
        listed = ("along", "start", "stop", "num", "values")
        return {name: [value] if name in listed else value for name, value in table.items()}

    @model_validator(mode="after")
    def _complete(self) -> "SweepTable":
        ends = [self.start, self.stop, self.num]
        if (self.values is None and None in ends) or (self.values is not None and ends != [None] * 3):
            raise ValueError("needs either `start`, `stop` and `num`, or `values`, e.g. values = [0.3, 2.5]")
        if any(e is not None and len(e) != len(self.along) for e in (*ends, self.values)):
            raise ValueError(f"varies {len(self.along)} keys; give as many entries in every list")
        return self


class File(Table):
    """A whole scene file."""

    title: Annotated[str, key("what the scene shows, in one line", "Fig. 9", pattern="^.*$")] = ""
    blades: BladesTable
    shroud: ShroudTable
    contact: ContactTable
    friction: FrictionTable
    drive: DriveTable
    initial: InitialTable = InitialTable()
    model: ModelTable = ModelTable()
    run: Run
    sweep: SweepTable | None = None

    @model_validator(mode="after")
    def _smooth_has_a_width(self) -> "File":
        smooth, width = self.model.contact == "smooth", self.contact.width
        if smooth and width is None:
            raise ValueError('[contact] lacks `width`; add it for contact = "smooth", e.g. width = "0.1 um"')
        if smooth and self.contact.reading:
            raise ValueError('[contact] reading must be "consistent" for contact = "smooth"')
        if width is not None and not smooth:
            raise ValueError('[contact] width is for smooth contact; drop it, or add [model] contact = "smooth"')
        return self


TABLES: dict[str, type[Table]] = {
    "blades": BladesTable,
    "shroud": ShroudTable,
    "contact": ContactTable,
    "friction": FrictionTable,
    "drive": DriveTable,
    "initial": InitialTable,
    "model": ModelTable,
    "run": Run,
    "sweep": SweepTable,
}
PHYSICS = tuple(TABLES)[:7]


def is_per_blade(table: str, name: str) -> bool:
    """Whether a key has one value per blade."""
    return get_origin(TABLES[table].model_fields[name].annotation) is tuple
