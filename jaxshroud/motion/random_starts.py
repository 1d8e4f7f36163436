"""Starts drawn at random around what a scene would do without contact."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.states import inside
from jaxshroud.march.events import seat
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.ready import model
from jaxshroud.model.state import State, start
from jaxshroud.motion.averages import half_diagonal
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Scene

SPREAD = 2.0  # contact can double what the free motion reaches
MOST_DRAWS = 64  # for each start, before it is taken as it is


def reach(scene: Scene) -> Motion:
    """How far starts go to either side, fields (2,): the steady amplitude without contact plus the gap.

    An angle counts the gap as the turn that moves a block's corner by it; rates are omega times displacements.
    """
    free, gap, omega = steady_amplitudes(scene), abs(float(scene.shroud.gap)), float(scene.drive.omega)
    place = [np.asarray(np.abs(a), float) for a in free]
    lever = float(half_diagonal(scene.shroud))
    moves = [np.array([scene.parts.has(name, blade) for blade in (0, 1)]) for name in ("x", "y", "theta")]
    wide = [(p + g) * m for p, g, m in zip(place, (gap, gap, gap / lever), moves, strict=True)]
    return Motion(*wide, *(omega * w for w in wide))


def random_starts(scene: Scene, n: int, seed: int, spread: float) -> State:
    """States (n,) apart at drive phase 0, uniform within `spread` times the `reach`.

    Those with overlapping blocks are drawn again: they would begin with energy that no motion has put there.
    """
    draw, wide = np.random.default_rng(seed), reach(scene)
    kept = np.empty((0, 6, 2))
    drawn = kept
    for _ in range(MOST_DRAWS):
        drawn = draw.uniform(-spread, spread, (n, 6, 2)) * np.stack(wide)
        apart = np.asarray(_depth(scene, Motion(*np.moveaxis(drawn, 1, 0))) < 0)
        kept = np.concatenate([kept, drawn[apart]])
        if len(kept) >= n:
            break
    kept = np.concatenate([kept, drawn])[:n]  # nearly all overlap: interference
    return jax.vmap(start)(Motion(*(jnp.asarray(a) for a in np.moveaxis(kept, 1, 0))))


def _depth(scene: Scene, motions: Motion):
    """How deep blocks overlap (n,); -1 m where the model has no contact."""
    if scene.parts.contact == "none":
        return -np.ones(len(motions.x))
    return _depths(scene, motions)


@jax.jit
def _depths(scene: Scene, motions: Motion):
    ready = model(scene)

    def depth(motion: Motion):
        state = inside(start(motion), ready)
        return seat(state.motion, state, ready)[2].v

    return jax.vmap(depth)(motions)
