"""What an accuracy means for rows of blades: it chooses one of two methods, and no trial says whether it is kept."""

import warnings
from dataclasses import dataclass

from jaxshroud.io.lane_status import AccuracyWarning
from jaxshroud.march.method import FAST, Choices, StepCount
from jaxshroud.march.tableau import tableau
from jaxshroud.verbs.accuracy import Choice, accuracy_level

COARSE_ACCURACY = 1e-3  # from here on Tsitouras 5 is cheaper


@dataclass(frozen=True)
class RowChoice:
    """The method by which rows are marched for an accuracy."""

    accuracy: float
    asked: bool = False  # by an argument or an option, rather than by a scene file or by default
    steps: StepCount = "auto"  # per period

    @property
    def method(self) -> Choices:
        """The static choices of the march, without a ledger."""
        return FAST._replace(tableau=tableau("tsit5" if self.accuracy >= COARSE_ACCURACY else "dopri8"))

    def __str__(self) -> str:
        levels = "from 1e-03 on" if self.accuracy >= COARSE_ACCURACY else "below 1e-03"
        method = f"{self.method.rk.name} marches rows for every accuracy {levels}"
        return f"accuracy {self.accuracy:.0e}: not examined for rows, and maybe missed; {method}"


Accuracy = str | float | Choice | RowChoice  # a name, a number, or what was chosen for one


def accuracy_as_number(accuracy: Accuracy) -> float:
    """The accuracy as a number."""
    return accuracy.accuracy if isinstance(accuracy, Choice | RowChoice) else accuracy_level(accuracy)


def row_choice(accuracy: Accuracy, asked: bool) -> RowChoice:
    """What an accuracy chooses for rows, with a warning at the line that calls the verb where it was asked for."""
    if isinstance(accuracy, RowChoice):
        return accuracy
    choice = RowChoice(accuracy_as_number(accuracy), asked)
    if asked:
        warnings.warn(str(choice), AccuracyWarning, stacklevel=5)
    return choice
