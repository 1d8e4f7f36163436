"""The command `sweep`."""

import argparse
import math
import sys
import time
from datetime import timedelta
from pathlib import Path
from typing import Any, NoReturn

import jax
import numpy as np

from jaxshroud.batch.extent import fits, memory, results_size
from jaxshroud.batch.periods import CHUNK
from jaxshroud.batch.projection import projected_seconds
from jaxshroud.batch.runs import Plan
from jaxshroud.batch.threads import Interrupted, cores
from jaxshroud.cli.asked import loaded, march, unmet, warned
from jaxshroud.cli.axes import with_axes
from jaxshroud.cli.plot import draw_dataset
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_table, progress_bar, warn_status
from jaxshroud.march.method import FAST, FAST_WITH_LEDGER
from jaxshroud.model.modes import Status
from jaxshroud.motion.settling import UNKNOWN
from jaxshroud.results.files import written
from jaxshroud.results.store import write_json
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.unfinished import BEGUN, relabel, remove
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.parts import WAYS
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import Choice
from jaxshroud.verbs.door import Marched
from jaxshroud.verbs.sweep import AT_ONCE, sweep
from jaxshroud.version import __version__

LONG = 10**9  # steps of lanes: minutes
ALONE = 16  # as long as so many lanes of a chunk takes one that is run by itself
GOES_ON = "; the same command with --resume goes on"
MOST_IN_FILE = 2**30  # bytes of results that are held in memory, and written at the end as one file


def sweep_verb(options: argparse.Namespace) -> None:
    """Simulate a scene for many values of its numbers."""
    file = with_axes(loaded(options), options)
    if not 0 <= options.phase < 2 * np.pi:
        raise CommandError(f"--phase must be in [0, 2 pi), but is {options.phase}")
    if not 0 <= options.period_tol < np.inf:
        raise CommandError(f"--period-tol must be a number of at least 0, but is {options.period_tol}")
    asked, began, place = file.sweep_run, time.perf_counter(), _store(file, options)
    with blamed(file.name):
        count = _count(file)
        at_once = place is not None or options.no_samples
        fits(count, asked.transient, asked.periods, min(count, AT_ONCE) if at_once else None)
    lanes = _lanes(file)
    how = march(file, lanes, options, FAST_WITH_LEDGER if options.ledger else FAST)
    plan = Plan(asked.transient, asked.periods, how.steps, options.phase, how.method)
    slow = 1 if file.direction == "independent" else max(ALONE // _beside(file), 1)
    if slow * count * (plan.transient + plan.kept) * plan.steps_per_period > LONG:
        _tell_projection(file, lanes, plan, options, place)
    with progress_bar("lane-periods") as report, blamed(file.name):
        try:
            result = sweep(
                file.scene,
                {a.key: a.values for a in file.axes},
                n_periods=asked.periods,
                transient=asked.transient,
                direction=file.direction,
                phase=options.phase,
                period_tol=options.period_tol,
                ledger=options.ledger,
                lyapunov=options.lyapunov,
                forces=options.forces,
                samples=not options.no_samples,
                progress=report,
                **_marched(how, place, options),
            )
        except Interrupted as stopped:
            if stopped.done is None:
                raise _unfinished(place) from None
            _keep_finished(stopped.done, file, options.out, place, began)
    if place is None:
        missed = _save(named(result, file), file, unmet(lanes, how.choice), how.choice, options.out)
    else:
        written.append(place)
        relabel(place, named(result, file).data.attrs)
        missed = None if how.choice is None else warned(result.inaccurate, how.choice)
        draw_dataset(place, result.to_xarray(), options.out / "sweep.png")
    met = {} if missed is None else {"accuracy": str(how.choice), "inaccurate": int(missed.sum())}
    summary = _summary(result, file, began) | met
    write_json(summary, options.out / "summary.json")
    warn_status(result.status, result.chatter)
    print_table(file.title or file.name, {**summary, "written": options.out})


def _tell_projection(
    file: SceneFile, lanes: Scene, plan: Plan, options: argparse.Namespace, place: Path | None
) -> None:
    """Say what a long run will take, before it starts."""
    count, beside = _count(file), _beside(file)
    lanes, each = in_precision(lanes, plan.method.precision), {}
    ways = WAYS if file.direction == "both" else (file.direction,)
    for at_once in {None if way == "independent" else beside for way in ways}:
        with progress_bar("lane-periods of a trial") as report:
            each[at_once] = projected_seconds(lanes, plan, beside=at_once, progress=report)
    taken = [each[None if way == "independent" else beside] for way in ways]
    busy = [min(cores(), cores() if way == "independent" else -(-beside // CHUNK)) for way in ways]
    whole = timedelta(seconds=round(sum(taken)))
    real = timedelta(seconds=round(sum(seconds / n for seconds, n in zip(taken, busy, strict=True))))
    by = f", {real} h on {cores()} core{'s' * (cores() > 1)}" if options.scheduler is None else ""
    held = memory(count, plan.kept, min(count, AT_ONCE) if place is not None or options.no_samples else None) / 2**30
    stored = results_size(count, plan.kept, samples=not options.no_samples) / 2**30
    about = f"some {whole} h of processor time{by}, {held:.3g} GiB of memory, {stored:.3g} GiB of results"
    print(f"{count} lanes: {about}{'' if place is None else f' in {place}'}", file=sys.stderr)


def _beside(file: SceneFile) -> int:
    """How many lanes each value of the first key has."""
    return math.prod(a.values.size for a in file.axes[1:])


def _count(file: SceneFile) -> int:
    """How many lanes there are."""
    return math.prod(a.values.size for a in file.axes) * (len(WAYS) if file.direction == "both" else 1)


def _store(file: SceneFile, options: argparse.Namespace) -> Path | None:
    """Where the sweep is stored block by block, None where it is a file; the place made free for it."""
    if options.resume and options.store == "nc":
        raise CommandError("--resume goes on with a store; leave out --store nc")
    if options.scheduler and options.store == "nc":
        raise CommandError("--scheduler needs a store, which keeps what workers have computed; leave out --store nc")
    size = results_size(_count(file), file.sweep_run.periods, samples=not options.no_samples)
    usual = "zarr" if options.resume or options.scheduler or size > MOST_IN_FILE else "nc"
    if (options.store or usual) == "nc":
        directory(options.out, ("sweep.nc", "sweep.png", "summary.json"), options.force)
        return None
    place = options.out / "sweep.zarr"
    if place.exists() and not (options.resume or options.force):
        raise CommandError(f"{place}: exists and is kept; give --resume to go on with it, or --force to replace it")
    directory(options.out, () if options.resume else (place.name, "sweep.png", "summary.json"), options.force)
    if options.force and not options.resume:
        remove(place)
    return place


def _marched(how: Marched, place: Path | None, options: argparse.Namespace) -> dict[str, Any]:
    """How the lanes are marched, by whom, and where they are stored, as arguments."""
    if place is None:
        return {"steps_per_period": how.steps, "method": how.method}
    chosen = {"method": how.method, "steps_per_period": how.steps} if how.choice is None else {"accuracy": how.choice}
    return {**chosen, "store": place, "resume": options.resume, "scheduler": options.scheduler}


def _save(
    result: SweepResult, file: SceneFile, missed: np.ndarray | None, choice: Choice | None, out: Path
) -> np.ndarray | None:
    """Write and draw a sweep, with the lanes that miss the accuracy asked for; these again."""
    ds = result.to_xarray()
    if choice is not None and missed is not None:
        about = {"long_name": "estimated to miss the accuracy asked for", "accuracy": choice.accuracy}
        dims, shape = ds["status"].dims[-len(file.axes) :], ds["status"].shape[-len(file.axes) :]
        ds["inaccurate"] = (dims, missed.reshape(shape).astype(np.int8), about)
    result.save(out / "sweep.nc")
    draw_dataset(out / "sweep.nc", ds, out / "sweep.png")
    return missed


def _unfinished(place: Path | None) -> KeyboardInterrupt:
    """What an interrupted sweep says that has finished no block: of its first, values may be kept."""
    if place is None or not any((place / "resume").glob(f"*{BEGUN}")):
        return KeyboardInterrupt()
    return KeyboardInterrupt(f"{place} with the values of its first block that had ended", GOES_ON)


def _keep_finished(result: SweepResult, file: SceneFile, out: Path, place: Path | None, began: float) -> NoReturn:
    """Write what an interrupted sweep had finished, without a picture; a store has it already."""
    known = f"with the {(result.status != Status.NOT_RUN).sum()} of {result.status.size} lanes that had ended"
    if place is not None:
        raise KeyboardInterrupt(f"{place} {known}", GOES_ON)
    named(result, file).save(out / "sweep.nc")
    write_json(_summary(result, file, began), out / "summary.json")
    raise KeyboardInterrupt(f"{out / 'sweep.nc'} {known}")


def _summary(result, file: SceneFile, began: float) -> dict[str, Any]:
    return {**sweep_summary(result, time.perf_counter() - began), "scene": file.name, "version": __version__}


def sweep_summary(result, seconds: float) -> dict[str, Any]:
    """A sweep in a few numbers."""
    ok, residual, dropped = result.status == Status.OK, result.energy_residual, result.energy_dropped
    P_d = np.where(ok, result.P_d, np.nan)
    numbers, counts = np.unique(result.period_number[ok], return_counts=True)
    best = None
    if np.isfinite(P_d).any():
        at = np.unravel_index(np.nanargmax(P_d), P_d.shape)
        place = {key: float(v[i]) for (key, v), i in zip(result.axes.items(), at[-len(result.axes) :], strict=True)}
        best = {"P_d": float(P_d[at]), "ci": float(result.P_d_ci[at]), **place}
    return {
        **_directions(result),
        "lanes": int(ok.size),
        "periods kept": len(result.period),
        "status": {s.name: int((result.status == s).sum()) for s in Status if (result.status == s).any()},
        "period numbers": {str(n) if n else "aperiodic": int(c) for n, c in zip(numbers, counts, strict=True)},
        "unsettled": int((~result.settled & ok).sum()),
        **_settling(result, ok),
        "largest P_d": best,
        **({} if result.lyapunov is None else {"positive exponents": _positive(result)}),
        **({} if residual is None else {"largest energy residual": float(np.max(residual, where=ok, initial=0.0))}),
        **({} if dropped is None else {"largest energy dropped": float(np.max(dropped, where=ok, initial=0.0))}),
        **_forces(result, ok),
        "method": f"{result.method}, {result.steps_per_period} steps a period",
        "seconds": round(seconds, 2),
    }


def _positive(result) -> int:
    """How many lanes have a largest exponent that is positive with its interval."""
    return int((result.lyapunov - result.lyapunov_ci > 0).sum())


def _forces(result, ok: np.ndarray) -> dict[str, float]:
    """Largest forces and work of friction of all lanes, if they were kept."""
    told = {
        "largest normal force [N]": result.N_max,
        "largest friction force [N]": result.F_max,
        "largest work of friction per period [J]": result.friction_work,
    }
    return {name: float(np.max(a, where=ok, initial=0.0)) for name, a in told.items() if a is not None}


def _directions(result) -> dict[str, Any]:
    """Where the motion jumps and where motions coexist, of a sweep in several directions."""
    if result.jump is None:
        return {}
    ((_, values),) = result.axes.items()
    ways = result.data["direction"].to_numpy().tolist()
    jumps = {f"jumps {way}": values[row].tolist() for way, row in zip(ways, result.jump, strict=True) if row.any()}
    return {"values with coexisting motions": int(result.coexisting.sum()), **jumps}


def _settling(result, ok: np.ndarray) -> dict[str, Any]:
    """What is known of lanes that are not settled, and of intervals that span too little."""
    more = result.periods_more[ok & np.isfinite(result.periods_more)]
    return {
        "of these unknown": int(((result.settling == UNKNOWN) & ok).sum()),
        "most periods more": float(more.max(initial=0.0)),
        "P_d unsettled": int((~result.P_d_settled & ok).sum()),
        "short intervals of P_d": int((result.P_d_ci_short & ok).sum()),
    }


def _lanes(file: SceneFile):
    """The scenes of a sweep (leading axis)."""
    scenes = grid_of_scenes(file.scene, {a.key: a.values for a in file.axes})
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(file.axes) :]), scenes)
