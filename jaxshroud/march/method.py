"""Static choices of the march."""

from typing import NamedTuple

from jaxshroud.march.locate import Locate
from jaxshroud.march.tableau import RK4, Tableau
from jaxshroud.scene.checks import Precision, checked, type_argument, word_argument


@checked
class Method(NamedTuple):
    """Static choices of the march; ValueError for a word that is not known."""

    tableau: Tableau = RK4
    locate: Locate = "bisection"
    ledger: bool = True  # keep the works that the energy balance needs
    precision: Precision = "float64"
    derivative: bool = False  # instants of events are differentiable, at the price of one more trial for each
    within: bool = False  # log what happens between the ends of steps too

    def __check_init__(self):
        type_argument("tableau", self.tableau, Tableau, 'tableau("dopri8")')
        word_argument("locate", self.locate, Locate)
        word_argument("precision", self.precision, Precision)
        type_argument("ledger", self.ledger, bool, "True")
        type_argument("derivative", self.derivative, bool, "True")

    def __str__(self) -> str:
        return f"{self.tableau.name}, events by {self.locate}, {self.precision}"


REFERENCE = Method()
FAST_WITH_LEDGER = Method(locate="cubic")  # the same errors in less time
FAST = FAST_WITH_LEDGER._replace(ledger=False)  # no energy residual either
