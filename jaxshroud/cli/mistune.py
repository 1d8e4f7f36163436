"""The command `mistune`: its axis, its store, and what it will take."""

import argparse
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxshroud.batch.plan import Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.cli.computation import Computation, VerbCall, call_verb, write_files
from jaxshroud.cli.projection import print_projection_of_long_run
from jaxshroud.cli.sweep import RESUME_ADVICE
from jaxshroud.cli.terminal import CommandError, files_written, print_columns, print_table, warn_status
from jaxshroud.io.unfinished_store import remove_store
from jaxshroud.results.extremes import amplitude_words
from jaxshroud.results.mistuned import Mistuned
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.layout import SINGLE_DIRECTIONS
from jaxshroud.scene.mistuning import NO_PATTERN
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.title import display_value
from jaxshroud.verbs.arguments import MarchPlan
from jaxshroud.verbs.mistune import search_size
from jaxshroud.verbs.mistuned_rows import tuned_store
from jaxshroud.verbs.sweep import MAX_LANES_AT_ONCE


def _mistune_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    own = _axis_of(file, options)
    arguments = {"along": {own.key: own.values}, "designs": options.designs or [NO_PATTERN]}
    if options.linear is not None or file.scene.parts.contact == "none":
        if options.resume:
            raise CommandError("--resume goes on with a march; a linear row is in closed form and has no store")
        return arguments
    return {**arguments, "store": claimed_store(options)}


def _axis_of(file: SceneFile, options: argparse.Namespace) -> Axis:
    """The axis of the options, or the scene's own."""
    if options.along is None:
        if len(file.axes) != 1:
            raise CommandError(f"{file.name} does not sweep one key; give --along KEY --start A --stop B")
        return file.axes[0]
    return axis(file, options.along, start=options.start, stop=options.stop, num=options.num)


def claimed_store(options: argparse.Namespace) -> Path:
    """The store of the march; one that exists is refused, continued or replaced."""
    store = options.out / "mistune.zarr"
    for path in (store, tuned_store(store)):
        if path.exists() and not (options.resume or options.force):
            raise CommandError(f"{path}: exists and is kept; give --resume to go on with it, or --force to replace it")
        if options.force and not options.resume:
            remove_store(path)
    return store


def _print_projection_of_march(call: VerbCall, scenes: Scene, march: MarchPlan) -> None:
    """Print what a long march will take, the search included."""
    chosen = call.arguments
    direction = chosen["direction"]
    (values,) = chosen["along"].values()
    if direction != "independent":  # the patterns of a value run side by side, not the values of a pattern

        def by_value(a):
            return np.swapaxes(np.reshape(a, (-1, len(values), *np.shape(a)[1:])), 0, 1).reshape(np.shape(a))

        scenes = jax.tree.map(by_value, scenes)
    method = march.method._replace(amplitudes=True)
    plan = march._replace(method=method).plan(chosen["transient"], chosen["n_periods"])
    lanes = len(scenes.drive.omega)
    blades = scenes.layout.blades
    size = search_size(chosen["scan"], chosen["starts"], chosen["updates"], None, direction)
    searched = 0 if size is None else size.most_patterns(1 + blades / len(values)) * len(values)
    print_projection_of_long_run(
        scenes,
        plan,
        SINGLE_DIRECTIONS if direction == "both" else (direction,),
        lanes // len(values),
        repeats=1 + searched / lanes,
        lanes_held=min(lanes, MAX_LANES_AT_ONCE),
        place=f" in {chosen['store']}",
    )


def _run_mistuning(call: VerbCall, progress: Progress) -> Mistuned:
    try:
        return call_verb(call, progress)
    except Interrupted:
        store = call.arguments.get("store")
        raise KeyboardInterrupt(*([f"{store} with what had ended", RESUME_ADVICE] if store else [])) from None


def _output_mistuning(completed: VerbCall) -> None:
    result: Mistuned = completed.result
    write_files(completed)
    heads = ("design", "sigma", "5 %", "median", "95 %", "largest", "design alone")
    print_columns("amplification", heads, _amplification_rows(result))
    warn_status(result.status, result.chatter)
    worst = result.worst
    value = result.worst_value[result.worst]
    key = find_key(result.along)[0].parts
    shown = {
        "tuned": f"{amplitude_words(result.of, result.tuned_largest)} at {display_value(*key, result.tuned_value)}",
        "largest drawn": f"{result.amplification[worst]:.4g} times that, of blade {result.worst_blade[worst]} at "
        f"{display_value(*key, value)}; {100 * result.participation_ratio[worst]:.2g} % of the blades take part",
        "Whitehead (linear, one mode per blade)": f"{result.whitehead:.4g}",
        **_search_rows(result),
        "ended": result.ended,
        "method": result.method,
        "seconds": completed.seconds,
    }
    print_table(completed.title, {**shown, "written": files_written()})
    for line in result.messages:
        print(f"warning: {line}")


def _amplification_rows(result: Mistuned) -> list[tuple[str, ...]]:
    """The quantiles of each design and sigma with their intervals."""
    rows = []
    for i, design in enumerate(result.designs):
        for j, sigma in enumerate(result.sigmas):
            ends = zip(result.quantile[i, j], result.quantile_low[i, j], result.quantile_high[i, j], strict=True)
            quantiles = (f"{value:.4g} ({_known(low)} to {_known(high)})" for value, low, high in ends)
            largest = np.nanmax(result.amplification[i, j], initial=-np.inf)
            rows.append((design, f"{sigma:g}", *quantiles, f"{largest:.4g}", f"{result.design_amplification[i]:.4g}"))
    return rows


def _known(end: float) -> str:
    """The end of an interval as text, if there are patterns enough for it."""
    return f"{end:.4g}" if np.isfinite(end) else "not known"


def _search_rows(result: Mistuned) -> dict[str, str]:
    """The amplification that the gradient and random patterns have led to, if there was a search."""
    if result.searched_mistuning is None:
        return {}
    unit = "solutions" if result.linear else "lane-periods"
    by_gradient, by_chance = result.search_amplification[-1], result.random_amplification[-1]
    ties = f"; {result.search_ties} slopes at ties" if result.search_ties else ""
    return {
        "worst by gradient": f"{by_gradient:.4g}, after {result.search_cost[-1]:g} {unit}{ties}",
        "by random patterns": f"{by_chance:.4g}, at equal cost",
    }


mistune_command = Computation(
    prepare=_mistune_arguments,
    announce=_print_projection_of_march,
    run=_run_mistuning,
    output=_output_mistuning,
)
