"""How to march: what is asked, and what runs."""

from typing import NamedTuple

from jaxshroud.march.method import Choices, Method, StepCount, method_as_json, method_of
from jaxshroud.verbs.setting import Choice, accuracy_level

ACCURACY = "balanced"  # unless an argument or the scene file says how to march


class MarchPlan(NamedTuple):
    """What runs: a method with what it records, and the steps per period. Beside it stands what it was chosen for."""

    steps: int  # per period
    method: Choices
    choice: Choice | None = None  # where an accuracy chose the method

    @property
    def tried(self) -> Choice | None:
        """The choice, if its accuracy was tried on the scenes."""
        return self.choice if self.choice is not None and self.choice.promised is not None else None

    @property
    def again(self) -> "Asked":
        """The argument `method` of verbs that march the same way."""
        return Asked(plan=self)

    @property
    def untried(self) -> "MarchPlan":
        """The same for parts of a result, in which the accuracy is not told again."""
        return self._replace(choice=None) if self.tried else self

    @property
    def attributes(self) -> dict[str, int | str]:
        """The attributes of results that describe it."""
        chosen = {"accuracy": str(self.choice)} if self.choice is not None and self.choice.told else {}
        march = method_as_json(method_of(self.steps, self.method))
        return {"steps_per_period": self.steps, "method": str(self.method), "march": march, **chosen}


class Asked(NamedTuple):
    """How to march as it was asked: by an accuracy, by a method or by steps alone, as another verb does, or not at all.

    It is also the argument `method` by which a verb has another one march the same way.
    """

    accuracy: float | None = None
    method: Method | None = None
    steps: StepCount | None = None  # of the method or of the scene file
    plan: MarchPlan | None = None
    by_argument: bool = True  # rather than by a scene file

    @property
    def says_nothing(self) -> bool:
        """Whether nothing was asked."""
        return self.accuracy is None and self.method is None and self.steps is None and self.plan is None

    @property
    def level(self) -> float | None:
        """The accuracy that chooses the method, by default `ACCURACY`; None where another thing was asked."""
        if self.plan is not None:
            return None if self.plan.choice is None else self.plan.choice.accuracy
        return accuracy_level(ACCURACY) if self.says_nothing else self.accuracy

    @property
    def given_steps(self) -> StepCount:
        """The steps per period that were asked for; "auto" where none were."""
        steps = self.steps if self.plan is None else self.plan.steps
        return "auto" if steps is None else steps


MethodArgument = Method | str | float | Asked | None
