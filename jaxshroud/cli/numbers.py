"""The commands of a scene's numbers: `gradient`, `fit` and `scatter`.

They say what each number does, what the numbers are by measurements, and how P_d scatters where they do.
"""

import argparse
import sys
from typing import Any, cast

import numpy as np

from jaxshroud.batch.plan import Progress
from jaxshroud.cli.computation import CompletedCall, Computation, VerbCall, call_verb, write_files
from jaxshroud.cli.drawing import draw
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.run_options import bounds, load_scene, scatters
from jaxshroud.cli.terminal import (
    CommandError,
    files_written,
    input_errors_at,
    print_columns,
    print_table,
    require_free,
)
from jaxshroud.io.files import write
from jaxshroud.io.measurements import read_measurements
from jaxshroud.io.store import write_json
from jaxshroud.march.method import FOR_P_D
from jaxshroud.orbits.bifurcation import grazing_margins
from jaxshroud.results.fit import Fit, FittedNumber
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.scatter import SHARES, Scatter
from jaxshroud.scene.drive_orders import check_continuous
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.quantities import Quantity, check_quantity, is_reduction, unit_of
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.amplitudes import check_resonance, check_vibration, counted_reduction
from jaxshroud.signals.effects import Effect, with_interval
from jaxshroud.verbs.design_problem import design_corners, problem_of
from jaxshroud.verbs.fit import fit_problem
from jaxshroud.verbs.fit_models import fit_corners
from jaxshroud.verbs.gradient import differences
from jaxshroud.verbs.scattering import scatter_bounds

CHECK_STEPS = (1e-4, 3e-5, 1e-5)  # relative


# Gradient


def _gradient_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The keys of --wrt."""
    if options.out.suffix == ".png":
        raise CommandError(f"--out {options.out}: must not end in .png; it holds JSON, beside which --relative draws")
    require_free(options.out, options.force)
    if options.relative:
        require_free(options.out.with_suffix(".png"), options.force)
    if not 0 < options.sigma < float("inf"):
        raise CommandError(f"--sigma must be positive, but is {options.sigma}")
    of = options.of or counted_reduction(file.scene)
    with input_errors_at(file.name):
        check_quantity(of, file.scene)
        if is_reduction(of):
            check_vibration(of, file.scene)
            check_resonance(of, file.scene)
    if options.wrt == "all":
        return {"wrt": "all"}
    keys = [*dict.fromkeys(key.strip() for key in options.wrt.split(","))]
    with input_errors_at(f"--wrt {options.wrt}"):
        for key in keys:
            check_continuous(key, file.scene)
    return {"wrt": keys}


def _call_gradient(call: VerbCall, progress: Progress) -> Gradient:
    with input_errors_at(f"--wrt {call.options.wrt}"):
        return call_verb(call, progress)


def _output_gradient(completed: CompletedCall) -> None:
    """Print the derivatives, check them if asked to, and write what was computed."""
    gradient, options = completed.result, completed.options
    print_table(completed.title, _gradient_rows(gradient, with_slopes=not options.relative))
    summary = gradient.summary()
    if options.relative:
        _print_effects(gradient)
        _draw_effects(completed, summary)
    if options.check:
        summary["check"] = _check_by_differences(gradient)
    write_json(summary, options.out)
    print_table("", {"written": files_written()})


def _gradient_rows(gradient: Gradient, with_slopes: bool) -> dict[str, Any]:
    slopes = {f"d{gradient.of}/d {effect.key}": _slope_text(gradient, effect) for effect in gradient.effects}
    rows = {
        "kind": gradient.kind,
        gradient.of: with_interval(gradient.level, gradient.level_ci, unit_of(gradient.of)),
        **(slopes if with_slopes else {}),
        "flags": ", ".join(gradient.flags) or "none",
        **({"side": gradient.side} if gradient.side else {}),
        **({"mean position": gradient.mean_shift} if gradient.mean_shift else {}),
    }
    if gradient.kind != "periodic":
        return {**rows, "smoothing": f"{gradient.sigma:g} of each value"}
    name, margin = gradient.orbit.bifurcation
    return {
        **rows,
        "period number": gradient.orbit.q,
        "nearest bifurcation": f"{name}, at a distance of {margin:.3g}",
        **({} if np.isnan(gradient.conditioning) else {"conditioning": f"{gradient.conditioning:.3g}"}),
        "periods simulated": gradient.orbit.periods,
    }


def _slope_text(gradient: Gradient, effect: Effect) -> str:
    """A derivative with its unit, and what it is by percent: of an angle by degree."""
    unit = parse_key(effect.key)[0].unit or "1"
    slope = gradient.value[effect.key], gradient.ci[effect.key]
    if unit_of(gradient.of) == "%":
        change = with_interval(effect.change, effect.ci, "percentage points")
        return f"{with_interval(*slope, f'% per {unit}')}; {change} per {effect.per}"
    in_units = with_interval(*slope, f"{unit_of(gradient.of)} per {unit}")
    if gradient.level == 0:  # of a blade that does not move
        return in_units
    share, ci = (100 * size / gradient.level for size in (effect.change, effect.ci))
    return f"{in_units}; {with_interval(share, ci, f'% of {gradient.of}')} per {effect.per}"


def _print_effects(gradient: Gradient) -> None:
    """Print what 1 percent of each number changes."""
    unit = "percentage points" if unit_of(gradient.of) == "%" else unit_of(gradient.of)
    heads = ["key", "value [SI]", "more by", f"changes {gradient.of} by [{unit}]"]
    print_columns("what matters", heads, [effect.cells for effect in gradient.effects])


def _draw_effects(completed: CompletedCall, summary: dict[str, Any]) -> None:
    from jaxshroud.plotting.pictures import picture

    options = completed.options
    draw(lambda: picture("gradient", summary), options.out.with_suffix(".png"), dpi=options.dpi)


def _check_by_differences(gradient: Gradient) -> dict[str, Any]:
    """Compare an exact gradient with differences; say so where there is nothing to compare."""
    if gradient.kind != "periodic":
        print("no check: where the motion is aperiodic, differences have no limit", file=sys.stderr)
        return {}
    margins = grazing_margins(gradient.orbit.cycle())
    slopes = _differences_by_key(gradient)
    errors = {key: _relative_error(exact, slopes[key]) for key, exact in gradient.value.items()}
    heads = ["key", "exact", *(f"step {step:g}" for step in CHECK_STEPS), "least error"]
    rows = [
        [key, f"{exact:.9g}", *(f"{slope:.9g}" for slope in slopes[key]), f"{errors[key]:.1e}"]
        for key, exact in gradient.value.items()
    ]
    print_columns("check by differences", heads, rows)
    events = ", ".join(f"{n} {name}" for name, n in margins.counters.items() if n) or "none"
    known = margins.slowest_onset == margins.slowest_onset
    onset = f"{margins.slowest_onset:.3g} of the largest closing speed" if known else "unknown"
    print_table("", {"events": events, "slowest onset": onset})
    return {
        "steps": list(CHECK_STEPS),
        "differences": slopes,
        "relative_error": errors,
        "events": margins.counters,
        "slowest_onset": margins.slowest_onset,
        "nearest_miss": margins.nearest_miss,
    }


def _differences_by_key(gradient: Gradient) -> dict[str, list[float]]:
    """The difference quotients of each number, one for each step."""
    slopes: list[dict[str, float]] = []
    with progress_bar("differences") as report:
        for step in CHECK_STEPS:
            slopes.append(differences(gradient.orbit, list(gradient.value), step, cast(Quantity, gradient.of)))
            report(len(slopes), len(CHECK_STEPS))
    return {key: [of_step[key] for of_step in slopes] for key in gradient.value}


def _relative_error(exact: float, slopes: list[float]) -> float:
    """The least error of the differences; absolute where the derivative is zero."""
    if not exact:
        return float(min(map(abs, slopes)))
    return min(abs(slope - exact) for slope in slopes) / abs(exact)


# Fit


def _fit_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The measurements, which are looked at before anything is written, and the bounds."""
    read_measurements(options.measurements)
    return {"measurements": options.measurements, "over": bounds(file, options.over)}


def _fit_corners(call: VerbCall) -> Scene:
    """The scenes at the ends of the bounds; a fit that cannot be made is refused."""
    return fit_corners(
        fit_problem(call.file.scene, read_measurements(call.options.measurements), call.arguments["over"])
    )


def _output_fit(completed: CompletedCall) -> None:
    found: Fit = completed.result
    write_files(completed)
    best = load_scene(completed.options, [f"{key}={value!r}" for key, value in found.value.items()])
    write(completed.paths[-1], best.text().encode())
    cells = [(key, f"{n.value:.6g}", *_interval_cells(n)) for key, n in found.numbers.items()]
    print_columns("fitted numbers", ("number", "value [SI]", "from (95 %)", "to", "by"), cells)
    print_table(completed.title, {**_fit_rows(found), "written": files_written()})


def _interval_cells(number: FittedNumber) -> tuple[str, str, str]:
    """The interval of a number, and what it is by."""
    if not number.is_determined:
        return "not", "determined", ""
    return f"{number.low:.6g}", f"{number.high:.6g}", number.by


def _fit_rows(found: Fit) -> dict[str, Any]:
    noise = "given" if found.sigma_is_known else f"estimated from {found.noise_from}"
    notes = {f"note {i}": note for i, note in enumerate(found.notes, 1)}
    return {
        "chi2": f"{found.chi2:.4g} for {found.freedom} degrees of freedom",
        f"noise, {noise}": ", ".join(f"{name} {size:.3g}" for name, size in found.noise.items()) + " (SI)",
        **(notes or {"determined": "every number"}),
    }


# Scatter


def _scatter_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    spreads = {**bounds(file, options.over), **scatters(file, options)}
    if not spreads:
        raise CommandError("nothing scatters: give --over, --tolerance or --spread, e.g. --tolerance shroud.gap=10um")
    return {"scatters": spreads}


def _scatter_corners(call: VerbCall) -> Scene:
    """The scenes at the ends of the scatter."""
    scene = call.file.scene
    of = call.options.of or counted_reduction(scene)
    if is_reduction(of) and not call.options.over:
        check_vibration(of, scene)
    return design_corners(problem_of(scene, scatter_bounds(scene, call.arguments["scatters"]), {}))


def _output_scatter(completed: CompletedCall) -> None:
    write_files(completed)
    scatter: Scatter = completed.result
    heads = ("number", "low [SI]", "high [SI]", "alone (95 %)", "in all (95 %)")
    shares = [_share_cells(scatter, i) for i in range(len(scatter.keys))]
    print_columns(f"shares of the variance of {scatter.quantity}", heads, shares)
    at_least = completed.options.at_least is not None
    unit = unit_of(scatter.quantity)
    rows = {
        f"median of {scatter.quantity}": f"{scatter.median:.4g} {unit}",
        "nine draws in ten": f"{scatter.likely_low:.4g} to {scatter.likely_high:.4g} {unit}",
        **{name: getattr(scatter, name) for name in ("flat", "undefined") if getattr(scatter, name)},
        **({f"P_d at least {scatter.at_least:g} %": f"probability {scatter.chance}"} if at_least else {}),
        "stopped": f"{scatter.stopped} of {scatter.runs} runs",
        "written": files_written(),
    }
    print_table(completed.title, rows)


def _share_cells(scatter: Scatter, i: int) -> list[str]:
    """A number with its bounds and its shares of the variance, with their intervals."""
    shares = [scatter.share_text(name, i) for name in SHARES]
    return [scatter.keys[i], f"{scatter.low[i]:.6g}", f"{scatter.high[i]:.6g}", *shares]


gradient_command = Computation(prepare=_gradient_arguments, usual=FOR_P_D, run=_call_gradient, output=_output_gradient)
fit_command = Computation(prepare=_fit_arguments, scenes=_fit_corners, output=_output_fit)
scatter_command = Computation(
    prepare=_scatter_arguments,
    scenes=_scatter_corners,
    usual=FOR_P_D,
    output=_output_scatter,
)
