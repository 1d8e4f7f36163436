"""Options as what verbs take: the scene file with overrides, how it is marched, and numbers with their units."""

import argparse
import sys
import warnings
from collections.abc import Sequence
from contextlib import contextmanager

from jaxshroud.cli.terminal import CommandError, input_errors_at
from jaxshroud.io.lane_status import AccuracyWarning
from jaxshroud.linear.held_contact import is_linear
from jaxshroud.march.method import FAST, REFERENCE, Method, RungeKutta, Taylor
from jaxshroud.march.stability import step_report, stiffest
from jaxshroud.scene.config import load
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import KNOW_LINEAR
from jaxshroud.scene.overrides import axis, size_in_si
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.verbs.arguments import Asked, MarchPlan, asked_by
from jaxshroud.verbs.lanes import check_verb
from jaxshroud.verbs.settled import in_state, settling_advice, settling_periods

METHOD_OPTIONS = ("tableau", "order", "step_tolerance", "locate", "precision")
CHOSEN_BY_ACCURACY = ("steps_per_period", *METHOD_OPTIONS)


def load_scene(options: argparse.Namespace, overrides: Sequence[str] = ()) -> SceneFile:
    """The scene file of the options with its overrides, then those of [run], then `overrides`.

    Raises:
        InputError: It is invalid, or the command does not know scenes of its layout.
    """
    run = {name: getattr(options, name, None) for name in ("periods", "steps_per_period", "transient")}
    of_run = [f"run.{name}={value}" for name, value in run.items() if value is not None]
    file = load(options.scene, [*options.set, *of_run, *overrides])
    if options.verb in KNOW_LINEAR and getattr(options, "linear", None) is not None:
        with input_errors_at(f"--linear {options.linear}"):
            file = in_state(file, options.linear)
    check_verb(options.verb, file)
    return file


def asked_method(file: SceneFile, options: argparse.Namespace) -> Asked:
    """How to march as the options say, else the file's [run], which has their steps already."""
    given = [name for name in CHOSEN_BY_ACCURACY if getattr(options, name) is not None]
    if given and options.accuracy is not None:
        raise CommandError(f"--accuracy chooses --{given[0].replace('_', '-')} itself; give one of them")
    named = any(name in METHOD_OPTIONS for name in given)
    asked = asked_by(_method_of_options(options) if named else options.accuracy, file.run)
    return asked._replace(by_argument=asked.by_argument or bool(given))


def _method_of_options(options: argparse.Namespace) -> Method:
    """The method that the options name, as is usual where they do not say."""
    numbers = {"order": options.order, "tolerance": options.step_tolerance}
    numbers = {name: value for name, value in numbers.items() if value is not None}
    usual = REFERENCE if options.verb == "simulate" else FAST
    precision = options.precision or usual.precision
    if options.tableau == "taylor":
        if options.locate not in (None, "series"):
            raise CommandError("--locate is of Runge-Kutta methods only; power series locate their events themselves")
        return Taylor(precision=precision, **numbers)
    if numbers:
        raise CommandError(f"--{'order' if 'order' in numbers else 'step-tolerance'} is of --tableau taylor only")
    return RungeKutta(options.tableau or usual.rk, None, options.locate or usual.locate, precision)


def print_march(file: SceneFile, options: argparse.Namespace, scenes: Scene, march: MarchPlan) -> None:
    """Say how scenes (leading axis) are marched, with a warning where it is inaccurate."""
    choice = march.choice
    is_judged = options.verb in KNOW_LINEAR and not is_linear(scenes)
    if choice is not None:
        print(f"{'' if march.tried else 'warning: '}{file.name}: {choice}", file=sys.stderr)
    elif is_linear(scenes):
        print(f"{file.name}: contact that stays {scenes.parts.contact}, in closed form", file=sys.stderr)
    elif scenes.parts.contact != "none":
        _print_steps(file, scenes, march)
    elif options.accuracy is not None:
        print(f"{file.name}: without contact the motion is in closed form; --accuracy has no choice", file=sys.stderr)
    if is_judged and (advice := _settling_advice(file, scenes)):
        print(f"{file.name}: {advice}", file=sys.stderr)


def _settling_advice(file: SceneFile, scenes: Scene) -> str:
    """How long light damping takes, where the transient is shorter."""
    needed = settling_periods(without_given(scenes))
    discarded = f", {file.run.transient} are discarded"
    advice = settling_advice(needed, scenes.parts.contact != "none", discarded)
    return advice if needed > file.run.transient else ""


def _print_steps(file: SceneFile, scenes: Scene, march: MarchPlan) -> None:
    if not isinstance(file.run.steps_per_period, int):
        print(f"steps_per_period = {march.steps}, by the stiffness of the scene", file=sys.stderr)
        return
    report = step_report(*stiffest(scenes, 1), march.steps, march.method.tableau)
    if report:
        print(f"warning: {file.name}: [run] {report}", file=sys.stderr)


@contextmanager
def accuracy_warnings_printed():
    """Within, accuracy warnings of verbs are collected, and printed on standard error at the end."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AccuracyWarning)
        yield
    for warning in caught:
        if issubclass(warning.category, AccuracyWarning):
            print(f"warning: {warning.message}", file=sys.stderr)
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def bounds(file: SceneFile, texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Numbers with their lower and upper bounds [SI], from --over KEY=LOW:HIGH."""
    return dict(_bounds(file, text) for text in texts)


def _bounds(file: SceneFile, text: str) -> tuple[str, tuple[float, float]]:
    key, _, ends = text.partition("=")
    if ends.count(":") != 1:
        raise CommandError(f"--over {text}: is not KEY=LOW:HIGH, e.g. --over shroud.gap=5um:200um")
    low, high = axis(file, key.strip(), ends.split(":"), where=f"--over {key}").values.tolist()
    return key.strip(), (low, high)


def operating_conditions(file: SceneFile, options: argparse.Namespace) -> dict[str, list[float]]:
    """Operating conditions with their values [SI], from --range KEY=A,B,C."""
    return dict(_condition(file, text) for text in options.range)


def _condition(file: SceneFile, text: str) -> tuple[str, list[float]]:
    key, _, values = text.partition("=")
    if not values:
        raise CommandError(f"--range {text}: is not KEY=A,B,C, e.g. --range drive.F_0=20,40,60,80")
    if "," not in values:
        raise CommandError(f"--range {text}: is a single condition, which is given by --set {text}")
    return key.strip(), axis(file, key.strip(), values, where=f"--range {key}").values.tolist()


def limits(file: SceneFile, options: argparse.Namespace) -> dict[str, float]:
    """The limits of penetration [m] and force [N] by the arguments of verbs; infinity where none is given."""
    return {
        "most_penetration": _limit(file, "--most-penetration", "shroud.gap", options.most_penetration),
        "most_force": _limit(file, "--most-force", "drive.F_0", options.most_force),
    }


def _limit(file: SceneFile, flag: str, key: str, text: str | None) -> float:
    """A limit with the unit of a key."""
    if text is None:
        return float("inf")
    value = size_in_si(file, key, text, f"{flag} {text}")
    if not value > 0:
        raise CommandError(f"{flag} {text}: must be positive")
    return value


def scatters(file: SceneFile, options: argparse.Namespace) -> dict[str, float | str]:
    """Numbers that scatter: half widths [SI] from --tolerance KEY=WIDTH, shares from --spread KEY=PERCENT."""
    widths: dict[str, float | str] = {}
    for text in options.tolerance:
        key, _, width = (part.strip() for part in text.partition("="))
        widths[key] = abs(size_in_si(file, key, width, f"--tolerance {text}"))
    for text in options.spread:
        key, _, percent = (part.strip() for part in text.partition("="))
        if key in widths:
            raise CommandError(f"{key} has both a --tolerance and a --spread; give one of them")
        try:
            widths[key] = f"{float(percent.removesuffix('%'))!r}%"
        except ValueError:
            raise CommandError(f"--spread {text}: is not KEY=PERCENT, e.g. --spread drive.F_0=20%") from None
    return widths
