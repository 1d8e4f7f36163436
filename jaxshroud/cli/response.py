"""The command `response`."""

import argparse
from typing import Any

import numpy as np

from jaxshroud.cli.computation import CompletedCall, Computation, VerbCall, call_with_accuracy_warnings, write_files
from jaxshroud.cli.terminal import CommandError, files_written, print_columns, print_table
from jaxshroud.march.method import FOR_P_D
from jaxshroud.results.response import Response
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.title import display_value


def _response_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The number, its range, the amplitude and the family."""
    along = options.along or next((one.key for one in file.axes), "drive.omega")
    own = next((one.values for one in file.axes if one.key == along), None)
    ends = [options.start, options.stop]
    if own is not None:
        ends = [pick(own) if end is None else end for end, pick in zip(ends, (np.min, np.max), strict=True)]
    if None in ends:
        raise CommandError(f"--along {along}: {file.name} has no range of it; give --start and --stop")
    values = axis(file, along, start=ends[0], stop=ends[1], num=2).values
    at = None if options.at is None else float(axis(file, along, options.at).values[0])
    return {
        **{"along": along, "start": float(values.min()), "stop": float(values.max()), "at": at},
        **{"of": options.of or "x_peak", "over": _family(file, options)},
    }


def _family(file: SceneFile, options: argparse.Namespace) -> dict[str, np.ndarray] | None:
    if options.over is None:
        return None
    key, sign, values = options.over.partition("=")
    if not sign or not values:
        raise CommandError(f"--over {options.over}: must be a number and its values, e.g. --over friction.mu=0.1,0.2")
    return {key.strip(): axis(file, key.strip(), values).values}


def _ends_of_response(call: VerbCall) -> Scene:
    """The scenes at both ends of the range."""
    start, stop = call.arguments["start"], call.arguments["stop"]
    return scenes_at(call.file.scene, [call.arguments["along"]], np.array([[start], [stop]]))


def _output_response(completed: CompletedCall) -> None:
    write_files(completed)
    result: Response = completed.result
    unit = result.data["peak_amplitude"].attrs["units"]
    shift, ratio = "shift from free peak", "over free peak"
    in_row = result.peak_blades is not None
    heads = (result.along, f"{result.of} [{unit}]", "period", "stable", "half width over value", shift, ratio)
    heads += ("largest blade",) if in_row else ()
    rows = [
        (
            _place_text(result, row["value"]),
            f"{row['amplitude']:.6g}",
            str(row["q"]),
            "yes" if row["stable"] else "no",
            f"{row['zeta']:.4g}" if np.isfinite(row["zeta"]) else row["reason"],
            f"{row['shift']:+.3%}",
            f"{row['ratio']:.4g}",
            *([_blades_text(result, row["blades"])] if in_row else []),
        )
        for row in result.peaks
    ]
    print_columns("", heads, rows)
    shown = {
        "peaks": len(rows),
        "largest without contact": "; ".join(
            f"{a:.6g} {unit} at {_place_text(result, v)}"
            for a, v in zip(result.free_amplitude, result.free_value, strict=True)
        ),
        **_jump_rows(result),
        "ended": result.ended,
        "method": result.method,
    }
    print_table(completed.title, {**shown, "written": files_written()})
    for line in result.messages:
        print(f"warning: {line}")


def _blades_text(result: Response, blades: list[int]) -> str:
    """The blades that swing most."""
    return "all" if len(blades) == result.data.sizes["blade"] else ", ".join(map(str, blades))


def _place_text(result: Response, value: float) -> str:
    """A value of the first number, in the unit of the picture."""
    return display_value(*find_key(result.along)[0].parts, value)


def _jump_rows(result: Response) -> dict[str, str]:
    """The values before which the sweeps jump, by direction and member."""
    members = [f" of member {i}" for i in range(len(result.jumps))] if result.over else [""]
    return {
        f"jumps {direction}{member}": ", ".join(_place_text(result, value) for value in values)
        for member, jumps in zip(members, result.jumps, strict=True)
        for direction, values in jumps.items()
    }


response_command = Computation(
    prepare=_response_arguments,
    scenes=_ends_of_response,
    usual=FOR_P_D,
    run=call_with_accuracy_warnings,
    output=_output_response,
)
