"""The amplification of mistuned rows: all patterns, quantiles, and the worst pattern that a search has found."""

from collections.abc import Sequence

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.scene_numbers import dimension, key_attrs
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.model.modes import Status
from jaxshroud.results.base import Result
from jaxshroud.results.sweep import DIRECTION
from jaxshroud.scene.layout import row_layout
from jaxshroud.signals.effects import too_few_periods_text
from jaxshroud.signals.waves import whitehead_factor

QUANTILE_SHARES = (0.05, 0.5, 0.95)
PATTERN_DIMS = ("design", "sigma", "pattern")
LANE_DIMS = (DIRECTION, "value")
NARROW = "whether the peak is narrower than the distance of values"
MAX_NAMED = 5  # patterns that a message names


class Mistuned(Result):
    """The largest amplitudes of rows with random patterns of mistuning, over those of the tuned row.

    Panels of its picture: "amplification", "amplitude" and "pattern".
    """

    stored_as = "mistuned"
    required = ("amplification", "status", "quantile")

    mistuning = Variable("relative deviation of the stiffnesses of each blade", "1", (*PATTERN_DIMS, "blade"))
    amplitude = Variable("largest amplitude of all blades, `of`, in SI units", None, (*PATTERN_DIMS, *LANE_DIMS))
    status = Variable(
        "how each lane ended", None, (*PATTERN_DIMS, *LANE_DIMS), stored=np.int8, kind=np.int32, more=FLAGS
    )
    amplification = Variable("largest amplitude over that of the tuned row; NaN if a lane stopped", "1", PATTERN_DIMS)
    worst_value = Variable("where the largest amplitude is: value of `along` in SI units", None, PATTERN_DIMS)
    worst_blade = Variable("the blade that has it", None, PATTERN_DIMS)
    participation_ratio = Variable("how many of the blades take part there, of all", "1", PATTERN_DIMS)
    narrow = Variable(NARROW, None, PATTERN_DIMS, stored=np.int8, kind=bool)
    quantile = Variable("quantile of the amplification", "1", ("design", "sigma", "share"))
    quantile_low = Variable("lower end of its 95 % interval; NaN: too few patterns", "1", ("design", "sigma", "share"))
    quantile_high = Variable("upper end of its 95 % interval; NaN: too few patterns", "1", ("design", "sigma", "share"))
    design_mistuning = Variable("relative deviation of each blade in a design", "1", ("design", "blade"))
    design_amplitude = Variable("largest amplitude without random mistuning", None, ("design", *LANE_DIMS))
    design_amplification = Variable("amplification without random mistuning", "1", ("design",))
    design_narrow = Variable(NARROW, None, ("design",), stored=np.int8, kind=bool)
    tuned_amplitude = Variable("largest amplitude of all blades of the tuned row", None, LANE_DIMS)
    tuned_status = Variable("how the lanes of the tuned row ended", None, LANE_DIMS, stored=np.int8, more=FLAGS)
    searched_mistuning = Variable("the worst pattern that the search has found", "1", ("blade",))
    searched_amplitude = Variable("largest amplitude of all blades with that pattern", None, LANE_DIMS)
    search_cost = Variable("lane-periods, or solutions of a linear row, spent up to an update", "1", ("update",))
    search_amplification = Variable("largest amplification that the gradient has led to", "1", ("update",))
    random_amplification = Variable("largest amplification by random search at that cost", "1", ("update",))
    search_ties = Attribute(int)  # slopes of the search that were taken where another blade or instant is as large
    of = Attribute(str)  # the amplitude that counts
    along = Attribute(str)  # the key along which rows respond
    linear = Attribute(str)  # the state of contact of a linear row; empty: marched
    direction_of = Attribute(str, name="direction_of_sweep")
    seed = Attribute(int)
    tuned_largest = Attribute()  # the largest amplitude of the tuned row [SI]
    tuned_value = Attribute()  # where it has it
    left_out = Attribute(int)  # patterns of which a lane stopped
    at_end = Attribute(int)  # patterns whose largest amplitude is at an end of the range, the tuned row included
    coarse = Attribute(int)  # patterns whose peak is narrower than the distance of values, the tuned row included
    tuned_narrow = Attribute(int)  # whether that of the tuned row is
    unsettled = Attribute(int)  # lanes that are not known to be settled, those of the tuned row included
    unjudged = Attribute(int)  # of these, those that keep too few periods to judge an aperiodic motion
    periods_to_keep = Attribute()  # until they can be judged

    @property
    def designs(self) -> tuple[str, ...]:
        """The intentional patterns."""
        return tuple(map(str, self.data["design"].to_numpy()))

    @property
    def sigmas(self) -> np.ndarray:
        """The standard deviations of the random patterns."""
        return self.data["sigma"].to_numpy()

    @property
    def values(self) -> np.ndarray:
        """The values of `along` in SI units."""
        return self.data["value"].to_numpy()

    @property
    def whitehead(self) -> float:
        """(1 + sqrt(N)) / 2: the bound of a linear row with one mode per blade, and of no other."""
        return whitehead_factor(self.data.sizes["blade"])

    @property
    def worst(self) -> tuple[int, int, int]:
        """The design, the sigma and the pattern with the largest amplification of all that were drawn."""
        finite = np.nan_to_num(self.amplification, nan=-np.inf)
        return tuple(int(i) for i in np.unravel_index(finite.argmax(), finite.shape))  # pyright: ignore[reportReturnType]

    @property
    def failed(self) -> int:
        """The number of lanes that stopped, those of the tuned row included."""
        return int(np.sum(self.status != Status.OK) + np.sum(self.tuned_status != Status.OK))

    @property
    def coarse_patterns(self) -> list[str]:
        """The patterns whose peak is narrower than the distance of values, by name."""
        names = ["the tuned row"] if self.tuned_narrow else []
        several = len(self.designs) > 1
        names += [f"{self.designs[i]} alone" for i in np.flatnonzero(self.design_narrow)]
        patterns = np.argwhere(self.narrow)
        return names + [
            f"{f'{self.designs[i]}, ' * several}sigma {self.sigmas[j]:g}, pattern {k}" for i, j, k in patterns
        ]

    def _coarse_text(self) -> str:
        names = self.coarse_patterns
        named = "; ".join(names[:MAX_NAMED]) + (f"; and {len(names) - MAX_NAMED} more" * (len(names) > MAX_NAMED))
        which = f" ({named})" if names else ""
        return f"{self.coarse} patterns{which} have a peak narrower than the distance of values: give more values"

    @property
    def messages(self) -> list[str]:
        """What to know before these numbers are used."""
        n = self.amplification.size
        drifting = self.unsettled - self.unjudged
        said = {
            f"{self.left_out} of {n} patterns are left out: a lane of theirs stopped": self.left_out,
            "a lane of the tuned row stopped: amplifications are over what is left of it": np.any(self.tuned_status),
            f"of {self.at_end} patterns the largest amplitude is at an end of the range: widen it": self.at_end,
            self._coarse_text(): self.coarse,
            f"the transient of {drifting} runs is perhaps not over: give a longer --transient": drifting,
            too_few_periods_text(self.unjudged, "runs", self.periods_to_keep): self.unjudged,
        }
        return [*super().messages, *(text for text, applies in said.items() if applies)]

    def summary(self) -> dict[str, JSONValue]:
        """Quantiles with intervals for each design and sigma, the worst pattern and the search, in plain numbers."""
        design, sigma, pattern = self.worst
        numbers = {
            "amplification": {
                name: {f"{s:g}": self._quantiles(i, j) for j, s in enumerate(self.sigmas)}
                for i, name in enumerate(self.designs)
            },
            "largest drawn": {
                "amplification": self.amplification[self.worst],
                "design": self.designs[design],
                "sigma": self.sigmas[sigma],
                "pattern": pattern,
                "blade": int(self.worst_blade[self.worst]),
                self.along: self.worst_value[self.worst],
                "participation ratio": self.participation_ratio[self.worst],
                "mistuning": self.mistuning[self.worst].tolist(),
            },
            "tuned": {"amplitude": self.tuned_largest, self.along: self.tuned_value},
            "without random mistuning": dict(zip(self.designs, self.design_amplification.tolist(), strict=True)),
            "Whitehead, linear, one mode per blade": self.whitehead,
            "patterns": self.data.sizes["pattern"],
        }
        names = ("of", "linear", "seed", "left_out", "at_end", "coarse")
        numbers |= {name: getattr(self, name) for name in names}
        numbers |= {"transient not over": self.unsettled, "runs": self.status.size + self.tuned_status.size}
        numbers |= {"coarse patterns": self.coarse_patterns}
        numbers |= self._search_numbers()
        return json_values({**numbers, "direction": self.direction_of, "method": self.method, **self.source})

    def _quantiles(self, design: int, sigma: int) -> dict[str, list[float]]:
        """The quantiles of a design and a sigma, each with its interval."""
        at = design, sigma
        columns = (self.quantile[at], self.quantile_low[at], self.quantile_high[at])
        return {f"{share:g}": list(map(float, row)) for share, *row in zip(QUANTILE_SHARES, *columns, strict=True)}

    def _search_numbers(self) -> dict[str, object]:
        """What the search has found, in plain numbers; nothing without a search."""
        if self.searched_mistuning is None:
            return {}
        return {
            "search": {
                "by gradient": self.search_amplification[-1],
                "by random patterns at equal cost": self.random_amplification[-1],
                "cost": self.search_cost[-1],
                "unit of cost": "solutions" if self.linear else "lane-periods",
                "slopes at ties": self.search_ties,
                "mistuning": self.searched_mistuning.tolist(),
            }
        }

    def __repr__(self) -> str:
        design, sigma, _ = self.worst
        low, median, high = self.quantile[design, -1]
        return (
            f"Mistuned row of {self.data.sizes['blade']}, {self.data.sizes['pattern']} patterns of the design "
            f"{self.designs[design]!r}: amplification {median:.4g} at sigma = {self.sigmas[-1]:g}, nine in ten from "
            f"{low:.4g} to {high:.4g}; largest {self.amplification[self.worst]:.4g} at sigma = {self.sigmas[sigma]:g}; "
            f"{self.ended}; {self.method}"
        )


def mistuned_coordinates(
    along: str, values: np.ndarray, designs: Sequence[str], sigmas: np.ndarray, directions: Sequence[str], blades: int
) -> dict[str, object]:
    """The coordinates of the result as xarray takes them."""
    names = row_layout(blades, True).names
    return {
        "design": list(designs),
        "sigma": ("sigma", sigmas, {"units": "1", "long_name": "standard deviation of the mistuning"}),
        "share": ("share", np.array(QUANTILE_SHARES), {"long_name": "share of patterns below"}),
        DIRECTION: list(directions),
        "value": ("value", values, key_attrs(along, names) | {"dimension": dimension(along, names)}),
        "blade": np.arange(blades),
    }
