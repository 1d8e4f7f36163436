"""The command `tune`."""

import argparse
from typing import Any

from jaxshroud.batch.extent import fits
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.numbers import bounds, limit_of, spreads, tolerances, values_of
from jaxshroud.cli.parser import MAP
from jaxshroud.cli.robust import told_limits, told_robustness
from jaxshroud.cli.store import named, tune_json
from jaxshroud.cli.terminal import blamed, directory, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.results import drawing, plot_design
from jaxshroud.results.files import write
from jaxshroud.results.store import write_json
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.design import corners, problem_of
from jaxshroud.verbs.robust import wanted_of
from jaxshroud.verbs.scattering import scattering_of
from jaxshroud.verbs.tune import objective_map, tune

ASKED = ("goal", "updates", "seed", "scan", "draws", "loss", "at_least", "samples", "motions")  # passed on as they are
FEWER = 2  # values a side of the map by which it is coarser where numbers scatter: each takes all draws


def tune_verb(options: argparse.Namespace) -> None:
    """Find the numbers of a scene that reduce the vibration most."""
    file = loaded(options)
    over = {a.key: (float(a.values[0]), float(a.values[1])) for a in (bounds(file, t) for t in options.over)}
    conditions = {a.key: a.values.tolist() for a in (values_of(file, t) for t in options.range)}
    scatter = {"tolerance": tolerances(file, options), "spread": spreads(options)}
    limits = {
        "most_penetration": limit_of(file, "--most-penetration", "shroud.gap", options.most_penetration),
        "most_force": limit_of(file, "--most-force", "drive.F_0", options.most_force),
    }
    directory(options.out, ("tune.json", "tune.nc", "tune.png", "best.toml"), options.force)
    with blamed(file.name):
        scattering = scattering_of(**scatter, draws=options.draws, seed=options.seed)
        wanted_of(scattering is not None, options.loss, options.at_least, options.samples, options.motions)
        problem = problem_of(file.scene, over, conditions, scattering)
        side = options.map if options.map is not None else MAP // (FEWER if scattering else 1)
        fits(problem.runs * side**2, file.run.transient, file.run.periods)
        extremes = corners(problem)
    how = march(file, extremes, options, FAST, derivatives=True)
    with progress_bar("lane-periods") as report:
        with blamed(file.name):
            tuned = tune(
                file.scene,
                over,
                conditions=conditions,
                **scatter,
                **limits,
                **{name: getattr(options, name) for name in ASKED},
                n_starts=options.starts,
                n_periods=file.run.periods,
                transient=file.run.transient,
                steps_per_period=how.steps,
                method=how.method,
                progress=report,
            )
        drawn = objective_map(tuned, side) if len(over) == 2 and side else None
    _written(tuned, drawn, file, options)


def _written(tuned: Tuned, drawn: dict[str, Any] | None, file: SceneFile, options: argparse.Namespace) -> None:
    """What was found, as files and as a table."""
    named(tuned, file).save(options.out / "tune.nc")
    data = tune_json(tuned, drawn, file)
    write_json(data, options.out / "tune.json")
    drawing.save(plot_design.tuning(data), options.out / "tune.png")
    best = loaded(options, *(f"{key}={value!r}" for key, value in tuned.design.items()))
    write(options.out / "best.toml", best.text().encode())
    told = {
        **({} if tuned.feasible else {"infeasible": "the best design found does not keep the limits, or stops"}),
        **{key: f"{value:.6g}" for key, value in tuned.design.items()},
        f"{options.goal} P_d{' over the draws' if tuned.scatters else ''}": f"{tuned.objective:.4g} %",
        **{f"  {name}": f"{c.objective[0]:.4g} %" for name, c in tuned.checks.items()},
        **({"at a bound": tuned.at_bounds} if tuned.at_bounds else {}),
        **told_limits(tuned),
        **told_robustness(tuned),
        "verdict": "confirmed" if tuned.confirmed else "not confirmed: the simulations differ, or exceed a limit",
        "periods simulated": tuned.periods,
        "written": options.out,
    }
    print_table(file.title or file.name, told)
