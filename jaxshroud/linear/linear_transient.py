"""What dies out beside a settled linear motion: how fast, and whether contact keeps its state until then, too.

What dies out is a sum of decaying modes, and none is ever larger than at the start. A margin of the settled motion that
is above the sum of their magnitudes in it cannot be used up.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.cache.programs import kept
from jaxshroud.linear.equilibrium import in_pieces
from jaxshroud.linear.held_contact import HeldContact, sprung
from jaxshroud.linear.linear_motion import NUMBERS_OF_MOTIONS, LinearMotion
from jaxshroud.linear.linear_swing import HeldRest, SwingWaves, steady_swings
from jaxshroud.model.linear_system import LinearSystem, rate_matrix
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray

ROUNDING = 1e-6  # of the start, to which its modes must sum up


class _Transient(NamedTuple):
    """What dies out in lanes: where it begins, and the derivatives of the numbers that must keep their signs."""

    matrices: LinearSystem
    place: Any  # (lanes, coordinates)
    rate: Any
    N: Any  # (lanes, interfaces, points, coordinates) of normal forces
    slip: Any  # (lanes, interfaces, 2 points, coordinates) of mu N - F and of mu N + F
    gap: Any  # (lanes, interfaces, corners, coordinates) of gaps


def outlasts_transient(scenes: Scene, held: HeldContact, motion: LinearMotion) -> np.ndarray:
    """Whether each lane (leading axis) keeps its state from the start at rest in the static equilibrium on.

    The blades of the scenes do not turn. It is said of no lane whose motion does not die out.
    """
    transients: _Transient = in_pieces(_transients, (without_given(sprung(scenes)), held), NUMBERS_OF_MOTIONS)
    lanes = [jax.tree.map(lambda a, i=i: a[i], transients) for i in range(len(transients.place))]
    bounds = [_bounds(lane) for lane in lanes]
    margins = motion.margins
    used = zip(*bounds, strict=True)
    pairs = zip((margins.N, margins.slip, margins.gap), used, strict=True)
    return np.all([np.all(np.asarray(least) > np.array(most), axis=-1) for least, most in pairs], axis=0)


def _bounds(lane: _Transient) -> list[FloatArray]:
    """How much of the margins of N, of slip and of the gap, (interfaces,) each, what dies out can take at most."""
    eigenvalues, modes = np.linalg.eig(rate_matrix(*lane.matrices))
    size = len(lane.place)
    start = np.concatenate([lane.place, lane.rate])
    shares = np.linalg.lstsq(modes, start.astype(complex), rcond=None)[0]
    numbers = lane.N, lane.slip, lane.gap
    lost = np.abs(modes @ shares - start) > ROUNDING * np.abs(start).max()
    if lost.any() or np.real(eigenvalues).max() >= 0:
        return [np.full(len(a), np.inf) for a in numbers]
    return [np.abs(a @ (modes[:size] * shares)).sum(axis=-1).max(axis=-1) for a in numbers]


def linear_multipliers(scenes: Scene, held: HeldContact) -> np.ndarray:
    """The Floquet multipliers of each linear motion (leading axis), largest first: those of places and rates."""
    transients: _Transient = in_pieces(_transients, (without_given(sprung(scenes)), held), NUMBERS_OF_MOTIONS)
    period = 2 * np.pi / np.asarray(scenes.drive.omega, float)
    every = []
    for i, T in enumerate(period):
        own = jax.tree.map(lambda a, i=i: a[i], transients.matrices)
        multipliers = np.exp(T * np.linalg.eigvals(rate_matrix(*own)))
        multipliers = multipliers[np.argsort(-np.abs(multipliers), kind="stable")]
        every.append(np.pad(multipliers, (0, 2 * len(own.mass) - len(multipliers))))
    return np.array(every)


def _transients(scenes: Scene, held: HeldContact) -> _Transient:
    return _starts(scenes, held, *steady_swings(scenes, held))


@kept()
def _starts(scenes: Scene, held: HeldContact, rest: HeldRest, waves: SwingWaves) -> _Transient:
    return jax.vmap(_transient)(scenes, held, rest, waves)


def _transient(scene: Scene, held: HeldContact, at: HeldRest, waves: SwingWaves) -> _Transient:
    free = held.rigid
    place, rate = jnp.zeros_like(at.matrices.mass), jnp.zeros_like(at.matrices.mass)
    for n, wave in waves.items():
        place, rate = place - wave.imag, rate - scene.drive.frequency(n) * wave.real
    mu = jnp.broadcast_to(jnp.atleast_1d(scene.friction.mu), held.case.shape)[:, None, None]
    N_q, F_q = at.N_q @ free, at.F_q @ free
    slip_q = jnp.concatenate([mu * N_q - F_q, mu * N_q + F_q], axis=1)
    return _Transient(at.matrices, place, rate, N_q, slip_q, at.open_v_q @ free)
