"""The misfit of a model to data: residuals over their noise, with their slopes in the unit cube of some numbers."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# points (P, keys) and rows -> (P, n, c), (P, n, c, keys), of which only the first rows are needed; None: all
Predict = Callable[[np.ndarray, int | None], tuple[np.ndarray, np.ndarray]]
FEWEST_NOISE = 1e-9  # least noise of a channel, over the root mean square of its values


class Data(NamedTuple):
    """Measured values and the standard deviations of their noise."""

    values: np.ndarray  # (n, c)
    sigma: np.ndarray  # (n, c)
    sigma_is_known: bool


class Residuals(NamedTuple):
    """Residuals over the noise, of points (leading axis) or of one; the channels of a row follow each other."""

    values: np.ndarray  # (n * c,)
    jacobian: np.ndarray  # (n * c, keys)
    known: np.ndarray  # (n * c,) whether the model says something


class Misfit:
    """The weighted residuals of one problem and their Jacobian, which are computed together.

    Where the model says nothing, the residual is the datum itself, with no slope: a descent goes elsewhere.
    """

    def __init__(self, predict: Predict, data: Data, skip: Callable[[int], None] = lambda _: None):
        """The misfit of a model.

        Args:
            predict: Values and slopes at points.
            data: What was measured.
            skip: Called with a number of evaluations that were counted on and are not needed.
        """
        self.predict, self.data, self.skip, self.evaluations = predict, data, skip, 0
        self._latest: tuple[bytes, Residuals] | None = None

    @property
    def channels(self) -> int:
        """The number of channels."""
        return self.data.values.shape[1]

    @property
    def samples(self) -> int:
        """The number of samples."""
        return len(self.data.values)

    @property
    def size(self) -> int:
        """The number of residuals."""
        return self.data.values.size

    def of_points(self, points: np.ndarray, rows: int | None = None) -> Residuals:
        """The residuals of points, and their Jacobians; only those of the first `rows` mean anything."""
        values, slopes = self.predict(points, rows)
        known = np.isfinite(values) & np.isfinite(slopes).all(axis=-1)
        residuals = np.where(known, values - self.data.values, self.data.values) / self.data.sigma
        slopes = np.where(known[..., None], slopes, 0.0) / self.data.sigma[..., None]
        self.evaluations += len(points)
        flat = lambda a: a.reshape(len(points), -1, *a.shape[3:])
        return Residuals(flat(residuals), flat(slopes), flat(known))

    def at(self, u: np.ndarray) -> Residuals:
        """Those of one point."""
        if self._latest is None or self._latest[0] != u.tobytes():
            self._latest = u.tobytes(), Residuals(*(a[0] for a in self.of_points(u[None])))
        return self._latest[1]

    def chi2(self, u: np.ndarray) -> float:
        """chi^2 of one point."""
        return float(np.sum(self.at(u).values ** 2))

    def with_sigma(self, sigma: np.ndarray) -> "Misfit":
        """The same with another noise of each channel (channels,)."""
        sigma = np.broadcast_to(sigma, self.data.values.shape)
        changed = Misfit(self.predict, self.data._replace(sigma=sigma), self.skip)
        changed.evaluations = self.evaluations
        return changed


def noise_of_neighbours(residuals: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The noise of each channel (channels,) by how far residuals depart from the line through both neighbours.

    What the model misses is smooth from sample to sample, and hardly counts: this is the noise of the data even where
    the fit is bad.

    Args:
        residuals: Of the channels, (n, channels), n > 2.
        at: Where they were measured, growing, (n,).
    """
    before, after = np.diff(at)[:-1, None], np.diff(at)[1:, None]
    share = after / (before + after)  # of the sample before
    away = residuals[1:-1] - share * residuals[:-2] - (1 - share) * residuals[2:]
    return np.sqrt(np.mean(away**2 / (1 + share**2 + (1 - share) ** 2), axis=0))
