"""Derivatives of the vibration-power reduction, of the kind that the motion allows.

On a periodic orbit P_d has a derivative, and it is exact. In chaos P_d against a parameter has windows, jumps and no
derivative at a point; what exists is the derivative of an average over a stated width.
"""

from collections.abc import Sequence
from functools import partial
from typing import Literal, NamedTuple

import jax
import numpy as np
from scipy.special import stdtrit

from jaxshroud.batch.runs import Plan, run_lanes, starts
from jaxshroud.batch.tangents import Course, direction
from jaxshroud.batch.xla import repeated
from jaxshroud.model.linear import area, free_power, power_reduction
from jaxshroud.model.modes import Status
from jaxshroud.motion.averages import averages
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.shooting import followed, moved_start
from jaxshroud.motion.together import Algorithm, Derivatives, stacked
from jaxshroud.scene.errors import InputError, KeyNameError, NumericalError
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.precision import in_precision
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of, vary

Of = Literal["P_d", "P"]
STRUCTURE = 3.0  # times its own noise that P_d may scatter about a straight line in a smooth neighbourhood,
ROUGH = 0.1  # or this share of all its scatter, whichever is more


class Slope(NamedTuple):
    """Derivatives of one scene's P_d or P with respect to some of its numbers."""

    kind: Literal["none", "periodic", "smoothed"]
    value: np.ndarray  # (keys,)
    ci: np.ndarray  # (keys,) half width of the 95 % interval; 0 where the derivative is exact
    level: float  # what is differentiated: its value on the orbit, or its average over the neighbourhood
    level_ci: float
    orbit: Cycle
    conditioning: float  # of the orbit: how far a push of its map moves it; NaN if smoothed
    sigma: float  # relative width of the neighbourhood; 0 on an orbit
    flags: tuple[str, ...]  # those of the orbit, "structured" where the neighbourhood is not smooth, "lanes stopped"


def with_numbers(scene: Scene, keys: Sequence[str]) -> Scene:
    """The scene written such that each of `keys` is one of its own numbers (`gamma` or `k`, `m_y` or `m`).

    Raises:
        KeyNameError: There is no such number, or both `contact.k` and `contact.gamma` are asked for.
    """
    if {"contact.k", "contact.gamma"} <= set(keys):
        raise KeyNameError("contact.k and contact.gamma are one number; name one of them")
    for key in keys:
        value = value_of(scene, key)
        if key.split("[")[0] in ("contact.k", "contact.gamma", "blades.m_y"):
            scene = vary(scene, key, value)
    return scene


class Smoothing(NamedTuple):
    """How an average over a neighbourhood is sampled, where the motion has no derivative at a point."""

    sigma: float  # standard deviation of the parameters, relative to their values
    pairs: int  # antithetic pairs of samples
    plan: Plan  # of each sample
    seed: int


def slope_of(scene: Scene, wrt: Sequence[str], of: Of, found: Cycle, smoothing: Smoothing) -> Algorithm[Slope]:
    """The slope of the kind that the motion allows: exact on the orbit that was found, else smoothed.

    Raises:
        NumericalError: The march stops in this scene, or in nearly all of its neighbourhood.
    """
    if found.sound:
        return (yield from slope_on_orbit(found, wrt, of))
    if {"stopped", "failed"} & set(found.flags):
        raise NumericalError("The march stops in this scene; there is nothing to differentiate.")
    return smoothed(scene, wrt, of, found, *smoothing)


def slope_on_orbit(found: Cycle, wrt: Sequence[str], of: Of = "P_d") -> Algorithm[Slope]:
    """The exact slope on a periodic orbit, by the implicit function theorem."""
    scene, at = with_numbers(found.scene, wrt), found.jacobian
    assert at is not None  # there is an orbit
    along = [direction(scene, key) for key in wrt]
    by = yield Derivatives(Course(scene, found.start, along, False), found.q, found.steps_per_period, found.method)
    moved = moved_start(at.by_state, by.by_parameter, found.slider_is_free)
    power_by = by.power_by_parameter + at.power_by_state @ moved
    same = repeated((scene, at.power), len(wrt))
    slope = slopes(*same, stacked(along), power_by.T, of)
    level = found.P_d if of == "P_d" else float(found.P[0])
    nothing = np.zeros(len(wrt))
    return Slope("periodic", np.asarray(slope, float), nothing, level, 0.0, found, found.conditioning, 0.0, found.flags)


def differences_on(found: Cycle, wrt: Sequence[str], step: float, of: Of = "P_d") -> dict[str, float]:
    """Fourth-order central differences of `of` on orbits followed from scene to scene; see `differences`."""
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
    return P if of == "P" else power_reduction(P, free_power(scene)[0])


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
    scene: Scene, wrt: Sequence[str], of: Of, found: Cycle, sigma: float, pairs: int, plan: Plan, seed: int
) -> Slope:
    """The gradient of the average of `of` over normally distributed parameters, by antithetic pairs.

    The slope is fitted to the differences of the pairs by least squares. In expectation that is the gradient of the
    average; where `of` is linear across the neighbourhood it is exact for any samples.
    """
    centre = np.array([value_of(scene, key) for key in wrt])
    for key, value in zip(wrt, centre, strict=True):
        if value == 0:
            raise InputError(f"{key} is 0: a relative width says nothing about it.")
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
    return Slope(
        kind="smoothed",
        value=slope / (sigma * centre),
        ci=slope_ci / np.abs(sigma * centre),
        level=float(means.mean()),
        level_ci=float(stdtrit(len(means) - 1, 0.975) * means.std(ddof=1) / np.sqrt(len(means))),
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
    return slope, stdtrit(n - size, 0.975) * np.sqrt(np.diag(covariance))
