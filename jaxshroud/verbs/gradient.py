"""Derivatives of the vibration-power reduction, of the kind that the motion allows.

On a periodic orbit P_d has a derivative, and it is exact. In chaos P_d against a parameter has windows, jumps and no
derivative at a point; what exists is the derivative of an average over a stated width.
"""

from collections.abc import Sequence
from functools import partial

import jax
import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.batch.tangents import differentiable, direction, tangents
from jaxshroud.batch.xla import repeated
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import Steps, steps_for
from jaxshroud.model.linear import area, free_power
from jaxshroud.model.modes import Status
from jaxshroud.motion.averages import averages
from jaxshroud.motion.interval import quantile
from jaxshroud.motion.orbit import UNSOUND, Orbit, followed, moved_start, orbit
from jaxshroud.results.gradient import Gradient, Of
from jaxshroud.scene.checks import NumericalError, count_argument, positive_argument, word_argument
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of, vary

STRUCTURE = 3.0  # times its own noise that P_d may scatter about a straight line in a smooth neighbourhood,
ROUGH = 0.1  # or this share of all its scatter, whichever is more


def gradient(
    scene: Scene,
    wrt: Sequence[str],
    *,
    of: Of = "P_d",
    at: Orbit | None = None,
    sigma: float = 0.01,
    pairs: int = 128,
    n_periods: int = 256,
    transient: int = 64,
    most_periods: int = 512,
    steps_per_period: Steps = 400,
    seed: int = 0,
    method: Method | Choices = FAST,
) -> Gradient:
    """Gradient of the left blade's P_d, or of P, with respect to numbers of the scene.

    Where the scene settles on a periodic orbit the gradient is exact, by the implicit function theorem. Elsewhere it is
    the gradient of the average over a normal distribution of the parameters around their values, with an interval.

    Args:
        scene: The scene.
        wrt: Keys as for `vary`; without a blade's index both blades change together.
        of: What to differentiate.
        at: The scene's orbit where it is known already.
        sigma: Standard deviation of that distribution, relative to each parameter's value.
        pairs: Antithetic pairs of samples; all samples start from the scene's initial state.
        n_periods: Drive periods that each sample's P_d is averaged over.
        transient: Drive periods each sample runs before.
        most_periods: Drive periods after which a motion that has not repeated counts as aperiodic.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs.
        seed: Of the samples.
        method: Static choices of the march.

    Returns:
        The derivatives and what they are worth.

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such `of`, a count is too small, `sigma` is not positive, or a smoothed derivative is
            asked for with respect to a number that is 0.
        NumericalError: The march stops in this scene or in nearly all of its neighbourhood.
        LinAlgError: The orbit's equations cannot be solved.

    Source:
        dP/dp = P_p + P_z (I - M)^-1 Phi_p for the fixed point z of the flow Phi over the orbit's periods.
    """
    method = choices(method)
    word_argument("of", of, Of)
    positive_argument("sigma", sigma)
    scene = with_numbers(scene, wrt)
    steps_per_period = steps_for(scene, 0, steps_per_period, method.tableau)
    found = (
        at
        if at is not None
        else orbit(scene, most_periods=most_periods, steps_per_period=steps_per_period, method=method)
    )
    if found.found and not UNSOUND & set(found.flags):
        return on_orbit(found, wrt, of)
    if "stopped" in found.flags:
        raise NumericalError("The march stops in this scene; there is nothing to differentiate.")
    count_argument("pairs", pairs, 2)
    fits(2 * pairs, transient, n_periods)
    plan = Plan(transient, n_periods, steps_per_period, 0.0, method)
    return smoothed(scene, wrt, of, found, sigma, pairs, plan, seed)


def with_numbers(scene: Scene, keys: Sequence[str]) -> Scene:
    """The scene written such that each of `keys` is one of its own numbers (`gamma` or `k`, `m_y` or `m`).

    Raises:
        KeyError: There is no such number, or both `contact.k` and `contact.gamma` are asked for.
    """
    if {"contact.k", "contact.gamma"} <= set(keys):
        raise KeyError("contact.k and contact.gamma are one number; name one of them.")
    for key in keys:
        value = value_of(scene, key)
        if key.split("[")[0] in ("contact.k", "contact.gamma", "blades.m_y"):
            scene = vary(scene, key, value)
    return scene


def on_orbit(found: Orbit, wrt: Sequence[str], of: Of = "P_d") -> Gradient:
    """The exact gradient on a periodic orbit; ValueError if there is no such `of`."""
    word_argument("of", of, Of)
    scene, at = with_numbers(found.scene, wrt), found.jacobian
    assert at is not None  # there is an orbit
    along = [direction(scene, key) for key in wrt]
    steps, method = found.steps_per_period, differentiable(found.method)
    by = tangents(scene, found.start, along, n=found.q, steps=steps, method=method, by_state=False)
    moved = moved_start(at.by_state, by.by_parameter, found.slider_is_free)
    power_by = by.power_by_parameter + at.power_by_state @ moved
    same = repeated((scene, at.power), len(wrt))
    slope = slopes(*same, jax.tree.map(lambda *a: np.stack(a), *along), power_by.T, of)
    value = dict(zip(wrt, np.asarray(slope, float).tolist(), strict=True))
    level = found.P_d if of == "P_d" else float(found.P[0])
    return Gradient(
        of, "periodic", value, dict.fromkeys(wrt, 0.0), level, 0.0, found, found.conditioning, 0.0, found.flags
    )


def differences(found: Orbit, wrt: Sequence[str], step: float, of: Of = "P_d") -> dict[str, float]:
    """Fourth-order central differences of `of` on orbits followed from scene to scene: a check of `on_orbit`.

    Args:
        found: The orbit.
        wrt: Keys as for `gradient`.
        step: Relative to each parameter's value, or absolute where that is 0.
        of: What to differentiate.

    Returns:
        The derivative with respect to each key; NaN where an orbit so near does not close.

    Raises:
        ValueError: There is no such `of`, or the step is not positive.
    """
    word_argument("of", of, Of)
    positive_argument("step", step)
    scene, offsets = with_numbers(found.scene, wrt), np.array([[-2], [-1], [1], [2]])
    values = [value_of(scene, key) for key in wrt]
    each = [step * (abs(value) or 1) for value in values]
    parts = [scenes_at(scene, [key], v + h * offsets) for key, v, h in zip(wrt, values, each, strict=True)]
    scenes = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    level = np.asarray(_measures(of, scenes, followed(found, scenes)), float).reshape(len(wrt), 4)
    slope = level @ np.array([1, -8, 8, -1]) / (12 * np.array(each))
    return dict(zip(wrt, slope.tolist(), strict=True))


def _measure(of: Of, scene: Scene, power):
    """`of` from the left blade's mean square displacement."""
    P = area(scene.shroud) * power[0]
    return P if of == "P" else 100 * (1 - P / free_power(scene)[0])


@partial(jax.jit, static_argnames="of")
def _measures(of: Of, scenes: Scene, power):
    return jax.vmap(lambda scene, power: _measure(of, scene, power))(scenes, power)


@partial(jax.jit, static_argnames="of")
def slopes(scenes: Scene, power, along: Scene, power_along, of: Of):
    """Derivatives of `of` along directions of scenes and of the mean square displacement, all with a leading axis."""
    return jax.vmap(lambda *point_and_direction: _slope(of, *point_and_direction))(scenes, power, along, power_along)


def _slope(of: Of, scene: Scene, power, along: Scene, power_along):
    return jax.jvp(lambda scene, power: _measure(of, scene, power), (scene, power), (along, power_along))[1]


def smoothed(
    scene: Scene, wrt: Sequence[str], of: Of, found: Orbit, sigma: float, pairs: int, plan: Plan, seed: int
) -> Gradient:
    """The gradient of the average of `of` over normally distributed parameters, by antithetic pairs.

    The slope is fitted to the differences of the pairs by least squares. In expectation that is the gradient of the
    average; where `of` is linear across the neighbourhood it is exact for any samples.
    """
    centre = np.array([value_of(scene, key) for key in wrt])
    for key, value in zip(wrt, centre, strict=True):
        if value == 0:
            raise ValueError(f"{key} is 0: a relative width says nothing about it.")
    xi = np.random.default_rng(seed).standard_normal((pairs, len(wrt)))
    signed = np.concatenate([xi, -xi])
    level, noise, number, ok = _levels(scene, wrt, centre * (1 + sigma * signed), of, plan)
    good = ok[:pairs] & ok[pairs:]
    if good.sum() < len(wrt) + 2:
        told = f"Only {good.sum()} of {pairs} pairs ran to their end; too few for {len(wrt)} derivatives."
        raise NumericalError(told)
    difference = (level[:pairs] - level[pairs:])[good] / 2
    slope, slope_ci = _fitted(xi[good], difference)
    rest, own = np.std(difference - xi[good] @ slope), np.sqrt(np.nanmean(np.append(noise, 0.0) ** 2)) / 1.96
    structured = len(np.unique(number)) > 1 or rest > max(STRUCTURE * own, ROUGH * np.std(difference))
    flags = (*found.flags, *(["structured"] if structured else []), *([] if good.all() else ["lanes stopped"]))
    means = ((level[:pairs] + level[pairs:]) / 2)[good]
    return Gradient(
        of=of,
        kind="smoothed",
        value=dict(zip(wrt, (slope / (sigma * centre)).tolist(), strict=True)),
        ci=dict(zip(wrt, (slope_ci / np.abs(sigma * centre)).tolist(), strict=True)),
        level=float(means.mean()),
        level_ci=float(quantile(len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means))),
        orbit=found,
        conditioning=float("nan"),
        sigma=sigma,
        flags=flags,
    )


def _levels(scene: Scene, wrt: Sequence[str], values: np.ndarray, of: Of, plan: Plan):
    """At each row of parameter values: `of`, its own half interval, the period number, and whether the lane is OK."""
    scenes = in_precision(scenes_at(scene, wrt, values), plan.method.precision)
    runs = run_lanes(scenes, starts(scenes), plan, lambda _: None)
    motion, got, P_0 = averages(scenes, runs.samples)
    share = P_0[:, 0] / 100
    level, noise = (got.P_d, got.ci) if of == "P_d" else (got.P[:, 0], got.ci * share)
    return level, noise, motion.number, runs.last.status == Status.OK


def _fitted(xi: np.ndarray, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares slope (parameters,) of `difference` in `xi`, and the half width of its 95 % interval.

    The scatter about the line is no constant (curvature, windows), so the covariance is the one that allows for that.
    """
    n, size = xi.shape
    inverse = np.linalg.inv(xi.T @ xi)
    slope = inverse @ xi.T @ difference
    rest = (difference - xi @ slope) / (1 - np.einsum("ij,jk,ik->i", xi, inverse, xi))  # as if each were left out
    covariance = inverse @ (xi.T * rest**2) @ xi @ inverse
    return slope, quantile(n - size) * np.sqrt(np.diag(covariance))
