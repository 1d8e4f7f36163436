"""The commands `gradient` and `tune`."""

import argparse
import math
import sys
from typing import Any

from jaxshroud.batch.extent import fits
from jaxshroud.batch.xla import alone
from jaxshroud.cli.store import gradient_json, tune_json
from jaxshroud.cli.terminal import (
    NUMERICAL,
    SEEDS,
    InputError,
    OneLineParser,
    check_step,
    chosen_method,
    count,
    directory,
    free,
    loaded,
    number,
    path,
    print_columns,
    print_table,
    progress_bar,
    scene_options,
)
from jaxshroud.results.files import write
from jaxshroud.results.store import write_json
from jaxshroud.scene.config import Axis, SceneFile, axis

MAP, MOST_MAP = 24, 1000  # values of each of two keys in the map behind the paths
CHECK_STEPS = (1e-4, 3e-5, 1e-5)  # relative


def _with_derivatives(options: argparse.Namespace):
    """The static choices of the march; an accuracy that float32 reaches is not one of its derivatives."""
    method = chosen_method(options)._replace(ledger=False)
    return method if options.choice is None else method._replace(precision="float64")


def gradient_options(made: OneLineParser) -> None:
    """Options of `jaxshroud gradient`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first, where smoothed")
    made.add_argument("--wrt", required=True, metavar="K1,K2", help="numbers of the scene, e.g. shroud.gap")
    made.add_argument("--of", choices=("P_d", "P"), default="P_d")
    made.add_argument("--sigma", type=number, default=0.01, help="relative width of the smoothing, in chaos")
    made.add_argument("--pairs", type=count(2), default=128, metavar="N", help="pairs of samples, in chaos")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N", help="of the samples")
    made.add_argument("--check", action="store_true", help="compare with differences at three step sizes")
    made.add_argument("--out", type=path, required=True, metavar="FILE.json")


def gradient_verb(options: argparse.Namespace) -> None:
    """`jaxshroud gradient`."""
    from jaxshroud.verbs.gradient import gradient

    file = loaded(options)
    free(options.out, options.force)
    if not 0 < options.sigma < float("inf"):
        raise InputError(f"--sigma must be positive, but is {options.sigma}")
    wrt = list(dict.fromkeys(key.strip() for key in options.wrt.split(",")))
    steps = check_step(file, alone(file.scene), options)
    try:
        found = gradient(
            file.scene,
            wrt,
            of=options.of,
            sigma=options.sigma,
            pairs=options.pairs,
            n_periods=file.run.periods,
            transient=file.run.transient,
            steps_per_period=steps,
            seed=options.seed,
            method=_with_derivatives(options),
        )
    except NUMERICAL:
        raise
    except (KeyError, ValueError) as error:
        raise InputError(f"--wrt {options.wrt}: {error.args[0]}") from None
    data = gradient_json(found, file)
    unit = "%" if options.of == "P_d" else "m^4"
    at = found.orbit
    rows: dict[str, Any] = {
        "kind": found.kind,
        options.of: f"{found.level:.6g} +- {found.level_ci:.2g} {unit}",
        **{f"d{options.of}/d {key}": f"{v:.6g} +- {found.ci[key]:.2g}" for key, v in found.value.items()},
        "flags": ", ".join(found.flags) or "none",
    }
    if found.kind == "periodic":
        name, margin = at.bifurcation
        rows["period number"] = at.q
        rows["nearest bifurcation"] = f"{name}, at a distance of {margin:.3g}"
        rows["conditioning"] = f"{found.conditioning:.3g}"
        rows["periods simulated"] = at.periods
    else:
        rows["smoothing"] = f"{found.sigma:g} of each value"
    print_table(file.title or file.name, {**rows, "written": options.out})
    if options.check:
        data["check"] = _checked(found)
    write_json(data, options.out)


def _checked(found) -> dict[str, Any]:
    """Compare an exact gradient with differences; say so where there is nothing to compare."""
    from jaxshroud.motion.orbit import contact_margins
    from jaxshroud.verbs.gradient import differences

    if found.kind != "periodic":
        print("no check: where the motion is aperiodic, differences have no limit", file=sys.stderr)
        return {}
    margins = contact_margins(found.orbit)
    slopes = {step: differences(found.orbit, list(found.value), step, found.of) for step in CHECK_STEPS}
    rows, errors = [], {}
    for key, exact in found.value.items():
        by = [slopes[step][key] for step in CHECK_STEPS]
        errors[key] = min(abs(b - exact) for b in by) / abs(exact) if exact else float(min(map(abs, by)))
        rows.append([key, f"{exact:.9g}", *(f"{b:.9g}" for b in by), f"{errors[key]:.1e}"])
    heads = ["key", "exact", *(f"step {step:g}" for step in CHECK_STEPS), "least error"]
    print_columns("check by differences", heads, rows)
    seen = ", ".join(f"{n} {name}" for name, n in margins.counters.items() if n) or "none"
    print_table("", {"events": seen, "slowest onset": f"{margins.slowest_onset:.3g} of the largest closing speed"})
    return {
        "steps": list(CHECK_STEPS),
        "differences": {key: [slopes[step][key] for step in CHECK_STEPS] for key in found.value},
        "relative_error": errors,
        "events": margins.counters,
        "slowest_onset": margins.slowest_onset,
        "nearest_miss": margins.nearest_miss,
    }


def tune_options(made: OneLineParser) -> None:
    """Options of `jaxshroud tune`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    made.add_argument("--over", action="append", required=True, metavar="K=LO:HI", help="number to tune, its bounds")
    made.add_argument("--range", action="append", default=[], metavar="K=A,B,C", help="operating condition, its values")
    made.add_argument("--goal", choices=("mean", "worst"), default="mean", help="of P_d over the conditions")
    made.add_argument("--most-penetration", metavar="LENGTH", help="limit, e.g. 0.2mm")
    made.add_argument("--most-force", metavar="FORCE", help="limit of the normal force, e.g. 500N")
    made.add_argument("--scan", type=count(1), metavar="N", help="designs looked at first")
    made.add_argument("--starts", type=count(1), metavar="N", help="the best of them, to climb from")
    made.add_argument("--updates", type=count(1), metavar="N", help="steps of each path")
    made.add_argument("--map", type=count(0, MOST_MAP), default=MAP, metavar="N", help="values a side of the map, or 0")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def tune_verb(options: argparse.Namespace) -> None:
    """`jaxshroud tune`."""
    from jaxshroud.results import drawing, plot_design
    from jaxshroud.verbs.tune import corners, objective_map, problem_of, tune

    file = loaded(options)
    over = {a.key: (float(a.values[0]), float(a.values[1])) for a in (_bounds(file, t) for t in options.over)}
    conditions = {a.key: a.values.tolist() for a in (_values(file, t) for t in options.range)}
    most_v = _limit(file, "--most-penetration", "shroud.gap", options.most_penetration)
    most_N = _limit(file, "--most-force", "drive.F_0", options.most_force)
    directory(options.out, ("tune.json", "tune.png", "best.toml"), options.force)
    run = file.run
    try:
        extremes = corners(problem_of(file.scene, over, conditions))
        fits(math.prod(map(len, conditions.values())) * options.map**2, run.transient, run.periods)
    except (KeyError, ValueError) as error:
        raise InputError(f"{file.name}: {error.args[0]}") from None
    steps = check_step(file, extremes, options)
    with progress_bar("lane-periods") as report:
        try:
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
                n_periods=run.periods,
                transient=run.transient,
                steps_per_period=steps,
                seed=options.seed,
                method=_with_derivatives(options),
                progress=report,
            )
        except NUMERICAL:
            raise
        except (KeyError, ValueError) as error:
            raise InputError(f"{file.name}: {error.args[0]}") from None
        drawn = objective_map(tuned, options.map) if len(over) == 2 and options.map else None
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


def _bounds(file: SceneFile, text: str) -> Axis:
    key, _, ends = text.partition("=")
    if ends.count(":") != 1:
        raise InputError(f"--over {text}: is not KEY=LOW:HIGH, e.g. --over shroud.gap=5um:200um")
    return axis(file, key.strip(), ends.split(":"), where=f"--over {key}")


def _values(file: SceneFile, text: str) -> Axis:
    key, _, values = text.partition("=")
    if not values:
        raise InputError(f"--range {text}: is not KEY=A,B,C, e.g. --range drive.F_0=20,40,60,80")
    return axis(file, key.strip(), values, where=f"--range {key}")


def _limit(file: SceneFile, flag: str, key: str, text: str | None) -> float:
    if text is None:
        return float("inf")
    value = float(axis(file, key, ["0", text], where=f"{flag} {text}").values[1])
    if not value > 0:
        raise InputError(f"{flag} {text}: must be positive")
    return value
