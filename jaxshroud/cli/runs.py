"""The commands of a single scene and its run: `simulate`, `diagnose`, `power` and `trade`."""

import argparse
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxshroud.cli.computation import (
    DATASETS,
    Computation,
    VerbCall,
    print_result,
    write_files,
)
from jaxshroud.cli.terminal import CommandError, files_written, print_columns
from jaxshroud.io.restart import stored_end
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import amplitude_numbers, load_numbers
from jaxshroud.results.extremes import amplitude_words
from jaxshroud.scene.file import SceneFile
from jaxshroud.signals.amplitudes import is_preloaded
from jaxshroud.signals.effects import with_interval
from jaxshroud.verbs.accuracy import LEVELS


def _simulate_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """The stored end that the run goes on from, if any; what differs from its scene is printed."""
    if options.out.suffix != ".nc":
        raise CommandError(f"{options.out}: a trajectory needs a name that ends in .nc")
    if options.earlier is None:
        return {}
    begin = stored_end(options.earlier, file)
    if begin.differences:
        print(f"going on from another scene: {'; '.join(begin.differences)}", file=sys.stderr)
    return {"state": begin.state, "turns": begin.turns, "t": begin.t}


def _output_run(completed: VerbCall) -> None:
    write_files(completed)
    run = completed.result
    rows = {
        "samples": len(run.t),
        "status": Status(run.status).name,
        "events": ", ".join(f"{np.sum(n)} {name}" for name, n in run.counters.items() if np.any(n)) or "none",
        **energy_rows(run),
    }
    print_result(completed, rows)


def energy_rows(run: Any) -> dict[str, str]:
    """What the energy balance of a run leaves open, and what beginnings of flat contact dropped."""
    return {
        "energy residual": f"{run.energy_residual:.1e} of the drive's work",
        "energy dropped": f"{run.energy_dropped:.1e} of the drive's gross work, where flat contact began",
    }


def _output_diagnosis(completed: VerbCall) -> None:
    write_files(completed)
    from jaxshroud.plotting.plot_diagnosis import diagnosis_rows

    rows = {**diagnosis_rows(completed.result), **energy_rows(completed.result)}
    print_result(completed, {**rows, "evidence": completed.result.evidence})


def _power_arguments(_: SceneFile, options: argparse.Namespace) -> Mapping[str, Any]:
    """None beyond the options, which are checked."""
    if not options.stable_within > 0:
        raise CommandError(f"--tolerance must be positive, but is {options.stable_within}")
    return {}


def _output_power(completed: VerbCall) -> None:
    write_files(completed)
    final = completed.result.final
    of_vibration = {"P_d of the vibration": with_interval(final["P_d_vibration"], final["P_d_vibration_ci"], "%")}
    ok = final["status"] == Status.OK
    rows = {
        **(of_vibration if is_preloaded(completed.file.scene) else {}),
        "P_d": with_interval(final["P_d"], final["ci"], "%"),
        **({"P_d of the worst blade": f"{final['P_d_worst']:.4g} %"} if "P_d_worst" in final else {}),
        **of_vibration,
        **({"mean position": completed.result.mean_shift} if completed.result.mean_shift else {}),
        "periods": final["n"],
        "stable": "yes" if final["stable"] else "no",
        "motion": f"period {final['period_number']}" if final["period_number"] else "aperiodic",
        **dict(_in_units_of_pictures(amplitude_numbers(completed.result, ok, final["period_number"] == 0, final["n"]))),
        **load_numbers(completed.result, ok),
    }
    print_result(completed, rows)
    print(completed.result.mechanism)
    if not final["stable"]:
        print(f"warning: P_d is not stable after {final['n']} periods; give more with --periods", file=sys.stderr)


def _in_units_of_pictures(numbers: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Rows of amplitudes: numbers in the unit of pictures, without those of what does not move."""
    for name, value in numbers.items():
        if not isinstance(value, float):
            yield name, value
        elif value:
            head = name.partition(" [")[0]
            yield head, amplitude_words(f"{head.split()[-1]}_peak", value)


def _output_trade(completed: VerbCall) -> None:
    write_files(completed)
    heads = ("accuracy of the state", "cheapest setting", "steps", "us / lane / period", "error", "P_d [%]")
    rows = [(f"{level:.0e}", *_cheapest_cells(completed.result, level)) for level in LEVELS]
    print_columns(f"{completed.title}: {completed.options.lanes} scenes around it", heads, rows)
    print(files_written())


def _cheapest_cells(trade: Any, level: float) -> tuple[str, ...]:
    """The cheapest setting that keeps an accuracy, as cells of a table."""
    best = trade.cheapest(level)
    if best is None:
        return ("none reaches it", "", "", "", "")
    return (
        best.setting,
        f"{best.steps_per_period:g}",
        f"{best.cost * 1e6:.3g}",
        f"{best.state_error:.1e}",
        f"{best.P_d:.1e}",
    )


simulate_command = Computation(
    prepare=_simulate_arguments,
    imports=DATASETS,
    output=_output_run,
)
diagnose_command = Computation(output=_output_diagnosis)
power_command = Computation(prepare=_power_arguments, output=_output_power)
trade_command = Computation(output=_output_trade)
