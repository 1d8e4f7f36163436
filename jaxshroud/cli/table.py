"""The command `table`."""

import argparse
from typing import Any

from jaxshroud.batch.plan import Plan
from jaxshroud.batch.threads import cores
from jaxshroud.cli.computation import CompletedCall, Computation, VerbCall, call_with_accuracy_warnings, print_result
from jaxshroud.cli.projection import LONG_RUN_STEPS, print_projection, projected_seconds
from jaxshroud.cli.terminal import CommandError, input_errors_at, progress_bar, shortened
from jaxshroud.io.csv_text import read_csv
from jaxshroud.march.method import FOR_P_D
from jaxshroud.march.method_names import LARGEST_FIRST
from jaxshroud.results.base import ORIGIN
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.signals.amplitudes import counted_reduction
from jaxshroud.verbs.arguments import resolve_options
from jaxshroud.verbs.plan import plan_march
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE
from jaxshroud.verbs.table import check_ranking, checked_designs

SHOWN_ENTRIES, SHOWN_LAST = 16, 4  # entries of the best design that are printed, and those of them that come last
LONGEST_CELL = 60  # characters of a cell that are printed
SHOWN_REASONS = 5  # rows whose faults are printed
LONG_TABLE_STEPS = LONG_RUN_STEPS // 10  # with loads and amplitudes, in all lanes together


def _table_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The designs of the table."""
    if options.out.suffix not in (".csv", ".nc"):
        raise CommandError(f"--out {options.out}: must end in .csv, the ranked table, or in .nc")
    table = read_csv(options.designs)
    with input_errors_at(file.name):
        check_ranking(options.by or counted_reduction(file.scene), file.scene)
    with input_errors_at(str(options.designs)):
        return {"designs": checked_designs(table.columns, file.scene, table.faults, table.decimal_comma)}


def _scenes_of_designs(call: VerbCall) -> Scene:
    return call.arguments["designs"].scenes(call.file.scene)


def _print_projection_of_long_table(call: VerbCall) -> None:
    """Print what a long table will take."""
    scenes = without_given(_scenes_of_designs(call))
    resolved = resolve_options(call.file, method=call.arguments["method"], verb="table")
    march = plan_march(resolved, scenes, FOR_P_D)
    method = march.method._replace(ledger=True, forces=True, amplitudes=True)
    plan = Plan(call.arguments["transient"], call.arguments["n_periods"], march.steps, 0.0, method)
    lanes = len(scenes.drive.omega)
    if lanes * (plan.transient + plan.kept) * plan.steps_per_period <= LONG_TABLE_STEPS:
        return
    with progress_bar("lane-periods of a trial") as report:
        seconds = projected_seconds(in_precision(scenes, method.precision), plan, progress=report)
    print_projection(lanes, plan.kept, seconds, seconds / cores(), lanes_held=min(lanes, MAX_LANES_AT_ONCE))


def _output_table(completed: CompletedCall) -> None:
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


table_command = Computation(
    prepare=_table_arguments,
    scenes=_scenes_of_designs,
    usual=FOR_P_D,
    announce=_print_projection_of_long_table,
    run=call_with_accuracy_warnings,
    output=_output_table,
)
