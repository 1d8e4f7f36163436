"""What contact does to the first harmonic: a stiffness and a damping between the blades, and P_d with the former alone.

The contact forces are not sampled. Their first harmonic follows from that of the displacements by Eq. (1),

    R = (k - m omega^2 + i omega c) q - F,

at each coordinate of each block, less what couples the blades otherwise. Along the normal n = (sin alpha, -cos alpha)
of the faces at rest and along their tangent t = (cos alpha, sin alpha), the relative displacement of the blocks'
centres d = q_1 - q_2 gives the dynamic stiffness K = -R d^-1 = k_eq + i omega c_eq, of which the sign is that of a
spring and a damper between the blades. What the blocks' rotation moves at the faces is left out of d, and is thus seen
as a part of K. Along a direction in which d does not move K is undefined, as it is where the faces never touch. Of
blades by modes there are none: Eq. (1) is that of lumped ones.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float

from jaxshroud.batch.lanes import motion_rows
from jaxshroud.batch.runs import sampled_motions
from jaxshroud.batch.sampling import SampleGrid
from jaxshroud.batch.stretches import cubic_mean
from jaxshroud.march.method import Choices
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.linear_system import LinearSystem, free_system, moving_coordinates, solutions
from jaxshroud.model.prepared import State
from jaxshroud.scene.drive import AnyLoad
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene

HARMONIC_PERIODS = 16  # over which the first harmonic of an aperiodic motion is taken
NEGLIGIBLE_FORCE = 1e-6  # of contact, over that of the drive: the error of samples
NEGLIGIBLE_MOTION = 1e-6  # along one direction of the faces, over that along the other: likewise

PerCoordinate = Float[np.ndarray, "6"]  # x of both blades, then y, then theta
ComplexAmplitudes = Complex[np.ndarray, "6"]
IN_PLANE = 4  # coordinates


class LinearBlades(NamedTuple):
    """Eq. (1) without contact, of one pair."""

    free: LinearSystem
    moves: np.ndarray  # (6,)
    drive: ComplexAmplitudes  # complex amplitude of the load, of the first harmonic
    mean: PerCoordinate  # constant load
    omega: float
    axes: Float[np.ndarray, "2 2"]  # normal and tangent of the faces at rest, as rows


class Equivalent(NamedTuple):
    """The equivalents of contact along the normal and the tangent of the faces; NaN where they are undefined."""

    touches: bool  # the faces touch at some time
    stiffness: Float[np.ndarray, "2"]  # [N/m]
    damping: Float[np.ndarray, "2"]  # [N s/m]
    ratio: Float[np.ndarray, "2"]  # damping ratio of the relative motion; see `relative_damping_ratio`


def equivalent_values(
    scenes: Scene, states: State, number: np.ndarray, P_0: np.ndarray, steps: int, method: Choices
) -> dict[str, np.ndarray]:
    """The values of `WithEquivalent` by their names, (lanes,) each, of motions over their next periods.

    NaN where the blades are not lumped or do not move along both x and y, where the faces never touch, and along a
    direction of the faces in which nothing moves.

    Args:
        scenes: The scenes (leading axis).
        states: The states on the settled motions, at drive phase 0.
        number: The period number of each lane, 0 if aperiodic: the harmonic is that of `HARMONIC_PERIODS`.
        P_0: The mean square displacement of the left block without contact (lanes,) [m^2].
        steps: Steps in a period.
        method: The options of the march.
    """
    names = ("k_n", "k_t", "c_n", "c_t", "zeta_n", "zeta_t", "P_d_stiffness", "touches")
    found = np.full((len(number), len(names)), np.nan)
    if scenes.parts.contact != "none" and "y" in scenes.parts.motion and scenes.mode_numbers is None:
        periods = np.where(number > 0, number, HARMONIC_PERIODS)
        grid = SampleGrid(0.0, steps, 1, int(periods.max()) * steps)
        plain = method._replace(forces=False, amplitudes=False, vibration=False)
        rows = motion_rows(sampled_motions(scenes, states, grid, plain))
        for i, n in enumerate(periods.tolist()):
            blades = linear_blades(scenes, i)
            contact = equivalent_contact(blades, rows[i, : 1 + n * steps], steps)
            P_d = reduction_with_stiffness(blades, contact.stiffness, float(P_0[i]))
            found[i] = *contact.stiffness, *contact.damping, *contact.ratio, P_d, contact.touches
    return dict(zip(names, found.T, strict=True))


def linear_blades(scenes: Scene, i: int) -> LinearBlades:
    """The blades of one of many scenes (leading axis)."""
    scene = jax.tree.map(lambda a: np.asarray(a, float)[i], scenes)
    loads = scene.drive.harmonics()
    alpha = float(scene.shroud.alpha)
    return LinearBlades(
        free=free_system(scene),
        moves=moving_coordinates(scene),
        drive=_load_of(loads.get(1)),
        mean=np.imag(_load_of(loads.get(0))),
        omega=float(scene.drive.omega),
        axes=np.array([[np.sin(alpha), -np.cos(alpha)], [np.cos(alpha), np.sin(alpha)]]),
    )


def _load_of(one: AnyLoad | None) -> ComplexAmplitudes:
    """The complex amplitudes of the load of one harmonic."""
    if one is None:
        return np.zeros(6, complex)
    return np.concatenate([re + 1j * im for re, im in map(one.parts, COORDINATES)])


class HarmonicMotion(NamedTuple):
    """The complex amplitudes, or the means, of displacements, rates and accelerations: (6,) each."""

    q: ComplexAmplitudes | PerCoordinate
    rate: ComplexAmplitudes | PerCoordinate
    acceleration: ComplexAmplitudes | PerCoordinate


def first_harmonics(rows: np.ndarray, steps: int, omega: float) -> HarmonicMotion:
    """The first harmonics of whole drive periods of motions (1 + periods steps, 12).

    Of rates and accelerations they are integrated by parts, so that the first and the last state may differ.
    """
    q, v = rows[:, :6], rows[:, 6:]
    interval = 2 * np.pi / omega / steps
    wave = np.exp(-1j * omega * interval * np.arange(len(rows)))[:, None]
    h = np.full((1, 1, 1), interval)
    displacement = 2j * cubic_mean((q * wave)[None], ((v - 1j * omega * q) * wave)[None], h)[0]

    def gained(a):
        return 2j * (a[-1] - a[0]) / (interval * (len(rows) - 1))

    rate = gained(q) + 1j * omega * displacement
    return HarmonicMotion(displacement, rate, gained(v) + 1j * omega * rate)


def mean_motion(rows: np.ndarray, steps: int, omega: float) -> HarmonicMotion:
    """The means over the same periods of displacements, rates and accelerations."""
    q, v = rows[:, :6], rows[:, 6:]
    interval = 2 * np.pi / omega / steps

    def gained(a):
        return (a[-1] - a[0]) / (interval * (len(rows) - 1))

    mean = cubic_mean(q[None], v[None], np.full((1, 1, 1), interval))[0]
    return HarmonicMotion(mean, gained(q), gained(v))


def equivalent_contact(blades: LinearBlades, rows: np.ndarray, steps: int) -> Equivalent:
    """The equivalents of the contact of a motion (1 + periods steps, 12)."""
    motion = first_harmonics(rows, steps, blades.omega)
    mean = mean_motion(rows, steps, blades.omega)
    on_left, pressing = _contact_force(blades, motion, blades.drive), _contact_force(blades, mean, blades.mean)
    least = NEGLIGIBLE_FORCE * max(np.abs(blades.drive).max(), np.abs(blades.mean).max())
    oscillates, presses = (np.abs(force).max() > least for force in (on_left, pressing))
    K = np.full(2, complex(np.nan, np.nan))
    if oscillates or presses:
        along = _relative_motion(blades, motion.q)
        force = -(blades.axes @ on_left) if oscillates else np.zeros(2)
        np.divide(force, along, out=K, where=np.isfinite(along))
    k = np.real(K)
    c = np.imag(K) / blades.omega
    return Equivalent(bool(oscillates or presses), k, c, relative_damping_ratio(blades, k, c))


def _contact_force(
    blades: LinearBlades, motion: HarmonicMotion, drive: ComplexAmplitudes | PerCoordinate
) -> np.ndarray:
    """The force of contact on the left block along x and y, from Eq. (1)."""
    mass, damping, stiffness = blades.free
    load = mass * motion.acceleration + damping @ motion.rate + stiffness @ motion.q - drive
    left, right = load[:IN_PLANE:2], load[1:IN_PLANE:2]
    return (left - right) / 2 if blades.moves[1] else left


def _relative_motion(blades: LinearBlades, q: ComplexAmplitudes) -> np.ndarray:
    """The relative displacement of the blocks along the normal and the tangent; NaN along which nothing moves."""
    along = blades.axes @ (q[:IN_PLANE:2] - q[1:IN_PLANE:2])
    reach = max(np.abs(along).max(), NEGLIGIBLE_MOTION * np.abs(q).max())
    return np.where(np.abs(along) > NEGLIGIBLE_MOTION * reach, along, np.nan)


def relative_damping_ratio(blades: LinearBlades, k_eq: np.ndarray, c_eq: np.ndarray) -> np.ndarray:
    """The damping ratio that contact adds to the relative motion along the normal and the tangent.

    c_eq / (2 sqrt((k_r + k_eq) m_r)), with the mass m_r and the stiffness k_r against which both blades move apart
    along that direction: 1 / m_r and 1 / k_r are sums of those of x and y of both blades, weighted by its squared
    cosines; springs between the blades are added to k_r. NaN where k_r + k_eq is not positive.
    """
    mass, _, stiffness = blades.free
    between = -stiffness[[0, 2], [1, 3]]

    def along(a):
        return 1 / (blades.axes**2 @ np.where(blades.moves, 1 / a, 0.0)[:IN_PLANE].reshape(2, 2).sum(axis=1))

    with np.errstate(invalid="ignore"):
        k_r = along(stiffness.sum(axis=1)) + blades.axes**2 @ between
        return c_eq / (2 * np.sqrt((k_r + k_eq) * along(mass)))


def reduction_with_stiffness(blades: LinearBlades, stiffness: np.ndarray, P_0: float) -> float:
    """P_d of the linear blades joined by springs of this stiffness along the normal and the tangent [%].

    Args:
        blades: The blades.
        stiffness: Along the normal and the tangent [N/m]; complex, with dampers i omega c.
        P_0: The mean square displacement of the left block without contact [m^2].
    """
    if not np.any(blades.drive):
        return np.nan
    if np.isinf(P_0):
        return 100.0
    apart, joined = map(
        mean_square_of, (joined_displacements(blades, np.zeros(2)), joined_displacements(blades, stiffness))
    )
    return float(power_reduction(np.float64(P_0 - apart + joined), np.float64(P_0)))


def mean_square_of(q: ComplexAmplitudes) -> float:
    """The mean square displacement of the left block's centre from complex amplitudes."""
    return float(np.sum(np.abs(q[:IN_PLANE:2]) ** 2) / 2)


def joined_displacements(blades: LinearBlades, stiffness: np.ndarray) -> ComplexAmplitudes:
    """The complex amplitudes of both blades with springs (normal, tangent) between them, which do not turn.

    An undefined spring, NaN, is left out; without any there is no motion to describe.
    """
    known = np.isfinite(stiffness)
    q = np.zeros(6, complex)
    if not known.any():
        return q + np.nan
    Z = blades.free.dynamic(blades.omega)
    opposed = np.array([[1, -1], [-1, 1]])
    Z[:IN_PLANE, :IN_PLANE] += np.kron(blades.axes.T @ np.diag(np.where(known, stiffness, 0.0)) @ blades.axes, opposed)
    moves = np.flatnonzero(blades.moves[:IN_PLANE])
    q[moves] = solutions(Z[np.ix_(moves, moves)], blades.drive[moves])
    return q
