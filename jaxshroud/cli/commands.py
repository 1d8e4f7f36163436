"""The command line: load a scene, compute, write. One verb per question.

Exit status 0: done (a run that stopped early is a warning). 1: the machine or the numbers failed. 2: the input is
wrong, one line says where. 130: interrupted. 141: nobody reads what is printed.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import jax
import numpy as np

from jaxshroud.batch.extent import STEP, fits, memory_for
from jaxshroud.batch.xla import alone
from jaxshroud.cli.design import gradient_options, gradient_verb, tune_options, tune_verb
from jaxshroud.cli.keyboard import interruptible
from jaxshroud.cli.plot import draw_dataset, draw_json, plot_options, plot_verb
from jaxshroud.cli.store import named, power_json
from jaxshroud.cli.terminal import (
    NUMERICAL,
    InputError,
    OneLineParser,
    blamed,
    check_step,
    choose_accuracy,
    chosen_method,
    count,
    directory,
    free,
    loaded,
    number,
    one_line,
    path,
    print_table,
    progress_bar,
    scene_options,
    unmet,
    warn_status,
    words,
)
from jaxshroud.cli.trade import trade_options, trade_verb
from jaxshroud.march.tableau import LEAST_STEPS
from jaxshroud.model.modes import Status
from jaxshroud.motion.settling import UNKNOWN
from jaxshroud.results import files
from jaxshroud.results.earlier import Earlier, last_state
from jaxshroud.results.files import StoreError
from jaxshroud.results.store import read_json, write_json
from jaxshroud.scene.config import Axis, SceneError, SceneFile, axis, shipped
from jaxshroud.scene.limits import MOST_VALUES
from jaxshroud.version import __version__

EXAMPLES = {
    "simulate": "jaxshroud simulate fig10b --periods 20 --out fig10b.nc",
    "sweep": "jaxshroud sweep fig09 --out fig09\n"
    "  jaxshroud sweep table1 --along contact.gamma --start 0 --stop 8 --num 200 --transient 100 --out gamma",
    "power": "jaxshroud power fig15a --out fig15a",
    "gradient": "jaxshroud gradient fig10b --wrt shroud.gap,contact.gamma --check --out gradient.json",
    "tune": "jaxshroud tune table1 --set drive.M_0=10 --over shroud.gap=5um:200um --over contact.gamma=0.1:10 "
    "--range drive.F_0=20,40,60,80 --out tuned",
    "plot": "jaxshroud plot fig09",
    "trade": "jaxshroud trade table1 --out trade",
    "explain": 'jaxshroud explain table1 --set \'model.motion=["x", "y"]\'',
    "scenes": "jaxshroud scenes",
}

SHOW_CURSOR = "\x1b[?25h"  # which the progress bar hides


@dataclass
class Along:
    """One axis asked for on the command line."""

    key: str | None = None  # None: that of the scene
    values: str | None = None
    start: str | None = None
    stop: str | None = None
    num: str | None = None


class _NewAxis(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        """Begin a new axis."""
        if namespace.along and namespace.along[0].key is None:
            parser.error(f"{option_string} {values} comes after what describes it; give it first")
        namespace.along = [*(namespace.along or []), Along(str(values))]


class _OfAxis(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        """Describe the latest axis, or the scene's own."""
        if namespace.along is None:
            namespace.along = [Along()]
        setattr(namespace.along[-1], self.dest.removeprefix("axis_"), str(values))


def parser() -> OneLineParser:
    """All verbs with their options."""
    top = OneLineParser(
        prog="jaxshroud",
        description="Rub-impact dynamics of two shrouded blades under bending-torsion coupling.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=OneLineParser)

    def verb(name: str, run: Callable, text: str) -> OneLineParser:
        made = verbs.add_parser(
            name,
            help=text,
            description=text,
            epilog=f"example:\n  {EXAMPLES[name]}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        made.set_defaults(run=run)
        return made

    one = verb("simulate", simulate_verb, "Integrate one scene and store its motion at every step.")
    scene_options(one)
    one.add_argument("--every", type=count(1), default=1, metavar="M", help="store every M-th step")
    one.add_argument("--from", dest="earlier", type=path, metavar="FILE.nc", help="start from its last state")
    one.add_argument("--out", type=path, required=True, metavar="FILE.nc")

    many = verb("sweep", sweep_verb, "Simulate a scene for many values of one or two of its numbers.")
    scene_options(many)
    many.add_argument("--along", action=_NewAxis, metavar="KEY", help="key to vary; twice makes a grid")
    for name, text in dict(values="a,b,c", start="A", stop="B", num="N").items():
        many.add_argument(f"--{name}", dest=f"axis_{name}", action=_OfAxis, metavar=text, help="of the last --along")
    many.add_argument("--direction", choices=("independent", "forward", "backward"))
    many.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    many.add_argument("--phase", type=number, default=0.0, metavar="RAD", help="drive phase of the samples")
    many.add_argument("--period-tol", type=number, default=1e-3, help="relative tolerance of the period number")
    many.add_argument("--ledger", action="store_true", help="keep every lane's energy balance (10 to 20 %% slower)")
    many.add_argument("--out", type=path, required=True, metavar="DIR")

    mean = verb("power", power_verb, "Vibration-power reduction P_d of one scene and its convergence.")
    scene_options(mean)
    mean.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    mean.add_argument("--tolerance", type=number, default=0.1, help="percentage points at which P_d counts as stable")
    mean.add_argument("--out", type=path, required=True, metavar="DIR")

    gradient_options(verb("gradient", gradient_verb, "Derivatives of P_d with respect to numbers of a scene."))
    tune_options(verb("tune", tune_verb, "Find the numbers of a scene that reduce the vibration most."))

    trade_options(verb("trade", trade_verb, "Measure accuracy against cost on a scene of your own."))

    tell = verb("explain", explain_verb, "Say what the model of a scene consists of, what it lacks and what it costs.")
    scene_options(tell)

    plot_options(verb("plot", plot_verb, "Draw stored results again, without simulating."))

    verb("scenes", scenes_verb, "List the shipped scenes.")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        jax.config.update("jax_compilation_cache_dir", os.path.join(cache, "jaxshroud"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    files.written.clear()
    with interruptible(_leave):
        try:
            return _status(arguments)
        except KeyboardInterrupt as stopped:
            print(_interrupted(str(stopped)), file=sys.stderr)
            return 130


def _status(arguments: Sequence[str] | None) -> int:
    """Exit status of the command, whose failures are told in one line."""
    try:
        options = parser().parse_args(words(sys.argv[1:] if arguments is None else arguments))
        options.run(options)
        sys.stdout.flush()
    except files.MachineError as error:
        print(error, file=sys.stderr)
        return 1
    except (InputError, SceneError, StoreError) as error:
        print(one_line(error), file=sys.stderr)
        return 2
    except NUMERICAL as error:
        print(f"numerical failure: {one_line(error)}", file=sys.stderr)
        return 1
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        print(f"the machine failed: {one_line(error) or 'out of memory'}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of standard output went away; keep Python's own flush from complaining
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return 0


def _interrupted(told: str = "") -> str:
    """What an interrupted command says."""
    return f"interrupted; {told or ', '.join(map(str, files.written)) or 'nothing'} was written"


def _leave() -> None:
    """End the process at once: the second Ctrl-C."""
    files.remove_parts()
    os.write(2, f"{SHOW_CURSOR if sys.stderr.isatty() else ''}{_interrupted()}\n".encode())
    os._exit(130)


def simulate_verb(options: argparse.Namespace) -> None:
    """`jaxshroud simulate`."""
    from jaxshroud.verbs.simulate import simulate

    file = loaded(options)
    free(options.out, options.force)
    if options.out.suffix != ".nc":
        raise InputError(f"{options.out}: a trajectory needs a name that ends in .nc")
    steps = file.run.steps_per_period
    least = LEAST_STEPS if steps == "auto" or options.accuracy else steps
    with blamed(file.name):
        memory_for("what is stored of this run", file.run.periods * least // options.every * STEP)
    lanes = alone(file.scene)
    begin = Earlier(None, 0.0, 0.0, ()) if options.earlier is None else last_state(options.earlier, file)
    steps = check_step(file, lanes, options)
    if begin.differences:
        print(f"going on from another scene: {'; '.join(begin.differences)}", file=sys.stderr)
    with blamed(file.name):
        run = simulate(
            file.scene,
            begin.state,
            n_periods=file.run.periods,
            steps_per_period=steps,
            every=options.every,
            turns=begin.turns,
            t=begin.t,
            method=chosen_method(options, "bisection"),
        )
    named(run, file).save(options.out)
    warn_status(np.asarray([run.status]), run.chatter)
    unmet(lanes, options)
    events = ", ".join(f"{n} {name}" for name, n in run.counters.items() if n) or "none"
    print_table(
        file.title or file.name,
        {
            "samples": len(run.t),
            "status": Status(run.status).name,
            "events": events,
            "energy residual": f"{run.energy_residual:.1e} of the drive's work",
            "energy dropped": f"{run.energy_dropped:.1e} of the drive's gross work, where flat contact began",
            "written": options.out,
        },
    )


def sweep_verb(options: argparse.Namespace) -> None:
    """`jaxshroud sweep`."""
    from jaxshroud.batch.threads import Interrupted
    from jaxshroud.verbs.sweep import sweep

    file = _with_axes(loaded(options), options)
    if not 0 <= options.phase < 2 * np.pi:
        raise InputError(f"--phase must be in [0, 2 pi), but is {options.phase}")
    if not options.period_tol >= 0:
        raise InputError(f"--period-tol must be a number of at least 0, but is {options.period_tol}")
    names = ("sweep.nc", "sweep.png", "summary.json")
    directory(options.out, names, options.force)
    run, began = file.sweep_run, time.perf_counter()
    with blamed(file.name):
        fits(math.prod(a.values.size for a in file.axes), run.transient, run.periods)
    lanes = _lanes(file)
    steps = check_step(file, lanes, options)
    with progress_bar("lane-periods") as report, blamed(file.name):
        try:
            result = sweep(
                file.scene,
                {a.key: a.values for a in file.axes},
                n_periods=run.periods,
                transient=run.transient,
                steps_per_period=steps,
                direction=file.direction,
                phase=options.phase,
                period_tol=options.period_tol,
                method=chosen_method(options),
                progress=report,
            )
        except Interrupted as stopped:
            if stopped.done is None:
                raise
            _keep_finished(stopped.done, file, options.out, began)
    ds, missed = named(result, file).to_xarray(), unmet(lanes, options)
    if missed is not None:
        about = {"long_name": "estimated to miss the accuracy asked for", "accuracy": options.choice.accuracy}
        ds["inaccurate"] = (ds["status"].dims, missed.reshape(ds["status"].shape).astype(np.int8), about)
    result.save(options.out / "sweep.nc")
    draw_dataset(options.out / "sweep.nc", ds, options.out / "sweep.png")
    met = {} if missed is None else {"accuracy": str(options.choice), "inaccurate": int(missed.sum())}
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


def power_verb(options: argparse.Namespace) -> None:
    """`jaxshroud power`."""
    from jaxshroud.verbs.power import power

    file = loaded(options)
    if not options.tolerance > 0:
        raise InputError(f"--tolerance must be positive, but is {options.tolerance}")
    directory(options.out, ("power.json", "power.png"), options.force)
    lanes = alone(file.scene)
    with blamed(file.name):
        fits(1, file.run.transient, file.run.periods)
    steps = check_step(file, lanes, options)
    with progress_bar("periods") as report, blamed(file.name):
        result = power(
            file.scene,
            most_periods=file.run.periods,
            transient=file.run.transient,
            steps_per_period=steps,
            tolerance=options.tolerance,
            method=chosen_method(options),
            progress=report,
        )
    data = power_json(result, file)
    write_json(data, options.out / "power.json")
    draw_json(options.out / "power.json", read_json(options.out / "power.json"), options.out / "power.png")
    final = result.final
    unmet(lanes, options)
    warn_status(np.asarray([final["status"]]), final["chatter"])
    if not final["stable"]:
        print(
            f"warning: P_d is not stable after {final['n']} periods; give more with --periods",
            file=sys.stderr,
        )
    print_table(
        file.title or file.name,
        {
            "P_d": f"{final['P_d']:.6g} +- {final['ci']:.2g} %",
            "periods": final["n"],
            "stable": final["stable"],
            "period number": final["period_number"] or "aperiodic",
            "written": options.out,
        },
    )


def explain_verb(options: argparse.Namespace) -> None:
    """`jaxshroud explain`."""
    from jaxshroud.scene.parts import Parts
    from jaxshroud.verbs.explain import explain

    file = loaded(options)
    choose_accuracy(file, alone(file.scene), options)
    with blamed(file.name):
        told = explain(file.scene, chosen_method(options)._replace(ledger=False))
    whole = zip(Parts._fields, told.parts, Parts(), strict=True)
    lacks = [f"{name}: {part}" for name, part, full in whole if part != full]
    operations = f"{told.operations}, {told.operations / told.full_operations:.2f} of the full model"
    if told.parts.contact == "none":
        operations = "none: closed form"
    rows = {
        "motion": ", ".join(told.parts.motion),
        "neighbour": told.parts.neighbour,
        "friction": told.parts.friction,
        "contact": told.parts.contact,
        "not the full model in": "; ".join(lacks) or "nothing",
        "events looked for": ", ".join(told.events) or "none",
        "numbers carried by a lane": told.numbers,
        "operations in a trial step": operations,
        "omega_max": f"{told.omega_max:.4g} rad/s",
        **{f"steps per period, {name}": n for name, n in told.steps.items()},
        **({} if options.choice is None else {"accuracy": options.choice}),
        **{f"note {i}": text for i, text in enumerate(told.advice, 1)},
    }
    print_table(file.title or file.name, rows)


def scenes_verb(options: argparse.Namespace) -> None:
    """`jaxshroud scenes`."""
    for name, title in shipped().items():
        print(f"{name:<12} {title}")


def _lanes(file: SceneFile):
    """The scenes of a sweep (leading axis)."""
    from jaxshroud.scene.grids import grid_of_scenes

    scenes = grid_of_scenes(file.scene, {a.key: a.values for a in file.axes})
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[len(file.axes) :]), scenes)


def _with_axes(file: SceneFile, options: argparse.Namespace) -> SceneFile:
    axes = file.axes
    if options.along and options.along[0].key is None:
        axes = (_own_axis(file, options.along[0]),)
    elif options.along:
        axes = tuple(_axis(file, asked.key, asked) for asked in options.along)
    if not axes:
        raise InputError(f"{file.name}: [sweep] is missing; add it, or give --along KEY --values a,b,c")
    return replace(file, axes=axes, direction=options.direction or file.direction)


def _axis(file: SceneFile, key: str, asked: Along) -> Axis:
    num = asked.num
    if num is not None:
        try:
            num = count(0, MOST_VALUES)(num)
        except argparse.ArgumentTypeError as error:
            raise InputError(f"--along {key}: --num {error}") from None
    return axis(file, key, asked.values, start=asked.start, stop=asked.stop, num=num)


def _own_axis(file: SceneFile, asked: Along) -> Axis:
    """The scene's own axis with some of what describes it replaced."""
    given = {name: value for name, value in vars(asked).items() if value is not None}
    flags = " and ".join(f"--{name}" for name in given)
    if len(file.axes) != 1:
        raise InputError(f"{flags} needs an --along KEY before it: {file.name} sweeps {len(file.axes) or 'no'} keys")
    (own,), values = file.axes, file.axes[0].values
    if "values" not in given and len(given) < 3:
        if not np.array_equal(values, np.linspace(values[0], values[-1], values.size)):
            raise InputError(f"{flags}: [sweep] of {file.name} lists its values; give --start, --stop and --num")
        given = {"start": float(values[0]), "stop": float(values[-1]), "num": str(values.size), **given}
    return _axis(file, own.key, Along(**given))
