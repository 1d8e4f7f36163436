"""Lyapunov exponents: how fast neighbouring motions part, from tangents through every event."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import Plan
from jaxshroud.batch.states import STATE, final_states
from jaxshroud.batch.tangents import Course
from jaxshroud.march.method import Choices
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.interval import interval
from jaxshroud.motion.together import Algorithm, Derivatives, Periods
from jaxshroud.scene.scene import Scene

ALIGNING = 64  # periods after the transient in which tangents turn into their directions, at most
ALIKE = 1e-4  # difference of the logarithms of two frames' growth in a period that makes them one


class Exponents(NamedTuple):
    """Exponents of one scene per drive period, largest first; the slider's own is among them."""

    exponents: np.ndarray  # (13,); -inf where a direction is forgotten altogether
    ci: np.ndarray  # (13,) half width of the 95 % interval
    growth: np.ndarray  # (n, 13) of each period
    status: int
    last: State


def exponents(
    scene: Scene, state: State, n_periods: int, transient: int, steps: int, method: Choices
) -> Algorithm[Exponents]:
    """Exponents of the motion from a state, by QR factors of the product of the periods' Jacobians.

    After the transient the tangents start in random directions; the average begins when two frames of them grow alike,
    or 64 periods later (where directions grow equally fast, no order emerges). They do not start earlier: along a
    motion that still changes, they may take an order that is not the settled motion's, and keep it for long.
    """
    state = yield from settled(scene, state, transient, steps, method)
    unit, frames, growth, status = units(scene), first_frames(STATE), [], Status.OK
    while len(growth) < n_periods:
        at = yield Derivatives(Course(scene, state), 1, steps, method)
        state, status = at.end, Status(at.status)
        if status != Status.OK:
            break
        frames, grown = pushed(frames, at.by_state * unit / unit[:, None])
        growth += grown
    return Exponents(*averaged(np.array(growth).reshape(-1, STATE)), int(status), state)


class Frames(NamedTuple):
    """Two frames of directions on their way through a product of Jacobians."""

    pair: tuple[np.ndarray, ...]  # (size, size) each, orthonormal
    done: int  # Jacobians so far
    aligned: bool  # whether they have taken the motion's directions


def first_frames(size: int) -> Frames:
    """Two random frames of as many directions as the state has numbers."""
    random = np.random.default_rng(0)
    return Frames(tuple(np.linalg.qr(random.standard_normal((size, size)))[0] for _ in range(2)), 0, False)


def pushed(frames: Frames, M: np.ndarray) -> tuple[Frames, list[np.ndarray]]:
    """The frames after the next Jacobian of any map, and the logarithms of their growth: none until they are aligned.

    The first to grow alike turn the average on; the growth of that period is not in it yet.
    """
    pair, factors = zip(*(np.linalg.qr(M @ f) for f in frames.pair), strict=True)
    with np.errstate(divide="ignore"):
        grown = np.log(np.abs([np.diag(R) for R in factors]))
    done = frames.done + 1
    aligned = frames.aligned or done >= ALIGNING or _alike(grown)
    return Frames(pair, done, aligned), [grown[0]] if frames.aligned else []


def averaged(rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exponents, largest first, half widths of their intervals, and the growth in each period (n, size) in that order.

    NaN where there is no period.
    """
    if not len(rates):
        nothing = np.full(rates.shape[1], np.nan)
        return nothing, nothing, rates
    with np.errstate(invalid="ignore"):
        mean, ci = rates.mean(axis=0), interval(rates.T)
    order = np.argsort(-mean)
    return mean[order], ci[order], rates[:, order]


def units(scene: Scene) -> np.ndarray:
    """Displacements, rates and a place of the slider (..., 13) of equal energy: tangents' lengths then hardly swing."""
    b = scene.blades
    soft = [1 / jnp.sqrt(a) for a in (b.k_x, b.k_y, b.k_T, b.m, b.inertia_y, b.I)]
    return np.concatenate([np.asarray(a, float) for a in (*soft, soft[0][..., :1])], axis=-1)


def _alike(grown: np.ndarray) -> bool:
    """Whether two frames span the same directions; two neighbours that turn about each other count as one."""
    with np.errstate(invalid="ignore"):
        volumes = np.cumsum(np.where(np.isfinite(grown), grown, 0.0), axis=1)
    apart = np.abs(volumes[0] - volumes[1]) > ALIKE
    return not np.any(apart[1:] & apart[:-1])


def settled(scene: Scene, state: State, transient: int, steps: int, method: Choices) -> Algorithm[State]:
    """The state `transient` periods later."""
    if transient == 0:
        return state
    runs = yield Periods(scene, state, Plan(transient - 1, 1, steps, 0.0, method))
    return jax.tree.map(lambda a: a[0], final_states(runs.last.state))
