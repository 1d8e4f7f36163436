"""The period number, the vibration power and its reduction P_d (Sec. 3.2, Eqs. (23), (24)) over the kept periods.

With them goes the vibration about the mean position: what is left of the power without a static deflection.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from jaxshroud.batch.periods import LANES_PER_CALL, Sample
from jaxshroud.batch.threads import in_chunks
from jaxshroud.cache.programs import kept
from jaxshroud.march.accumulator import ContactTimes
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.geometry import corners, gyration_of_sides
from jaxshroud.model.linear import (
    StaticPosition,
    about_static,
    area,
    free_power,
    free_reach,
    power_reduction,
    static_position,
    steady_amplitudes,
)
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.scene import Scene, Shroud, without_given
from jaxshroud.scene.typed import FloatArray
from jaxshroud.signals.period import (
    PERIOD_TOLERANCE,
    SETTLED,
    Repetition,
    closing_tolerances,
    repetition,
    series_settling,
)
from jaxshroud.signals.statistics import MIN_CORRELATION_TIMES, confidence_interval, correlation_times


class Positions(NamedTuple):
    """The mean positions of blocks in each of some periods."""

    x: FloatArray  # (lanes, periods, blades that count) [m], as the next three
    y: FloatArray
    sin: FloatArray  # of theta
    versine: FloatArray  # 1 - cos(theta)
    gyration: FloatArray  # (lanes,) polar second moment of a block's area per area, J_A / A [m^2]


def static_positions(scenes: Scene) -> StaticPosition | None:
    """The static positions of the blades that count of scenes (leading axis), (lanes, 1, blades) each.

    None where there are no mean loads; then nothing is compiled for it.
    """
    if 0 not in scenes.drive.harmonics():
        return None
    at = _static_positions(without_given(scenes))
    assert at is not None  # as there is a mean load
    return StaticPosition._make(np.asarray(a, float)[:, None, scenes.layout.counting] for a in at)


@kept()
def _static_positions(scenes: Scene) -> StaticPosition | None:
    return jax.vmap(static_position)(scenes)


def positions_of(scenes: Scene, samples: Sample) -> Positions | None:
    """The mean positions in each kept period of scenes (leading axis); None where they were not integrated.

    With mean loads they are those from the static position without contact, as the power is.
    """
    if samples.means is None:
        return None
    sides = (np.asarray(a, float) for a in (scenes.shroud.l_oa, scenes.shroud.l_ab))
    x, y, sine, versine = about_static(samples.means, static_positions(scenes))
    return Positions(x, y, sine, versine, gyration_of_sides(*sides))


def square_about_mean(square: FloatArray, at: Positions) -> FloatArray:
    """The mean square displacement of each period about the mean position over all of them.

    Args:
        square: That about the position of rest, (lanes, periods, blades) [m^2].
        at: The mean positions.

    Returns:
        A series of the same shape. Its mean over the periods is that of <x^2> - <x>^2 + <y^2> - <y>^2 +
        (2 J_A / A) (1 - R), R^2 = <cos theta>^2 + <sin theta>^2, with means over all periods: the square displacement
        averaged over a block that turns about its mean direction.
    """
    X, Y, S, V = (a.mean(axis=1, keepdims=True) for a in at[:4])
    R = np.hypot(1 - V, S)
    tilt = S / (R + 1 - V)  # the tangent of half the mean angle
    turned = S / R * (at.sin - (1 - at.versine) * tilt)
    return square - X * (2 * at.x - X) - Y * (2 * at.y - Y) - 2 * at.gyration[:, None, None] * turned


POWER_ROUNDINGS = 20  # rounding units by which the power of an orbit was found to be off, threefold
NEGLIGIBLE_DRIFT = 0.01  # percentage points; a smaller drift does not count


class Reduction(NamedTuple):
    """The power of all blades and the reduction of those that count, for each lane."""

    P: FloatArray  # (..., blades) [m^4]
    P_d: FloatArray  # (...) [%]
    ci: FloatArray  # (...) half width of the 95 % interval of P_d [percentage points]
    settled: NDArray[np.bool_]  # (...) P_d is known to have settled
    n: NDArray[np.int64]  # (...) averaged periods
    settling: NDArray[np.int8]  # (...) 0: P_d still drifts, 1: it does not, 2: unknown
    periods_more: FloatArray  # (...) of transient until it no longer does; NaN if unknown
    ci_short: NDArray[np.bool_]  # (...) too few correlation times for the interval to be trusted
    P_d_vibration: FloatArray  # (...) P_d of the vibration about the mean position [%]; NaN where it was not kept
    vibration_ci: FloatArray  # (...) half width of its 95 % interval [percentage points]


class VibrationPower(NamedTuple):
    """What the power about the mean position is worked out from."""

    square: FloatArray  # mean square displacement in each period (lanes, n, blades) [m^2]
    positions: Positions
    area: FloatArray  # (lanes,) of a block [m^2]

    def series(self, n: int, P_0: FloatArray, layout: Layout) -> FloatArray:
        """P_d of the vibration in each of the latest `n` periods (lanes, n) [%], about the mean position over all."""

        def latest(a):
            return a[:, a.shape[1] - n :]

        x, y, sine, versine = map(latest, self.positions[:4])
        at = self.positions._replace(x=x, y=y, sin=sine, versine=versine)
        square = square_about_mean(latest(self.square)[..., : x.shape[-1]], at)
        return power_series_of(self.area[:, None, None] * square, P_0, layout)


def reduction(
    power: FloatArray,
    P_0: FloatArray,
    number: NDArray[np.int32],
    layout: Layout = PAIR,
    vibration: VibrationPower | None = None,
) -> Reduction:
    """The reduction P_d, by the rule of the paper for the number n of averaged periods.

    Args:
        power: P of each kept period, (..., n, blades) [m^4], oldest first.
        P_0: Power without contact, (..., blades) [m^4].
        number: Period number of each lane, 0 if aperiodic.
        layout: Which blades count: P_d is 100 (1 - sum P / sum P_0) over these.
        vibration: What P_d of the vibration alone needs, for one leading axis; None where it was not kept.

    Returns:
        Averages over the largest multiple of the period number within the kept periods, or over all of them where the
        orbit is aperiodic. The interval is the `confidence_interval`, with batches of whole orbits, and is short
        where the run spans fewer than 30 correlation times and P_d has not settled on an orbit. P_d is NaN where P_0
        is zero (no drive).
    """
    power, P_0, number = np.asarray(power), np.asarray(P_0), np.asarray(number)
    lanes = number.shape
    flat = power.reshape(-1, *power.shape[-2:])
    base = np.broadcast_to(P_0, (*lanes, power.shape[-1])).reshape(-1, power.shape[-1])
    groups = [np.flatnonzero(number.ravel() == q) for q in np.unique(number)]
    reductions = [
        _reduction_of_period(
            flat[group],
            base[group],
            int(q),
            layout,
            jax.tree.map(lambda a, group=group: a[group], vibration),
        )
        for q, group in zip(np.unique(number), groups, strict=True)
    ]
    order = np.argsort(np.concatenate(groups))
    return Reduction._make(
        np.concatenate(a)[order].reshape(lanes + a[0].shape[1:]) for a in zip(*reductions, strict=True)
    )


def period_reductions(scenes: Scene, samples: Sample, P_0: FloatArray) -> FloatArray:
    """P_d of each kept period of lanes (lanes, n) [%], of the blades that count."""
    A = closed_forms(scenes)[0].astype(float)
    return power_series_of(A[:, None, None] * samples.power, P_0, scenes.layout)


def power_series_of(power: FloatArray, P_0: FloatArray, layout: Layout) -> FloatArray:
    """P_d of each period (lanes, n) [%], of the blades that count."""

    def total(a):
        return a[..., layout.counting].sum(axis=-1)

    return power_reduction(total(power), total(P_0)[:, None])


def convergence(series: FloatArray, number: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """How the average of P_d converges.

    Args:
        series: P_d of each period (n,) [%], oldest first.
        number: The period number, 0 if aperiodic.

    Returns:
        Numbers of periods, spaced logarithmically; the average over the first so many, and its half width.
    """
    q = max(number, 1)
    n = q * np.unique(np.geomspace(1, max(len(series) // q, 1), 200).astype(int))
    n = n[n <= len(series)]
    return n, np.cumsum(series)[n - 1] / n, np.array([confidence_interval(series[:m], q) for m in n])


def _reduction_of_period(
    power: FloatArray, P_0: FloatArray, number: int, layout: Layout, vibration: VibrationPower | None
) -> Reduction:
    q = max(number, 1)
    n = power.shape[1] // q * q
    used = power[:, power.shape[1] - n :]
    P = used.mean(axis=1)
    percent = power_series_of(used, P_0, layout)
    settling_result = series_settling(percent, number, NEGLIGIBLE_DRIFT)
    settled = settling_result.verdict == SETTLED
    is_short = ~(correlation_times(percent, q) >= MIN_CORRELATION_TIMES)
    alone = np.full_like(percent, np.nan) if vibration is None else vibration.series(n, P_0, layout)
    return Reduction(
        P=P,
        P_d=percent.mean(axis=1),
        ci=confidence_interval(percent, q),
        settled=settled,
        n=np.full(len(P), n),
        settling=settling_result.verdict,
        periods_more=settling_result.periods_more,
        ci_short=is_short & ~(settled & (number > 0)),
        P_d_vibration=alone.mean(axis=1),
        vibration_ci=confidence_interval(alone, q),
    )


def contact_shares(times: ContactTimes) -> dict[str, np.ndarray]:
    """Fractions of the time in each contact state, from the times in them."""
    spent = {f"time_{name}": np.asarray(t, float) for name, t in times._asdict().items()}
    total = sum(spent.values())
    with np.errstate(invalid="ignore", divide="ignore"):
        return {name: t / total for name, t in spent.items()}


def relative_residual(samples: Sample) -> np.ndarray:
    """The largest energy residual of a period over the mean work of the drive in a period, (lanes,)."""
    work = np.abs(samples.work).mean(axis=-1)
    return np.abs(samples.residual).max(axis=-1) / np.where(work > 0, work, 1.0)


def relative_drop(samples: Sample) -> np.ndarray:
    """The largest energy that flat contact dropped in a period over the gross work of the drive in it, (lanes,)."""
    gross = np.asarray(samples.gross)
    return (samples.dropped / np.where(gross > 0, gross, 1.0)).max(axis=-1)


def closed_forms(scenes: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The area, the power without contact and half the diagonal of the blocks, (lanes,), (lanes, blades), (lanes,).

    They are computed for as many lanes at a time as are marched, so that batches of any size have the same bits.
    """
    count = len(scenes.drive.omega)

    def chunk(_, chunk_lanes):
        return _closed_forms(jax.tree.map(lambda a: np.asarray(a)[chunk_lanes], scenes))

    return in_chunks(chunk, count, 1 if count == 1 else LANES_PER_CALL)


@kept()
def _closed_forms(scenes: Scene):
    return jax.vmap(lambda scene: (area(scene.shroud), free_power(scene), half_diagonal(scene.shroud)))(scenes)


def stiffnesses(scenes: Scene) -> np.ndarray:
    """The contact stiffness of each scene (leading axis) [N/m]."""
    return np.asarray(_stiffnesses(scenes), float)


@kept()
def _stiffnesses(scenes: Scene):
    return jax.vmap(lambda scene: scene.k)(scenes)


def half_diagonal(shroud: Shroud) -> Scalar:
    """Half the longer diagonal of a block [m]: the displacement of its corners per radian."""
    block = corners(shroud)
    return jnp.hypot(block.a_x, block.h_y)


def least_tilt(scenes: Scene) -> float:
    """The smallest tilt of the faces of the lanes (leading axis).

    The tilt is the free amplitude of the corners by torsion over that of the blocks by bending. Where it is small, the
    faces are nearly parallel, and the case switches dozens of times in a period.
    """
    return float(np.min(np.asarray(_tilts(scenes))))


@kept()
def _tilts(scenes: Scene) -> Array:
    def tilt(scene: Scene) -> Array:
        free = steady_amplitudes(scene)
        by_bending = jnp.sqrt(free_reach(free, "x") ** 2 + free_reach(free, "y") ** 2)
        return jnp.max(free_reach(free, "theta")) * half_diagonal(scene.shroud) / jnp.max(by_bending)

    return jax.vmap(tilt)(scenes)


def displacements(samples: Sample) -> np.ndarray:
    """The displacements x, y and theta of the blades at the ends of periods, (lanes, n, 3 blades)."""
    return np.concatenate(samples.motion[:3], axis=-1, dtype=float)


def period_maxima(samples: Sample) -> np.ndarray:
    """The largest magnitude of each of the `displacements` within each period, (lanes, n, 3 blades)."""
    if samples.largest is None:
        return np.abs(displacements(samples))
    return np.concatenate(samples.largest, axis=-1, dtype=float)


def closing_tolerances_of(scenes: Scene, samples: Sample, tolerance: float, precision: str) -> np.ndarray:
    """The differences of displacements (lanes, 3 blades) that count as zero, relative to their sizes."""
    lever = closed_forms(scenes)[2].astype(float)
    return closing_tolerances(period_maxima(samples).max(axis=1), lever, tolerance, precision)


def averages(
    scenes: Scene, samples: Sample, period_tol: float = PERIOD_TOLERANCE
) -> tuple[Repetition, Reduction, np.ndarray]:
    """The period number and the power of lanes (leading axis) over their kept periods, and P_0 (lanes, blades)."""
    A, P_0, lever = (np.asarray(f, float) for f in closed_forms(scenes))
    orbit = repetition(
        displacements(samples), period_maxima(samples).max(axis=-2), lever, period_tol, scenes.drive.omega.dtype
    )
    square = samples.power
    positions = positions_of(scenes, samples)
    vibration = None if positions is None else VibrationPower(square, positions, A)
    power = reduction(A[:, None, None] * square, P_0, orbit.number, scenes.layout, vibration)
    return orbit, _with_rounding(power, float(np.finfo(scenes.drive.omega.dtype).eps)), P_0


def _with_rounding(power: Reduction, unit: float) -> Reduction:
    """The reduction with intervals that are no narrower than the rounding of a march makes them."""

    def of_rounding(P_d):
        return POWER_ROUNDINGS * unit * np.abs(100 - P_d)

    return power._replace(
        ci=np.maximum(power.ci, of_rounding(power.P_d)),
        vibration_ci=np.maximum(power.vibration_ci, of_rounding(power.P_d_vibration)),
    )
