"""What a gradient gives."""

from dataclasses import dataclass
from typing import Literal

from jaxshroud.motion.orbit import Orbit

Of = Literal["P_d", "P"]


@dataclass(frozen=True)
class Gradient:
    """Derivatives of `of` with respect to some numbers of a scene, in SI units (P_d in percentage points)."""

    of: Of
    kind: Literal["periodic", "smoothed"]
    value: dict[str, float]
    ci: dict[str, float]  # half width of the 95 % interval; 0 where the derivative is exact
    level: float  # what is differentiated: its value on the orbit, or its average over the neighbourhood
    level_ci: float
    orbit: Orbit  # see its flags, multipliers and bifurcation
    conditioning: float  # of the orbit: how far a push of its map moves it; NaN if smoothed
    sigma: float  # relative width of the neighbourhood; 0 on an orbit
    flags: tuple[str, ...]  # those of the orbit, "structured" where the neighbourhood is not smooth, "lanes stopped"

    def __repr__(self) -> str:
        unit = "%" if self.of == "P_d" else "m^4"
        slopes = ", ".join(f"d{self.of}/d {key} = {v:.6g} +- {self.ci[key]:.2g}" for key, v in self.value.items())
        return (
            f"Gradient, {self.kind}: {slopes}; {self.of} {self.level:.6g} +- {self.level_ci:.2g} {unit}; "
            f"flags: {', '.join(self.flags) or 'none'}"
        )
