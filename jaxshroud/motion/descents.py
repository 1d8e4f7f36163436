"""Least squares from many points at once: damped Gauss-Newton steps within the unit cube, over a part of the record."""

from typing import Any, NamedTuple

import numpy as np

from jaxshroud.motion.misfit import Misfit, Residuals

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-7, 1e6  # over the squares of the slopes
EASED, RAISED = 0.2, 5.0  # factors of the damping after a step that succeeds, and after one that fails
LONGEST_STEP = 0.2  # of any number, over its range


class Points(NamedTuple):
    """Points of the unit cube (leading axis), with their residuals, of which the first ones count."""

    u: np.ndarray  # (points, keys)
    residuals: Residuals  # fields with the same leading axis

    @classmethod
    def at(cls, misfit: Misfit, u: np.ndarray, samples: int | None = None) -> "Points":
        """The points of these places, with residuals of so many samples; None: of all."""
        return cls(u, misfit.of_points(u, samples))

    def chi2(self, residuals: int) -> np.ndarray:
        """chi^2 of each point over the first residuals."""
        return np.sum(self.residuals.values[:, :residuals] ** 2, axis=1)

    def take(self, which: Any) -> "Points":
        """Some of the points."""
        return Points(self.u[which], Residuals(*(a[which] for a in self.residuals)))

    def put(self, which: np.ndarray, others: "Points") -> "Points":
        """The points with others in some places."""

        def placed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            changed = a.copy()
            changed[which] = b
            return changed

        pairs = zip(self.residuals, others.residuals, strict=True)
        return Points(placed(self.u, others.u), Residuals(*(placed(a, b) for a, b in pairs)))


def descend_together(
    misfit: Misfit, points: Points, samples: int, steps: int, least_gain: float, free: np.ndarray | None = None
) -> Points:
    """The points after at most so many steps down chi^2 over the first samples of the record.

    Args:
        misfit: Evaluated at all points that still move, as one batch.
        points: Where to begin.
        samples: Those that count.
        steps: At most.
        least_gain: Decrease of chi^2 in a step below which a point rests.
        free: Whether each number of each point may move, (points, keys); None: all.

    Source:
        The method of Levenberg and Marquardt: a step solves (J^T J + damping diag(J^T J)) d = -J^T r. Numbers at a
        bound that chi^2 pushes beyond it rest.
    """
    free = np.ones(points.u.shape, bool) if free is None else free
    rows = samples * misfit.channels
    damping, moving = np.full(len(points.u), FIRST_DAMPING), np.ones(len(points.u), bool)
    for _ in range(steps):
        at = np.flatnonzero(moving)
        if not at.size:
            break
        here = points.take(at)
        there = Points.at(misfit, _stepped(here, rows, damping[at], free[at]), samples)
        gain = here.chi2(rows) - there.chi2(rows)
        points = points.put(at[gain > 0], there.take(gain > 0))
        factor = np.where(gain > 0, EASED, RAISED)
        damping[at] = np.maximum(damping[at] * factor, LEAST_DAMPING)
        moving[at] = np.where(gain > 0, gain > least_gain, damping[at] < MOST_DAMPING)
        misfit.skip(len(points.u) - len(at))
    return points


def _stepped(points: Points, rows: int, damping: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The places after one step."""
    residuals, slopes = points.residuals.values[:, :rows], points.residuals.jacobian[:, :rows]
    downhill = -np.einsum("pik,pi->pk", slopes, residuals)
    outward = ((points.u <= 0) & (downhill < 0)) | ((points.u >= 1) & (downhill > 0))
    moves = free & ~outward
    square = np.einsum("pik,pil->pkl", slopes, slopes)
    size = np.einsum("pkk->pk", square)
    floor = 1e-12 * size.max(axis=1, keepdims=True) + np.finfo(float).tiny
    own = damping[:, None] * size + np.where(moves, floor, 1.0)
    both = moves[:, :, None] & moves[:, None, :]
    system = np.where(both, square, 0.0) + own[:, :, None] * np.eye(size.shape[1])
    step = np.linalg.solve(system, np.where(moves, downhill, 0.0)[..., None])[..., 0]
    return np.clip(points.u + np.clip(step, -LONGEST_STEP, LONGEST_STEP), 0.0, 1.0)
