"""What a report finds of the contact of a design, in its own words: of a pair, and of a row of blades."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import numpy as np

from jaxshroud.model.linear import power_reduction
from jaxshroud.plotting.documents import Section
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.data_sheet import DataSheet
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.quantities import RequiredReduction
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.diagnose import diagnose
from jaxshroud.verbs.doubts import LEAST_DRIVEN
from jaxshroud.verbs.sheet_tables import mode_rows


@dataclass(frozen=True)
class DesignFindings:
    """The findings on a pair. A table has no columns and a paragraph no words beside those of all designs."""

    # Arguments of `sweep` for the runs of all conditions.
    run_for: ClassVar[dict[str, Any]] = {"forces": True, "amplitudes": True}
    amplitudes_of: ClassVar[tuple[str, ...]] = ()  # sentences that say whose numbers are given
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
        return [head for name, (head, _) in STRESS_CELLS.items() if getattr(self.runs, name) is not None]

    def cells(self, of: RequiredReduction, condition: int) -> list[str]:
        """What a table says of a condition beside the reduction that is judged."""
        stress = [(getattr(self.runs, name), per_si) for name, (_, per_si) in STRESS_CELLS.items()]
        is_pair = self.diagnosis is None
        return [_largest_cell(a[condition], per_si, is_pair) for a, per_si in stress if a is not None]

    def motion_cells(self, motions: Attractors, motion: int) -> list[str]:
        """What a table says of a coexisting motion beside what it says of all."""
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


MM_PER_M = 1e3
STRESS_CELLS = {"sigma_a": ("stress amplitude [MPa]", 1e-6), "goodman": ("Goodman's utilisation", 1.0)}
MOST_LINES = 24  # of a table of blades or interfaces
WAVE_LINES, LEAST_WAVE = 6, 1e-3  # of a table of waves, and their least amplitude over the largest
DOUBTFUL_VERDICTS = ("transient not over", "undecided", "stopped")


@dataclass(frozen=True)
class RowFindings(DesignFindings):
    """The findings on a row, of all its blades and interfaces; its diagnosis is of the worst condition."""

    amplitudes_of: ClassVar[tuple[str, ...]] = (
        "P_d is that of all blades; amplitudes are those of the blade that swings most.",
    )
    motions_by: ClassVar[tuple[str, ...]] = (
        "Runs from rest with random rates, told apart by their Poincaré points; no orbit is closed. In a ring "
        "the copies of a motion that begin at another blade count each.",
    )
    motion_heads: ClassVar[tuple[str, ...]] = ("least of the worst blade [%]", "largest amplitude of x [mm]")

    @classmethod
    def of_runs(cls, scenes: Scene, worst: int, runs: SweepResult, run_options: Mapping[str, Any]) -> "RowFindings":
        """The findings on a design in all its conditions (leading axis), with a diagnosis of the worst."""
        how = {name: run_options[name] for name in ("transient", "method")}
        diagnosis = diagnose(jax.tree.map(lambda a: np.asarray(a)[worst], scenes), **how)
        return cls(runs, worst, diagnosis)

    @property
    def blade_P_d(self) -> np.ndarray:
        """The P_d of each blade in each condition, (conditions, blades) [percent]."""
        return power_reduction(self.runs.P, self.runs.P_0)

    def heads(self, of: RequiredReduction) -> list[str]:
        """The heads of `cells`."""
        of_all = ["P_d of all blades [%]"] if of == "P_d_worst" else []
        stress = DesignFindings.heads(self, of)
        return [*of_all, "P_d of the worst blade [%]", "largest amplitude of x [mm]", *stress]

    def cells(self, of: RequiredReduction, condition: int) -> list[str]:
        """What a table says of the row in a condition beside the reduction that is judged."""
        of_all = [f"{self.runs.P_d[condition]:.5g}"] if of == "P_d_worst" else []
        stress = DesignFindings.cells(self, of, condition)
        return [*of_all, self.worst_blade(condition), self.largest_peak(condition), *stress]

    def worst_blade(self, condition: int) -> str:
        """The P_d of the blade that gains the least in a condition, and which it is."""
        reductions = self.blade_P_d[condition]
        blade = int(np.argmin(np.where(np.isfinite(reductions), reductions, np.inf)))
        return f"{reductions[blade]:.5g} (blade {blade})"

    def largest_peak(self, condition: int) -> str:
        """The largest amplitude of x in a condition [mm], and the blade that has it."""
        return _largest_cell(self.runs.x_peak[condition])

    def motion_cells(self, motions: Any, motion: int) -> list[str]:
        """The least P_d of any blade on a coexisting motion [percent], and the largest amplitude of x [mm]."""
        return [f"{motions.P_d_worst[motion]:.5g}", _largest_cell(motions.x_peak[motion])]

    def level_words(self, level: str) -> list[str]:
        """The sentence on the level at which slopes are taken."""
        return [level]

    def sections(self, sheet: DataSheet, about: list[str]) -> list[Section]:
        """The sections on modes, waves, blades and interfaces in the worst condition."""
        return [
            _modes_section(sheet, about),
            _waves_section(self.diagnosis, about),
            _blades_section(self, about),
            _interfaces_section(self, about),
        ]

    @property
    def doubts(self) -> list[str]:
        """What a longer run leaves open in the worst condition."""
        run = self.diagnosis
        return [f"a longer run is judged {run.evidence}"] if run.verdict in DOUBTFUL_VERDICTS else []


def _modes_section(sheet: DataSheet, about: list[str]) -> Section:
    driven = tuple(mode for mode in sheet.modes if mode.driven > LEAST_DRIVEN)
    words = (
        f"With all interfaces in one state of contact. Of {len(sheet.modes)} modes the drive excites {len(driven)}; "
        "those with less than a thousandth of its work are left out."
    )
    head, rows = mode_rows(replace(sheet, modes=driven))
    return Section("Natural modes", [*about, words], [head, *rows] if driven else [])


def _waves_section(run: Diagnosis, about: list[str]) -> Section:
    paragraphs = [*about, f"{run.evidence[:1].upper()}{run.evidence[1:]}."]
    if run.verdict == "stopped":
        return Section("Waves and localisation", paragraphs)
    blades = run.x_peak.shape[-1]
    paragraphs.append(
        f"The participation ratio is {float(run.participation_ratio):.4g}: 1 where all blades swing alike, "
        f"{1 / blades:.3g} where one of the {blades} swings alone."
    )
    if not run.closed:
        return Section("Waves and localisation", paragraphs, figure=run.plot(kind="map", title=""))
    paragraphs.append(
        "Below are the largest waves of x over the last period: a travelling wave has one nodal diameter for each "
        "harmonic. The share outside of one is of the square of the motion."
    )
    return Section("Waves and localisation", paragraphs, _wave_table(run), run.plot(kind="diameters", title=""))


def _wave_table(run: Diagnosis) -> list[list[str]]:
    """The largest waves of the last period in x."""
    spectrum = run.spectrum()
    amplitude = spectrum.amplitude[1:]
    order = np.argsort(-amplitude, axis=None, kind="stable")[:WAVE_LINES]
    table = [["harmonic of the drive", "nodal diameter", "amplitude of x [mm]"]]
    for harmonic, place in zip(*np.unravel_index(order, amplitude.shape), strict=True):
        level = amplitude[harmonic, place]
        if level >= LEAST_WAVE * amplitude.max():
            table.append([str(harmonic + 1), f"{spectrum.diameters[place]:d}", f"{MM_PER_M * level:.4g}"])
    return table


def _blades_section(findings: RowFindings, about: list[str]) -> Section:
    runs = findings.runs
    reductions, peaks, free = (a[findings.worst] for a in (findings.blade_P_d, runs.x_peak, runs.x_free))
    table = [["blade", "P_d [%]", "amplitude of x [mm]", "without contact [mm]"]]
    order = np.argsort(np.where(np.isfinite(reductions), reductions, np.inf), kind="stable")
    for i in order[:MOST_LINES]:
        table.append([str(i), f"{reductions[i]:.5g}", f"{MM_PER_M * peaks[i]:.5g}", f"{MM_PER_M * free[i]:.5g}"])
    figure = findings.diagnosis.plot(kind="amplitudes", title="")
    words = f"Those that gain the least first.{_left_out(len(order), 'blades')}"
    return Section("Blades", [*about, words], table, figure)


def _interfaces_section(findings: RowFindings, about: list[str]) -> Section:
    run = findings.runs.lane(findings.worst)
    shown = findings.diagnosis
    columns = {
        "largest N [N]": run.N_max,
        "mean N [N]": run.N_mean,
        "N in slip [N]": run.N_slip,
        "largest friction [N]": run.F_max,
        "slip [mm]": MM_PER_M * run.slip,
        "friction work [J]": run.friction_work,
        "impacts": run.impacts,
    }
    times = np.stack([np.ravel(a) for a in (shown.time_apart, shown.time_stick, shown.time_slip)], axis=1)
    numbers = np.stack([np.ravel(a) for a in columns.values()], axis=1)
    table = [["interface", *columns, "apart, stick, slip [%]"]]
    for i in np.sort(np.argsort(-numbers[:, 0], kind="stable")[:MOST_LINES]):
        shares = ", ".join(f"{100 * share:.1f}" for share in times[i])
        table.append([str(i), *(f"{number:.4g}" for number in numbers[i]), shares])
    words = (
        "Of the kept periods, extremes within steps too; slip, work and impacts are those of one period. Times are "
        f"those of the run that is shown.{_left_out(len(numbers), 'interfaces')}"
    )
    return Section("Loads at the interfaces", [*about, words], table)


def _largest_cell(peaks: np.ndarray, per_si: float = MM_PER_M, is_pair: bool = False) -> str:
    """The largest of the blades' amplitudes, in mm or another unit, and the blade that has it."""
    blade = int(np.argmax(np.where(np.isfinite(peaks), peaks, -np.inf)))
    return f"{per_si * peaks[blade]:.5g} ({f'{PAIR.names[blade]} blade' if is_pair else f'blade {blade}'})"


def _left_out(count: int, what: str) -> str:
    """The end of a paragraph that says how many lines a table lacks."""
    return f" {count - MOST_LINES} {what} are left out." if count > MOST_LINES else ""
