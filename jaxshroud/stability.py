"""The fastest motion of a scene, and the steps per period it asks for."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshroud.friction import springs
from jaxshroud.geometry import Corners, corners, pose, touch
from jaxshroud.scene import Scalar, Scene

STABILITY_LIMIT = 2.8  # omega h beyond which RK4 amplifies an undamped oscillation (2.83 exactly)
ACCURACY_LIMIT = 0.5  # omega h at which an error of about 1e-4 of the state per few periods is to be expected


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


def step_report(omega_max: float, period: float, steps_per_period: int) -> str | None:
    """What is wrong with the step: None if nothing, else one line with numbers and cure.

    Raises:
        StepTooLongError: The march would be unstable.
    """
    product = omega_max * period / steps_per_period
    need = lambda limit: math.ceil(omega_max * period / limit)  # noqa: E731
    numbers = f"omega_max h = {product:.3g} (omega_max = {omega_max:.4g} rad/s with contact and friction springs)"
    if product > STABILITY_LIMIT:
        raise StepTooLongError(
            f"steps_per_period = {steps_per_period} is unstable: {numbers} exceeds {STABILITY_LIMIT}; "
            f"use at least {need(ACCURACY_LIMIT)}"
        )
    if product > ACCURACY_LIMIT:
        return (
            f"steps_per_period = {steps_per_period} is inaccurate: {numbers} exceeds {ACCURACY_LIMIT}; "
            f"{need(ACCURACY_LIMIT)} steps would meet it"
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
