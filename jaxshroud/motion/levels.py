"""The quantities of `Quantity` over the kept periods of runs."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.batch.xla import one_lane
from jaxshroud.model.linear import area, free_power, power_reduction
from jaxshroud.motion.amplitudes import amplitude_values
from jaxshroud.motion.averages import averages, closed_forms, half_diagonal
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.quantities import Quantity, amplitude_of, counted_amplitude, is_reduction
from jaxshroud.scene.scene import Scene, without_given


class Levels(NamedTuple):
    """A quantity of many lanes."""

    value: np.ndarray  # (lanes,)
    ci: np.ndarray  # (lanes,) half width of its 95 % interval; NaN for amplitudes
    number: np.ndarray  # (lanes,) period number, 0: aperiodic


def levels_of(of: Quantity, scenes: Scene, samples: Sample) -> Levels:
    """The quantity `of` of scenes (leading axis) from their samples, with moments and extent for an amplitude."""
    motion, power, P_0 = averages(scenes, samples)
    if of == "P_d":
        return Levels(power.P_d, power.ci, motion.number)
    if of == "P_d_vibration":
        return Levels(power.P_d_vibration, power.vibration_ci, motion.number)
    counts = scenes.layout.counting
    if of == "P":
        return Levels(power.P[:, counts].sum(axis=1), power.ci * P_0[:, counts].sum(axis=1) / 100, motion.number)
    if of == "P_d_worst":
        value = power_reduction(power.P, P_0).min(axis=1)
    else:
        value = counted_amplitude(amplitude_values(scenes, samples, motion.number)[of], scenes.layout)
    return Levels(value, np.full_like(value, np.nan), motion.number)


def free_level(of: Quantity, scene: Scene) -> float:
    """What a quantity is compared with: P_0, or the RMS displacement of a block without contact; NaN for P_d.

    It is the sum of P_0 over the blades that count, or the largest of their displacements. Angles are compared with
    that displacement over half the longer diagonal of a block [rad].
    """
    if is_reduction(of):
        return np.nan
    amplitude, P_0 = amplitude_of(of), np.asarray(free_power(scene))[scene.layout.counting]
    if amplitude is None:
        return float(P_0.sum())
    lever = float(half_diagonal(scene.shroud)) if amplitude.displacement == "theta" else 1.0
    return float(np.sqrt(P_0.max() / area(scene.shroud))) / lever


def compared_powers(of: str, scenes: Scene) -> np.ndarray:
    """The powers without contact with which `of` of one scene or many is compared, (lanes, powers) [m^4]."""
    lanes = scenes if np.ndim(scenes.drive.omega) else one_lane(scenes)
    P_0 = closed_forms(without_given(lanes))[1].astype(float)[:, scenes.layout.counting]
    return P_0 if of == "P_d_worst" else P_0.sum(axis=1, keepdims=True)


def is_comparable(of: str, scene: Scene) -> bool:
    """Whether `of` of a single scene is compared with a power that is neither 0 nor infinite."""
    P_0 = compared_powers(of, scene)
    return bool(np.all((P_0 > 0) & np.isfinite(P_0)))


def check_vibration(of: str, scenes: Scene, lanes: Callable[[Any], Any] = np.any) -> None:
    """Raise an InputError where `of` is compared with nothing in these `lanes` of one scene or many.

    Args:
        of: The quantity, a `Quantity`.
        scenes: The scenes.
        lanes: Whether it counts that the blades of some lanes (lanes,) do not vibrate without contact.
    """
    if not lanes((compared_powers(of, scenes) == 0).any(axis=1)):
        return
    if scenes.row is None:
        nothing = "The left blade does not vibrate without contact"
    else:
        which = "a blade of the row does not vibrate" if of == "P_d_worst" else "no blade of the row vibrates"
        nothing = f"Without contact {which}"
    lost = f"there is no {of}" if is_reduction(of) else f"{of} has nothing to be compared with"
    force = "force in drive.harmonic" if scenes.drive.of_harmonics() else "drive.F_0"
    raise InputError(f"{nothing}, and {lost}; give it a {force}.")


def check_resonance(of: str, scenes: Scene, lanes: Callable[[Any], Any] = np.any) -> None:
    """Raise an InputError where `of` is compared with an infinite amplitude: every motion is a reduction by 100 %.

    The arguments are those of `check_vibration`.
    """
    if lanes(np.isinf(compared_powers(of, scenes)).any(axis=1)):
        raise InputError(
            f"The drive meets an undamped natural frequency: without contact the amplitude, with which {of} is "
            "compared, is infinite; change drive.omega or give the blades a damping."
        )
