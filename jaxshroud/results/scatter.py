"""What a scatter of numbers does to P_d."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Attribute, Variable
from jaxshroud.results.words import between
from jaxshroud.scene.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Scatter(Result):
    """The distribution of P_d over draws of some numbers, and what it comes from."""

    stored_as = "scatter"

    low = Variable("lower bound of each number, in SI units", None, ("key",))
    high = Variable("upper bound of each number, in SI units", None, ("key",))
    drawn = Variable("the numbers of each draw, in SI units", None, ("draw", "key"))
    P_d = Variable("vibration-power reduction of each draw", "percent", ("draw",))
    status = Variable("how the march of each draw ended", None, ("draw",), stored=np.int8, more=FLAGS)
    first = Variable("share of the variance that a number has alone", "1", ("key",))
    first_low = Variable("lower end of its 95 % interval", "1", ("key",))
    first_high = Variable("upper end of its 95 % interval", "1", ("key",))
    total = Variable("share of the variance that is gone where a number does not scatter", "1", ("key",))
    total_low = Variable("lower end of its 95 % interval", "1", ("key",))
    total_high = Variable("upper end of its 95 % interval", "1", ("key",))
    mean = Attribute()  # of P_d [percent]
    median = Attribute()
    likely_low = Attribute()  # 5 % of the draws are below
    likely_high = Attribute()  # 5 % of the draws are above
    at_least = Attribute()  # P_d asked for
    probability = Attribute()  # that it is met
    probability_low = Attribute()  # ends of the 95 % interval
    probability_high = Attribute()
    runs = Attribute(int)
    stopped = Attribute(int)  # of the runs
    seed = Attribute(int)

    @property
    def keys(self) -> tuple[str, ...]:
        """The numbers that scatter."""
        return tuple(map(str, self.data["key"].to_numpy()))

    @property
    def chance(self) -> str:
        """The probability that `at_least` is met with, and its 95 % interval, in words."""
        return between(self.probability, self.probability_low, self.probability_high)

    @property
    def failed(self) -> int:
        """How many of the runs stopped."""
        return self.stopped

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """The distribution of P_d, and the shares of its variance.

        Args:
            ax: There is no panel to draw alone.
            options: `title`, `width`, `style` of the picture.

        Raises:
            InputError: `ax` is given.
        """
        from jaxshroud.results import plot_scatter
        from jaxshroud.results.drawing import Look

        if ax is not None:
            raise InputError("Argument `ax` is not for the picture of a Scatter.")
        return plot_scatter.scatter(self.data, look=Look(**options))

    def __repr__(self) -> str:
        asked = ""
        if self.at_least is not None:
            ends = f"[{self.probability_low:.3g}, {self.probability_high:.3g}]"
            asked = f"; at least {self.at_least:g} % with probability {self.probability:.3g} {ends}"
        shares = ", ".join(f"{key} {share:.2g}" for key, share in zip(self.keys, self.total, strict=True))
        return (
            f"Scatter of P_d over {len(self.P_d)} draws: {self.median:.4g} %, nine in ten between "
            f"{self.likely_low:.4g} and {self.likely_high:.4g} %{asked}; total shares: {shares}; "
            f"{self.stopped} of {self.runs} runs stopped; {self.method}, {self.steps_per_period} steps a period"
        )
