"""The distribution of P_d where numbers of a scene scatter, and the report on a design as one document."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.plotting.documents import DOTS, Section, save_document
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.base import Result
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.quantities import unit_of
from jaxshroud.scene.typed import typed
from jaxshroud.signals.effects import between, flat_text

SHARES = ("first", "total")  # shares of the variance: Sobol indices of first and of total order


class Scatter(Result):
    """The distribution of P_d over draws of some numbers, and the share of each number in the variance.

    The panels of its picture are "draws" and "shares".
    """

    stored_as = "scatter"

    low = Variable("lower bound of each number, in SI units", None, ("key",))
    high = Variable("upper bound of each number, in SI units", None, ("key",))
    drawn = Variable("the numbers of each draw, in SI units", None, ("draw", "key"))
    P_d = Variable("vibration-power reduction of each draw", "percent", ("draw",))
    P_d_ci = Variable("half width of its 95 % interval", "percent", ("draw",))
    P_d_vibration = Variable("that of the vibration about the mean position alone", "percent", ("draw",))
    level = Variable("another quantity, `of`, of each draw, in SI units; the statistics are of it", None, ("draw",))
    status = Variable("how the march of each draw ended", None, ("draw",), stored=np.int8, more=FLAGS)
    first = Variable("share of the variance that a number has alone", "1", ("key",))
    first_low = Variable("lower end of its 95 % interval", "1", ("key",))
    first_high = Variable("upper end of its 95 % interval", "1", ("key",))
    total = Variable("share of the variance that is gone where a number does not scatter", "1", ("key",))
    total_low = Variable("lower end of its 95 % interval", "1", ("key",))
    total_high = Variable("upper end of its 95 % interval", "1", ("key",))
    of = Attribute(str)  # whose statistics and shares these are: P_d [percent], or `level` [SI]
    mean = Attribute()
    median = Attribute()
    likely_low = Attribute()  # 5 % of the draws are below
    likely_high = Attribute()  # 5 % of the draws are above
    at_least = Attribute()  # required P_d [percent]
    probability = Attribute()  # that the required P_d is met
    probability_low = Attribute()  # ends of its 95 % interval
    probability_high = Attribute()
    N_max = Attribute()  # largest normal force of any run, k v_max [N]
    v_max = Attribute()  # largest penetration of any run [m]
    conditions_json = Attribute(str, name="conditions")  # the operating conditions as JSON
    runs = Attribute(int)
    stopped = Attribute(int)  # number of runs that stopped
    seed = Attribute(int)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the numbers that scatter."""
        return tuple(map(str, self.data["key"].to_numpy()))

    @property
    def quantity(self) -> str:
        """What scatters, `of`; P_d in files of versions that knew nothing else."""
        return self.of or "P_d"

    @property
    def conditions(self) -> dict[str, list[float]]:
        """The operating conditions, key -> values; P_d of a draw is the smallest of all combinations."""
        return json.loads(self.conditions_json or "{}")

    @property
    def flat(self) -> str:
        """What to say where P_d moves less than its intervals over the scatter; else empty."""
        return "" if self.quantity != "P_d" else flat_text(self.P_d, self.P_d_ci)

    @property
    def undefined(self) -> str:
        """What to say where the quantity does not vary, and has no shares of a variance; else empty."""
        if not np.isnan(self.total).all():
            return ""
        return f"shares are undefined: {self.quantity} of the draws varies by no more than rounding"

    def share_text(self, name: str, i: int) -> str:
        """The share of number `i`, "first" or "total", with its 95 % interval."""
        share, low, high = (getattr(self, f"{name}{end}")[i] for end in ("", "_low", "_high"))
        return "undefined" if np.isnan(share) else between(share, low, high)

    @property
    def chance(self) -> str:
        """The probability that `at_least` is met, and its 95 % interval, as text."""
        return between(self.probability, self.probability_low, self.probability_high)

    @property
    def failed(self) -> int:
        """The number of runs that stopped."""
        return self.stopped

    def summary(self) -> dict[str, JSONValue]:
        """The distribution and the shares of its variance in plain numbers, as `summary.json` holds them."""
        names = ["mean", "median", "likely_low", "likely_high", "runs", "stopped", "seed", "steps_per_period"]
        if self.at_least is not None:
            names += ["at_least", "probability", "probability_low", "probability_high"]
        shares = {
            key: {name: getattr(self, name)[i] for name in ("low", "high", "first", "total")}
            | {f"{name}_95": [getattr(self, f"{name}_{end}")[i] for end in ("low", "high")] for name in SHARES}
            for i, key in enumerate(self.keys)
        }
        names += [] if self.quantity == "P_d" else ["of"]
        numbers = {name: getattr(self, name) for name in names} | {
            name: getattr(self, name) for name in ("flat", "undefined") if getattr(self, name)
        }
        return json_values({**numbers, "over": shares, "method": str(self.method), **self.source})

    def __repr__(self) -> str:
        requirement = ""
        unit = unit_of(self.quantity)
        if self.at_least is not None:
            requirement = f"; at least {self.at_least:g} % with probability {self.chance}"
        shares = ", ".join(f"{key} {share:.2g}" for key, share in zip(self.keys, self.total, strict=True))
        shares = self.undefined or f"total shares: {shares}"
        return (
            f"Scatter of {self.quantity} over {len(self.P_d)} draws: {self.median:.4g} {unit}, nine in ten between "
            f"{self.likely_low:.4g} and {self.likely_high:.4g} {unit}{requirement}; {shares}; "
            f"{self.stopped} of {self.runs} runs stopped; {self.method}, {self.steps_per_period} steps a period"
        )


@dataclass(frozen=True)
class Report:
    """The verdict on a design with its reasons, and the results in the worst condition on which it rests."""

    title: str
    verdict: str  # "sound", "doubtful" or "fails"
    reasons: tuple[str, ...]
    run: SweepResult  # the design itself, with its largest forces and its energy balance
    over_gap: SweepResult
    scatter: Scatter | None  # each draw in its worst condition
    gradient: Gradient
    attractors: Attractors
    coexisting: tuple[Attractors, ...]  # one for each condition
    sections: Sequence[Section]
    diagnosis: Diagnosis | None = None  # of a row of blades

    @typed
    def save(self, path: str | Path, *, dpi: int = DOTS) -> None:
        """Write the document as .html or .pdf.

        Args:
            path: A name that ends in .html or .pdf.
            dpi: Dots per inch of the pictures in HTML; those in PDF are lines.

        Raises:
            InputError: The suffix is neither.
            WriteError: The place cannot be written.
        """
        save_document(self.title, self.sections, Path(path), dpi)

    def summary(self) -> dict[str, JSONValue]:
        """The verdict with its reasons, and the summaries of the results on which it rests."""
        parts = {name: getattr(self, name) for name in ("run", "over_gap", "scatter", "gradient", "attractors")}
        of_row = {} if self.diagnosis is None else {"diagnosis": self.diagnosis.summary()}
        return {
            **of_row,
            **{name: getattr(self, name) for name in ("title", "verdict")},
            "reasons": list(self.reasons),
            **{name: None if part is None else part.summary() for name, part in parts.items()},
            "coexisting": [attractors.summary() for attractors in self.coexisting],
        }

    def __repr__(self) -> str:
        return f"Report: {self.verdict}; {'; '.join(self.reasons)}"
