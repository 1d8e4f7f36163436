"""A loaded scene file: the physics as plain numbers, the run and the sweep."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from jaxshroud.scene.checks import fail
from jaxshroud.scene.derived_inputs import in_tables, same_quantity
from jaxshroud.scene.layout import Direction, Layout, reading_text
from jaxshroud.scene.nested_tables import nested
from jaxshroud.scene.replacing import layout_of
from jaxshroud.scene.schema import RunTable, Table
from jaxshroud.scene.speed import without_zeros
from jaxshroud.scene.typed import typed

if TYPE_CHECKING:
    import jaxshroud.scene.scene


@dataclass(frozen=True, eq=False)
class Axis:
    """One key of a sweep and its values in SI units, float64 (n,)."""

    key: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class SceneFile:
    """A loaded scene: the physics, the run and the sweep.

    `run`, `axes`, `direction` and `keep` may be replaced with `dataclasses.replace`; to change the physics,
    `load` again with an override, so that `text` stays true.
    """

    name: str
    title: str
    tables: Mapping[str, Mapping[str, Any]]  # the physics as plain SI numbers
    run: RunTable
    axes: tuple[Axis, ...] = ()
    direction: Direction = "independent"
    keep: int | None = None  # periods kept in a sweep, if different from `run.periods`
    given: Mapping[str, Any] = field(default_factory=dict)  # inputs by their keys, from which numbers were worked out
    notes: Mapping[str, str] = field(default_factory=dict)  # what loading it has to say, as names and texts

    def __post_init__(self):
        keys = [a.key for a in self.axes]
        if len(keys) > 2 or (len(keys) == 2 and same_quantity(keys[0], keys[1], self.layout)):
            fail(self.name, f"[sweep] along: {', '.join(keys)} is no grid; give one or two independent keys")

    @cached_property
    def scene(self) -> "jaxshroud.scene.scene.Scene":
        """The scene, built at the first access, in the precision that JAX has then."""
        from jaxshroud.scene.tables import scene_of

        return scene_of(self.tables, self.given)

    @property
    def layout(self) -> Layout:
        """The layout of the blades: that of the row, or the pair."""
        return layout_of(self.tables)

    @property
    def given_tables(self) -> dict[str, dict[str, Any]]:
        """The physics as it is given, in SI units, as written by `text`."""
        entries = {f"{t}.{n}": v for t, table in self.tables.items() for n, v in table.items()}
        return in_tables(entries, self.given, self.layout)

    @property
    def sweep_run(self) -> RunTable:
        """The `run` of a sweep: [sweep] keep replaces [run] periods."""
        return self.run if self.keep is None else self.run.model_copy(update={"periods": self.keep})

    @typed
    def text(self, run: Mapping[str, object] | None = None) -> str:
        """The resolved file as TOML, with overrides, in SI units: loading it gives the same scene.

        Args:
            run: The run to write instead of its own [run].
        """
        tables = {"title": self.title, **self.given_tables, "run": run or self.run.model_dump(exclude_none=True)}
        if self.axes:
            tables["sweep"] = _sweep_table(self)
        return tomli_w.dumps(nested(tables))


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


def table_values(table: Table) -> dict[str, Any]:
    """A physics table as TOML values; lists of equal numbers become one number."""
    values: dict[str, Any] = {}
    for name, value in table:
        if name == "reading":
            values[name] = reading_text(value)
        elif name == "motion":
            values[name] = list(value)
        elif value is not None:
            values[name] = value[0] if isinstance(value, tuple) and len(set(value)) == 1 else value
    if values.get("m_y", 0) == values.get("m"):
        del values["m_y"]  # so that an override of m in the written file changes both, as in the original
    return without_zeros(values)
