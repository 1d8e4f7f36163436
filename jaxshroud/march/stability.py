"""The fastest motion of a scene, and the steps per period that it requires."""

import math
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.cache.programs import kept
from jaxshroud.march.method import StepCount
from jaxshroud.march.tableau import MIN_STEPS, RK4, Tableau, TaylorOptions
from jaxshroud.model.arithmetic import Scalar, filled
from jaxshroud.model.contact_law import ContactLaw
from jaxshroud.model.coupling import couplings_of_pairs
from jaxshroud.model.geometry import corners
from jaxshroud.model.linear import free_reach, steady_amplitudes
from jaxshroud.model.linear_system import (
    contact_gradients,
    coordinates_that_move,
    free_system,
    over_coordinates,
    shroud_map,
    spring_stiffness,
)
from jaxshroud.model.prepared import prepared_law
from jaxshroud.model.row import pair_at
from jaxshroud.scene.checks import MAX_AUTO_STEPS, InputError, StepTooLongError, count_argument
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed

ACCURACY_LIMIT = 0.5  # omega h at which RK4 errs by about 1e-4 of the state in a few periods
# omega_max h of "auto": where contact is no stiffer than the blades, and where it is stiffest. Every impact multiplies
# errors, and stiffer contact has more impacts; h therefore shrinks faster than 1 / omega_max in between.
AUTO_STEP_ANGLES = {"rk4": (0.2, 0.02), "tsit5": (0.4, 0.08), "dopri8": (0.8, 0.4)}
MIN_AUTO_STEPS = 64  # steps per period
# rate of the internal state of a user law times the step of "auto"; it is reached for moments only
AUTO_RELAXATION_STEPS = 4.0
MAX_RELAXATION_RATE = 8.0  # beyond which the march is refused
UNSTABLE_GROWTH = 1.01  # of an undamped oscillation per step, beyond which a method is called unstable


@cache
def step_limits(method: Tableau | TaylorOptions) -> tuple[float, float]:
    """The omega h beyond which the method is unstable, and that beyond which its error per radian exceeds RK4's at 0.5.

    Both are for oscillations; a decay of that rate is stable as well. Power series choose their own steps: inf.
    """
    y = np.linspace(0.01, 12, 1200)

    def first(beyond):
        return float(y[np.argmax(beyond)]) if np.any(beyond) else math.inf

    grows = np.maximum(np.abs(method.amplification(y)), np.abs(method.amplification(1j * y))) > UNSTABLE_GROWTH

    def error(m, y):
        return np.abs(m.amplification(y) * np.exp(-1j * y) - 1) / y

    errs = error(method, y) > error(RK4, np.array([ACCURACY_LIMIT])) * (1 + 1e-9)
    return first(grows), min(first(errs), first(grows))


@typed
def largest_frequency(scene: Scene) -> Scalar:
    """The largest natural circular frequency, or decay rate, with the contact and friction springs engaged [rad/s].

    It is the larger one of both corner pairs, at the unloaded positions of the blades and in full stick. Of a row it is
    the bound by which its steps are judged: that of the pairs at its interfaces, with twice the stiffness of contact.
    """
    pairs = _bounding_pairs(jax.tree.map(lambda a: jnp.asarray(a)[None], scene))
    return jnp.max(_frequencies(_batched_stiffness(pairs)[0], jnp, jnp.linalg.eigvalsh)[0])


class _Stiffness(NamedTuple):
    """The quantities that determine the natural frequencies of a scene."""

    squares: Float[Array, "... 3 n n"]  # per mass: with the lower corners engaged, with the upper ones, with neither
    fading: Float[Array, "..."]  # fastest decay of an overdamped blade [1/s]
    haste: Float[Array, "..."]  # of the slider of smooth contact [1/s]
    relaxation: Float[Array, "..."]  # of the internal state of a user friction law [1/s]


def _stiffness_of(scene: Scene) -> _Stiffness:
    law = prepared_law(scene)
    block = corners(scene.running_shroud, scene.contact.reading)
    mass, damping, engaged = free_system(scene)
    modes = scene.mode_numbers
    shroud = shroud_map(scene)
    springs = modes.stiffness if modes else [k for _, _, k in scene.running_blades.oscillators.values()]
    own = jnp.concatenate(springs)
    mobility = jnp.where(coordinates_that_move(scene), 1 / mass, 0.0)
    k, k_d, haste = filled((law.normal_stiffness, law.tangential_stiffness, law.slider_haste), mass[0])

    def touching(case: Int[Array, ""]) -> Float[Array, "n n"]:
        of_shrouds = jnp.stack(contact_gradients(case, block, jnp.zeros(6, mass.dtype)))
        return engaged + spring_stiffness(jnp.stack([k, k_d]), over_coordinates(of_shrouds, shroud))

    stiffness = jnp.concatenate([jax.vmap(touching)(jnp.array([3, 1], jnp.int32)), engaged[None]])
    damping = jnp.abs(damping).sum(axis=-1) * mobility / 2
    excess = damping**2 - own * mobility
    fading = jnp.max(jnp.where(excess > 0, damping + jnp.sqrt(jnp.maximum(excess, 0.0)), 0.0))
    return _Stiffness(stiffness * jnp.sqrt(jnp.outer(mobility, mobility))[None], fading, haste, _relaxation(law, scene))


def _relaxation(law: ContactLaw, scene: Scene) -> Scalar:
    """The fastest relaxation rate of the state of a user friction law, at the speed of the free motion."""
    if not law.relaxes:
        return jnp.zeros_like(scene.drive.omega)
    free = steady_amplitudes(scene)
    lever = (scene.shroud.l_oa + scene.shroud.l_ab) / 2
    reach = jnp.sum(free_reach(free, "x") + free_reach(free, "y") + lever * free_reach(free, "theta"))
    return law.relaxation(scene.drive.frequency(max(free)) * (reach + jnp.abs(scene.running_shroud.gap)))


def _frequencies(of: _Stiffness, xp: ModuleType, eigenvalues: Callable[[Any], Any]) -> tuple[Any, Any]:
    """The largest frequency with contact and friction springs, and with neither [rad/s], by NumPy or JAX.

    `eigenvalues` gives those of symmetric matrices, the largest one last.
    """
    squares = eigenvalues(of.squares)[..., -1]
    floor = xp.asarray(of.fading)
    own = xp.maximum(xp.sqrt(squares[..., 2]), floor)
    engaged = xp.maximum(xp.sqrt(xp.maximum(squares[..., 0], squares[..., 1])), floor)
    return xp.maximum(engaged, xp.asarray(of.haste)), own


def largest_eigenvalue(M: Float[Array, "... n n"]) -> Float[Array, "... 1"]:
    """The largest eigenvalue of symmetric, positive semidefinite matrices, by products of matrices alone.

    LAPACK's routines for many matrices wait for threads of the pool in which they run themselves: for ever where
    several devices of a CPU run at once. Squaring so often leaves an error of 2^-40 / e of the eigenvalue, where the
    next one is nearest; else none.
    """

    def total(P):
        return jnp.trace(P, axis1=-2, axis2=-1)[..., None, None]

    def scaled(P):
        return P / jnp.where(total(P) == 0, 1.0, total(P))

    P = lax.fori_loop(0, 40, lambda _, P: scaled(P @ P), scaled(M))
    return total(P @ M)[..., 0]


def step_report(
    omega_max: float, period: float, steps_per_period: int, method: Tableau | TaylorOptions = RK4
) -> str | None:
    """What is wrong with the step: None if nothing, else one line with numbers and cure.

    Raises:
        StepTooLongError: The march would be unstable.
    """
    unstable, inaccurate = step_limits(method)
    product = omega_max * period / steps_per_period

    def need(limit):
        return math.ceil(omega_max * period / limit)

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


class StepVerdict(NamedTuple):
    """What can be said of a step before the run."""

    stable: Bool[Array, ""]
    coarseness: Scalar  # omega_max h over the limit of accuracy of the method; 0 of power series


def judge_step(scene: Scene, steps: Int[Array, ""], method: Tableau | TaylorOptions) -> StepVerdict:
    """The check of `steps_for` inside transformations of JAX: of one scene, without a derivative."""
    unstable, inaccurate = step_limits(method)
    if math.isinf(unstable):
        return StepVerdict(jnp.ones((), bool), jnp.zeros_like(scene.drive.omega))
    scene = lax.stop_gradient(scene)
    alone = jax.tree.map(lambda a: jnp.asarray(a)[None], scene)
    stiffness, period = _batched_stiffness(_bounding_pairs(alone))
    h = period / steps.astype(period.dtype)
    rates = _frequencies(stiffness, jnp, largest_eigenvalue)[0], stiffness.relaxation
    angle, relaxed = (jnp.max(rate * h) for rate in rates)
    return StepVerdict((angle <= unstable) & (relaxed <= MAX_RELAXATION_RATE), angle / inaccurate)


@typed
def steps_for(scenes: Scene, batch_dims: int, steps: StepCount, method: Tableau | TaylorOptions | None) -> int:
    """Steps per period to march with.

    Args:
        scenes: One scene, or many with leading axes.
        batch_dims: The number of leading axes.
        steps: The steps requested, or "auto": by the stiffness of the lane that needs the most.
        method: The method; None where nothing is stepped.

    Raises:
        StepTooLongError: The march would be unstable, or "auto" would take more than 10^7 steps.
        ValueError: `steps` is too small, or is not a number.
    """
    count_argument("batch_dims", batch_dims, 0)
    if batch_dims > np.ndim(scenes.drive.omega):
        raise InputError(f"These scenes have {np.ndim(scenes.drive.omega)} leading axes, not {batch_dims}.")
    if method is None:
        steps = MIN_AUTO_STEPS if steps == "auto" else steps
        count_argument("steps_per_period", steps, 1)
        return steps
    if steps == "auto":
        return _auto_steps(_fastest(scenes, batch_dims), method)
    count_argument("steps_per_period", steps, 1)
    step_report(*stiffest(scenes, batch_dims), steps, method)
    of = _fastest(scenes, batch_dims)
    turns = float(np.max(of.relaxation * of.period))
    if turns > MAX_RELAXATION_RATE * steps:
        raise StepTooLongError(
            f"steps_per_period = {steps} is unstable: the internal state of the friction law follows at up to "
            f"{turns / steps:.3g} per step, more than {MAX_RELAXATION_RATE:g}; "
            f"use at least {math.ceil(turns / AUTO_RELAXATION_STEPS)}"
        )
    count_argument("steps_per_period", steps, MIN_STEPS)
    return steps


def _auto_steps(of: "_Fastest", method: Tableau | TaylorOptions) -> int:
    need = float(np.max(_needed_steps(of, method)))
    if not need < MAX_AUTO_STEPS:
        raise StepTooLongError(
            f'steps_per_period = "auto" would be {need:.3g}: the drive is too slow, or a spring or damper too stiff, '
            f"to follow a period with at most {MAX_AUTO_STEPS:.0e} steps"
        )
    return max(math.ceil(need), MIN_AUTO_STEPS)


def _needed_steps(of: "_Fastest", method: Tableau | TaylorOptions) -> np.ndarray:
    """The steps per period that each lane needs."""
    most, least = AUTO_STEP_ANGLES[method.auto_steps_like]
    product = np.clip(1.25 * most * of.own / of.omega_max, least, most)
    return np.maximum(of.omega_max / product, of.relaxation / AUTO_RELAXATION_STEPS) * of.period


def lanes_that_auto_steps_follow(scenes: Scene) -> np.ndarray:
    """Whether "auto" steps of RK4 follow each lane (leading axis): others have numbers too large, or are too stiff."""
    steps = _needed_steps(_fastest(scenes, 1), RK4)
    return np.all(steps.reshape(len(scenes.drive.omega), -1) < MAX_AUTO_STEPS, axis=1)  # of a row: at every interface


def stiffest(scenes: Scene, batch_dims: int) -> tuple[float, float]:
    """The largest frequency [rad/s] and the drive period [s] of the lane that needs the most steps per period."""
    of = _fastest(scenes, batch_dims)
    worst = np.argmax(of.omega_max * of.period)
    return float(of.omega_max[worst]), float(of.period[worst])


def stiffness_ratio(scenes: Scene, batch_dims: int) -> float:
    """The largest ratio, over all lanes, of the highest frequency with contact to that without."""
    of = _fastest(scenes, batch_dims)
    return float(np.max(of.omega_max / of.own))


class _Fastest(NamedTuple):
    """The highest frequencies of each lane of a flat batch, (lanes,)."""

    omega_max: np.ndarray  # largest frequency with contact [rad/s]; NaN where numbers are too large
    own: np.ndarray  # without [rad/s]
    period: np.ndarray  # of the drive [s]
    relaxation: np.ndarray  # see `_Stiffness` [1/s]


def _fastest(scenes: Scene, batch_dims: int) -> _Fastest:
    """The highest frequencies of scenes with `batch_dims` leading axes.

    NumPy computes the eigenvalues: JAX would import scipy.linalg, which takes longer than everything else here.
    """

    def flat(a):
        return np.asarray(a).reshape(-1, *np.shape(a)[batch_dims:])

    stiffness, period = _batched_stiffness(_bounding_pairs(jax.tree.map(flat, scenes)))
    stiffness = jax.tree.map(np.asarray, stiffness)
    finite = np.isfinite(stiffness.squares).all(axis=(-3, -2, -1))
    squares = np.where(finite[:, None, None, None], stiffness.squares, 0.0)
    omega_max, own = _frequencies(stiffness._replace(squares=squares), np, np.linalg.eigvalsh)
    omega_max = np.where(finite, omega_max, np.nan)
    return _Fastest(omega_max=omega_max, own=own, period=np.asarray(period), relaxation=stiffness.relaxation)


def _bounding_pairs(scenes: Scene) -> Scene:
    """Pairs (leading axis) that are at least as stiff as the scenes."""
    return scenes if scenes.layout == PAIR else _pairs_of_rows(scenes)


@kept()
def _pairs_of_rows(rows: Scene) -> Scene:
    """The pairs at every interface of rows, with twice the stiffness of contact and of what couples them else.

    A blade between two neighbours is held on both sides, and no blade by more.
    """

    def pairs(row: Scene) -> Scene:
        at = jax.vmap(lambda j: pair_at(row, j, by_modes=True))(jnp.arange(row.layout.interfaces))

        def stiffness(s: Any) -> Any:
            return (s.contact.k, s.friction.k_d)

        at = eqx.tree_at(stiffness, at, tuple(2 * k for k in stiffness(at)))
        return eqx.tree_at(lambda s: (s.coupling, s.aero), at, couplings_of_pairs(row)) if row.is_coupled else at

    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), jax.vmap(pairs)(rows))


@kept()
def _batched_stiffness(scenes: Scene) -> tuple[Any, Array]:
    return jax.vmap(lambda scene: (_stiffness_of(scene), scene.drive.period))(scenes)
