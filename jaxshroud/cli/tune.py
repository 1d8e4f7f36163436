"""The command `tune`."""

import argparse
import math

from jaxshroud.batch.extent import fits
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.store import named, tune_json
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.results import drawing, plot_design
from jaxshroud.results.files import write
from jaxshroud.results.store import write_json
from jaxshroud.scene.axes import axis
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.verbs.design import corners, problem_of
from jaxshroud.verbs.tune import objective_map, tune


def tune_verb(options: argparse.Namespace) -> None:
    """Find the numbers of a scene that reduce the vibration most."""
    file = loaded(options)
    over = {a.key: (float(a.values[0]), float(a.values[1])) for a in (bounds(file, t) for t in options.over)}
    conditions = {a.key: a.values.tolist() for a in (values_of(file, t) for t in options.range)}
    most_v = limit_of(file, "--most-penetration", "shroud.gap", options.most_penetration)
    most_N = limit_of(file, "--most-force", "drive.F_0", options.most_force)
    directory(options.out, ("tune.json", "tune.nc", "tune.png", "best.toml"), options.force)
    asked = file.run
    with blamed(file.name):
        extremes = corners(problem_of(file.scene, over, conditions))
        fits(math.prod(map(len, conditions.values())) * options.map**2, asked.transient, asked.periods)
    how = march(file, extremes, options, FAST, derivatives=True)
    with progress_bar("lane-periods") as report:
        with blamed(file.name):
            tuned = tune(
                file.scene,
                over,
                conditions=conditions,
                goal=options.goal,
                most_penetration=most_v,
                most_force=most_N,
                scan=options.scan,
                n_starts=options.starts,
                updates=options.updates,
                n_periods=asked.periods,
                transient=asked.transient,
                steps_per_period=how.steps,
                seed=options.seed,
                method=how.method,
                progress=report,
            )
        drawn = objective_map(tuned, options.map) if len(over) == 2 and options.map else None
    named(tuned, file).save(options.out / "tune.nc")
    data = tune_json(tuned, drawn, file)
    write_json(data, options.out / "tune.json")
    drawing.save(plot_design.tuning(data), options.out / "tune.png")
    best = loaded(options, *(f"{key}={value!r}" for key, value in tuned.design.items()))
    write(options.out / "best.toml", best.text().encode())
    print_table(
        file.title or file.name,
        {
            **({} if tuned.feasible else {"infeasible": "the best design found does not keep the limits, or stops"}),
            **{key: f"{value:.6g}" for key, value in tuned.design.items()},
            f"{options.goal} P_d": f"{tuned.objective:.4g} %",
            **{f"  {name}": f"{c.objective[0]:.4g} %" for name, c in tuned.checks.items()},
            **({"at a bound": tuned.at_bounds} if tuned.at_bounds else {}),
            "verdict": "confirmed" if tuned.confirmed else "not confirmed: the simulations differ, or exceed a limit",
            "periods simulated": tuned.periods,
            "written": options.out,
        },
    )


def bounds(file: SceneFile, text: str) -> Axis:
    """A number with its lower and upper bound, from KEY=LOW:HIGH."""
    key, _, ends = text.partition("=")
    if ends.count(":") != 1:
        raise CommandError(f"--over {text}: is not KEY=LOW:HIGH, e.g. --over shroud.gap=5um:200um")
    return axis(file, key.strip(), ends.split(":"), where=f"--over {key}")


def values_of(file: SceneFile, text: str) -> Axis:
    """An operating condition with its values, from KEY=A,B,C."""
    key, _, values = text.partition("=")
    if not values:
        raise CommandError(f"--range {text}: is not KEY=A,B,C, e.g. --range drive.F_0=20,40,60,80")
    return axis(file, key.strip(), values, where=f"--range {key}")


def limit_of(file: SceneFile, flag: str, key: str, text: str | None) -> float:
    """A limit with the unit of a key; infinity where none is given."""
    if text is None:
        return float("inf")
    value = float(axis(file, key, ["0", text], where=f"{flag} {text}").values[1])
    if not value > 0:
        raise CommandError(f"{flag} {text}: must be positive")
    return value
