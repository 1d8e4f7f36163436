"""Scene files: TOML in, a checked `Scene` with its run and sweep out.

The first problem of a file becomes one line that names file, table, key and cure.
"""

import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import tomli_w
from pydantic import (
    TypeAdapter,
    ValidationError,
)
from pydantic.fields import FieldInfo

from jaxshroud.scene.checks import hint, meant
from jaxshroud.scene.limits import MOST_VALUES
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.parts import MISPRINTS, Direction, Parts
from jaxshroud.scene.scene import Blades, Contact, Drive, Friction, Scene, Shroud
from jaxshroud.scene.schema import PHYSICS, TABLES, File, Run, SweepTable, Table, is_per_blade
from jaxshroud.scene.vary import NUMERIC_KEYS

OVERRIDE = re.compile(r"\s*([a-z]+)\.(\w+)(?:\[([01])\])?\s*=\s*(\S.*?)\s*")
# Setting the left key drops the right ones: they say the same thing another way.
RIVALS = {
    ("contact", "k"): [("contact", "gamma")],
    ("contact", "gamma"): [("contact", "k")],
    ("run", "periods"): [("sweep", "keep")],
    ("sweep", "values"): [("sweep", "start"), ("sweep", "stop"), ("sweep", "num")],
    **{("sweep", key): [("sweep", "values")] for key in ("start", "stop", "num")},
}


class SceneError(ValueError):
    """A scene file or an override is wrong; the message is one line with file, table, key and cure."""


def _fail(where: str, what: str) -> NoReturn:
    raise SceneError(" ".join(f"{where}: {what}".split()))


@dataclass(frozen=True, eq=False)
class Axis:
    """One key of a sweep and its values in SI units, float64 (n,)."""

    key: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class SceneFile:
    """A loaded scene: the physics, how to run it and what to sweep.

    `run`, `axes`, `direction` and `keep` may be replaced with `dataclasses.replace`; to change the physics,
    `load` again with an override, so that `text` stays true.
    """

    name: str
    title: str
    scene: Scene
    tables: Mapping[str, Mapping[str, Any]]  # the physics as plain SI numbers, as `text` writes it
    run: Run
    axes: tuple[Axis, ...] = ()
    direction: Direction = "independent"
    keep: int | None = None  # periods kept in a sweep, where they differ from `run.periods`

    def __post_init__(self):
        stems = [re.sub(r"\[.\]", "", "contact.k" if a.key == "contact.gamma" else a.key) for a in self.axes]
        alike = len(stems) == 2 and stems[0] == stems[1] and {a.key[-3:] for a in self.axes} != {"[0]", "[1]"}
        if alike or len(stems) > 2:
            names = ", ".join(a.key for a in self.axes)
            _fail(self.name, f"[sweep] along: {names} is no grid; give one or two independent keys")

    @property
    def sweep_run(self) -> Run:
        """`run` as a sweep uses it: [sweep] keep takes the place of [run] periods."""
        return self.run if self.keep is None else self.run.model_copy(update={"periods": self.keep})

    def text(self) -> str:
        """The resolved file as TOML, overrides included, in SI numbers: loading it gives the same scene."""
        tables = {"title": self.title, **self.tables, "run": self.run.model_dump()}
        if self.axes:
            tables["sweep"] = _sweep_table(self)
        return tomli_w.dumps(tables)


def _sweep_table(scene_file: SceneFile) -> dict[str, Any]:
    axes = scene_file.axes
    columns: dict[str, list[Any]] = {"along": [a.key for a in axes]}
    if all(np.array_equal(a.values, np.linspace(a.values[0], a.values[-1], a.values.size)) for a in axes):
        columns["start"] = [float(a.values[0]) for a in axes]
        columns["stop"] = [float(a.values[-1]) for a in axes]
        columns["num"] = [a.values.size for a in axes]
    else:
        columns["values"] = [a.values.tolist() for a in axes]
    table = {name: column[0] if len(axes) == 1 else column for name, column in columns.items()}
    keep = {} if scene_file.keep is None else {"keep": scene_file.keep}
    return {**table, "direction": scene_file.direction, **keep}


def _plain(table: Table) -> dict[str, Any]:
    """A physics table as TOML values; pairs of equals become one number."""
    plain: dict[str, Any] = {}
    for name, value in table:
        if name == "reading":
            kept = [m for m in MISPRINTS if m in value]
            plain[name] = {0: "consistent", len(MISPRINTS): "printed"}.get(len(kept), kept)
        elif name == "motion":
            plain[name] = list(value)
        elif value is not None:
            plain[name] = value[0] if isinstance(value, tuple) and value[0] == value[1] else value
    if plain.get("m_y", 0) == plain.get("m"):
        del plain["m_y"]  # so that an override of m on the written file moves both, as on the original
    return plain


def _scene(file: File) -> Scene:
    m_y = None if file.blades.m_y == file.blades.m else file.blades.m_y
    return Scene(
        blades=Blades(**{**dict(file.blades), "m_y": m_y}),
        shroud=Shroud(**dict(file.shroud)),
        contact=Contact(**dict(file.contact)),
        friction=Friction(**dict(file.friction)),
        drive=Drive(**dict(file.drive)),
        initial=Motion(**dict(file.initial)),
        parts=Parts(**dict(file.model)),
    )


# Messages


def _shown(value: Any) -> str:
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except ValueError:  # Python does not write whole numbers of more than 4,300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def _told(problem: Any) -> str:
    """Pydantic's account of a problem, in our words where a validator of ours found it."""
    context = problem.get("ctx", {})
    given, known = problem["input"], re.findall(r"'(\w+)'", context.get("expected", ""))
    cure = meant(given, known) if isinstance(given, str) else ""
    return str(context.get("error", re.sub(r"^\w+ should", "must", problem["msg"]))) + cure


def _example(field: FieldInfo) -> Any:
    return (field.examples or [""])[0]


def _problem(error: ValidationError, document: dict[str, Any]) -> tuple[str, str, str]:
    """Table, key and description of the first problem; unknown keys first: they explain missing ones."""
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    if not first["loc"]:
        return "model", "contact", _told(first)
    table, name = (*map(str, first["loc"][:2]), "")[:2]
    told = _told(first)
    if name == "":
        return table, name, _table_problem(table, first["type"], told)
    fields = TABLES[table].model_fields
    if first["type"] == "extra_forbidden":
        return table, name, f"[{table}] has no key `{name}`{hint(name, list(fields))}"
    example, meaning = _shown(_example(fields[name])), fields[name].description
    if first["type"] == "missing" and len(first["loc"]) == 2:
        return table, name, f"[{table}] lacks `{name}`; add it, e.g. {name} = {example} ({meaning})"
    given = _shown(document[table].get(name, document[table].get("m")))
    return table, name, f"[{table}] {name} = {given} {told}, e.g. {name} = {example} ({meaning})"


def _table_problem(table: str, kind: str, told: str) -> str:
    if kind == "extra_forbidden":
        return f"there is no table [{table}]{hint(table, list(File.model_fields))}"
    if kind == "missing":
        return f"[{table}] is missing; add this table with {', '.join(TABLES[table].model_fields)}"
    if table not in TABLES:
        return f'{table} must be one line of text, e.g. {table} = "Fig. 9"'
    return f"[{table}] {told if kind == 'value_error' else 'must be a table of keys'}"


# Overrides


def _literal(text: str) -> Any:
    """A value from the command line: a number, TOML, a comma-separated list, or else a string."""
    for read in (int, float, lambda t: tomllib.loads(f"v = {t}")):
        try:
            value = read(text)
        except (ValueError, RecursionError):
            continue
        if not isinstance(value, dict):
            return value
        if list(value) == ["v"]:
            return value["v"]
    return [_literal(t.strip()) for t in text.split(",")] if "," in text and text[0] != "[" else text


def _override(document: dict[str, Any], text: str) -> tuple[str, str]:
    """Set one key of `document` in place and return its table and name."""
    match = OVERRIDE.fullmatch(text)
    if match is None:
        _fail("--set", f"{_shown(text)} is not table.key=value, e.g. --set contact.gamma=3")
    table, name, blade, value = match[1], match[2], match[3], _literal(match[4])
    rows = document.setdefault(table, {})
    if not isinstance(rows, dict):
        return "", ""  # the fault is the file's
    if blade is not None:
        if table in TABLES and name in TABLES[table].model_fields and not is_per_blade(table, name):
            _fail("--set", f"[{table}] {name} is one number, not one per blade; drop the [{blade}]")
        old = rows.get(name, rows.get("m") if name == "m_y" else 0.0 if table == "initial" else None)
        pair = old if isinstance(old, list) else [old, old]
        if old is None or len(pair) != 2:
            return "", ""  # the fault is the file's
        value = [value if i == int(blade) else v for i, v in enumerate(pair)]
    rows[name] = value
    for other, rival in RIVALS.get((table, name), []):
        if isinstance(document.get(other), dict):
            document[other].pop(rival, None)
    return table, name


# Loading


def _in_range(where: str, table: str, name: str, values: list[Any]) -> list[float]:
    """`values` in SI, checked against the range of the key [table] name."""
    field = TABLES[table].model_fields[name]
    if any(isinstance(v, list | dict) or v is None for v in values):
        _fail(where, f"{_shown(values)} must be one number per value")
    adapter, points = TypeAdapter(field.rebuild_annotation()), []
    for value in values:
        try:
            point = adapter.validate_python(value)
        except ValidationError as error:
            told, example = _told(error.errors()[0]), _shown(_example(field))
            _fail(where, f"{_shown(value)} {told}, e.g. {example} ({field.description})")
        points.append(point[0] if isinstance(point, tuple) else point)
    return points


def _same_units(where: str, values: list[Any]) -> None:
    """Refuse the text of a bare number after one with a unit, as in `1mm,2`: two metres are hardly meant."""
    texts = [v for v in values if isinstance(v, str)]
    bare = [isinstance(_literal(v), int | float) for v in texts]
    for i, text in enumerate(texts):
        if bare[i] and not all(bare[:i]):
            _fail(where, f"{_shown(text)} has no unit, but {_shown(texts[bare.index(False)])} before it has; add one")


def _listed(values: Any) -> list[Any]:
    """A sequence of values; those of a text that is no TOML as the texts between its commas."""
    if isinstance(values, str):
        values = _literal(values) if values.lstrip().startswith("[") else [v.strip() for v in values.split(",")]
    values = values.tolist() if hasattr(values, "tolist") else values
    return list(values) if isinstance(values, list | tuple) else [values]


def axis(
    scene_file: SceneFile,
    key: str,
    values: Any = None,
    *,
    start: Any = None,
    stop: Any = None,
    num: int | None = None,
    where: str = "",
) -> Axis:
    """One key to sweep and its values, checked against the scene.

    Args:
        scene_file: The scene that is swept.
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only.
        values: Numbers in SI or strings with units (a list, an array or "a,b,c"); or else `start`,
            `stop` and `num` for equally spaced ones.
        start: First value.
        stop: Last value.
        num: Number of values.
        where: What error messages name first; by default the command line's `--along`.

    Raises:
        SceneError: The scene has no such number, a value is out of its range, or fewer than two differ.
    """
    where, known = where or f"--along {key}", NUMERIC_KEYS
    match = re.fullmatch(r"(([a-z]+)\.(\w+?))(\[[01]\])?", key)
    if match is None or match[1] not in known:
        _fail(where, f"the scene has no number `{key}`{hint(key, known)}")
    table, name, blade = match[2], match[3], match[4]
    if blade and not is_per_blade(table, name):
        _fail(where, f"{table}.{name} is one number, not one per blade; drop the {blade}")
    if name == "width" and scene_file.scene.contact.width is None:
        _fail(where, 'the scene\'s contact is not smooth and has no width; add [model] contact = "smooth"')
    ends = [start, stop, num]
    if (values is None and None in ends) or (values is not None and ends != [None] * 3):
        _fail(where, "needs either values, or start, stop and num")
    given = [start, stop] if values is None else _listed(values)
    _same_units(where, given)
    points = _in_range(where, table, name, [_literal(v) if isinstance(v, str) else v for v in given])
    size = len(points) if num is None else num
    if size < 2 or len(set(points)) < 2:
        count = max(0, min(size, len(set(points))))
        _fail(
            where,
            f"{count} different value{'s' * (count != 1)} given; a sweep needs at least two, e.g. num = 100",
        )
    if size > MOST_VALUES:
        _fail(where, f"num must be at most {MOST_VALUES}")
    grid = points if values is not None else np.linspace(points[0], points[1], size)
    return Axis(key, np.asarray(grid, np.float64))


def _axes(scene_file: SceneFile, sweep: SweepTable, where: str) -> tuple[Axis, ...]:
    columns = {name: getattr(sweep, name) for name in ("values", "start", "stop", "num")}
    return tuple(
        axis(scene_file, key, where=f"{where} {key}", **{n: c and c[i] for n, c in columns.items()})
        for i, key in enumerate(sweep.along)
    )


def parse(text: str, name: str, overrides: Sequence[str] = ()) -> SceneFile:
    """The scene in TOML `text`; messages call it `name`. See `load`."""
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: a number of 5,000 digits
        _fail(name, f"not valid TOML: {error}")
    blamed = {_override(document, override) for override in overrides}
    try:
        file = File.model_validate(document)
    except ValidationError as error:
        table, key, told = _problem(error, document)
        by_override = (table, key) in blamed or (table not in TABLES and table in dict(blamed))
        _fail("--set" if by_override else name, told)
    tables = {table: _plain(getattr(file, table)) for table in PHYSICS}
    loaded = SceneFile(name, file.title, _scene(file), tables, file.run)
    if file.sweep is None:
        return loaded
    where = f"{'--set' if 'sweep' in dict(blamed) else name}: [sweep]"
    axes = _axes(loaded, file.sweep, where)
    return replace(loaded, axes=axes, direction=file.sweep.direction, keep=file.sweep.keep)


def _config_dir() -> Path:
    package = Path(__file__).parent.parent
    inside = package / "configs"  # in a wheel; in a checkout they lie beside the package
    return inside if inside.is_dir() else package.parent / "configs"


def shipped() -> dict[str, str]:
    """Name and title of every shipped scene."""
    paths = sorted(_config_dir().glob("*.toml"))
    return {path.stem: tomllib.loads(path.read_text("utf-8")).get("title", "") for path in paths}


def load(source: str | os.PathLike, overrides: Sequence[str] = ()) -> SceneFile:
    """Read a scene file.

    Args:
        source: A path, or the name of a shipped scene such as "fig09".
        overrides: `table.key=value` each, in order; `contact.gamma` replaces `contact.k` and vice versa.

    Raises:
        SceneError: The file or an override is wrong; the message is one line with the place and the cure.
    """
    path, name = Path(source), os.fspath(source)
    if not os.path.isfile(path):
        names = [p.stem for p in sorted(_config_dir().glob("*.toml"))]
        if name.removesuffix(".toml") not in names:
            cure = hint(path.name.removesuffix(".toml"), names)
            _fail(name, f"no such file or shipped scene{cure}; `jaxshroud scenes` lists the shipped ones")
        path = _config_dir() / f"{name.removesuffix('.toml')}.toml"
        name = path.name
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        _fail(name, f"cannot be read as UTF-8 text: {error}")
    return parse(text, name, overrides)
