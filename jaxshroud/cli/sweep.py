"""The command `sweep`: its axes, its store, what it will take, and what an interrupted one keeps."""

import argparse
import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from jaxshroud.batch.limits import results_size
from jaxshroud.batch.plan import Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.cli.computation import DATASETS, PICTURES, STATISTICS, Computation, VerbCall, call_verb, with_origin
from jaxshroud.cli.option_table import Along, count
from jaxshroud.cli.projection import print_projection_of_long_run
from jaxshroud.cli.run_options import load_scene
from jaxshroud.cli.terminal import (
    CommandError,
    claim_directory,
    draw,
    files_written,
    print_table,
    warn_status,
)
from jaxshroud.io.files import place_of, written_files
from jaxshroud.io.store import write_json
from jaxshroud.io.unfinished_store import remove_store, write_attributes
from jaxshroud.model.modes import Status
from jaxshroud.results.extremes import passed_sides
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import MAX_VALUES
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.layout import SINGLE_DIRECTIONS
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.title import display_value
from jaxshroud.signals.effects import with_interval
from jaxshroud.verbs.arguments import MarchPlan
from jaxshroud.verbs.lanes import check_row
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE

BARE_AMPLITUDES = ("largest amplitude of x [m]", "largest amplitude of y [m]", "largest amplitude of theta [rad]")
DOUBTED = {  # of runs that a result marks, by the names of the marks
    "inaccurate": "may miss the accuracy{of} over three periods (marked in {store}): statistics of chaos bear it, "
    "single values do not",
    "unconfirmed": "settle elsewhere by a finer march (marked in {store})",
}
RESUME_ADVICE = "; the same command with --resume goes on"
MOST_IN_FILE = 2**30  # bytes of results that are held in memory, and written at the end as one file


def _scene_of_sweep(options: argparse.Namespace) -> SceneFile:
    """The scene with the axes of the sweep."""
    return with_axes(load_scene(options), options)


def _sweep_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The axes, and the store."""
    _check_numbers(options)
    check_row(file.scene, lyapunov=options.lyapunov)
    return {
        "along": {a.key: a.values for a in file.axes},
        "n_periods": file.sweep_run.periods,
        "direction": file.direction,
        "keep_samples": not options.no_samples,
        "store": _claim_store(file, options),
    }


def _check_numbers(options: argparse.Namespace) -> None:
    if not 0 <= options.phase < 2 * np.pi:
        raise CommandError(f"--phase must be in [0, 2 pi), but is {options.phase}")
    if not 0 <= options.period_tol < np.inf:
        raise CommandError(f"--period-tol must be a number of at least 0, but is {options.period_tol}")


def _lane_count(file: SceneFile) -> int:
    return math.prod(a.values.size for a in file.axes) * (len(SINGLE_DIRECTIONS) if file.direction == "both" else 1)


# Axes


def with_axes(file: SceneFile, options: argparse.Namespace) -> SceneFile:
    """The scene file with the axes and the direction of the options."""
    axes = file.axes
    if options.along and options.along[0].key is None:
        axes = (_changed_axis(file, options.along[0]),)
    elif options.along:
        axes = tuple(_axis(file, along.key, along) for along in options.along)
    if not axes:
        raise CommandError(f"{file.name}: [sweep] is missing; add it, or give --along KEY --values a,b,c")
    return replace(file, axes=axes, direction=options.direction or file.direction)


def _axis(file: SceneFile, key: str, along: Along) -> Axis:
    num = along.num
    if num is not None:
        try:
            num = count(0, MAX_VALUES)(num)
        except argparse.ArgumentTypeError as error:
            raise CommandError(f"--along {key}: --num {error}") from None
    return axis(file, key, along.values, start=along.start, stop=along.stop, num=num)


def _changed_axis(file: SceneFile, along: Along) -> Axis:
    """The scene's own axis with some of what describes it replaced."""
    given = {name: value for name, value in vars(along).items() if value is not None}
    flags = " and ".join(f"--{name}" for name in given)
    if len(file.axes) != 1:
        raise CommandError(f"{flags} needs an --along KEY before it: {file.name} sweeps {len(file.axes) or 'no'} keys")
    (own,), values = file.axes, file.axes[0].values
    if "values" not in given and len(given) < 3:
        if not np.array_equal(values, np.linspace(values[0], values[-1], values.size)):
            raise CommandError(f"{flags}: [sweep] of {file.name} lists its values; give --start, --stop and --num")
        given = {"start": float(values[0]), "stop": float(values[-1]), "num": str(values.size), **given}
    return _axis(file, own.key, Along(**given))


# Store


def _claim_store(file: SceneFile, options: argparse.Namespace) -> Path | None:
    """Where the sweep is stored block by block, None where it is a file; files that exist are refused, or replaced."""
    if not _is_stored(file, options):
        claim_directory(options.out, ("sweep.nc", "sweep.png", "summary.json"), options.force)
        return None
    store = options.out / "sweep.zarr"
    if store.exists() and not (options.resume or options.force):
        raise CommandError(f"{store}: exists and is kept; give --resume to go on with it, or --force to replace it")
    claim_directory(options.out, () if options.resume else (store.name, "sweep.png", "summary.json"), options.force)
    if options.force and not options.resume:
        remove_store(store)
    return store


def _is_stored(file: SceneFile, options: argparse.Namespace) -> bool:
    """Whether the sweep is stored block by block."""
    if options.resume and options.store == "nc":
        raise CommandError("--resume goes on with a store; leave out --store nc")
    if options.scheduler and options.store == "nc":
        raise CommandError("--scheduler needs a store, which keeps what workers have computed; leave out --store nc")
    if options.store is not None:
        return options.store == "zarr"
    samples = not options.no_samples
    blades = file.layout.blades
    size = results_size(_lane_count(file), file.sweep_run.periods, samples=samples, blades=blades)
    return bool(options.resume or options.scheduler or size > MOST_IN_FILE)


# Projection


def _print_projection_of_long_sweep(call: VerbCall, scenes: Scene, march: MarchPlan) -> None:
    """Print what a run will take that is long."""
    file, options = call.file, call.options
    run = file.sweep_run
    store = call.arguments["store"]
    lanes = _lane_count(file)
    print_projection_of_long_run(
        scenes,
        march.plan(run.transient, run.periods, options.phase),
        SINGLE_DIRECTIONS if file.direction == "both" else (file.direction,),
        math.prod(a.values.size for a in file.axes[1:]),
        repeats=2.0 if options.confirm else 1.0,
        elsewhere=options.scheduler is not None,
        lanes_held=min(lanes, MAX_LANES_AT_ONCE) if store or options.no_samples else None,
        samples=not options.no_samples,
        place=f" in {store}" if store else "",
    )


# Computation and results


def _sweep(call: VerbCall, progress: Progress) -> SweepResult:
    """The sweep; where it is interrupted, what has ended is written."""
    try:
        return call_verb(call, progress)
    except Interrupted as interrupt:
        if interrupt.done is None:
            raise KeyboardInterrupt from None
        call.result = interrupt.done
        _keep_ended_lanes(call)


def _keep_ended_lanes(call: VerbCall) -> NoReturn:
    """Write the lanes of an interrupted sweep that had ended, without a picture; a store has them already."""
    result: SweepResult = call.result
    store = call.arguments["store"]
    ended = f"with the {(result.status != Status.NOT_RUN).sum()} of {result.status.size} lanes that had ended"
    if store is not None:
        raise KeyboardInterrupt(f"{store} {ended}", RESUME_ADVICE)
    path = call.options.out / "sweep.nc"
    with_origin(result, call.file).save(path)
    write_json(_summary(call), call.options.out / "summary.json")
    raise KeyboardInterrupt(f"{place_of(path)} {ended}")


def _output_sweep(completed: VerbCall) -> None:
    """Write a sweep, of a store what is not yet there, its picture and its summary."""
    result: SweepResult = completed.result
    options, march = completed.options, completed.march
    store = completed.arguments["store"]
    path = store or options.out / "sweep.nc"
    if store:
        written_files[path] = path
        write_attributes(path, result.data.attrs)
    else:
        result.save(path)
    draw(result.plot, options.out / "sweep.png", dpi=options.dpi)
    summary = _summary(completed)
    if result.accuracy is not None:
        summary |= {"accuracy": result.accuracy.removeprefix("accuracy ")}
    for name, do in DOUBTED.items():
        lanes = getattr(result, name)
        if lanes is not None:
            of = f" of {march.tried.accuracy:.0e}" if march and march.tried else ""
            words = f"{lanes.sum()} of {lanes.size} runs" + f" {do.format(store=path.name, of=of)}" * bool(lanes.any())
            summary |= {name: {"runs": int(lanes.sum()), "words": words}}
    write_json(summary, options.out / "summary.json")
    warn_status(result.status, result.chatter)
    for line in passed_sides(result):
        print(f"warning: {line}", file=sys.stderr)
    shown = {**_in_words(summary), **_best_row(summary), **_jump_places(result), "written": files_written()}
    print_table(completed.title, shown)


def _summary(completed: VerbCall) -> dict[str, Any]:
    return {**completed.result.summary(), "seconds": completed.seconds}


def _jump_places(result: SweepResult) -> dict[str, str]:
    """The values before which the motion jumps, or is steep, in each direction, in the unit of pictures."""
    key = next(iter(result.axes), "")

    def text(value):
        return display_value(*parse_key(key)[0].parts, value)

    places = {"jumps": result.jumps, "steep": result.steep_places}
    return {
        f"{kind} {direction}": ", ".join(map(text, values))
        for kind, by_direction in places.items()
        for direction, values in by_direction.items()
    }


def _in_words(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A summary as it is printed: what has words by these, and amplitudes not in SI units as well."""
    words = {name: value["words"] for name, value in summary.items() if isinstance(value, dict) and "words" in value}
    return {name: value for name, value in summary.items() if name not in BARE_AMPLITUDES} | words


def _best_row(summary: Mapping[str, Any]) -> dict[str, str]:
    """The largest P_d with its interval and where it is, if there is one."""
    if summary["largest P_d"] is None:
        return {}
    P_d, ci, *_ = summary["largest P_d"].values()
    place = ", ".join(_number_text(key, value) for key, value in [*summary["largest P_d"].items()][2:])
    return {"largest P_d": f"{with_interval(P_d, ci, '%')}, at {place}"}


def _number_text(head: str, value: float) -> str:
    """A number of a summary in the unit that its head names, or in the unit of pictures."""
    key, _, unit = head.partition(" [")
    in_unit = f"{value:.6g} {unit.removesuffix(']')}" if unit else display_value(*parse_key(key)[0].parts, value)
    return f"{key} = {in_unit}"


sweep_command = Computation(
    load=_scene_of_sweep,
    prepare=_sweep_arguments,
    claim=lambda options: None,
    imports=(*DATASETS, *STATISTICS, *PICTURES),
    announce=_print_projection_of_long_sweep,
    run=_sweep,
    output=_output_sweep,
)
