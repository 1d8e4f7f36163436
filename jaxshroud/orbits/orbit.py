"""The periodic orbit of one scene: its Floquet multipliers and its reliability.

The section is drive phase 0. An orbit of period number q is a fixed point of the map of q drive periods on the state
(motion and sliders); its multipliers are the eigenvalues of the map's Jacobian M, which comes with the march.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxshroud.batch.lanes import coordinate_sizes
from jaxshroud.batch.tangents import Tangents
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march.method import Choices
from jaxshroud.model.geometry import gyration_of_sides
from jaxshroud.model.linear import StaticPosition, about_static, power_reduction, vibration_square
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.signals.averages import closed_forms, static_positions

# The promised relative errors of derivatives; an orbit for which they cannot be kept is ill conditioned.
MAX_DERIVATIVE_ERROR = {"float64": 1e-6, "float32": 1e-2}
FREE_SLIDER_ROUNDINGS = 1e3  # rounding units by which the Jacobian's row of a free slider may differ from the unit row
UNSOUND_FLAGS = {"unstable", "not converged", "stopped"}  # flags of motions that do not last


class ShootingState(NamedTuple):
    """A shooting iterate with its Jacobian and its closing error."""

    state: State
    tangents: Tangents
    residual: float
    updates: int


@dataclass(frozen=True)
class PeriodicOrbit:
    """The periodic orbit of one scene, or the result of a failed search.

    `flags` is empty for a reliable orbit. Else it holds any of "aperiodic" (the motion never nearly
    repeated), "not converged" (Newton's method did not close it), "unstable" (a multiplier outside the unit circle),
    "not unique" (permanent stick: the slider stays where it starts, with one orbit for each of its positions;
    derivatives are those with the slider fixed), "ill conditioned" (`doubt` exceeds 1e-6) and "stopped" (the march
    ended with a status other than OK).
    """

    scene: Scene
    start: State  # at drive phase 0
    q: int  # period number; 0: no orbit
    P: np.ndarray  # (blades,) Eq. (23) [m^4]; NaN without an orbit
    P_0: np.ndarray  # (blades,) [m^4]
    P_d: float  # of the left blade, Eq. (24), or of a whole row [%]
    P_d_vibration: float  # that of the vibration about the mean position alone [%]; NaN where it was not integrated
    residual: float  # closing error relative to the largest value of each quantity
    multipliers: np.ndarray  # (numbers,) Floquet multipliers, largest first, including those of sliders
    conditioning: (
        float  # norm of (I - M)^-1 in the `_state_units`: displacement of the orbit per perturbation of the map
    )
    doubt: float  # bound of the relative error of derivatives by the closing error and by rounding
    flags: tuple[str, ...]
    updates: int  # of Newton's method
    periods: int  # drive periods simulated in all, with each Jacobian counted as one run
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
        """Whether a slider is free: it stays where it starts (permanent stick)."""
        return "not unique" in self.flags

    @property
    def free_sliders(self) -> np.ndarray:
        """Which sliders are free: one of the pair, else one for each interface."""
        assert self.jacobian is not None  # there is an orbit
        return free_sliders(self.scene, self.jacobian)

    @property
    def others(self) -> np.ndarray:
        """The multipliers without those of free sliders."""
        return without_sliders(self.multipliers, int(self.free_sliders.sum()) if self.slider_is_free else 0)

    @property
    def bifurcation(self) -> tuple[str, float]:
        """The bifurcation that the leading multiplier approaches, and its distance 1 - abs(multiplier)."""
        return bifurcation_of(self.others[0])

    @property
    def sound(self) -> bool:
        """Whether it is a stable, converged orbit."""
        return self.found and not UNSOUND_FLAGS & set(self.flags)


def bifurcation_of(lead: complex) -> tuple[str, float]:
    """The bifurcation that a leading multiplier approaches, and its distance."""
    real = "fold" if lead.real > 0 else "flip"
    return "Neimark-Sacker" if abs(lead.imag) > 1e-6 * abs(lead) else real, float(1 - abs(lead))


def _state_units(scene: Scene) -> np.ndarray:
    """The units of the numbers of a state in norms: lengths at a corner of a block, and these per radian.

    A norm in these units does not depend on the size of the motion. The lever is half the hypotenuse of the sides, not
    `half_diagonal`, with which `conditioning` and `doubt` would change.
    """
    lever = np.hypot(float(scene.shroud.l_oa), float(scene.shroud.l_ab)) / 2
    place = coordinate_sizes(np.repeat([1.0, 1.0, 1 / lever], scene.layout.blades), scene)
    sliders = np.ones(scene.sliders)
    return np.concatenate([place, float(scene.drive.omega) * place, sliders])


def _in_state_units(scene: Scene, M: np.ndarray) -> np.ndarray:
    units = _state_units(scene)
    return M * units / units[:, None]


def free_sliders(scene: Scene, tangents: Tangents) -> np.ndarray:
    """Which sliders are free: up to rounding they end where they started, and nothing else moves them."""
    M = _in_state_units(scene, tangents.by_state)
    largest = FREE_SLIDER_ROUNDINGS * np.finfo(tangents.by_state.dtype).eps * max(1.0, float(np.abs(M).max()))
    sticks = np.ravel(tangents.end.mode) == Mode.STICK
    count = len(sticks)
    return sticks & np.all(np.abs(M[-count:] - np.eye(len(M))[-count:]) <= largest, axis=1)


def determined(size: int, free: np.ndarray | bool) -> np.ndarray:
    """The places of the numbers of a state, of `size` in all, without free sliders."""
    sliders = np.atleast_1d(free)
    return np.flatnonzero(np.append(np.ones(size - len(sliders), bool), ~sliders))


def conditioning_of(scene: Scene, tangents: Tangents, free: np.ndarray) -> float:
    """Norm of (I - M)^-1 in the units of `_state_units`, without free sliders; NaN if unknown."""
    if not np.all(np.isfinite(tangents.by_state)):
        return float("nan")
    moves = determined(len(tangents.by_state), free)
    with np.errstate(divide="ignore"):
        system = np.eye(len(moves)) - _in_state_units(scene, tangents.by_state)[np.ix_(moves, moves)]
        return float(1 / np.linalg.svd(system, compute_uv=False)[-1])


def derivative_error_of(conditioning: float, shot: ShootingState) -> float:
    """The bound of the relative error of derivatives by the closing error and by rounding.

    An error of the map moves the orbit by `conditioning` times as much, and the derivatives by that factor once more.
    """
    return conditioning**2 * max(shot.residual, float(np.finfo(shot.tangents.by_state.dtype).eps))


def without_sliders(multipliers: np.ndarray, free: int) -> np.ndarray:
    """The multipliers without those of so many free sliders."""
    return np.delete(multipliers, np.argsort(np.abs(multipliers - 1), kind="stable")[:free])


def reduction_of(scene: Scene, P: np.ndarray, P_0: np.ndarray) -> float:
    """P_d of the left blade of a pair, or of a whole row [%]."""
    counts = scene.layout.counting
    return float(power_reduction(P[counts].sum(), P_0[counts].sum()))


def vibration_reduction(scene: Scene, tangents: Tangents, area: float, P_0: np.ndarray) -> float:
    """P_d of the vibration about the mean position alone [%]; NaN where that was not integrated."""
    if tangents.means is None:
        return float("nan")
    gyration = gyration_of_sides(float(scene.shroud.l_oa), float(scene.shroud.l_ab))
    at = static_positions(repeat_lane(without_given(scene), 1))
    means = about_static(tangents.means, at and StaticPosition._make(a[0, 0] for a in at))
    square = vibration_square(tangents.power[: tangents.means.shape[-1]], means, gyration)
    return reduction_of(scene, area * square, P_0)


def area_and_free_power(scene: Scene) -> tuple[float, np.ndarray]:
    """The area of a block [m^2] and the power of all blades without contact [m^4] of one scene."""
    area, P_0, _ = closed_forms(repeat_lane(without_given(scene), 1))
    return float(area[0]), P_0[0].astype(float)


def describe_orbit(
    scene: Scene, shot: ShootingState, q: int, tolerance: float, simulated: int, steps: int, method: Choices
) -> PeriodicOrbit:
    """The orbit of a shooting iterate, with its multipliers and flags."""
    tangents = shot.tangents
    multipliers = (
        np.linalg.eigvals(tangents.by_state)
        if np.all(np.isfinite(tangents.by_state))
        else np.full(len(tangents.vector), np.nan + 0j)
    )
    free = free_sliders(scene, tangents)
    multipliers = multipliers[np.argsort(-np.abs(multipliers))]
    others = without_sliders(multipliers, int(free.sum()))
    conditioning = conditioning_of(scene, tangents, free)
    doubt = derivative_error_of(conditioning, shot)
    flags = {
        "stopped": tangents.status != Status.OK,
        "not converged": not shot.residual <= max(1e3 * tolerance, 1e-9),
        "unstable": bool(np.any(np.abs(others) > 1)),
        "not unique": bool(free.any()),
        "ill conditioned": doubt > MAX_DERIVATIVE_ERROR[method.precision],
    }
    area, P_0 = area_and_free_power(scene)
    P = area * tangents.power
    return PeriodicOrbit(
        scene=scene,
        start=shot.state,
        q=q,
        P=P,
        P_0=P_0,
        P_d=reduction_of(scene, P, P_0),
        P_d_vibration=vibration_reduction(scene, tangents, area, P_0),
        residual=shot.residual,
        multipliers=multipliers,
        conditioning=conditioning,
        doubt=doubt,
        flags=tuple(name for name, raised in flags.items() if raised),
        updates=shot.updates,
        periods=simulated,
        steps_per_period=steps,
        method=method,
        status=tangents.status,
        jacobian=tangents,
    )


def no_orbit(
    scene: Scene, state: State, flag: str, simulated: int, steps: int, method: Choices, status: int = Status.OK
) -> PeriodicOrbit:
    """The result where no orbit was found."""
    _, P_0 = area_and_free_power(scene)
    return PeriodicOrbit(
        scene=scene,
        start=state,
        q=0,
        P=np.full(len(P_0), np.nan),
        P_0=P_0,
        P_d=float("nan"),
        P_d_vibration=float("nan"),
        residual=float("nan"),
        multipliers=np.full(scene.state_size, np.nan + 0j),
        conditioning=float("nan"),
        doubt=float("nan"),
        flags=(flag,),
        updates=0,
        periods=simulated,
        steps_per_period=steps,
        method=method,
        status=status,
        jacobian=None,
    )
