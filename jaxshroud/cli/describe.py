"""The commands that describe scenes and compute no motion: `check`, `explain` and `scenes`."""

import argparse
from typing import Any

import jaxshroud
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.terminal import claim_directory, files_written, input_errors_at, print_columns, print_table
from jaxshroud.scene.shipped import aliases, shipped


def check_command(options: argparse.Namespace) -> None:
    """Print the data sheet of a scene; with --out, write it, and draw its Campbell diagram."""
    from jaxshroud.cli.run_options import load_scene
    from jaxshroud.verbs.sheet_tables import crossing_rows, flow_rows, left_out, lines_of, mode_rows, rows_of

    file = load_scene(options)
    if options.out is not None:
        claim_directory(options.out, COMMANDS["check"].files, options.force)
    with input_errors_at(file.name):
        sheet = jaxshroud.check(file, engine_orders=options.engine_orders, start=options.start, stop=options.stop)
    print_columns(file.title or file.name, *rows_of(sheet))
    print_columns("", *mode_rows(sheet))
    if sheet.flow_modes:
        print_columns("", *flow_rows(sheet))
    print_columns("", *crossing_rows(sheet))
    lines = lines_of(sheet)
    if rest := left_out(sheet):
        lines["not shown"] = rest
    lines |= file.notes
    if options.out is not None:
        _write_sheet(sheet, file, options)
        lines["written"] = files_written()
    print_table("", lines)


def _write_sheet(sheet: Any, file: Any, options: argparse.Namespace) -> None:
    from jaxshroud.cli.computation import VerbCall, with_origin, write_files

    campbell = with_origin(sheet.campbell, file)
    write_files(VerbCall(file, options, {}, result=campbell), {**campbell.origin, **sheet.summary()})


def explain_command(options: argparse.Namespace) -> None:
    """Print what the model of a scene consists of."""
    from jaxshroud.cli.run_options import asked_method, load_scene, print_march
    from jaxshroud.march.method import FAST, method_of
    from jaxshroud.verbs.arguments import MarchPlan, choose_method, resolve_options

    file = load_scene(options)
    with input_errors_at(file.name):
        resolved = resolve_options(file.scene, method=asked_method(file, options))
        method, choice = choose_method(resolved, resolved.lanes, FAST, periods=0)
        march = MarchPlan(0, method, choice)
        if march.tried or resolved.scene.parts.contact == "none":
            print_march(file, options, resolved.lanes, march)
        explanation = jaxshroud.explain(file.scene, method_of("auto", method))
    print_table(file.title or file.name, _explanation_rows(explanation, choice))


def _explanation_rows(explanation: Any, choice: Any) -> dict[str, Any]:
    from jaxshroud.cache.programs import where_kept
    from jaxshroud.scene.layout import Parts

    parts = explanation.parts
    lacks = [f"{n}: {part}" for n, part, full in zip(Parts._fields, parts, Parts(), strict=True) if part != full]
    share = explanation.operations / explanation.full_operations
    operations = f"{explanation.operations}, {share:.2f} of the full model"
    events = ", ".join(explanation.events) or "none"
    row = {"neighbour": parts.neighbour}
    if explanation.blades > 2 or explanation.interfaces > 1:
        row = {"row": f"{explanation.blades} blades, {explanation.interfaces} interfaces"}
        operations += f", {explanation.operations / explanation.blades:.0f} for each blade"
        events += f"; at {explanation.interfaces} interfaces, {len(explanation.events) * explanation.interfaces} in all"
    return {
        "motion": ", ".join(parts.motion),
        **row,
        "friction": parts.friction,
        "contact": parts.contact,
        "not the full model in": "; ".join(lacks) or "nothing",
        "events looked for": events,
        "numbers carried by a lane": explanation.numbers,
        "operations in a trial step": "none: closed form" if parts.contact == "none" else operations,
        "omega_max": f"{explanation.omega_max:.4g} rad/s",
        **{f"steps per period, {name}": n for name, n in explanation.steps.items()},
        **({} if choice is None else {"accuracy": f"{choice}, before it is tried on the lanes of a run"}),
        "compiled programs": where_kept(),
        **{f"note {i}": text for i, text in enumerate(explanation.advice, 1)},
    }


def scenes_command(_: argparse.Namespace) -> None:
    """Print names and titles of the shipped scenes, with the other names of some."""
    scenes = shipped()
    others = {name: other for other, name in aliases().items()}
    for name, title in scenes.items():
        also = f" (also {others[name]})" if name in others else ""
        print(f"{name:<12} {title}{also}")
