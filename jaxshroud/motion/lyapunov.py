"""Lyapunov exponents: how fast neighbouring motions part, from tangents through every event."""

from collections.abc import Iterator
from itertools import count
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.batch.states import STATE, final_states
from jaxshroud.batch.tangents import Tangents, differentiable, tangents
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State, start
from jaxshroud.motion.interval import interval
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene

ALIGNING = 64  # periods after the transient in which tangents turn into their directions, at most
ALIKE = 1e-4  # difference of the logarithms of two frames' growth in a period that makes them one


class Lyapunov(NamedTuple):
    """Exponents per drive period, largest first; the slider's own is among them."""

    exponents: np.ndarray  # (13,); -inf where a direction is forgotten altogether
    ci: np.ndarray  # (13,) half width of the 95 % interval
    growth: np.ndarray  # (n, 13) of each period
    status: int
    last: State

    def __repr__(self) -> str:
        first = ", ".join(f"{v:.4g} +- {ci:.2g}" for v, ci in zip(self.exponents[:3], self.ci, strict=False))
        return (
            f"Lyapunov exponents per drive period: {first}, ...; {len(self.growth)} periods; {Status(self.status).name}"
        )


def lyapunov(
    scene: Scene,
    *,
    n_periods: int,
    transient: int = 64,
    steps_per_period: Steps = 400,
    method: Method | Choices = FAST,
) -> Lyapunov:
    """Exponents of the motion that a scene settles on.

    Args:
        scene: The scene, started from its initial motion.
        n_periods: Drive periods averaged over.
        transient: Drive periods run and discarded first.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        method: Static choices of the march.

    Returns:
        The exponents, by QR factors of the product of the periods' Jacobians. After the transient the tangents start in
        random directions; the average begins when two frames of them grow alike, or 64 periods later (where directions
        grow equally fast, no order emerges). They do not start earlier: along a motion that still changes, they may
        take an order that is not the settled motion's, and keep it for long. The interval is by batch means.

    Raises:
        ValueError: A count is too small.
    """
    method = choices(method)
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    steps_per_period = steps_for(scene, 0, steps_per_period, method.tableau)
    scene = in_precision(scene, method.precision)
    state = settled(scene, transient, steps_per_period, method)
    growth, aligned, status = [], False, Status.OK
    for done, (at, grown) in enumerate(_grown(scene, state, steps_per_period, method), 1):
        state, status = at.end, Status(at.status)
        if status != Status.OK:
            break
        if aligned:
            growth.append(grown[0])
        aligned = aligned or done >= ALIGNING or _alike(grown)
        if len(growth) == n_periods:
            break
    rates = np.array(growth).reshape(-1, STATE)
    if not len(rates):
        nothing = np.full(STATE, np.nan)
        return Lyapunov(nothing, nothing, rates, status, state)
    with np.errstate(invalid="ignore"):
        mean, ci = rates.mean(axis=0), interval(rates.T)
    order = np.argsort(-mean)
    return Lyapunov(mean[order], ci[order], rates[:, order], status, state)


def _grown(scene: Scene, state: State, steps: int, method: Choices) -> Iterator[tuple[Tangents, np.ndarray]]:
    """Period by period: its tangents, and logarithms (2, 13) of how much the directions of two frames grew in it."""
    unit = _units(scene)
    random = np.random.default_rng(0)
    frames = [np.linalg.qr(random.standard_normal((STATE, STATE)))[0] for _ in range(2)]
    for _ in count():
        at = tangents(scene, state, [], n=1, steps=steps, method=differentiable(method))
        state = at.end
        frames, factors = zip(*(np.linalg.qr(at.by_state * unit / unit[:, None] @ f) for f in frames), strict=True)
        with np.errstate(divide="ignore"):
            yield at, np.log(np.abs([np.diag(R) for R in factors]))


def _units(scene: Scene) -> np.ndarray:
    """Displacements, rates and a place of the slider (13,) of equal energy: lengths of tangents then hardly swing."""
    b = scene.blades
    soft = [1 / jnp.sqrt(a) for a in (b.k_x, b.k_y, b.k_T, b.m, b.inertia_y, b.I)]
    return np.append(np.concatenate([np.asarray(a, float) for a in soft]), float(soft[0][0]))


def _alike(grown: np.ndarray) -> bool:
    """Whether two frames span the same directions; two neighbours that turn about each other count as one."""
    with np.errstate(invalid="ignore"):
        volumes = np.cumsum(np.where(np.isfinite(grown), grown, 0.0), axis=1)
    apart = np.abs(volumes[0] - volumes[1]) > ALIKE
    return not np.any(apart[1:] & apart[:-1])


def settled(scene: Scene, transient: int, steps: int, method: Choices) -> State:
    """The state after `transient` periods from the scene's start."""
    if transient == 0:
        return start(scene.initial)
    lane = alone(scene)
    runs = run_lanes(lane, starts(lane), Plan(transient - 1, 1, steps, 0.0, method), lambda _: None)
    return jax.tree.map(lambda a: a[0], final_states(runs.last.state))
