"""What Lyapunov exponents come as."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.base import Result
from jaxshroud.results.gathered import in_shape, lanes_in_words
from jaxshroud.results.status import FLAGS, named
from jaxshroud.results.variable import Moving, Variable

if TYPE_CHECKING:
    from jaxshroud.model.state import State
    from jaxshroud.motion.lyapunov import Exponents


class Lyapunov(Result):
    """Exponents per drive period, largest first; the slider's own is among them.

    Arrays start with the axes of the scenes; a single scene has none.
    """

    stored_as = "lyapunov"

    exponents = Variable("Lyapunov exponents per drive period; -inf: forgotten altogether", "1", ("direction",))
    ci = Variable("half width of the 95 % interval", "1", ("direction",))
    growth = Variable("exponents of each period; NaN once a lane has stopped", "1", ("period", "direction"))
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    motion = Moving("at the end")
    u_s = Variable("slider at the end", "m")
    mode = Variable("contact mode at the end")
    case = Variable("contact case at the end")

    @classmethod
    def of_exponents(cls, found: "Sequence[Exponents]", shape: tuple[int, ...], **told: Any) -> "Lyapunov":
        """The result from each lane's exponents; there are lanes of that shape."""
        longest = max(len(one.growth) for one in found)
        rows = [_row(one, longest) for one in found]
        values = {name: in_shape([row[name] for row in rows], shape) for name in rows[0]}
        return cls.from_values(values, coords={"blade": [0, 1]}, **told)

    @property
    def last(self) -> "State":
        """The state at the end, to go on from."""
        from jaxshroud.model.state import State

        return State(self.motion, self.u_s, self.mode, self.case)

    def __repr__(self) -> str:
        n = self.growth.shape[-2]
        if np.ndim(self.status):
            chaotic = np.sum(self.exponents[..., 0] - self.ci[..., 0] > 0)
            return (
                f"Lyapunov of {lanes_in_words(self.status, self.failed)}: {chaotic} chaotic; {n} periods; {self.ended}"
            )
        first = ", ".join(f"{v:.4g} +- {ci:.2g}" for v, ci in zip(self.exponents[:3], self.ci, strict=False))
        return f"Lyapunov exponents per drive period: {first}, ...; {n} periods; {named(self.status)}"


def _row(one: "Exponents", periods: int) -> dict[str, Any]:
    """One lane's numbers, over as many periods as the longest has."""
    growth = np.full((periods, len(one.exponents)), np.nan, one.growth.dtype)
    growth[: len(one.growth)] = one.growth
    last = one.last
    moved = {"motion": last.motion, "u_s": last.u_s, "mode": last.mode, "case": last.case}
    return {"exponents": one.exponents, "ci": one.ci, "growth": growth, "status": np.int32(one.status), **moved}
