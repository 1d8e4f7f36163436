"""How scenes are marched where a user says so in words, or names an accuracy that chooses."""

from jaxshroud.march.method import Choices
from jaxshroud.march.stability import Steps, step_report, steps_for, stiffest
from jaxshroud.march.tableau import Tableau
from jaxshroud.march.taylor import Taylor
from jaxshroud.march.words import Locate
from jaxshroud.scene.checks import Precision
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.accuracy import Choice, choose

CHOSEN = ("steps_per_period", "tableau", "order", "step_tolerance", "locate", "precision")  # by an accuracy


def method_for(
    choice: Choice | None,
    method: Tableau | Taylor,
    locate: Locate | None,
    precision: Precision | None,
    *,
    usual: Locate,
    ledger: bool,
) -> Choices:
    """The static choices of the march: those of the accuracy's `choice`, or what was asked for, or what is usual."""
    if choice is not None:
        return choice.method._replace(ledger=ledger)
    usual = "series" if isinstance(method, Taylor) else usual
    return Choices(method, locate or usual, ledger, precision or "float64")


def accuracy_for(scenes: Scene, accuracy: str | float) -> Choice | None:
    """How to march scenes (leading axis) for an accuracy; None without contact, where there is no choice.

    Raises:
        ValueError: There is no such accuracy.
    """
    return None if scenes.parts.contact == "none" else choose(scenes, 1, accuracy)


def steps_checked(scenes: Scene, asked: Steps, method: Tableau | Taylor) -> tuple[int, str | None]:
    """Steps per period of scenes (leading axis) for a method, and how they are inaccurate.

    Raises:
        ValueError: They are unstable for some scene.
    """
    if scenes.parts.contact == "none":
        return steps_for(scenes, 1, asked, None), None
    steps = steps_for(scenes, 1, asked, method)
    return steps, None if asked == "auto" else step_report(*stiffest(scenes, 1), steps, method)
