"""The commands about motions and their stability: `orbit`, `lyapunov`, `response`, `branch`, `attractors`, `basins`."""

import argparse
import sys
from typing import Any

import numpy as np

import jaxshroud
from jaxshroud.batch.limits import check_size
from jaxshroud.cli.computation import (
    Computation,
    VerbCall,
    print_result,
    with_origin,
    write_files,
)
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.run_options import load_scene
from jaxshroud.cli.terminal import (
    CommandError,
    draw,
    files_written,
    input_errors_at,
    print_columns,
    print_table,
    refuse_existing,
)
from jaxshroud.io.store import write_json
from jaxshroud.model.modes import Status
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.branch import Branch
from jaxshroud.results.diagnosis import Lyapunov
from jaxshroud.results.orbit import Orbit
from jaxshroud.results.response import Response
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.title import display_value
from jaxshroud.signals.effects import between, exponent_text, with_interval

BACKGROUND_FILE = "sweep.nc"  # the sweep behind a branch
NOT_IN_BRANCH_TABLE = ("along", "special", "ends", "scene", "version")  # of its summary
IN_ATTRACTORS_TABLE = ("starts", "undecided or stopped", "worst", "method", "seconds")


# One motion


def _output_orbit(completed: VerbCall) -> None:
    orbit: Orbit = completed.result
    write_files(completed)
    rows = {"motion": f"no orbit; {orbit.periods} periods simulated"}
    if orbit.found:
        multipliers = [f"{mu.real:.4g}{mu.imag:+.4g}i" for mu in orbit.multipliers if mu]
        rest = len(orbit.multipliers) - len(multipliers)
        largest = abs(orbit.multipliers[0])
        rows = {
            "motion": f"period {orbit.q}, {'unstable' if 'unstable' in orbit.flags else 'stable'}",
            "P_d": f"{orbit.P_d:.6g} %",
            "P_d of the vibration": f"{orbit.P_d_vibration:.6g} %",
            "largest multiplier": f"{largest:.4g}",
            "multipliers": ", ".join([*multipliers, *([f"{rest} are 0"] if rest else [])]),
            "closed to": f"{orbit.residual:.1e} of its size",
        }
    print_result(completed, {**rows, "flags": ", ".join(orbit.flags) or "none", **_run_rows(completed)})


def _run_rows(completed: VerbCall) -> dict[str, Any]:
    """How the run ended, and how it was marched."""
    result = completed.result
    method = f"{result.method}, {result.steps_per_period} steps a period"
    return {"status": result.summary()["status"], "method": method}


def _output_exponents(completed: VerbCall) -> None:
    result: Lyapunov = completed.result
    write_files(completed)
    texts = [exponent_text(*pair, result.stuck) for pair in zip(result.exponents, result.ci, strict=True)]
    rows = {"exponents per drive period": ", ".join(texts)} if result.status == Status.OK else {}
    print_result(completed, {**rows, **_run_rows(completed)})


# Response


def _response_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The number, its range, the amplitude and the family."""
    along = options.along or next((one.key for one in file.axes), "drive.omega")
    values = _values_in_range(file, options, along)
    return {
        "along": along,
        "start": float(values.min()),
        "stop": float(values.max()),
        "at": None if options.at is None else float(axis(file, along, options.at).values[0]),
        "of": options.of or "x_peak",
        "over": _family(file, options),
    }


def _values_in_range(file: SceneFile, options: argparse.Namespace, along: str, num: int = 2) -> np.ndarray:
    """Values of a number from --start to --stop, or from end to end of the file's own range."""
    own = next((one.values for one in file.axes if one.key == along), None)
    start, stop = options.start, options.stop
    if own is not None:
        start = np.min(own) if start is None else start
        stop = np.max(own) if stop is None else stop
    if start is None or stop is None:
        raise CommandError(f"--along {along}: {file.name} has no range of it; give --start and --stop")
    return axis(file, along, start=start, stop=stop, num=num).values


def _family(file: SceneFile, options: argparse.Namespace) -> dict[str, np.ndarray] | None:
    if options.over is None:
        return None
    key, sign, values = options.over.partition("=")
    if not sign or not values:
        raise CommandError(f"--over {options.over}: must be a number and its values, e.g. --over friction.mu=0.1,0.2")
    return {key.strip(): axis(file, key.strip(), values).values}


def _output_response(completed: VerbCall) -> None:
    write_files(completed)
    result: Response = completed.result
    unit = result.data["peak_amplitude"].attrs["units"]
    shift, ratio = "shift from the free peak", "amplitude / free peak"
    in_row = result.peak_blades is not None
    heads = (result.along, f"{result.of} [{unit}]", "period", "stable", "half width / value", shift, ratio)
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
        **_extreme_rows(result),
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


def _members_of(result: Response) -> list[str]:
    """How rows of a table name the members; empty where there is only one."""
    return [f" of member {i}" for i in range(result.data.sizes["member"])] if result.over else [""]


def _extreme_rows(result: Response) -> dict[str, str]:
    """The largest amplitude and the smallest P_d of each member."""
    rows = zip(_members_of(result), result.extremes, strict=True)
    return {f"{name}{member}": extreme["words"] for member, extremes in rows for name, extreme in extremes.items()}


def _jump_rows(result: Response) -> dict[str, str]:
    """The values before which the sweeps jump, by direction and member."""
    return {
        f"jumps {direction}{member}": ", ".join(_place_text(result, value) for value in values)
        for member, jumps in zip(_members_of(result), result.jumps, strict=True)
        for direction, values in jumps.items()
    }


# Branch


def _scene_of_branch(options: argparse.Namespace) -> SceneFile:
    """The scene at the value at which a branch begins."""
    return load_scene(options, [] if options.at is None else [f"{options.along}={options.at}"])


def _branch_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The ends of the range; where to begin, the scene says."""
    values = _values_in_range(file, options, options.along)
    if options.num:
        refuse_existing(options.out / BACKGROUND_FILE, options.force)
    return {"start": float(values.min()), "stop": float(values.max()), "at": None}


def _background_sweep(completed: VerbCall) -> SweepResult | None:
    """The sweep that is drawn behind a branch, by the same method; it is stored too."""
    file, options, march = completed.file, completed.options, completed.march
    if not options.num or march is None:
        return None
    values = _values_in_range(file, options, options.along, max(options.num, 2))
    run = file.sweep_run
    with progress_bar("lane-periods") as report, input_errors_at(file.name):
        check_size(values.size, run.transient, run.periods)
        sweep = jaxshroud.sweep(
            file.scene,
            {options.along: values},
            n_periods=run.periods,
            transient=run.transient,
            method=march.again,
            amplitudes=file.layout != PAIR,
            progress=report,
        )
    with_origin(sweep, file).save(options.out / BACKGROUND_FILE)
    return sweep


def _output_branch(completed: VerbCall) -> None:
    branch: Branch = completed.result
    dataset_path, picture_path, summary_path = completed.paths
    branch.save(dataset_path)
    draw(lambda: branch.plot(over=_background_sweep(completed)), picture_path, dpi=completed.options.dpi)
    summary = {**branch.summary(), "seconds": completed.seconds}
    write_json(summary, summary_path)
    for line in branch.messages:
        print(line, file=sys.stderr)
    _print_special_points(branch, completed.options.along)
    rows = {name: value for name, value in summary.items() if name not in NOT_IN_BRANCH_TABLE}
    print_table(completed.title, {**rows, "written": files_written()})


def _print_special_points(branch: Branch, key: str) -> None:
    """Folds, flips and other bifurcations, if there are any."""
    if not branch.special:
        return
    heads = ("kind", key, "finer march away by", "period", "branch", "multiplier")
    rows = [
        (
            point.kind,
            f"{point.value:.9g}",
            "-" if point.error is None else f"{point.error:.1g}",
            str(point.q),
            str(point.branch),
            f"{point.multiplier:.6g}",
        )
        for point in branch.special
    ]
    print_columns("", heads, rows)


# Attractors and basins


def _basins_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The numbers of the plane, and their ranges."""
    plane = [name.strip() for name in options.plane.split(",")]
    return {"plane": plane, "ranges": _plane_ranges(file, plane, options)}


def _plane_ranges(file: SceneFile, plane: list[str], options: argparse.Namespace) -> list[tuple[float, float]] | None:
    """The ranges of --start and --stop, which have a value for each number of the plane."""
    if options.start is None and options.stop is None:
        return None
    ends = [[end.strip() for end in (text or "").split(",")] for text in (options.start, options.stop)]
    if any(len(end) != len(plane) or "" in end for end in ends):
        raise CommandError(f"--start and --stop need a value for each of {', '.join(plane)}, e.g. --start=-1mm,-0.5")
    axes = [
        axis(file, f"initial.{name.removeprefix('initial.')}", start=start, stop=stop, num=2).values
        for name, start, stop in zip(plane, *ends, strict=True)
    ]
    return [(float(values.min()), float(values.max())) for values in axes]


def _output_attractors(completed: VerbCall) -> None:
    attractors: Attractors = completed.result
    summary = {**attractors.summary(), "seconds": completed.seconds}
    write_files(completed, summary)
    heads = (
        "motion",
        "share of starts (95 %)",
        "P_d [%]",
        "distance to the nearest other motion, in sizes of the motion",
    )
    rows = [
        (
            name,
            between(attractors.share[i], attractors.share_low[i], attractors.share_high[i]),
            with_interval(attractors.P_d[i], attractors.P_d_ci[i]),
            f"{attractors.distance[i]:.3g}" if np.isfinite(attractors.distance[i]) else "no other",
        )
        for i, name in enumerate(attractors.names)
    ]
    print_columns("", heads, rows)
    rows = {name: summary[name] for name in IN_ATTRACTORS_TABLE}
    print_result(completed, {**rows, "worst": attractors.worst_text})


orbit_command = Computation(output=_output_orbit)
lyapunov_command = Computation(output=_output_exponents)
response_command = Computation(prepare=_response_arguments, output=_output_response)
branch_command = Computation(load=_scene_of_branch, prepare=_branch_arguments, output=_output_branch)
attractors_command = Computation(output=_output_attractors)
basins_command = Computation(prepare=_basins_arguments, output=_output_attractors)
