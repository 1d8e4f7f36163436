"""Travelling waves of tuned rings: the map over a part of the drive period, followed by the shift back.

In a ring of N alike blades under engine order EO a travelling wave repeats itself after T / N' at a blade s places
further: z_i(t + T / N') = z_(i + s)(t) with N' = N / gcd(EO, N) and EO s = gcd(EO, N) modulo N. It is a fixed point of
the reduced map: the flow over T / N', followed by the shift of all numbers by s places. This takes 1 / N' of the work
of a whole period, and its multipliers to the power N' are those of the period in magnitude; the powers themselves are
those of the period followed by a shift of N' s places. A multiplier that leaves the unit circle elsewhere than at 1
belongs to motions that are not such a wave: localisation begins there.
"""

import math
from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.tangents import TangentProblem, Tangents
from jaxshroud.model.modes import WAVE_RESIDUAL, Status
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives
from jaxshroud.orbits.orbit import PeriodicOrbit, determined
from jaxshroud.orbits.shooting import state_scales
from jaxshroud.scene.drive import ComplexLoad
from jaxshroud.scene.drive_orders import order_of_drive
from jaxshroud.scene.scene import Scene, without_given

REAL_SHARE = 1e-6  # of a multiplier's magnitude: a smaller imaginary part is rounding


class WaveSymmetry(NamedTuple):
    """The symmetry of a travelling wave."""

    parts: int  # N', of the drive period
    shift: int  # s: places from blade to blade


class TravellingWave(NamedTuple):
    """The reduced map at an orbit."""

    symmetry: WaveSymmetry
    residual: float  # how far the orbit is from a travelling wave, relative to the largest value of each quantity
    multipliers: np.ndarray  # (numbers,) of the reduced map, largest first
    others: np.ndarray  # those without free sliders, whose multipliers are roots of unity

    @property
    def holds(self) -> bool:
        """Whether the orbit is a travelling wave."""
        return self.residual <= WAVE_RESIDUAL


def wave_symmetry(scene: Scene) -> WaveSymmetry | None:
    """The symmetry of travelling waves of a scene; None unless it is a ring of alike blades under an engine order."""
    layout = scene.layout
    if not layout.closed or not _is_tuned(scene):
        return None
    N = layout.blades
    order = order_of_drive(scene.drive)
    if order is None:
        return None
    common = math.gcd(order, N)
    return WaveSymmetry(N // common, next(s for s in range(1, N + 1) if (order * s - common) % N == 0))


def whole_parts(steps: int, scene: Scene) -> int:
    """The least number of steps a period, at least `steps`, that the parts of travelling waves of a scene divide."""
    symmetry = wave_symmetry(scene)
    return steps if symmetry is None else -(-steps // symmetry.parts) * symmetry.parts


def _is_tuned(scene: Scene) -> bool:
    """Whether all blades and all interfaces are alike, except for their phases and their initial motion."""
    plain = without_given(scene)

    def alike(a):
        return np.all(np.asarray(a) == np.asarray(a)[..., :1]) if np.ndim(a) else True

    def loads(one):
        return one.amplitudes if isinstance(one, ComplexLoad) else (one.F_x, one.F_y, one.M_0)

    drive = [loads(one) for one in plain.drive.harmonics().values()]
    parts = (plain.mistuned_blades, plain.running_shroud.gap, plain.k, plain.contact.width, plain.friction, drive)
    return all(bool(alike(a)) for a in jax.tree.leaves(parts))


def travelling_wave(orbit: PeriodicOrbit) -> Algorithm[TravellingWave | None]:
    """The reduced map at an orbit of period 1; None where its scene has no travelling waves, or there is no orbit.

    Steps are those of a whole period where N' divides them; else a part has one more.
    """
    symmetry = wave_symmetry(orbit.scene)
    if symmetry is None or orbit.q != 1:
        return None
    problem = TangentProblem(orbit.scene, orbit.start)
    part: Tangents = yield Derivatives(problem, 1, orbit.steps_per_period, orbit.method, 1 / symmetry.parts)
    if part.status != Status.OK or not np.all(np.isfinite(part.by_state)):
        return None
    order = shifted_places(orbit.scene, symmetry.shift)
    assert orbit.jacobian is not None  # there is an orbit
    start = orbit.jacobian.vector  # with the sliders that the modes determine
    residual = float(np.max(np.abs(part.vector[order] - start) / state_scales(orbit.scene, orbit.start)))
    reduced = part.by_state[order]
    moves = determined(len(order), orbit.free_sliders)
    return TravellingWave(symmetry, residual, _multipliers_of(reduced), _multipliers_of(reduced[np.ix_(moves, moves)]))


def _multipliers_of(jacobian: np.ndarray) -> np.ndarray:
    """The eigenvalues, largest first."""
    multipliers = np.linalg.eigvals(jacobian)
    return multipliers[np.argsort(-np.abs(multipliers))]


def shifted_places(scene: Scene, shift: int) -> np.ndarray:
    """The places from which the numbers of a ring's state come when blade i takes over blade i - shift."""
    blades = scene.layout.blades
    places = np.arange(scene.state_size)
    motion = scene.state_size - scene.sliders
    turned = np.roll(places[:motion].reshape(-1, blades), shift, axis=1)
    sliders = np.roll(places[motion:].reshape(blades, -1), shift, axis=0)  # of each interface, point by point
    return np.concatenate([turned.ravel(), sliders.ravel()])


def wave_bifurcation(multipliers: np.ndarray, blades: int) -> tuple[str, float]:
    """What the leading multiplier of a reduced map approaches, and its distance 1 - abs(multiplier).

    In a ring of an odd number of blades all stay alike in the wave of twice the period: -1 is a flip.
    """
    lead = multipliers[:1]
    flips = blades % 2 == 1 and keeps_shift(-lead).all()
    kind = "fold" if keeps_shift(lead).all() else "flip" if flips else "localisation"
    return kind, float(1 - abs(lead[0]))


def keeps_shift(multipliers: np.ndarray) -> np.ndarray:
    """Whether multipliers of a reduced map are positive: the motions that belong to them are travelling waves."""
    return (np.real(multipliers) > 0) & (np.abs(np.imag(multipliers)) <= REAL_SHARE * np.abs(multipliers))
