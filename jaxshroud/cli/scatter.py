"""The command `scatter`."""

import argparse
from typing import Any

from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.numbers import bounds, spreads, tolerances
from jaxshroud.cli.store import named
from jaxshroud.cli.terminal import CommandError, blamed, directory, print_columns, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.results import drawing
from jaxshroud.results.scatter import Scatter
from jaxshroud.results.store import write_json
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.vary import value_of
from jaxshroud.verbs.design import corners, problem_of
from jaxshroud.verbs.scatter import scatter
from jaxshroud.version import __version__

SHARES = ("first", "total")
TOLD = ("mean", "median", "likely_low", "likely_high", "runs", "stopped", "seed", "steps_per_period")


def scatter_verb(options: argparse.Namespace) -> None:
    """How P_d scatters where numbers of a scene do."""
    file = loaded(options)
    over = scattering(file, options)
    if not over:
        raise CommandError("nothing scatters: give --over, --tolerance or --spread, e.g. --tolerance shroud.gap=10um")
    directory(options.out, ("scatter.nc", "scatter.png", "summary.json"), options.force)
    with blamed(file.name):
        how = march(file, corners(problem_of(file.scene, over, {})), options, FAST)
    with progress_bar("lane-periods") as report, blamed(file.name):
        found = scatter(
            file.scene,
            over,
            at_least=options.at_least,
            samples=options.samples,
            seed=options.seed,
            n_periods=file.run.periods,
            transient=file.run.transient,
            steps_per_period=how.steps,
            method=how.method,
            progress=report,
        )
    named(found, file).save(options.out / "scatter.nc")
    drawing.save(found.plot(), options.out / "scatter.png")
    _told(found, file, options)


def scattering(file: SceneFile, options: argparse.Namespace) -> dict[str, tuple[float, float]]:
    """Bounds of all numbers that scatter."""
    over = {a.key: (float(a.values[0]), float(a.values[1])) for a in (bounds(file, text) for text in options.over)}
    for key, by in tolerances(file, options).items():
        over[key] = _about(file, key, by)
    for key, share in spreads(options).items():
        over[key] = _about(file, key, share * abs(_value(file, key)))
    return over


def _about(file: SceneFile, key: str, by: float) -> tuple[float, float]:
    at = _value(file, key)
    if not by > 0:
        raise CommandError(f"{key}: scatters by nothing; give a width, e.g. --over {key}=LOW:HIGH")
    return at - by, at + by


def _value(file: SceneFile, key: str) -> float:
    with blamed(key):
        return value_of(file.scene, key)


def _told(found: Scatter, file: SceneFile, options: argparse.Namespace) -> None:
    """The summary, as a file and as tables."""
    names = (
        *TOLD,
        *(("at_least", "probability", "probability_low", "probability_high") if options.at_least is not None else ()),
    )
    shares: dict[str, dict[str, Any]] = {
        key: {name: float(getattr(found, name)[i]) for name in ("low", "high", "first", "total")}
        | {f"{name}_95": [float(getattr(found, f"{name}_{end}")[i]) for end in ("low", "high")] for name in SHARES}
        for i, key in enumerate(found.keys)
    }
    summary = {name: getattr(found, name) for name in names}
    about = {"over": shares, "method": found.method, "scene": file.name, "version": __version__}
    write_json({**summary, **about}, options.out / "summary.json")
    heads = ("number", "low [SI]", "high [SI]", "alone", "95 %", "in all", "95 %")
    lines = [
        [key, f"{s['low']:.6g}", f"{s['high']:.6g}"]
        + [text for name in SHARES for text in (f"{s[name]:.3f}", "{:.3f} to {:.3f}".format(*s[f"{name}_95"]))]
        for key, s in shares.items()
    ]
    print_columns("shares of the variance of P_d", heads, lines)
    met = {}
    if options.at_least is not None:
        ends = f"{found.probability_low:.3f} to {found.probability_high:.3f}"
        met = {f"P_d at least {found.at_least:g} %": f"probability {found.probability:.3f} ({ends})"}
    print_table(
        file.title or file.name,
        {
            "median of P_d": f"{found.median:.4g} %",
            "nine draws in ten": f"{found.likely_low:.4g} to {found.likely_high:.4g} %",
            **met,
            "stopped": f"{found.stopped} of {found.runs} runs",
            "written": options.out,
        },
    )
