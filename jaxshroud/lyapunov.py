"""Lyapunov exponents: how fast neighbouring motions part, from tangents through every event."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.analysis.power import interval
from jaxshroud.checks import count_argument, in_precision
from jaxshroud.integrate import FAST, Method
from jaxshroud.lanes import alone
from jaxshroud.scene import Scene
from jaxshroud.stability import Steps, steps_for
from jaxshroud.state import State, Status
from jaxshroud.sweep import Plan, final_states, run_lanes, starts
from jaxshroud.tangents import STATE, differentiable, tangents


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
    method: Method = FAST,
) -> Lyapunov:
    """Exponents of the motion that a scene settles on.

    Args:
        scene: The scene, started from its initial motion.
        n_periods: Drive periods averaged over.
        transient: Drive periods run and discarded first.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        method: Static choices of the march.

    Returns:
        The exponents, by QR factors of the product of the periods' Jacobians. The interval is by batch means.

    Raises:
        ValueError: A count is too small.
    """
    count_argument("n_periods", n_periods, 1)
    count_argument("transient", transient, 0)
    steps_per_period = steps_for(scene, 0, steps_per_period, method.tableau)
    scene = in_precision(scene, method.precision)
    state = settled(scene, transient, steps_per_period, method)
    frame, growth, status = np.eye(STATE), [], Status.OK
    for _ in range(n_periods):
        at = tangents(scene, state, [], n=1, steps=steps_per_period, method=differentiable(method))
        state, status = at.end, Status(at.status)
        if status != Status.OK:
            break
        frame, R = np.linalg.qr(at.by_state @ frame)
        with np.errstate(divide="ignore"):
            growth.append(np.log(np.abs(np.diag(R))))
    rates = np.array(growth).reshape(-1, STATE)
    with np.errstate(invalid="ignore"):
        mean, ci = rates.mean(axis=0), interval(rates.T)
    order = np.argsort(-mean)
    return Lyapunov(mean[order], ci[order], rates[:, order], status, state)


def settled(scene: Scene, transient: int, steps: int, method: Method) -> State:
    """The state after `transient` periods from the scene's start."""
    lane = alone(scene)
    runs = run_lanes(lane, starts(lane), Plan(max(transient - 1, 0), 1, steps, 0.0, method), lambda _: None)
    return jax.tree.map(lambda a: a[0], final_states(runs.last))
