"""The 0-1 test for chaos of a series of numbers."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxshroud.scene.errors import InputError

Floats = NDArray[np.float64]
FREQUENCIES, LOWEST, HIGHEST = 100, np.pi / 5, 4 * np.pi / 5  # at which K is looked at, away from resonance at 0 and pi
SHARE = 10  # lags up to a tenth of the series
FEWEST = 50  # numbers; with fewer there are not five lags


def zero_one(series: ArrayLike, near: ArrayLike | float = 0.0) -> Floats:
    """K of the 0-1 test: near 0 for regular motion, near 1 for chaos.

    The series drives a point in the plane, p(n + 1) = p(n) + phi(n) cos(n c), q(n + 1) = q(n) + phi(n) sin(n c). Its
    mean square displacement M(n) stays bounded for regular motion and grows like n in chaos; K is the correlation of M
    with n, and the median over 100 frequencies c is taken, since some resonate with the motion.

    The numbers must be far apart in time: of a smooth curve neighbours are so much alike that chaos looks regular.
    Samples once a drive period are, unless the motion itself is slow. A few hundred are needed, a thousand are good.

    Args:
        series: Numbers (..., n), at least 50, oldest first.
        near: Difference (...) that does not count: a series that spans no more is constant, and regular.

    Returns:
        K of each series, (...); NaN where it is not finite.

    Raises:
        ValueError: The series is too short.

    Source:
        Gottwald and Melbourne, "On the implementation of the 0-1 test for chaos", SIAM J. Appl. Dyn. Syst. 8 (2009),
        129: the correlation method. The mean is taken out before, in place of its oscillating part of M.

    Example:
        >>> import numpy as np
        >>> t, x = np.arange(1000), [0.3]
        >>> for _ in t[1:]: x.append(4 * x[-1] * (1 - x[-1]))
        >>> bool(zero_one(x) > 0.9), bool(zero_one(np.sin(t)) < 0.1)
        (True, True)
    """
    phi = np.asarray(series, float)
    if phi.shape[-1] < FEWEST:
        raise InputError(f"The 0-1 test needs {FEWEST} numbers, but has {phi.shape[-1]}.")
    flat = phi.reshape(-1, phi.shape[-1])
    least = np.broadcast_to(near, phi.shape[:-1]).ravel()
    return np.array([_of_one(*one) for one in zip(flat, least, strict=True)]).reshape(phi.shape[:-1])


def _of_one(phi: Floats, near: float) -> float:
    """K of one series."""
    if not np.isfinite(phi).all():
        return float("nan")
    if np.ptp(phi) <= near:
        return 0.0
    at, n = np.random.default_rng(0).uniform(LOWEST, HIGHEST, FREQUENCIES), len(phi)
    about = (phi - phi.mean()) / np.ptp(phi)  # of any size: squares would overflow
    point = np.cumsum(about * np.exp(1j * at[:, None] * np.arange(n)), axis=1)
    lags, last = np.arange(1, n // SHARE + 1), n - n // SHARE
    moved = np.stack([(np.abs(point[:, lag : last + lag] - point[:, :last]) ** 2).mean(axis=1) for lag in lags])
    return float(np.median([np.corrcoef(lags, one)[0, 1] for one in moved.T]))
