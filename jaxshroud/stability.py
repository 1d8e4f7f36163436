"""The fastest motion of a scene, and the steps per period it asks for."""

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshroud.friction import springs
from jaxshroud.geometry import Corners, corners, pose, touch
from jaxshroud.scene import Scalar, Scene
from jaxshroud.tableau import RK4, Tableau

ACCURACY_LIMIT = 0.5  # omega h at which RK4 errs by about 1e-4 of the state in a few periods
GROWTH = 1.01  # of an undamped oscillation per step, beyond which a method is called unstable


def amplification(method: Tableau, omega_h: np.ndarray) -> np.ndarray:
    """By what an undamped oscillation, exp(i omega h) in truth, is multiplied in one step."""
    stages, i_y = [], 1j * np.asarray(omega_h)
    for row in method.a:
        stages.append(1 + i_y * sum((w * k for w, k in zip(row, stages, strict=True)), 0j))
    return 1 + i_y * sum(w * k for w, k in zip(method.b, stages, strict=True))


@cache
def limits(method: Tableau) -> tuple[float, float]:
    """Omega h beyond which the method is unstable, and beyond which it errs more per radian than RK4 at 0.5."""
    y = np.linspace(0.01, 12, 1200)
    grows = np.abs(amplification(method, y)) > GROWTH
    error = lambda m, y: np.abs(amplification(m, y) * np.exp(-1j * y) - 1) / y  # noqa: E731
    errs = error(method, y) > error(RK4, np.array([ACCURACY_LIMIT])) * (1 + 1e-9)
    stable = float(y[np.argmax(grows)])
    return stable, min(float(y[np.argmax(errs)]), stable)


def largest_frequency(scene: Scene) -> Scalar:
    """Largest natural circular frequency with contact and friction springs engaged [rad/s].

    Both corner pairs are tried at the blades' unloaded positions, in full stick.
    """
    b, spring = scene.blades, springs(scene)
    block = corners(scene.shroud)
    mass = jnp.concatenate([b.m, b.inertia_y, b.I])
    blades = jnp.diag(jnp.concatenate([b.k_x, b.k_y, b.k_T]))
    k_d = jnp.where(spring.mu > 0, spring.k_d, 0.0)
    squares = []
    for case in (1, 3):
        v_q, u_q = contact_gradients(case, block, mass)
        K = blades + spring.k * jnp.outer(v_q, v_q) + k_d * jnp.outer(u_q, u_q)
        squares.append(jnp.linalg.eigvalsh(K / jnp.sqrt(jnp.outer(mass, mass)))[-1])
    return jnp.sqrt(jnp.maximum(*squares))


def contact_gradients(case: int, block: Corners, like: Array) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """dv/dq and du/dq of the corner pair of `case`, q = (x_1, x_2, y_1, y_2, theta_1, theta_2) = 0."""

    def v_and_u(q):
        at = touch(pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5])), jnp.int32(case), block, frozenset())
        return jnp.stack([at.v, at.u])

    v_q, u_q = jax.jacfwd(v_and_u)(jnp.zeros_like(like))
    return v_q, u_q


class StepTooLongError(ValueError):
    """The march would be unstable, or the message of a warning that it will be inaccurate."""


def step_report(omega_max: float, period: float, steps_per_period: int, method: Tableau = RK4) -> str | None:
    """What is wrong with the step: None if nothing, else one line with numbers and cure.

    Raises:
        StepTooLongError: The march would be unstable.
    """
    unstable, inaccurate = limits(method)
    product = omega_max * period / steps_per_period
    need = lambda limit: math.ceil(omega_max * period / limit)  # noqa: E731
    numbers = f"omega_max h = {product:.3g} (omega_max = {omega_max:.4g} rad/s with contact and friction springs)"
    if product > unstable:
        raise StepTooLongError(
            f"steps_per_period = {steps_per_period} is unstable: {numbers} exceeds {unstable:.3g}; "
            f"use at least {need(inaccurate)}"
        )
    if product > inaccurate:
        return (
            f"steps_per_period = {steps_per_period} is inaccurate: {numbers} exceeds {inaccurate:.3g}; "
            f"{need(inaccurate)} steps would meet it"
        )
    return None


def stiffest(scenes: Scene, batch_dims: int) -> tuple[float, float]:
    """Largest frequency [rad/s] and drive period [s] of the lane that asks for the most steps per period."""
    measure = lambda scene: (largest_frequency(scene), scene.drive.period)  # noqa: E731
    for _ in range(batch_dims):
        measure = jax.vmap(measure)
    omega_max, period = (jnp.ravel(a) for a in jax.jit(measure)(scenes))
    worst = jnp.argmax(omega_max * period)
    return float(omega_max[worst]), float(period[worst])
