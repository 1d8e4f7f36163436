"""The scene that a command line asks for, and how it is marched: what is chosen is told on standard error."""

import argparse
import sys

import numpy as np

from jaxshroud.cli.terminal import CommandError, blamed
from jaxshroud.march.method import Choices, as_tableau, located
from jaxshroud.march.stability import step_report, stiffest
from jaxshroud.scene.config import load
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import Choice, broken
from jaxshroud.verbs.door import Asked, Marched, asked, chosen, marched

WORDS = ("tableau", "order", "step_tolerance", "locate", "precision")  # of a method
CHOSEN = ("steps_per_period", *WORDS)  # by an accuracy


def loaded(options: argparse.Namespace, *more: str) -> SceneFile:
    """The scene file asked for, with its overrides and `more` of them."""
    flags = {"periods": options.periods, "steps_per_period": options.steps_per_period}
    flags["transient"] = getattr(options, "transient", None)
    overrides = [f"run.{name}={value}" for name, value in flags.items() if value is not None]
    return load(options.scene, [*options.set, *overrides, *more])


def march(
    file: SceneFile, scenes: Scene, options: argparse.Namespace, usual: Choices, *, derivatives: bool = False
) -> Marched:
    """How scenes (leading axis) are marched: refused where it is unstable, with a warning where it is inaccurate.

    Args:
        file: Where the scenes come from; its [run] counts where the options do not say.
        scenes: The scenes.
        options: Of the command line.
        usual: The method where steps alone are given, with a ledger or without.
        derivatives: Float32 only where the options say so.
    """
    with blamed(f"{file.name}: [run]"):
        how = marched(_request(file, options, usual), scenes, usual, derivatives=derivatives)
    _tell_choice(file, scenes, how.choice, options)
    if how.choice is None and scenes.parts.contact != "none":
        _tell_steps(file, scenes, how)
    return how


def method(
    file: SceneFile, scenes: Scene, options: argparse.Namespace, usual: Choices
) -> tuple[Choices, Choice | None]:
    """The same without steps, which may be too long."""
    with blamed(f"{file.name}: [run]"):
        found, choice = chosen(_request(file, options, usual), scenes, usual)
    _tell_choice(file, scenes, choice, options)
    return found, choice


def _request(file: SceneFile, options: argparse.Namespace, usual: Choices) -> Asked:
    """What the options ask for; their steps are in the file's [run] already."""
    for name in CHOSEN:
        if options.accuracy is not None and getattr(options, name) is not None:
            raise CommandError(f"--accuracy chooses --{name.replace('_', '-')} itself; give one of them")
    method = _method(options, usual) if any(getattr(options, name) is not None for name in WORDS) else None
    return asked(file, method=method, accuracy=options.accuracy)


def _method(options: argparse.Namespace, usual: Choices) -> Choices:
    """The method in the words of the options, as is usual where they do not say."""
    method = as_tableau(options.tableau or usual.rk, options.order, options.step_tolerance)
    locate = located(method, options.locate, usual.locate)
    return Choices(method, locate, usual.ledger, options.precision or usual.precision)


def _tell_choice(file: SceneFile, scenes: Scene, choice: Choice | None, options: argparse.Namespace) -> None:
    if choice is not None:
        print(f"{file.name}: {choice}", file=sys.stderr)
    elif options.accuracy is not None and scenes.parts.contact == "none":
        print(f"{file.name}: without contact the motion is in closed form; --accuracy has no choice", file=sys.stderr)


def _tell_steps(file: SceneFile, scenes: Scene, how: Marched) -> None:
    if not isinstance(file.run.steps_per_period, int):
        print(f"steps_per_period = {how.steps}, by the stiffness of the scene", file=sys.stderr)
        return
    report = step_report(*stiffest(scenes, 1), how.steps, how.method.tableau)
    if report:
        print(f"warning: {file.name}: [run] {report}", file=sys.stderr)


def unmet(scenes: Scene, choice: Choice | None) -> np.ndarray | None:
    """Which lanes (leading axis) seem to miss the accuracy asked for, with a warning; None if none was asked for."""
    if choice is None:
        return None
    return warned(broken(scenes, choice), choice)


def warned(missed: np.ndarray, choice: Choice) -> np.ndarray:
    """Which lanes seem to miss the accuracy asked for, with a warning."""
    if missed.any():
        accuracy = f"the accuracy of {choice.accuracy:.0e}"
        print(f"warning: {missed.sum()} of {missed.size} runs miss {accuracy} within three periods", file=sys.stderr)
    return missed
