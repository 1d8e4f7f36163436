"""The quantities of `Quantity` over the kept periods of runs."""

from typing import NamedTuple

import numpy as np

from jaxshroud.batch.periods import Sample
from jaxshroud.model.linear import area, free_power, power_reduction
from jaxshroud.motion.amplitudes import amplitude_values
from jaxshroud.motion.averages import averages, half_diagonal
from jaxshroud.scene.quantities import Quantity, amplitude_of, is_reduction
from jaxshroud.scene.scene import Scene


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
    counts = slice(1 if scenes.row is None else None)  # the left blade of a pair, all blades of a row
    if of == "P":
        return Levels(power.P[:, counts].sum(axis=1), power.ci * P_0[:, counts].sum(axis=1) / 100, motion.number)
    if of == "P_d_worst":
        value = power_reduction(power.P, P_0).min(axis=1)
    else:
        value = amplitude_values(scenes, samples, motion.number)[of][:, counts].max(axis=1)
    return Levels(value, np.full_like(value, np.nan), motion.number)


def free_level(of: Quantity, scene: Scene) -> float:
    """What a quantity is compared with: P_0, or the RMS displacement of the left block without contact; NaN for P_d.

    Of a row it is the sum of all P_0, or the largest of these displacements. Angles are compared with that displacement
    over half the longer diagonal of a block [rad].
    """
    if is_reduction(of):
        return np.nan
    amplitude, P_0 = amplitude_of(of), np.asarray(free_power(scene))[: 1 if scene.row is None else None]
    if amplitude is None:
        return float(P_0.sum())
    lever = float(half_diagonal(scene.shroud)) if amplitude.displacement == "theta" else 1.0
    return float(np.sqrt(P_0.max() / area(scene.shroud))) / lever
