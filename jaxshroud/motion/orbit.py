"""The periodic orbit of one scene: its Floquet multipliers, and what it can be relied upon for.

The section is drive phase 0. An orbit of period number q is a fixed point of the map of q drive periods on the state
(motion and slider); its multipliers are the eigenvalues of the map's Jacobian M, which comes with the march.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.states import STATE
from jaxshroud.batch.tangents import Tangents
from jaxshroud.march.method import Choices
from jaxshroud.model.linear import area, free_power, power_reduction
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.state import State
from jaxshroud.scene.scene import Scene

# Relative errors of derivatives that are promised; where they cannot be kept, conditions are ill.
EXACT = {"float64": 1e-6, "float32": 1e-2}
ROUNDINGS = 1e3  # units of rounding that a slider's row of the Jacobian may differ by from that of a slider at rest
UNSOUND = {"unstable", "not converged", "stopped"}  # flags of what is not a motion that lasts


class Shot(NamedTuple):
    """A state on its way to becoming an orbit."""

    state: State
    at: Tangents
    residual: float
    updates: int


@dataclass(frozen=True)
class Cycle:
    """The periodic orbit of one scene, or what was found in place of one.

    `flags` is empty for an orbit that can be relied upon. Else it holds any of "aperiodic" (the motion never nearly
    repeated), "not converged" (Newton's method did not close it), "unstable" (a multiplier outside the unit circle),
    "not unique" (permanent stick: the slider stays wherever it starts, one orbit for each of its places; derivatives
    are those with the slider held in its place), "ill conditioned" (`doubt` exceeds 1e-6) and "stopped" (the march
    ended with a status other than OK).
    """

    scene: Scene
    start: State  # at drive phase 0
    q: int  # period number; 0: no orbit
    P: np.ndarray  # (2,) Eq. (23) [m^4]; NaN without an orbit
    P_0: np.ndarray  # (2,) [m^4]
    P_d: float  # of the left blade, Eq. (24) [%]
    residual: float  # of closing, relative to the largest value of each quantity
    multipliers: np.ndarray  # (13,) Floquet multipliers, largest first; the slider's own is among them
    conditioning: float  # norm of (I - M)^-1 in the units of `_lengths`: how far a push of the map moves the orbit
    doubt: float  # relative error that derivatives may have from how well the orbit is closed, or from rounding
    flags: tuple[str, ...]
    updates: int  # of Newton's method
    periods: int  # drive periods simulated in all, each Jacobian counted as one run
    steps_per_period: int
    method: Choices
    status: int  # how the march ended
    jacobian: Tangents | None = field(repr=False)  # of the map at the orbit

    @property
    def found(self) -> bool:
        """Whether there is a periodic orbit, stable or not."""
        return self.q > 0

    @property
    def slider_is_free(self) -> bool:
        """Whether the slider stays wherever it starts (permanent stick)."""
        return "not unique" in self.flags

    @property
    def others(self) -> np.ndarray:
        """The multipliers without that of a free slider."""
        return without_slider(self.multipliers, self.slider_is_free)

    @property
    def bifurcation(self) -> tuple[str, float]:
        """The bifurcation that the leading multiplier is on its way to, and its distance 1 - abs(multiplier)."""
        return bifurcation_of(self.others[0])

    @property
    def sound(self) -> bool:
        """Whether it is a motion that lasts."""
        return self.found and not UNSOUND & set(self.flags)


def bifurcation_of(lead: complex) -> tuple[str, float]:
    """The bifurcation that a leading multiplier is on its way to, and its distance."""
    real = "fold" if lead.real > 0 else "flip"
    return "Neimark-Sacker" if abs(lead.imag) > 1e-6 * abs(lead) else real, float(1 - abs(lead))


def _lengths(scene: Scene) -> np.ndarray:
    """What a state's numbers (13,) are counted in to compare them: lengths at a block's corner, and these per radian.

    A norm in these units does not depend on how large the motion is. The lever is half the hypotenuse of the sides, not
    `half_diagonal`: another number, with which `conditioning` and `doubt` would change.
    """
    lever = np.hypot(float(scene.shroud.l_oa), float(scene.shroud.l_ab)) / 2
    place = np.repeat([1.0, 1.0, 1 / lever], 2)
    return np.concatenate([place, float(scene.drive.omega) * place, [1.0]])


def _in_lengths(scene: Scene, M: np.ndarray) -> np.ndarray:
    units = _lengths(scene)
    return M * units / units[:, None]


def slider_is_free(scene: Scene, at: Tangents) -> bool:
    """Permanent stick: but for rounding, where the slider ends is where it started, and nothing else moves it."""
    M = _in_lengths(scene, at.by_state)
    most = ROUNDINGS * np.finfo(at.by_state.dtype).eps * max(1.0, float(np.abs(M).max()))
    return bool(at.end.mode == Mode.STICK and np.all(np.abs(M[-1] - np.eye(STATE)[-1]) <= most))


def conditioning_of(scene: Scene, at: Tangents, free: bool) -> float:
    """Norm of (I - M)^-1 in the units of `_lengths`, without a slider that stays where it starts; NaN if unknown."""
    if not np.all(np.isfinite(at.by_state)):
        return float("nan")
    size = STATE - free
    with np.errstate(divide="ignore"):
        rest = np.eye(size) - _in_lengths(scene, at.by_state)[:size, :size]
        return float(1 / np.linalg.svd(rest, compute_uv=False)[-1])


def doubt_of(conditioning: float, shot: Shot) -> float:
    """Relative error that derivatives may have from closing no better than this, or from rounding.

    An error of the map moves the orbit by `conditioning` times as much, and the derivatives by that once more.
    """
    return conditioning**2 * max(shot.residual, float(np.finfo(shot.at.by_state.dtype).eps))


def without_slider(multipliers: np.ndarray, free: bool) -> np.ndarray:
    """The multipliers without that of a slider that stays wherever it starts, if it does."""
    return np.delete(multipliers, np.argmin(np.abs(multipliers - 1))) if free else multipliers


def described(scene: Scene, shot: Shot, q: int, tolerance: float, spent: int, steps: int, method: Choices) -> Cycle:
    """The orbit through a closed shot, with its multipliers and flags."""
    at = shot.at
    multipliers = np.linalg.eigvals(at.by_state) if np.all(np.isfinite(at.by_state)) else np.full(STATE, np.nan + 0j)
    free = slider_is_free(scene, at)
    multipliers = multipliers[np.argsort(-np.abs(multipliers))]
    others = without_slider(multipliers, free)
    conditioning = conditioning_of(scene, at, free)
    doubt = doubt_of(conditioning, shot)
    flags = {
        "stopped": at.status != Status.OK,
        "not converged": not shot.residual <= max(1e3 * tolerance, 1e-9),
        "unstable": bool(np.any(np.abs(others) > 1)),
        "not unique": free,
        "ill conditioned": doubt > EXACT[method.precision],
    }
    P = float(area(scene.shroud)) * at.power
    P_0 = np.asarray(free_power(scene), float)
    return Cycle(
        scene=scene,
        start=shot.state,
        q=q,
        P=P,
        P_0=P_0,
        P_d=float(power_reduction(P[0], P_0[0])),
        residual=shot.residual,
        multipliers=multipliers,
        conditioning=conditioning,
        doubt=doubt,
        flags=tuple(name for name, raised in flags.items() if raised),
        updates=shot.updates,
        periods=spent,
        steps_per_period=steps,
        method=method,
        status=at.status,
        jacobian=at,
    )


def none_found(
    scene: Scene, state: State, flag: str, spent: int, steps: int, method: Choices, status: int = Status.OK
) -> Cycle:
    """What there is to say where no orbit was found."""
    nothing = np.full(2, np.nan)
    return Cycle(
        scene=scene,
        start=state,
        q=0,
        P=nothing,
        P_0=np.asarray(free_power(scene), float),
        P_d=float("nan"),
        residual=float("nan"),
        multipliers=np.full(STATE, np.nan + 0j),
        conditioning=float("nan"),
        doubt=float("nan"),
        flags=(flag,),
        updates=0,
        periods=spent,
        steps_per_period=steps,
        method=method,
        status=status,
        jacobian=None,
    )
