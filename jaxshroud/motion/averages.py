"""Period number and power of lanes over their kept periods."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.periods import CHUNK, Sample
from jaxshroud.batch.threads import in_chunks
from jaxshroud.model.absent import Scalar
from jaxshroud.model.geometry import corners
from jaxshroud.model.linear import area, free_power
from jaxshroud.motion.period import PERIOD_TOLERANCE, Repetition, nearness, repetition
from jaxshroud.motion.power import Reduction, reduction
from jaxshroud.scene.scene import Scene, Shroud


def relative_residual(samples: Sample) -> np.ndarray:
    """Largest energy residual of any period over the mean work of the drive in one, (lanes,)."""
    work = np.abs(samples.work).mean(axis=-1)
    return np.abs(samples.residual).max(axis=-1) / np.where(work > 0, work, 1.0)


def relative_drop(samples: Sample) -> np.ndarray:
    """Largest energy that flat contact dropped in any period over the drive's gross work in it, (lanes,)."""
    gross = np.asarray(samples.gross)
    return (samples.dropped / np.where(gross > 0, gross, 1.0)).max(axis=-1)


def closed_forms(scenes: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Area, power without contact and half the diagonal of each lane's blocks, (lanes,), (lanes, 2), (lanes,).

    As many lanes at a time as are marched: in batches of any size they have the same bits.
    """
    count = len(scenes.drive.omega)
    some = lambda _, at: _closed_forms(jax.tree.map(lambda a: np.asarray(a)[at], scenes))  # noqa: E731
    return in_chunks(some, count, 1 if count == 1 else CHUNK)


@jax.jit
def _closed_forms(scenes: Scene):
    return jax.vmap(lambda scene: (area(scene.shroud), free_power(scene), half_diagonal(scene.shroud)))(scenes)


def half_diagonal(shroud: Shroud) -> Scalar:
    """Half the longer diagonal of a block [m]: how far its corners go when it turns by a radian."""
    block = corners(shroud)
    return jnp.hypot(block.a_x, block.h_y)


def displacements(samples: Sample) -> np.ndarray:
    """x, y and theta of both blades at the ends of periods, (lanes, n, 6)."""
    z = samples.motion
    return np.stack([np.asarray(a, float) for pair in (z.x, z.y, z.theta) for a in pair], axis=-1)


def sizes_of(samples: Sample) -> np.ndarray:
    """The largest magnitude of each of the `displacements` within each period, (lanes, n, 6)."""
    if samples.largest is None:
        return np.abs(displacements(samples))
    return np.stack([np.asarray(a, float) for pair in samples.largest for a in pair], axis=-1)


def nearness_of(scenes: Scene, samples: Sample, tolerance: float, precision: str) -> np.ndarray:
    """Differences (lanes, 6) of displacements that count as none at that tolerance of their sizes."""
    lever = np.asarray(jax.vmap(half_diagonal)(scenes.shroud), float)
    return nearness(sizes_of(samples).max(axis=1), lever, tolerance, precision)


def averages(
    scenes: Scene, samples: Sample, period_tol: float = PERIOD_TOLERANCE
) -> tuple[Repetition, Reduction, np.ndarray]:
    """Period number and power of lanes (one leading axis of lanes) over their kept periods, and P_0 (lanes, 2)."""
    A, P_0, lever = (np.asarray(f, float) for f in closed_forms(scenes))
    orbit = repetition(
        displacements(samples), sizes_of(samples).max(axis=-2), lever, period_tol, scenes.drive.omega.dtype
    )
    return orbit, reduction(A[:, None, None] * np.stack(samples.power, axis=-1), P_0, orbit.number), P_0
