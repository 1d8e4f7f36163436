"""What a report finds of the contact of a design, in its own words: that of a pair, from the runs of all conditions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from jaxshroud.plotting.documents import Section
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.data_sheet import DataSheet
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.quantities import RequiredReduction
from jaxshroud.scene.scene import Scene


@dataclass(frozen=True)
class DesignFindings:
    """The findings on a pair. A table has no columns and a paragraph no words beside those of all designs."""

    run_for: ClassVar[dict[str, Any]] = {"forces": True}  # arguments of `sweep` for the runs of all conditions
    amplitudes_of: ClassVar[tuple[str, ...]] = ()  # sentences on whose numbers are told
    motions_by: ClassVar[tuple[str, ...]] = ()  # sentences on how coexisting motions are found
    motion_heads: ClassVar[tuple[str, ...]] = ()  # heads of `motion_cells`

    runs: SweepResult  # (conditions,)
    worst: int  # of the conditions
    diagnosis: Any = None  # of a row

    @classmethod
    def of_runs(cls, scenes: Scene, worst: int, runs: SweepResult, run_options: Mapping[str, Any]) -> "DesignFindings":
        """The findings on a design in all its conditions (leading axis), of which one is the worst."""
        return cls(runs, worst)

    @property
    def forces(self) -> np.ndarray | None:
        """The largest normal force in each condition [N], where it was kept."""
        return None if self.runs.N_max is None else self.runs.N_max.reshape(self.runs.P_d.size, -1).max(axis=-1)

    @property
    def friction_work(self) -> float:
        """The work of friction in a drive period of the worst condition, of all interfaces, on average [J]."""
        return float(np.sum(self.runs.lane(self.worst).friction_work))

    def heads(self, of: RequiredReduction) -> list[str]:
        """The heads of `cells`."""
        return []

    def cells(self, of: RequiredReduction, condition: int) -> list[str]:
        """What a table tells of a condition beside the reduction that is judged."""
        return []

    def motion_cells(self, motions: Attractors, motion: int) -> list[str]:
        """What a table tells of a coexisting motion beside what it tells of all."""
        return []

    def level_words(self, level: str) -> list[str]:
        """The sentence on the level at which slopes are taken."""
        return []

    def sections(self, sheet: DataSheet, about: list[str]) -> list[Section]:
        """Sections on the worst condition; each begins with the paragraphs `about`."""
        return []

    @property
    def doubts(self) -> list[str]:
        """Doubts about the motion in the worst condition."""
        return []
