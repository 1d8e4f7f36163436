"""The schema of scene files: tables, keys and the validation of values.

Pydantic checks the structure; the numbers are those of `keys`, the words those of `parts`.
"""

# pyright: reportInvalidTypeForm=false
# The types are made from the table of keys, which pyright cannot follow.
from collections.abc import Collection, Sequence
from functools import lru_cache, partial
from itertools import islice
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    create_model,
    model_validator,
)

from jaxshroud.scene.checks import DEFAULT_TRANSIENT, MAX_AUTO_STEPS, MAX_COUNT
from jaxshroud.scene.file_rules import (
    accuracy_in_file,
    coordinates_in_file,
    coupling_is_of_its_layout,
    one_stiffness,
    parts_are_of_its_layout,
    points_are_of_their_face,
    points_in_file,
    sector_in_file,
    shares_in_file,
    smooth_has_a_width,
    static_start_has_no_motion,
)
from jaxshroud.scene.key import FROM_0, Range
from jaxshroud.scene.keys import (
    AERO_KEYS,
    ALL_KEYS,
    COMPLEX_KEYS,
    HARMONIC_KEYS,
    LIMIT_KEYS,
    MAX_BLADES,
    MAX_ORDER,
    MIN_BLADES,
    MODAL_LOAD_KEYS,
    MODE_KEYS,
    ROW_KEYS,
    SINGLE_LOADS,
    TABLES_IN_ROW,
    Key,
    keys_of_table,
    list_words,
    number_shape,
)
from jaxshroud.scene.layout import (
    MOTIONS,
    PAIR,
    SECTOR_OF_CHAIN,
    ContactPart,
    Direction,
    FrictionPart,
    Layout,
    Neighbour,
    Sector,
    misprints,
    row_layout,
)
from jaxshroud.scene.optional import HarmonicForm
from jaxshroud.scene.units import to_si


def _as_list(size: int, words: str, value: Any) -> Any:
    if isinstance(value, list | tuple) and len(value) != size:
        raise ValueError(f"must be one number or {words}")
    return value if isinstance(value, list | tuple) else (value,) * size


def _in_range(allowed: Range, value: float) -> float:
    if not allowed.holds(value):
        raise ValueError(allowed.fault(value))
    return value


def number_type(number: Key) -> Any:
    """The pydantic type of one number, in SI or as a string with a unit."""
    value = Annotated[float, Field(strict=True), AfterValidator(partial(_in_range, number.range))]
    return Annotated[value, BeforeValidator(partial(to_si, number.unit))]


def numbers_type(number: Key, layout: Layout) -> Any:
    """The pydantic type of what a file gives for a key: one number, or one for each blade or interface."""
    one = number_type(number)
    shape = number_shape(number, layout)
    if not shape:
        return one
    many = Annotated[tuple[one, ...], BeforeValidator(partial(_as_list, shape[0], list_words(number, layout)))]
    return Annotated[many, BeforeValidator(partial(to_si, number.unit))]


def _entry(number: Key, layout: Layout) -> Any:
    """The pydantic type of a key."""
    value = numbers_type(number, layout)
    return Annotated[value if number.default is ... else value | None, key(number.about, number.example)]


def _default(number: Key, layout: Layout) -> Any:
    shape = number_shape(number, layout)
    return (number.default,) * shape[0] if shape and isinstance(number.default, float) else number.default


def key(meaning: str, example: Any, **kwargs: Any) -> Any:
    """The field of a key, with its meaning and an example for messages."""
    return Field(description=meaning, examples=[example], **kwargs)


NonNegativeInt = Annotated[int, Field(strict=True, ge=0, le=MAX_COUNT)]
PositiveInt = Annotated[NonNegativeInt, Field(ge=1)]
StepsPerPeriod = Annotated[PositiveInt, Field(le=MAX_AUTO_STEPS)]


class Table(BaseModel):
    """One table of a scene file, in SI units."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _number_table(table: str, layout: Layout, without: Collection[str] = (), **further: Any) -> type[Table]:
    """The model of a table of numbers with `further` fields, and `without` some."""
    rows = [row for row in keys_of_table(table) if row.parts[1] not in without]
    return create_model(f"{table.title()}Table", __base__=Table, **_fields(rows, layout), **further)


def _fields(rows: Sequence[Key], layout: Layout) -> dict[str, Any]:
    """The fields of numbers by their names in a table."""
    return {n.parts[1]: (_entry(n, layout), _default(n, layout)) for n in rows}


ORDERS = {  # of a harmonic
    "order": Annotated[int, Field(strict=True, ge=1, le=MAX_ORDER), key("order, a multiple of drive.omega", 2)],
    "engine_order": Annotated[int, Field(strict=True), key("engine order, by which the order follows", 8)],
}


def _blades_table(layout: Layout, modes: int) -> type[Table]:
    """The model of a [blades] with so many modes; none: they are lumped."""
    if not modes:
        return _number_table("blades", layout)
    rows = [ALL_KEYS[f"blades.modes[{j}].{name}"] for j in range(modes) for name in MODE_KEYS]
    return create_model("BladesTable", __base__=Table, **_fields([*rows, *LIMIT_KEYS.values()], layout))


def _drive_table(layout: Layout, harmonics: tuple[HarmonicForm, ...], modes: int) -> type[Table]:
    """The model of a [drive] with harmonics in tables of their own, see `harmonic_forms`; none: it has but one."""
    if not harmonics:
        return _number_table("drive", layout)
    of_complex = [*COMPLEX_KEYS, *islice(MODAL_LOAD_KEYS, 2 * modes)]
    names = [of_complex if form.is_complex else HARMONIC_KEYS for form in harmonics]
    rows = [ALL_KEYS[f"drive.harmonic[{i}].{name}"] for i, own in enumerate(names) for name in own]
    orders: dict[str, Any] = {f"harmonic[{i}].{one.order}": (ORDERS[one.order], ...) for i, one in enumerate(harmonics)}
    return _number_table("drive", layout, SINGLE_LOADS, **orders, **_fields(rows, layout))


MISTUNING = ROW_KEYS["row.mistuning"]
_IN_SI = BeforeValidator(partial(to_si, ""))


class RandomMistuning(Table):
    """Independent normal deviates, the same for one seed."""

    sigma: Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(partial(_in_range, FROM_0)), _IN_SI]
    seed: NonNegativeInt

    def drawn(self, blades: int) -> list[float]:
        """One deviate per blade."""
        return (self.sigma * np.random.default_rng(self.seed).standard_normal(blades)).tolist()


def _form_of_mistuning(value: Any) -> str | None:
    if isinstance(value, dict):
        return "random" if set(value) == set(RandomMistuning.model_fields) else None
    return "list" if isinstance(value, list) else "number"


_MISTUNING_TYPE = Annotated[
    Annotated[RandomMistuning, Tag("random")]
    | Annotated[list[number_type(MISTUNING)], Tag("list")]
    | Annotated[number_type(MISTUNING), Tag("number")],
    Discriminator(
        _form_of_mistuning,
        custom_error_type="mistuning",
        custom_error_message="must be a number, a list of them, or {sigma = 0.03, seed = 1}",
    ),
]


def _one_per_blade(value: Any, info: Any) -> Any:
    """The mistuning of each blade, drawn where a file gives a standard deviation and a seed."""
    if (blades := info.data.get("blades")) is None:
        return ()  # an error of the number of blades, which is reported
    shown = value.drawn(blades) if isinstance(value, RandomMistuning) else value
    return tuple(
        _in_range(MISTUNING.range, v) for v in _as_list(blades, list_words(MISTUNING, row_layout(blades, True)), shown)
    )


class RowTable(Table):
    """A row of blades in place of the pair."""

    blades: Annotated[int, Field(strict=True, ge=MIN_BLADES, le=MAX_BLADES), key("number of blades", 12)]
    closed: Annotated[bool, Field(strict=True), key("whether the last blade touches the first", True)] = False
    mistuning: Annotated[
        _MISTUNING_TYPE,
        AfterValidator(_one_per_blade),
        key(MISTUNING.about, {"sigma": 0.03, "seed": 1}, validate_default=True),
    ] = 0.0
    sector: Annotated[
        Sector | None,
        AfterValidator(sector_in_file),
        key("march a ring by the fewest blades after which it repeats, or whole", "auto"),
    ] = None

    @model_validator(mode="after")
    def _is_ring(self) -> "RowTable":
        if self.sector is not None and not self.closed:
            raise ValueError(SECTOR_OF_CHAIN)
        return self

    @property
    def layout(self) -> Layout:
        """The layout of the row."""
        return row_layout(self.blades, self.closed)


class PartsTable(Table):
    """The parts of the model of the scene; by default the full model."""

    motion: Annotated[
        tuple[str, ...], BeforeValidator(coordinates_in_file), key("coordinates of a block", ["x", "y"])
    ] = MOTIONS[-1]
    neighbour: Annotated[Neighbour, key("the right block: a blade, or at rest", "rigid")] = "blade"
    friction: Annotated[FrictionPart, key("law of friction", "none")] = "bilinear"
    contact: Annotated[ContactPart, key("law of contact", "smooth")] = "spring"


class RunTable(Table):
    """The length of the run and the method of integration."""

    periods: Annotated[PositiveInt, key("forcing periods kept", 100)]
    transient: Annotated[NonNegativeInt, key("periods discarded before them", 300)] = DEFAULT_TRANSIENT
    steps_per_period: Annotated[
        StepsPerPeriod | Literal["auto"] | None, key("integration steps in one forcing period", 400)
    ] = None
    accuracy: Annotated[
        str | float | None,
        BeforeValidator(accuracy_in_file),
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


READING = (Annotated[frozenset[str], BeforeValidator(misprints), key("misprints kept", "consistent")], frozenset())
_POINTS_KEY = key("points of contact of a face: how many, or where", 2)
_SHARES_KEY = key("share of the stiffnesses of each point", [0.5, 0.5])
_REST_KEY = key("with friction as loads from rest leave it", "from rest")
POINTS = (Annotated[Annotated[Any, BeforeValidator(points_in_file)] | None, _POINTS_KEY], None)
POINT_SHARES = (Annotated[Annotated[Any, BeforeValidator(shares_in_file)] | None, _SHARES_KEY], None)
START = (Annotated[Literal["static"] | None, key("start in the static equilibrium instead", "static")], None)
START_FRICTION = (Annotated[Literal["from rest"] | None, _REST_KEY], None)
TITLE = Annotated[str, key("what the scene shows, in one line", "Fig. 9", pattern=r"^[\P{Cc}\t]*$")]


@lru_cache(maxsize=16)
def table_models(layout: Layout, harmonics: tuple[HarmonicForm, ...], modes: int = 0) -> dict[str, type[Table]]:
    """The models of all tables of a file with lists of tables in them.

    Args:
        layout: The layout of the scene.
        harmonics: Those of its drive, see `harmonic_forms`.
        modes: The number of modes of its blades; 0 for lumped ones.
    """
    return {
        "blades": _blades_table(layout, modes),
        "shroud": _number_table("shroud", layout),
        "contact": _number_table("contact", layout, reading=READING, points=POINTS, shares=POINT_SHARES),
        "friction": _number_table("friction", layout),
        "coupling": _number_table("coupling", layout),
        "drive": _drive_table(layout, harmonics, modes),
        "initial": _number_table("initial", layout, start=START, friction=START_FRICTION),
        "parts": PartsTable,
        "run": RunTable,
        "sweep": SweepTable,
        "row": RowTable,
        "aero": create_model("AeroTable", __base__=Table, **_fields(AERO_KEYS, layout)),
    }


TABLE_MODELS = table_models(PAIR, ())
PHYSICS_TABLES = tuple(TABLE_MODELS)[:8]
ROW_TYPE: TypeAdapter[Any] = TypeAdapter(create_model("FileWithRow", row=(RowTable | None, None)))  # of any file


@lru_cache(maxsize=16)
def scene_file_type(layout: Layout, harmonics: tuple[HarmonicForm, ...], modes: int) -> Any:
    """The pydantic type of a file; the arguments are those of `table_models`."""
    models = table_models(layout, harmonics, modes)
    fields: dict[str, Any] = {
        "title": (TITLE, ""),
        **{table: (model, ...) for table, model in models.items()},
        "contact": (Annotated[models["contact"], AfterValidator(one_stiffness)], ...),
        "initial": (models["initial"], models["initial"]()),
        "parts": (PartsTable, PartsTable()),
        "sweep": (SweepTable | None, None),
        "row": (RowTable | None, None),
        **{table: (models[table] | None, None) for table in TABLES_IN_ROW},
    }
    file: Any = create_model("File", __base__=Table, **fields)
    checked: Any = Annotated[
        file,
        AfterValidator(smooth_has_a_width),
        AfterValidator(points_are_of_their_face),
        AfterValidator(static_start_has_no_motion),
        AfterValidator(partial(parts_are_of_its_layout, layout=layout)),
        AfterValidator(partial(coupling_is_of_its_layout, layout=layout)),
    ]
    return TypeAdapter(checked)
