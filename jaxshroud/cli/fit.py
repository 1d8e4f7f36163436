"""The command `fit`."""

import argparse
from typing import Any

from jaxshroud.cli.computation import CompletedCall, Computation, VerbCall, write_files
from jaxshroud.cli.run_options import bounds, load_scene
from jaxshroud.cli.terminal import files_written, print_columns, print_table
from jaxshroud.io.files import write
from jaxshroud.io.measurements import read_measurements
from jaxshroud.results.fit import Fit, FittedNumber
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.fit import fit_corners, fit_problem


def _fit_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The measurements, which are looked at before anything is written, and the bounds."""
    read_measurements(options.measurements)
    return {"measurements": options.measurements, "over": bounds(file, options.over)}


def _fit_corners(call: VerbCall) -> Scene:
    """The scenes at the ends of the bounds; a fit that cannot be made is refused."""
    return fit_corners(
        fit_problem(call.file.scene, read_measurements(call.options.measurements), call.arguments["over"])
    )


def _output_fit(completed: CompletedCall) -> None:
    found: Fit = completed.result
    write_files(completed)
    best = load_scene(completed.options, [f"{key}={value!r}" for key, value in found.value.items()])
    write(completed.paths[-1], best.text().encode())
    cells = [(key, f"{n.value:.6g}", *_interval_cells(n)) for key, n in found.numbers.items()]
    print_columns("fitted numbers", ("number", "value [SI]", "from (95 %)", "to", "by"), cells)
    print_table(completed.title, {**_fit_rows(found), "written": files_written()})


def _interval_cells(number: FittedNumber) -> tuple[str, str, str]:
    """The interval of a number, and what it is by."""
    if not number.is_determined:
        return "not", "determined", ""
    return f"{number.low:.6g}", f"{number.high:.6g}", number.by


def _fit_rows(found: Fit) -> dict[str, Any]:
    noise = "given" if found.sigma_is_known else f"estimated from {found.noise_from}"
    notes = {f"note {i}": note for i, note in enumerate(found.notes, 1)}
    return {
        "chi2": f"{found.chi2:.4g} for {found.freedom} degrees of freedom",
        f"noise, {noise}": ", ".join(f"{name} {size:.3g}" for name, size in found.noise.items()) + " (SI)",
        **(notes or {"determined": "every number"}),
    }


fit_command = Computation(prepare=_fit_arguments, scenes=_fit_corners, output=_output_fit)
