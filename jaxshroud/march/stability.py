"""The fastest motion of a scene, and the steps per period it asks for."""

import math
from functools import cache
from types import ModuleType
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshroud.march.tableau import LEAST_STEPS, RK4, Tableau
from jaxshroud.march.taylor import Taylor
from jaxshroud.model.absent import Scalar, filled
from jaxshroud.model.geometry import Corners, corners, pose, touch
from jaxshroud.model.ready import springs
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import StepTooLongError
from jaxshroud.scene.limits import MOST_AUTO
from jaxshroud.scene.scene import Scene

Steps = int | Literal["auto"]
ACCURACY_LIMIT = 0.5  # omega h at which RK4 errs by about 1e-4 of the state in a few periods
# omega_max h of "auto": where contact is no stiffer than the blades, and where it is stiffest. Every impact multiplies
# errors, the more of them the stiffer the contact, so that h shrinks faster than 1 / omega_max in between.
AUTO = {"rk4": (0.2, 0.02), "tsit5": (0.4, 0.08), "dop853": (0.8, 0.4), "dopri8": (0.8, 0.4)}
LEAST_AUTO = 64  # steps per period
GROWTH = 1.01  # of an undamped oscillation per step, beyond which a method is called unstable


def amplification(method: Tableau, omega_h: np.ndarray) -> np.ndarray:
    """By what an undamped oscillation, exp(i omega h) in truth, is multiplied in one step.

    An imaginary `omega_h` stands for a decay, exp(-abs(omega h)) in truth.
    """
    stages, i_y = [], 1j * np.asarray(omega_h)
    for row in method.a:
        stages.append(1 + i_y * sum((w * k for w, k in zip(row, stages, strict=True)), 0j))
    return 1 + i_y * sum(w * k for w, k in zip(method.b, stages, strict=True))


@cache
def limits(method: Tableau) -> tuple[float, float]:
    """Omega h beyond which the method is unstable, and beyond which it errs more per radian than RK4 at 0.5.

    Both for oscillations; a decay of that rate is stable as well.
    """
    y = np.linspace(0.01, 12, 1200)
    grows = np.maximum(np.abs(amplification(method, y)), np.abs(amplification(method, 1j * y))) > GROWTH
    error = lambda m, y: np.abs(amplification(m, y) * np.exp(-1j * y) - 1) / y  # noqa: E731
    errs = error(method, y) > error(RK4, np.array([ACCURACY_LIMIT])) * (1 + 1e-9)
    stable = float(y[np.argmax(grows)])
    return stable, min(float(y[np.argmax(errs)]), stable)


def largest_frequency(scene: Scene) -> Scalar:
    """Largest natural circular frequency, or rate of decay, with contact and friction springs engaged [rad/s].

    Both corner pairs are tried at the blades' unloaded positions, in full stick.
    """
    return _frequencies(_stiffness(scene), jnp)[0]


class _Stiffness(NamedTuple):
    """What the natural frequencies of a scene follow from."""

    squares: Float[Array, "... 3 6 6"]  # per mass: with the lower corners engaged, with the upper ones, with neither
    fading: Float[Array, "..."]  # fastest decay of a blade that is overdamped [1/s]
    haste: Float[Array, "..."]  # of smooth contact [1/s]


def _stiffness(scene: Scene) -> _Stiffness:
    b, spring = scene.blades, springs(scene)
    block = corners(scene.shroud, scene.contact.reading)
    mass = jnp.concatenate([b.m, b.inertia_y, b.I])
    moves = jnp.array([scene.parts.has(name, i) for name in ("x", "y", "theta") for i in (0, 1)])
    mobility = jnp.where(moves, 1 / mass, 0.0)
    blades = jnp.diag(jnp.concatenate([b.k_x, b.k_y, b.k_T]))
    k, k_d, mu, haste = filled((spring.k, spring.k_d, spring.mu, spring.haste), mass[0])
    k_d = scene.friction.k_d if scene.parts.contact == "own" else jnp.where(mu > 0, k_d, 0.0)

    def touching(case: Int[Array, ""]) -> Float[Array, "6 6"]:
        v_q, u_q = contact_gradients(case, block, mass)
        return blades + k * jnp.outer(v_q, v_q) + k_d * jnp.outer(u_q, u_q)

    stiffness = jnp.concatenate([jax.vmap(touching)(jnp.array([3, 1], jnp.int32)), blades[None]])
    damping = jnp.concatenate([b.c_x, b.c_y, b.c_T]) * mobility / 2
    excess = damping**2 - jnp.diag(blades) * mobility
    fading = jnp.max(jnp.where(excess > 0, damping + jnp.sqrt(jnp.maximum(excess, 0.0)), 0.0))
    return _Stiffness(stiffness * jnp.sqrt(jnp.outer(mobility, mobility)), fading, haste)


def _frequencies(of: _Stiffness, xp: ModuleType) -> tuple[Any, Any]:
    """Largest frequency with contact and friction springs engaged, and with neither [rad/s], by NumPy or JAX."""
    squares, floor = xp.linalg.eigvalsh(of.squares)[..., -1], xp.asarray(of.fading)
    own = xp.maximum(xp.sqrt(squares[..., 2]), floor)
    engaged = xp.maximum(xp.sqrt(xp.maximum(squares[..., 0], squares[..., 1])), floor)
    return xp.maximum(engaged, xp.asarray(of.haste)), own


def contact_gradients(
    case: int | Int[Array, ""], block: Corners, like: Array
) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """dv/dq and du/dq of the corner pair of `case`, q = (x_1, x_2, y_1, y_2, theta_1, theta_2) = 0."""

    def v_and_u(q):
        at = touch(pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5])), jnp.asarray(case), block, frozenset())
        return jnp.stack([at.v, at.u])

    v_q, u_q = jax.jacfwd(v_and_u)(jnp.zeros_like(like))
    return v_q, u_q


def step_report(omega_max: float, period: float, steps_per_period: int, method: Tableau | Taylor = RK4) -> str | None:
    """What is wrong with the step: None if nothing, else one line with numbers and cure.

    Power series choose their own steps: what is called a step there is a unit of time.

    Raises:
        StepTooLongError: The march would be unstable.
    """
    if isinstance(method, Taylor):
        return None
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


def steps_for(scenes: Scene, batch_dims: int, steps: Steps, method: Tableau | Taylor | None) -> int:
    """Steps per period to march with.

    Args:
        scenes: One scene, or many with so many leading dimensions.
        batch_dims: How many those are.
        steps: Steps asked for, or "auto": by the stiffness of the lane that needs the most.
        method: The method; None where nothing is stepped.

    Raises:
        StepTooLongError: The march would be unstable, or "auto" would take more than 10^7 steps.
        ValueError: `steps` is too small a number, or none.
    """
    if method is None:
        steps = LEAST_AUTO if steps == "auto" else steps
        count_argument("steps_per_period", steps, 1)
        return steps
    if steps == "auto":
        omega_max, own, period = _fastest(scenes, batch_dims)
        return _auto(omega_max, own, period, method)
    count_argument("steps_per_period", steps, 1)
    step_report(*stiffest(scenes, batch_dims), steps, method)
    count_argument("steps_per_period", steps, LEAST_STEPS)
    return steps


def _auto(omega_max: np.ndarray, own: np.ndarray, period: np.ndarray, method: Tableau | Taylor) -> int:
    most, least = AUTO["rk4" if isinstance(method, Taylor) else method.name]
    product = np.clip(1.25 * most * own / omega_max, least, most)
    need = float(np.max(omega_max * period / product))
    if not need < MOST_AUTO:
        raise StepTooLongError(
            f'steps_per_period = "auto" would be {need:.3g}: the drive is too slow, or a spring or damper too stiff, '
            f"to follow a period with at most {MOST_AUTO:.0e} steps"
        )
    return max(math.ceil(need), LEAST_AUTO)


def stiffest(scenes: Scene, batch_dims: int) -> tuple[float, float]:
    """Largest frequency [rad/s] and drive period [s] of the lane that asks for the most steps per period."""
    omega_max, _, period = _fastest(scenes, batch_dims)
    worst = np.argmax(omega_max * period)
    return float(omega_max[worst]), float(period[worst])


def stiffness_ratio(scenes: Scene, batch_dims: int) -> float:
    """How much faster contact makes the fastest motion, at most, of one scene or many."""
    omega_max, own, _ = _fastest(scenes, batch_dims)
    return float(np.max(omega_max / own))


def _fastest(scenes: Scene, batch_dims: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest frequency with contact and without, and drive period, of each lane of a flat batch.

    Eigenvalues are NumPy's: JAX's would import scipy.linalg, which takes longer than all else here.
    """
    flat = lambda a: np.asarray(a).reshape(-1, *np.shape(a)[batch_dims:])  # noqa: E731
    stiffness, period = _measured(jax.tree.map(flat, scenes))
    return *_frequencies(jax.tree.map(np.asarray, stiffness), np), np.asarray(period)


@jax.jit
@jax.vmap
def _measured(scene: Scene) -> tuple[_Stiffness, Scalar]:
    return _stiffness(scene), scene.drive.period
