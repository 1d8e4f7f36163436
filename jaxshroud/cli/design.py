"""The commands of designs: `tune`, `report` and, of many, `table`."""

import argparse
import shlex
import sys
from functools import partial
from typing import Any

import numpy as np

import jaxshroud
from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress
from jaxshroud.cli.computation import Computation, VerbCall, print_result
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.projection import LONG_RUN_STEPS, print_projection_of_long_run
from jaxshroud.cli.run_options import bounds, limits, load_scene, operating_conditions, scatters
from jaxshroud.cli.terminal import (
    CommandError,
    draw,
    files_written,
    input_errors_at,
    print_table,
    shortened,
)
from jaxshroud.io.files import write
from jaxshroud.io.store import write_json
from jaxshroud.march.method_names import LARGEST_FIRST
from jaxshroud.results.base import ORIGIN
from jaxshroud.results.scatter import Report
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.csv_text import read_csv
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.quantities import is_reduction, unit_of
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.title import display_value
from jaxshroud.verbs.arguments import MarchPlan
from jaxshroud.verbs.gradient_ascent import SearchOptions
from jaxshroud.verbs.report_sections import MM_PER_M
from jaxshroud.verbs.scattering import cube_corners
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE
from jaxshroud.verbs.table import checked_designs
from jaxshroud.verbs.tune import objective_map

MAP_SIDE = 24  # values of each of two keys in the map behind the paths
MAP_COARSENING = 2  # of the map where numbers scatter: each of its designs takes all draws
SHOWN_ENTRIES, SHOWN_LAST = 16, 4  # entries of the best design that are printed, and those of them that come last
LONGEST_CELL = 60  # characters of a cell that are printed
SHOWN_REASONS = 5  # rows whose faults are printed
LONG_TABLE_STEPS = LONG_RUN_STEPS // 10  # with loads and amplitudes, in all lanes together


# Tuning


def _tune_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    return {
        "over": bounds(file, options.over),
        "conditions": operating_conditions(file, options),
        "scatters": scatters(file, options),
        "search": SearchOptions(options.scan, options.n_starts, options.updates),
        **limits(file, options),
    }


def _check_map(call: VerbCall, corners: Scene, _: MarchPlan) -> None:
    """Refuse a tuning whose map would be too large, by the scenes at the ends of its bounds."""
    runs = len(corners.drive.omega) // len(cube_corners(len(call.arguments["over"])))
    check_size(runs * _map_side(call.options) ** 2, call.file.run.transient, call.file.run.periods)


def _map_side(options: argparse.Namespace) -> int:
    """Values of each of two keys in the map; fewer where numbers scatter."""
    if options.map is not None:
        return options.map
    return MAP_SIDE // (MAP_COARSENING if options.tolerance or options.spread else 1)


def _output_tuning(completed: VerbCall) -> None:
    from jaxshroud.plotting.pictures import picture

    tuned: Tuned = completed.result
    dataset_path, summary_path, picture_path, design_path = completed.paths
    tuned.save(dataset_path)
    summary = tuned.summary(_objective_map(tuned, _map_side(completed.options)))
    write_json(summary, summary_path)
    best = load_scene(completed.options, _overrides_of(tuned))
    write(design_path, best.text().encode())
    draw(lambda: picture("tuned", summary), picture_path, dpi=completed.options.dpi)
    print_table(completed.title, {**_tuning_rows(tuned), "written": files_written()})


def _objective_map(tuned: Tuned, side: int) -> dict[str, np.ndarray] | None:
    """The objective on a grid of that many values a side, where two numbers were tuned."""
    if len(tuned.keys) != 2 or not side:
        return None
    with progress_bar("objective map"):
        return objective_map(tuned, side)


def _overrides_of(tuned: Tuned) -> list[str]:
    """A design as overrides of its scene."""
    return [f"{key}={value!r}" for key, value in tuned.design.items()]


def _tuning_rows(tuned: Tuned) -> dict[str, Any]:
    goal = f"{tuned.goal} {tuned.quantity}{' over the draws' if tuned.scatters else ''}"
    return {
        **({} if tuned.feasible else {"infeasible": "the best design found does not keep the limits, or stops"}),
        **{key: _place_text(tuned, key, value) for key, value in tuned.design.items()},
        goal: _level_text(tuned, tuned.objective),
        **{f"  {name}": _level_text(tuned, check.objective[0]) for name, check in tuned.checks.items()},
        **({"at a bound": tuned.at_bounds} if tuned.at_bounds else {}),
        **({"flat": tuned.flat} if tuned.flat else {}),
        **({"mean position": tuned.mean_shift} if tuned.mean_shift else {}),
        **_limit_rows(tuned),
        **_robustness_rows(tuned),
        "verdict": "confirmed" if tuned.confirmed else "not confirmed: the simulations differ, or exceed a limit",
        "periods simulated": tuned.periods,
    }


def _place_text(tuned: Tuned, key: str, value: float) -> str:
    """A tuned number, and between which values the best one is."""
    shown = partial(display_value, *parse_key(key)[0].parts)
    ends = tuned.best_between.get(key)
    return (
        shown(value) if ends is None else f"{shown(value)}, the best is between {shown(ends[0])} and {shown(ends[1])}"
    )


def _level_text(tuned: Tuned, reduction: float) -> str:
    """The size of the tuned quantity at a reduction, with its unit."""
    return f"{float(tuned.levels(reduction)):.4g} {unit_of(tuned.quantity)}"


def _limit_rows(tuned: Tuned) -> dict[str, str]:
    """The largest force and penetration of any check, or draw, with what is left to their limits."""
    force = np.nanmax([*tuned.check_force, tuned.scattered_force or 0.0])
    deepest = np.nanmax([*tuned.check_v_max, tuned.scattered_v_max or 0.0])
    return {
        "largest normal force": _margin_text(force, tuned.most_force, "N"),
        "largest penetration": _margin_text(deepest * MM_PER_M, tuned.most_penetration * MM_PER_M, "mm"),
    }


def _margin_text(value: float, limit: float, unit: str) -> str:
    if not np.isfinite(limit):
        return f"{value:.4g} {unit}, no limit"
    margin = f"{1 - value / limit:.0%} left" if value <= limit else f"{value / limit - 1:.2%} too much"
    return f"{value:.4g} {unit} of {limit:.4g} {unit}: {margin}"


def _robustness_rows(tuned: Tuned) -> dict[str, str]:
    """Tolerances, the probability of a wanted P_d, and coexisting motions."""
    if tuned.loss is None:
        return {}
    rows = {f"up to {tuned.loss:g} points lost": "each number alone, in the worst condition; in SI units"}
    for key, interval in tuned.intervals.items():
        ends = zip((interval.low, interval.high), interval.ended_by, strict=True)
        text = " to ".join(f"{end:.5g} ({reason})" for end, reason in ends)
        rows[f"  {key}"] = f"{text}, looked at every {interval.apart:.2g}"
    if tuned.scatters:
        low, median = (_level_text(tuned, end) for end in np.nanquantile(tuned.sampled_P_d, (0.05, 0.5)))
        worse = "below" if is_reduction(tuned.quantity) else "above"
        rows[f"{tuned.quantity} under the scatter"] = f"median {median}, one draw in twenty {worse} {low}"
    if tuned.at_least is not None:
        rows[f"P_d at least {tuned.at_least:g} %"] = f"probability {tuned.chance}"
    return rows | _motion_rows(tuned)


def _motion_rows(tuned: Tuned) -> dict[str, str]:
    if tuned.motions is None:
        return {}
    worst = int(np.nanargmin(tuned.motions_worst)) if np.isfinite(tuned.motions_worst).any() else 0
    count = ", ".join(map(str, tuned.motions))
    undecided = tuned.motions_undecided.max()
    rest = f"; up to {undecided:.0%} of starts undecided" if undecided else ""
    from_rest, least = tuned.nominal_P_d[worst], tuned.motions_worst[worst]
    return {"coexisting motions": f"{count}; the worst has a P_d of {least:.4g} % (from rest {from_rest:.4g} %){rest}"}


# Report


def _tuning_of_report(options: argparse.Namespace) -> Tuned | None:
    """The tuning of --tune."""
    return None if options.tune is None else Tuned.load(options.tune / "tune.nc")


def _scene_of_report(options: argparse.Namespace) -> SceneFile:
    """The scene with the design of the tuning."""
    tuned = _tuning_of_report(options)
    return load_scene(options, [] if tuned is None else _overrides_of(tuned))


def _report_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    if options.out.suffix not in (".html", ".pdf"):
        raise CommandError(f"{options.out}: a report is .html or .pdf")
    return {
        "scatters": {**bounds(file, options.over), **scatters(file, options)},
        "conditions": operating_conditions(file, options),
        **limits(file, options),
        "tuned": _tuning_of_report(options),
        "command": f"jaxshroud {shlex.join(sys.argv[1:])}",
    }


def _call_report(call: VerbCall, progress: Progress) -> Report:
    """The report of the whole scene file."""
    return jaxshroud.report(call.file, **call.arguments, progress=progress)


def _output_report(completed: VerbCall) -> None:
    report: Report = completed.result
    report.save(completed.options.out, dpi=completed.options.dpi)
    reasons = {f"because {i}": reason for i, reason in enumerate(report.reasons, 1)}
    print_table(report.title, {"verdict": report.verdict, **reasons, "written": files_written()})


# Table


def _table_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The designs of the table."""
    if options.out.suffix not in (".csv", ".nc"):
        raise CommandError(f"--out {options.out}: must end in .csv, the ranked table, or in .nc")
    table = read_csv(options.designs)
    with input_errors_at(str(options.designs)):
        return {"designs": checked_designs(table.columns, file.scene, table.faults, table.decimal_comma)}


def _print_projection_of_long_table(call: VerbCall, scenes: Scene, march: MarchPlan) -> None:
    """Print what a long table will take."""
    method = march.method._replace(ledger=True, forces=True, amplitudes=True)
    plan = march._replace(method=method).plan(call.arguments["transient"], call.arguments["n_periods"])
    lanes = len(scenes.drive.omega)
    held = min(lanes, MAX_LANES_AT_ONCE)
    print_projection_of_long_run(scenes, plan, ("independent",), lanes, lanes_held=held, long=LONG_TABLE_STEPS)


def _output_table(completed: VerbCall) -> None:
    result = completed.result
    result.save(completed.options.out)
    rows = {name: value for name, value in result.summary().items() if name not in ORIGIN}
    rows["best"] = _shown_design(rows["best"])
    for line in result.wrong[:SHOWN_REASONS]:
        rows[line.partition(":")[0]] = shortened(line.partition(": ")[2])
    if len(result.wrong) > SHOWN_REASONS:
        rows["further wrong rows"] = len(result.wrong) - SHOWN_REASONS
    order = "largest" if result.by in LARGEST_FIRST else "smallest"
    headline = f"{completed.title}, ranked by {result.by}, the {order} first"
    print_result(completed, {**rows, "seconds": completed.seconds}, headline)


def _shown_design(best: dict[str, Any] | None) -> dict[str, Any] | None:
    """The best design as far as a terminal shows it: its first columns and its numbers, long cells shortened."""
    if best is None:
        return None

    def short(value):
        return shortened(value, LONGEST_CELL) if isinstance(value, str) else value

    shown = [(short(name), short(value)) for name, value in best.items()]
    more = len(shown) - SHOWN_ENTRIES
    return dict(shown if more <= 0 else [*shown[: -more - SHOWN_LAST], ("further columns", more), *shown[-SHOWN_LAST:]])


tune_command = Computation(prepare=_tune_arguments, announce=_check_map, output=_output_tuning)
report_command = Computation(load=_scene_of_report, prepare=_report_arguments, run=_call_report, output=_output_report)
table_command = Computation(
    prepare=_table_arguments,
    announce=_print_projection_of_long_table,
    output=_output_table,
)
