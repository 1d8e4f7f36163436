"""The command `sweep`: its axes, its store, what it will take, and what an interrupted one keeps."""

import argparse
import math
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import jax
import numpy as np

from jaxshroud.batch.limits import check_size, results_size
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.threads import Interrupted
from jaxshroud.cli.computation import DATASETS, PICTURES, STATISTICS, import_in_background, with_origin
from jaxshroud.cli.drawing import draw
from jaxshroud.cli.option_table import Along, count
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.projection import print_projection_of_long_run
from jaxshroud.cli.run_options import accuracy_warnings_printed, load_scene, resolve_march, resolved_options
from jaxshroud.cli.terminal import (
    CommandError,
    claim_directory,
    files_written,
    input_errors_at,
    print_table,
    warn_status,
)
from jaxshroud.io.files import place_of, written_files
from jaxshroud.io.store import write_json
from jaxshroud.io.unfinished_store import remove_store, write_attributes
from jaxshroud.march.method import FOR_P_D, FOR_P_D_WITH_LEDGER
from jaxshroud.model.modes import Status
from jaxshroud.results.extremes import passed_sides
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import MAX_VALUES
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.layout import SINGLE_DIRECTIONS
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.title import display_value
from jaxshroud.signals.effects import with_interval
from jaxshroud.verbs.arguments import check_row
from jaxshroud.verbs.asked import MarchPlan
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE, sweep

BARE_AMPLITUDES = ("largest amplitude of x [m]", "largest amplitude of y [m]", "largest amplitude of theta [rad]")
DOUBTED = {  # of runs that a result marks, by the names of the marks
    "inaccurate": "may miss the accuracy{of} over three periods (marked in {store}): statistics of chaos bear it, "
    "single values do not",
    "unconfirmed": "settle elsewhere by a finer march (marked in {store})",
}
RESUME_ADVICE = "; the same command with --resume goes on"
MOST_IN_FILE = 2**30  # bytes of results that are held in memory, and written at the end as one file


class SweepRequest(NamedTuple):
    """A sweep whose options are in order."""

    file: SceneFile
    options: argparse.Namespace
    store: Path | None  # where it is stored block by block; None: in one file
    start: float  # of the command [s], by `time.perf_counter`

    @property
    def lanes(self) -> int:
        """How many lanes there are."""
        return _lane_count(self.file)

    @property
    def row_lanes(self) -> int:
        """How many lanes each value of the first key has."""
        return math.prod(a.values.size for a in self.file.axes[1:])

    @property
    def lanes_held(self) -> int | None:
        """How many lanes have their samples in memory at once; None: all."""
        in_blocks = self.store is not None or self.options.no_samples
        return min(self.lanes, MAX_LANES_AT_ONCE) if in_blocks else None


def sweep_command(options: argparse.Namespace) -> None:
    """Simulate a scene for many values of its numbers."""
    file = with_axes(load_scene(options), options)
    _check_numbers(options)
    check_row(file.scene, lyapunov=options.lyapunov)
    start = time.perf_counter()
    request = SweepRequest(file, options, _claim_store(file, options), start)
    with input_errors_at(file.name):
        run, blades = file.sweep_run, file.layout.blades
        check_size(request.lanes, run.transient, run.periods, request.lanes_held, blades)
    scenes = _scenes_of_lanes(file)
    periods = file.sweep_run.transient + file.sweep_run.periods
    import_in_background((*DATASETS, *STATISTICS, *PICTURES))
    usual = FOR_P_D_WITH_LEDGER if options.ledger else FOR_P_D
    march = resolve_march(resolved_options(file, options, usual), file, scenes, options, usual, periods=periods)
    _print_projection_of_long_run(request, scenes, march)
    result = _sweep(request, march)
    _write(request, result)
    summary = _summary(request, result)
    if result.accuracy is not None:
        summary |= {"accuracy": result.accuracy.removeprefix("accuracy ")}
    store = "sweep.nc" if request.store is None else request.store.name
    for name, do in DOUBTED.items():
        lanes = getattr(result, name)
        if lanes is not None:
            of = f" of {march.tried.accuracy:.0e}" if march.tried else ""
            words = f"{lanes.sum()} of {lanes.size} runs" + f" {do.format(store=store, of=of)}" * bool(lanes.any())
            summary |= {name: {"runs": int(lanes.sum()), "words": words}}
    write_json(summary, options.out / "summary.json")
    warn_status(result.status, result.chatter)
    for line in passed_sides(result):
        print(f"warning: {line}", file=sys.stderr)
    shown = {**_in_words(summary), **_best_row(summary), **_jump_places(result), "written": files_written()}
    print_table(file.title or file.name, shown)


def _check_numbers(options: argparse.Namespace) -> None:
    if not 0 <= options.phase < 2 * np.pi:
        raise CommandError(f"--phase must be in [0, 2 pi), but is {options.phase}")
    if not 0 <= options.period_tol < np.inf:
        raise CommandError(f"--period-tol must be a number of at least 0, but is {options.period_tol}")


def _lane_count(file: SceneFile) -> int:
    return math.prod(a.values.size for a in file.axes) * (len(SINGLE_DIRECTIONS) if file.direction == "both" else 1)


def _scenes_of_lanes(file: SceneFile) -> Scene:
    """The scenes of a sweep (leading axis)."""
    scenes = grid_of_scenes(file.scene, {a.key: a.values for a in file.axes})
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(file.axes) :]), scenes)


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


def _print_projection_of_long_run(request: SweepRequest, scenes: Scene, march: MarchPlan) -> None:
    """Print what a run will take that is long."""
    run = request.file.sweep_run
    plan = Plan(run.transient, run.periods, march.steps, request.options.phase, march.method)
    print_projection_of_long_run(
        scenes,
        plan,
        SINGLE_DIRECTIONS if request.file.direction == "both" else (request.file.direction,),
        request.row_lanes,
        repeats=2.0 if request.options.confirm else 1.0,
        elsewhere=request.options.scheduler is not None,
        lanes_held=request.lanes_held,
        samples=not request.options.no_samples,
        place="" if request.store is None else f" in {request.store}",
    )


# Computation and results


def _sweep(request: SweepRequest, march: MarchPlan) -> SweepResult:
    """The sweep; where it is interrupted, what has ended is written."""
    file, options, store, _ = request
    stored = {} if store is None else {"store": store, "resume": options.resume, "scheduler": options.scheduler}
    with accuracy_warnings_printed(), progress_bar("lane-periods") as report, input_errors_at(file.name):
        try:
            return sweep(
                file.scene,
                {a.key: a.values for a in file.axes},
                n_periods=file.sweep_run.periods,
                transient=file.sweep_run.transient,
                direction=file.direction,
                phase=options.phase,
                period_tol=options.period_tol,
                ledger=options.ledger,
                lyapunov=options.lyapunov,
                forces=options.forces,
                amplitudes=options.amplitudes,
                confirm=options.confirm,
                keep_samples=not options.no_samples,
                progress=report,
                method=march.again,
                **stored,
            )
        except Interrupted as interrupt:
            if interrupt.done is None:
                raise KeyboardInterrupt from None
            _keep_ended_lanes(request, interrupt.done)


def _keep_ended_lanes(request: SweepRequest, result: SweepResult) -> NoReturn:
    """Write the lanes of an interrupted sweep that had ended, without a picture; a store has them already."""
    ended = f"with the {(result.status != Status.NOT_RUN).sum()} of {result.status.size} lanes that had ended"
    if request.store is not None:
        raise KeyboardInterrupt(f"{request.store} {ended}", RESUME_ADVICE)
    path = request.options.out / "sweep.nc"
    with_origin(result, request.file).save(path)
    write_json(_summary(request, result), request.options.out / "summary.json")
    raise KeyboardInterrupt(f"{place_of(path)} {ended}")


def _write(request: SweepRequest, result: SweepResult) -> None:
    """Write a sweep, of a store what is not yet there, and its picture."""
    with_origin(result, request.file)
    path = request.store or request.options.out / "sweep.nc"
    if request.store is None:
        result.save(path)
    else:
        written_files[path] = path
        write_attributes(path, result.data.attrs)
    draw(result.plot, request.options.out / "sweep.png", dpi=request.options.dpi)


def _summary(request: SweepRequest, result: SweepResult) -> dict[str, Any]:
    return {**result.summary(), "seconds": round(time.perf_counter() - request.start, 2)}


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
