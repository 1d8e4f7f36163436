"""The schema of scene files: tables, keys and the validation of values.

Pydantic checks the structure; the numbers are those of `keys`, the words those of `parts`.
"""

# pyright: reportInvalidTypeForm=false
# The types are made from the table of keys, which pyright cannot follow.
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from jaxshroud.scene.checks import DEFAULT_TRANSIENT, MAX_AUTO_STEPS, MAX_COUNT, did_you_mean
from jaxshroud.scene.keys import Key, Range, keys_of_table
from jaxshroud.scene.parts import ACCURACIES, MOTIONS, ContactPart, Direction, FrictionPart, Neighbour, misprints
from jaxshroud.scene.units import to_si

NO_STIFFNESS = "no_stiffness"  # the type of pydantic's error for a [contact] without one


def _as_pair(value: Any) -> Any:
    if isinstance(value, list) and len(value) != 2:
        raise ValueError("must be one number or a pair [left, right]")
    return value if isinstance(value, list) else (value, value)


def _in_range(allowed: Range, value: float) -> float:
    if not allowed.holds(value):
        raise ValueError(allowed.fault(value))
    return value


def number_type(row: Key, pair: bool = False) -> Any:
    """The pydantic type of a number, or of one per blade, in SI or as strings with a unit."""
    value = Annotated[float, Field(strict=True), AfterValidator(partial(_in_range, row.range))]
    value = Annotated[tuple[value, value], BeforeValidator(_as_pair)] if pair else value
    return Annotated[value, BeforeValidator(partial(to_si, row.unit))]


def _entry(row: Key) -> Any:
    """The pydantic type of a key."""
    value = number_type(row, row.pair)
    return Annotated[value if row.default is ... else value | None, key(row.about, row.example)]


def _default(row: Key) -> Any:
    return (row.default, row.default) if row.pair and isinstance(row.default, float) else row.default


def key(meaning: str, example: Any, **kwargs: Any) -> Any:
    """The field of a key, with its meaning and an example for messages."""
    return Field(description=meaning, examples=[example], **kwargs)


NonNegativeInt = Annotated[int, Field(strict=True, ge=0, le=MAX_COUNT)]
PositiveInt = Annotated[NonNegativeInt, Field(ge=1)]
StepsPerPeriod = Annotated[PositiveInt, Field(le=MAX_AUTO_STEPS)]


class Table(BaseModel):
    """One table of a scene file, in SI units."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _number_table(table: str, **further: Any) -> type[Table]:
    """The model of a table of numbers with `further` fields."""
    fields: dict[str, Any] = {row.parts[1]: (_entry(row), _default(row)) for row in keys_of_table(table)}
    return create_model(f"{table.title()}Table", __base__=Table, **fields, **further)


def _coordinates(value: Any) -> Any:
    if not isinstance(value, list | tuple) or tuple(value) not in MOTIONS:
        raise ValueError('must be ["x"], ["x", "y"] or ["x", "y", "theta"]')
    return tuple(value)


class PartsTable(Table):
    """The parts of the model of the scene; by default the full model."""

    motion: Annotated[tuple[str, ...], BeforeValidator(_coordinates), key("coordinates of a block", ["x", "y"])] = (
        MOTIONS[-1]
    )
    neighbour: Annotated[Neighbour, key("the right block: a blade, or at rest", "rigid")] = "blade"
    friction: Annotated[FrictionPart, key("law of friction", "none")] = "bilinear"
    contact: Annotated[ContactPart, key("law of contact", "smooth")] = "spring"


def _accuracy(value: Any) -> Any:
    named = isinstance(value, str) and value in ACCURACIES
    if not named and (isinstance(value, bool | str) or not 0.999e-10 <= value <= 1.001e-2):
        cure = did_you_mean(value, ACCURACIES) if isinstance(value, str) else ""
        raise ValueError(f"must be {', '.join(ACCURACIES)} or a number from 1e-10 to 1e-2{cure}")
    return value


class RunTable(Table):
    """The length of the run and the method of integration."""

    periods: Annotated[PositiveInt, key("forcing periods kept", 100)]
    transient: Annotated[NonNegativeInt, key("periods discarded before them", 300)] = DEFAULT_TRANSIENT
    steps_per_period: Annotated[
        StepsPerPeriod | Literal["auto"] | None, key("integration steps in one forcing period", 400)
    ] = None
    accuracy: Annotated[
        str | float | None,
        BeforeValidator(_accuracy),
        key("fast, balanced, reference or a number, instead", "fast"),
    ] = None

    @model_validator(mode="after")
    def _one_of_them(self) -> "RunTable":
        if self.accuracy is not None and self.steps_per_period is not None:
            raise ValueError("gives both `accuracy` and `steps_per_period`; keep one of them")
        return self


class SweepTable(Table):
    """The sweep of one or two keys; with two, every entry is a list of two."""

    along: Annotated[list[str], Field(min_length=1, max_length=2), key("key to vary", "contact.gamma")]
    start: Annotated[list[Any] | None, key("first value", 0.0)] = None
    stop: Annotated[list[Any] | None, key("last value", 8.0)] = None
    num: Annotated[list[Annotated[int, Field(strict=True)]] | None, key("number of values", 500)] = None
    values: Annotated[list[list[Any]] | None, key("the values", [0.3, 2.5, 4.2, 7.5])] = None
    direction: Annotated[Direction, key("order of the values", "forward")] = "independent"
    keep: Annotated[PositiveInt | None, key("periods kept in a sweep, instead of run.periods", 100)] = None

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


def _one_stiffness(contact: Any) -> Any:
    cure = "one of them, e.g. gamma = 2.5 (gamma = k / k_x of the left blade)"
    if contact.k is None and contact.gamma is None:
        raise PydanticCustomError(NO_STIFFNESS, f"lacks a stiffness; add {cure}")  # pyright: ignore[reportArgumentType]
    if contact.k is not None and contact.gamma is not None:
        raise ValueError(f"gives both `k` and `gamma`; keep {cure}")
    return contact


def _smooth_has_a_width(file: Any) -> Any:
    smooth, width = file.parts.contact == "smooth", file.contact.width
    if smooth and width is None:
        raise ValueError('[contact] lacks `width`; add it for contact = "smooth", e.g. width = "0.1 um"')
    if smooth and file.contact.reading:
        raise ValueError('[contact] reading must be "consistent" for contact = "smooth"')
    if width is not None and not smooth:
        raise ValueError('[contact] width is for smooth contact; drop it, or add [parts] contact = "smooth"')
    return file


READING = (Annotated[frozenset[str], BeforeValidator(misprints), key("misprints kept", "consistent")], frozenset())
TITLE = Annotated[str, key("what the scene shows, in one line", "Fig. 9", pattern="^.*$")]
TABLE_MODELS: dict[str, type[Table]] = {
    **{table: _number_table(table) for table in ("blades", "shroud")},
    "contact": _number_table("contact", reading=READING),
    **{table: _number_table(table) for table in ("friction", "drive", "initial")},
    "parts": PartsTable,
    "run": RunTable,
    "sweep": SweepTable,
}
PHYSICS_TABLES = tuple(TABLE_MODELS)[:7]
_FIELDS: dict[str, Any] = {
    "title": (TITLE, ""),
    **{table: (model, ...) for table, model in TABLE_MODELS.items()},
    "contact": (Annotated[TABLE_MODELS["contact"], AfterValidator(_one_stiffness)], ...),
    "initial": (TABLE_MODELS["initial"], TABLE_MODELS["initial"]()),
    "parts": (PartsTable, PartsTable()),
    "sweep": (SweepTable | None, None),
}
_File: Any = create_model("File", __base__=Table, **_FIELDS)
_CHECKED: Any = Annotated[_File, AfterValidator(_smooth_has_a_width)]
SCENE_FILE_TYPE: TypeAdapter[Any] = TypeAdapter(_CHECKED)
