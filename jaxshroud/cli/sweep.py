"""The command `sweep`."""

import argparse
import math
import time
from pathlib import Path
from typing import Any, NoReturn

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.threads import Interrupted
from jaxshroud.cli.asked import loaded, march, unmet
from jaxshroud.cli.axes import with_axes
from jaxshroud.cli.plot import draw_dataset
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_table, progress_bar, warn_status
from jaxshroud.march.method import FAST, FAST_WITH_LEDGER
from jaxshroud.model.modes import Status
from jaxshroud.motion.settling import UNKNOWN
from jaxshroud.results.store import write_json
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.verbs.sweep import sweep
from jaxshroud.version import __version__


def sweep_verb(options: argparse.Namespace) -> None:
    """Simulate a scene for many values of its numbers."""
    file = with_axes(loaded(options), options)
    if not 0 <= options.phase < 2 * np.pi:
        raise CommandError(f"--phase must be in [0, 2 pi), but is {options.phase}")
    if not options.period_tol >= 0:
        raise CommandError(f"--period-tol must be a number of at least 0, but is {options.period_tol}")
    names = ("sweep.nc", "sweep.png", "summary.json")
    directory(options.out, names, options.force)
    asked, began = file.sweep_run, time.perf_counter()
    with blamed(file.name):
        fits(math.prod(a.values.size for a in file.axes), asked.transient, asked.periods)
    lanes = _lanes(file)
    how = march(file, lanes, options, FAST_WITH_LEDGER if options.ledger else FAST)
    with progress_bar("lane-periods") as report, blamed(file.name):
        try:
            result = sweep(
                file.scene,
                {a.key: a.values for a in file.axes},
                n_periods=asked.periods,
                transient=asked.transient,
                steps_per_period=how.steps,
                direction=file.direction,
                phase=options.phase,
                period_tol=options.period_tol,
                method=how.method,
                progress=report,
            )
        except Interrupted as stopped:
            if stopped.done is None:
                raise
            _keep_finished(stopped.done, file, options.out, began)
    ds, missed = named(result, file).to_xarray(), unmet(lanes, how.choice)
    if how.choice is not None and missed is not None:
        about = {
            "long_name": "estimated to miss the accuracy asked for",
            "accuracy": how.choice.accuracy,
        }
        ds["inaccurate"] = (ds["status"].dims, missed.reshape(ds["status"].shape).astype(np.int8), about)
    result.save(options.out / "sweep.nc")
    draw_dataset(options.out / "sweep.nc", ds, options.out / "sweep.png")
    met = {} if missed is None else {"accuracy": str(how.choice), "inaccurate": int(missed.sum())}
    summary = _summary(result, file, began) | met
    write_json(summary, options.out / "summary.json")
    warn_status(result.status, result.chatter)
    print_table(file.title or file.name, {**summary, "written": options.out})


def _keep_finished(result, file: SceneFile, out: Path, began: float) -> NoReturn:
    """Write what an interrupted sweep had finished, without a picture."""
    named(result, file).save(out / "sweep.nc")
    write_json(_summary(result, file, began), out / "summary.json")
    done, lanes = (result.status != Status.NOT_RUN).sum(), result.status.size
    raise KeyboardInterrupt(f"{out / 'sweep.nc'} with the {done} of {lanes} lanes that had ended")


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
        place = {key: float(v[i]) for (key, v), i in zip(result.axes.items(), at, strict=True)}
        best = {"P_d": float(P_d[at]), "ci": float(result.P_d_ci[at]), **place}
    return {
        "lanes": int(ok.size),
        "periods kept": len(result.period),
        "status": {s.name: int((result.status == s).sum()) for s in Status if (result.status == s).any()},
        "period numbers": {str(n) if n else "aperiodic": int(c) for n, c in zip(numbers, counts, strict=True)},
        "unsettled": int((~result.settled & ok).sum()),
        **_settling(result, ok),
        "largest P_d": best,
        **({} if residual is None else {"largest energy residual": float(np.max(residual, where=ok, initial=0.0))}),
        **({} if dropped is None else {"largest energy dropped": float(np.max(dropped, where=ok, initial=0.0))}),
        "method": f"{result.method}, {result.steps_per_period} steps a period",
        "seconds": round(seconds, 2),
    }


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
