"""The command `gradient`."""

import argparse
import sys
from typing import Any

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, march
from jaxshroud.cli.store import gradient_json
from jaxshroud.cli.terminal import CommandError, blamed, free, print_columns, print_table, progress_bar
from jaxshroud.march.method import FAST
from jaxshroud.motion.margins import contact_margins
from jaxshroud.results import drawing, plot_effects
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.store import write_json
from jaxshroud.verbs.gradient import differences, gradient

CHECK_STEPS = (1e-4, 3e-5, 1e-5)  # relative


def gradient_verb(options: argparse.Namespace) -> None:
    """Derivatives of P_d with respect to numbers of a scene."""
    file = loaded(options)
    free(options.out, options.force)
    if not 0 < options.sigma < float("inf"):
        raise CommandError(f"--sigma must be positive, but is {options.sigma}")
    wrt = "all" if options.wrt == "all" else list(dict.fromkeys(key.strip() for key in options.wrt.split(",")))
    picture = options.out.with_suffix(".png")
    if options.relative:
        free(picture, options.force)
    how = march(file, alone(file.scene), options, FAST, derivatives=True)
    with progress_bar("periods") as report, blamed(f"--wrt {options.wrt}"):
        found = gradient(
            file.scene,
            wrt,
            of=options.of,
            sigma=options.sigma,
            pairs=options.pairs,
            n_periods=file.run.periods,
            transient=file.run.transient,
            steps_per_period=how.steps,
            seed=options.seed,
            method=how.method,
            progress=report,
        )
    data = gradient_json(found, file)
    unit = "%" if options.of == "P_d" else "m^4"
    at = found.orbit
    rows: dict[str, Any] = {
        "kind": found.kind,
        options.of: f"{found.level:.6g} +- {found.level_ci:.2g} {unit}",
        **({} if options.relative else _slopes(found)),
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
    if options.relative:
        unit = "percentage points" if options.of == "P_d" else "m^4"
        heads = ["key", "value [SI]", "more by", f"changes {options.of} by [{unit}]", "+-"]
        print_columns("what matters", heads, [effect.cells for effect in found.effects])
        drawing.save(plot_effects.tornado(data), picture)
    if options.check:
        data["check"] = _checked(found)
    write_json(data, options.out)


def _slopes(found: Gradient) -> dict[str, str]:
    """Derivatives in SI units."""
    return {f"d{found.of}/d {key}": f"{v:.6g} +- {found.ci[key]:.2g}" for key, v in found.value.items()}


def _checked(found) -> dict[str, Any]:
    """Compare an exact gradient with differences; say so where there is nothing to compare."""
    if found.kind != "periodic":
        print("no check: where the motion is aperiodic, differences have no limit", file=sys.stderr)
        return {}
    margins = contact_margins(found.orbit.cycle())
    slopes: dict[float, dict[str, float]] = {}
    with progress_bar("differences") as report:
        for step in CHECK_STEPS:
            slopes[step] = differences(found.orbit, list(found.value), step, found.of)
            report(len(slopes), len(CHECK_STEPS))
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
