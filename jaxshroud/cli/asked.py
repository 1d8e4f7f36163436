"""The scene that a command line asks for, and how it is to be marched: what is chosen is told on standard error."""

import argparse
import sys
from typing import Any

import numpy as np

from jaxshroud.cli.terminal import CommandError
from jaxshroud.march.method import Choices, as_tableau
from jaxshroud.march.tableau import Tableau
from jaxshroud.march.taylor import Taylor
from jaxshroud.march.words import Locate
from jaxshroud.scene.config import load
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.accuracy import broken
from jaxshroud.verbs.choice import CHOSEN, accuracy_for, method_for, steps_checked
from jaxshroud.verbs.door import ACCURACY


def loaded(options: argparse.Namespace, *more: str) -> SceneFile:
    """The scene file asked for, with its overrides and `more` of them."""
    flags = {"periods": options.periods, "steps_per_period": options.steps_per_period}
    flags["transient"] = getattr(options, "transient", None)
    overrides = [f"run.{name}={value}" for name, value in flags.items() if value is not None]
    return load(options.scene, [*options.set, *overrides, *more])


def chosen_method(options: argparse.Namespace, usual: Locate = "cubic") -> Choices:
    """The static choices of the march asked for."""
    words, ledger = (options.locate, options.precision), getattr(options, "ledger", True)
    try:
        return method_for(options.choice, tableau_of(options), *words, usual=usual, ledger=ledger)
    except InputError as error:
        raise CommandError(str(error)) from None


def tableau_of(options: argparse.Namespace) -> Tableau | Taylor:
    """The method asked for, before what an accuracy chooses."""
    try:
        return as_tableau(options.tableau or "rk4", options.order, options.step_tolerance)
    except InputError as error:
        raise CommandError(str(error)) from None


def with_derivatives(options: argparse.Namespace) -> Choices:
    """The same where derivatives are wanted; an accuracy that float32 reaches is not one of these."""
    method = chosen_method(options)._replace(ledger=False)
    return method if options.choice is None else method._replace(precision="float64")


def check_step(file: SceneFile, scenes: Any, options: argparse.Namespace) -> int:
    """Steps per period of scenes (leading axis): refuse what is unstable for some, warn of what is inaccurate."""
    choose_accuracy(file, scenes, options)
    if options.choice is not None:
        return options.choice.steps
    asked = file.run.steps_per_period or "auto"
    try:
        steps, report = steps_checked(scenes, asked, tableau_of(options))
    except ValueError as error:
        raise CommandError(f"{file.name}: [run] {error}") from None
    if asked == "auto" and file.scene.parts.contact != "none":
        print(f"steps_per_period = {steps}, by the stiffness of the scene", file=sys.stderr)
    if report:
        print(f"warning: {file.name}: [run] {report}", file=sys.stderr)
    return steps


def choose_accuracy(file: SceneFile, scenes: Any, options: argparse.Namespace) -> None:
    """Keep in the options how to march scenes (leading axis) for the accuracy asked for, if any is."""
    accuracy = options.accuracy or _unasked_accuracy(file, options)
    if accuracy is None:
        return
    for name in CHOSEN:
        if options.accuracy is not None and getattr(options, name) is not None:
            raise CommandError(f"--accuracy chooses --{name.replace('_', '-')} itself; give one of them")
    if file.scene.parts.contact == "smooth":
        raise CommandError("--accuracy knows located contact, not smooth contact; give --steps-per-period instead")
    options.choice = accuracy_for(scenes, accuracy)
    if options.choice is None:
        print(f"{file.name}: without contact the motion is in closed form; --accuracy has no choice", file=sys.stderr)
    else:
        print(f"{file.name}: {options.choice}", file=sys.stderr)


def _unasked_accuracy(file: SceneFile, options: argparse.Namespace) -> str | float | None:
    """The accuracy that the file asks for, or the default where nothing is said of steps or method."""
    if file.run.steps_per_period is not None or any(getattr(options, name) is not None for name in CHOSEN):
        return None
    return file.run.accuracy or (ACCURACY if file.scene.parts.contact == "spring" else None)


def unmet(scenes: Any, options: argparse.Namespace) -> np.ndarray | None:
    """Which lanes (leading axis) seem to miss the accuracy asked for, with a warning; None if none was asked for."""
    if options.choice is None:
        return None
    missed = broken(scenes, options.choice)
    if missed.any():
        accuracy = f"the accuracy of {options.choice.accuracy:.0e}"
        print(f"warning: {missed.sum()} of {missed.size} runs miss {accuracy} within three periods", file=sys.stderr)
    return missed
