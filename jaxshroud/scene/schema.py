"""What a scene file may hold: tables, keys and what is wrong with a value.

pydantic checks the structure; the numbers are those of `keys`, the words those of `parts`.
"""

# pyright: reportInvalidTypeForm=false
# Its types are made from the table of keys, which pyright cannot follow.
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

from jaxshroud.scene.checks import MOST_COUNT, meant
from jaxshroud.scene.keys import Key, Range, rows_of
from jaxshroud.scene.limits import MOST_AUTO, TRANSIENT
from jaxshroud.scene.parts import ACCURACIES, MOTIONS, ContactLaw, Direction, FrictionLaw, Neighbour, misprints
from jaxshroud.scene.units import to_si


def _pair(value: Any) -> Any:
    if isinstance(value, list) and len(value) != 2:
        raise ValueError("must be one number or a pair [left, right]")
    return value if isinstance(value, list) else (value, value)


def _in(allowed: Range, value: float) -> float:
    if not allowed.holds(value):
        raise ValueError(allowed.fault(value))
    return value


def number(row: Key, pair: bool = False) -> Any:
    """How pydantic reads one value of a number, or one per blade: in SI, or as strings with a unit."""
    value = Annotated[float, Field(strict=True), AfterValidator(partial(_in, row.range))]
    value = Annotated[tuple[value, value], BeforeValidator(_pair)] if pair else value
    return Annotated[value, BeforeValidator(partial(to_si, row.unit))]


def _entry(row: Key) -> Any:
    """How pydantic reads a key."""
    value = number(row, row.pair)
    return Annotated[value if row.default is ... else value | None, key(row.about, row.example)]


def _default(row: Key) -> Any:
    return (row.default, row.default) if row.pair and isinstance(row.default, float) else row.default


def key(meaning: str, example: Any, **kwargs: Any) -> Any:
    """What messages say about a key."""
    return Field(description=meaning, examples=[example], **kwargs)


Whole = Annotated[int, Field(strict=True, ge=0, le=MOST_COUNT)]
Count = Annotated[Whole, Field(ge=1)]
Steps = Annotated[Count, Field(le=MOST_AUTO)]


class Table(BaseModel):
    """One table of a scene file, in SI units."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _numbers(table: str, **words: Any) -> type[Table]:
    """The model of a table of numbers, and of `words`."""
    fields: dict[str, Any] = {row.parts[1]: (_entry(row), _default(row)) for row in rows_of(table)}
    return create_model(f"{table.title()}Table", __base__=Table, **fields, **words)


def _coordinates(value: Any) -> Any:
    if not isinstance(value, list | tuple) or tuple(value) not in MOTIONS:
        raise ValueError('must be ["x"], ["x", "y"] or ["x", "y", "theta"]')
    return tuple(value)


class PartsTable(Table):
    """What the model of the scene consists of; the full model unless given."""

    motion: Annotated[tuple[str, ...], BeforeValidator(_coordinates), key("coordinates of a block", ["x", "y"])] = (
        MOTIONS[-1]
    )
    neighbour: Annotated[Neighbour, key("the right block: a blade, or at rest", "rigid")] = "blade"
    friction: Annotated[FrictionLaw, key("law of friction", "none")] = "bilinear"
    contact: Annotated[ContactLaw, key("law of contact", "smooth")] = "spring"


def _accuracy(value: Any) -> Any:
    named = isinstance(value, str) and value in ACCURACIES
    if not named and (isinstance(value, bool | str) or not 0.999e-10 <= value <= 1.001e-2):
        cure = meant(value, ACCURACIES) if isinstance(value, str) else ""
        raise ValueError(f"must be {', '.join(ACCURACIES)} or a number from 1e-10 to 1e-2{cure}")
    return value


class Run(Table):
    """How long and how finely to integrate."""

    periods: Annotated[Count, key("forcing periods kept", 100)]
    transient: Annotated[Whole, key("periods discarded before them", 300)] = TRANSIENT
    steps_per_period: Annotated[Steps | Literal["auto"] | None, key("integration steps in one forcing period", 400)] = (
        None
    )
    accuracy: Annotated[
        str | float | None, BeforeValidator(_accuracy), key("fast, balanced, reference or a number, instead", "fast")
    ] = None

    @model_validator(mode="after")
    def _one_of_them(self) -> "Run":
        if self.accuracy is not None and self.steps_per_period is not None:
            raise ValueError("gives both `accuracy` and `steps_per_period`; keep one of them")
        return self


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


def _one_stiffness(contact: Any) -> Any:
    if (contact.k is None) == (contact.gamma is None):
        fault = "lacks a stiffness; add" if contact.k is None else "gives both `k` and `gamma`; keep"
        raise ValueError(f"{fault} one of them, e.g. gamma = 2.5 (gamma = k / k_x of the left blade)")
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
TABLES: dict[str, type[Table]] = {
    **{table: _numbers(table) for table in ("blades", "shroud")},
    "contact": _numbers("contact", reading=READING),
    **{table: _numbers(table) for table in ("friction", "drive", "initial")},
    "parts": PartsTable,
    "run": Run,
    "sweep": SweepTable,
}
PHYSICS = tuple(TABLES)[:7]
_FIELDS: dict[str, Any] = {
    "title": (TITLE, ""),
    **{table: (model, ...) for table, model in TABLES.items()},
    "contact": (Annotated[TABLES["contact"], AfterValidator(_one_stiffness)], ...),
    "initial": (TABLES["initial"], TABLES["initial"]()),
    "parts": (PartsTable, PartsTable()),
    "sweep": (SweepTable | None, None),
}
_File: Any = create_model("File", __base__=Table, **_FIELDS)
_CHECKED: Any = Annotated[_File, AfterValidator(_smooth_has_a_width)]
FILE: TypeAdapter[Any] = TypeAdapter(_CHECKED)
