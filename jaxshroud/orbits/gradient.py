"""The derivatives of the vibration-power reduction, or of an amplitude, of the kind that the motion permits.

On a periodic orbit P_d has an exact derivative. In chaos it has windows and jumps as a function of a parameter, and no
derivative at a point; what exists is the derivative of an average over a stated width.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import stdtrit

from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.tangents import TangentProblem, direction
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.cache.programs import kept
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import area, free_power, means_from_static, power_reduction, vibration_square
from jaxshroud.model.modes import Status
from jaxshroud.orbits.amplitude_slopes import AmplitudeSlope, amplitude_slope, largest_level
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives, stacked
from jaxshroud.orbits.orbit import PeriodicOrbit, area_and_free_power, vibration_reduction
from jaxshroud.orbits.shooting import moved_start, nearby_orbits
from jaxshroud.scene.checks import InputError, NumericalError
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.quantities import Power, Quantity, amplitude_of, counted_amplitude, is_reduction
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.valid import in_precision
from jaxshroud.scene.vary import level_of, offsets, with_numbers
from jaxshroud.signals.amplitudes import amplitude_values, is_comparable, levels_of

STRUCTURED_FACTOR = (
    3.0  # largest scatter of P_d about a straight line in a smooth neighbourhood, in times its own noise,
)
STRUCTURED_SHARE = 0.1  # or as a share of its total scatter, whichever is larger


class PowerGradient(NamedTuple):
    """The derivatives of a quantity of one scene with respect to some of its numbers."""

    kind: Literal["none", "periodic", "smoothed"]
    value: np.ndarray  # (keys,)
    ci: np.ndarray  # (keys,) half width of the 95 % interval; 0 where the derivative is exact
    level: float  # the value of the quantity on the orbit, or its average over the neighbourhood
    level_ci: float
    orbit: PeriodicOrbit
    conditioning: float  # condition of the orbit: its displacement per perturbation of the map; NaN if smoothed
    sigma: float  # relative width of the neighbourhood; 0 on an orbit
    # Those of the orbit; "structured": not smooth; "lanes stopped"; "no width": a number is 0; "two peaks" and "blades
    # tie": one-sided; "no P_d": there is none, see `is_comparable`.
    flags: tuple[str, ...]
    P_d: float = float("nan")  # where the quantity is a reduction, and so is the next [%]
    P_d_vibration: float = float("nan")


class _Reductions(NamedTuple):
    """P_d and that of the vibration alone [%]; NaN where they are not requested."""

    P_d: Any = float("nan")  # of one scene, or (samples,)
    P_d_vibration: Any = float("nan")


def scenes_around(scene: Scene, keys: Sequence[str], levels: np.ndarray) -> Scene:
    """Scenes (leading axis) at rows of `levels` (n, keys), see `level_of`: different blades keep their difference."""
    parts = [offsets(scene, key) for key in keys]
    columns = [levels[:, i] + offset for i, part in enumerate(parts) for offset in part.values()]
    return scenes_at(scene, [name for part in parts for name in part], np.stack(columns, axis=-1))


class Smoothing(NamedTuple):
    """The sampling of an average over a neighbourhood, where the motion has no derivative at a point."""

    sigma: float  # standard deviation of the parameters, relative to their values
    pairs: int  # antithetic pairs of samples
    plan: Plan  # of each sample
    seed: int


def gradient_of(
    scene: Scene, wrt: Sequence[str], of: Quantity, orbit: PeriodicOrbit, smoothing: Smoothing
) -> Algorithm[PowerGradient]:
    """The gradient of the kind that the motion permits: exact on the orbit that was found, else smoothed.

    Raises:
        NumericalError: The march stops in this scene, or in nearly all of its neighbourhood.
    """
    if is_reduction(of) and not is_comparable(of, scene):
        nan = np.full(len(wrt), np.nan)
        return PowerGradient("none", nan, nan, np.nan, np.nan, orbit, np.nan, np.nan, (*orbit.flags, "no P_d"))
    if orbit.sound:
        return (yield from orbit_gradient(orbit, wrt, of))
    if {"stopped", "failed"} & set(orbit.flags):
        raise NumericalError("The march stops in this scene; there is nothing to differentiate.")
    return smoothed_gradient(scene, wrt, of, orbit, *smoothing)


def orbit_gradient(orbit: PeriodicOrbit, wrt: Sequence[str], of: Quantity = "P_d") -> Algorithm[PowerGradient]:
    """The exact gradient on a periodic orbit, by the implicit function theorem."""
    scene = with_numbers(orbit.scene, wrt)
    amplitude = amplitude_of(of)
    problem = TangentProblem(scene, orbit.start, [direction(scene, key) for key in wrt])
    if amplitude is not None:
        level, slope, flags = yield from amplitude_slope(orbit, amplitude, problem)
        both = _Reductions()
    elif of == "P_d_vibration":
        (level, slope, flags), both = yield from _vibration_slope(orbit, problem)
    else:
        (level, slope, flags), both = yield from _power_slope(orbit, problem._replace(by_state=False), cast(Power, of))
    slope = np.asarray(slope, float)
    zeros = np.zeros(len(wrt))
    flags = (*orbit.flags, *flags)
    return PowerGradient("periodic", slope, zeros, level, 0.0, orbit, orbit.conditioning, 0.0, flags, **both._asdict())


def _power_slope(
    orbit: PeriodicOrbit, problem: TangentProblem, of: Power
) -> Algorithm[tuple[AmplitudeSlope, _Reductions]]:
    """The derivatives of a power along the directions of a problem."""
    tangents, directions = orbit.jacobian, problem.directions
    assert tangents is not None  # there is an orbit
    method = orbit.method._replace(vibration=is_reduction(of))
    by_numbers = yield Derivatives(problem, orbit.q, orbit.steps_per_period, method)
    shift = moved_start(tangents.by_state, by_numbers.by_parameter, orbit.free_sliders)
    power_by = by_numbers.power_by_parameter + tangents.power_by_state @ shift
    repeated = repeat_lane((without_given(problem.scene), tangents.power), len(directions))
    slope = np.asarray(directional_derivatives(*repeated, stacked(directions), power_by.T, of))
    both = _Reductions()
    if is_reduction(of):
        both = _Reductions(
            orbit.P_d, vibration_reduction(problem.scene, by_numbers, *area_and_free_power(problem.scene))
        )
    if of == "P_d_worst":
        found = [(-level, -by) for level, by in zip(power_reduction(orbit.P, orbit.P_0), slope.T, strict=True)]
        worst = largest_level(found, "blades tie")
        return AmplitudeSlope(-worst.level, -worst.slope, worst.flags), both
    counts = orbit.scene.layout.counting
    return AmplitudeSlope(orbit.P_d if of == "P_d" else float(orbit.P[counts].sum()), slope), both


def _vibration_slope(orbit: PeriodicOrbit, problem: TangentProblem) -> Algorithm[tuple[AmplitudeSlope, _Reductions]]:
    """P_d of the vibration alone and its derivatives along the directions of a problem."""
    assert orbit.jacobian is not None  # there is an orbit
    whole = yield Derivatives(problem, orbit.q, orbit.steps_per_period, orbit.method._replace(vibration=True))
    shift = moved_start(orbit.jacobian.by_state, whole.by_parameter, orbit.free_sliders)
    power_by = whole.power_by_parameter + whole.power_by_state @ shift
    means_by = whole.means_by_parameter + whole.means_by_state @ shift
    scene = without_given(problem.scene)
    squares = (whole.power, whole.means)
    scenes, squares, directions = *repeat_lane((scene, squares), len(problem.directions)), stacked(problem.directions)
    by = power_by.T, np.moveaxis(means_by, -1, 0)
    slope = directional_derivatives(scenes, squares, directions, by, "P_d_vibration")
    level = vibration_reduction(problem.scene, whole, *area_and_free_power(problem.scene))
    return AmplitudeSlope(level, np.asarray(slope)), _Reductions(orbit.P_d, level)


LevelsNearby = Callable[[PeriodicOrbit, Scene, Quantity], np.ndarray]  # a quantity of scenes near that of an orbit


def differences_on(
    orbit: PeriodicOrbit, wrt: Sequence[str], step: float, of: Quantity, levels_nearby: LevelsNearby
) -> dict[str, float]:
    """Fourth-order central differences of `of` on the orbits of nearby scenes; see `differences`."""
    scene = with_numbers(orbit.scene, wrt)
    offsets = np.array([[-2], [-1], [1], [2]])
    values = [level_of(scene, key) for key in wrt]
    steps = [step * (abs(value) or 1) for value in values]
    parts = [scenes_around(scene, [key], v + h * offsets) for key, v, h in zip(wrt, values, steps, strict=True)]
    scenes = jax.tree.map(lambda *a: np.concatenate(a), *parts)
    level = levels_nearby(orbit, scenes, of).astype(float).reshape(len(wrt), 4)
    slope = level @ np.array([1, -8, 8, -1]) / (12 * np.array(steps))
    return dict(zip(wrt, slope.tolist(), strict=True))


def marched_levels(orbit: PeriodicOrbit, scenes: Scene, of: Quantity) -> np.ndarray:
    """The quantity `of` on the orbits of scenes (leading axis) near that of `orbit`; NaN where one does not close."""
    starts, power, means = nearby_orbits(orbit, scenes, vibration=of == "P_d_vibration")
    if amplitude_of(of) is None:
        levels = np.asarray(_quantities(cast(Power, of), scenes, power if means is None else (power, means)))
        return levels.min(axis=-1) if of == "P_d_worst" else levels
    plan = Plan(0, orbit.q, orbit.steps_per_period, 0.0, orbit.method._replace(amplitudes=True, vibration=False))
    runs = run_lanes(scenes, starts, plan, lambda _: None)
    values = counted_amplitude(amplitude_values(scenes, runs.samples, np.full(len(power), orbit.q))[of], scenes.layout)
    return np.where(np.isfinite(power[:, 0]), values, np.nan)


def _quantity(of: Power, scene: Scene, power):
    """The quantity `of` from the mean square displacements of all blades; "P_d_worst" is P_d of each.

    That of the vibration alone needs a pair, of these and of the means of the position.
    """
    if of == "P_d_vibration":
        square, means = power
        means = means_from_static(scene, means)
        of = "P_d"
        power = vibration_square(square[: means.shape[-1]], means, gyration(scene.shroud))
    counts = scene.layout.counting
    P = area(scene.shroud) * power[counts]
    if of == "P_d_worst":
        return power_reduction(P, free_power(scene)[counts])
    return jnp.sum(P) if of == "P" else power_reduction(jnp.sum(P), jnp.sum(free_power(scene)[counts]))


def quantity_level(of: Power, scenes: Scene, power) -> Any:
    """The quantity `of` of scenes (leading axis); "P_d_worst" is P_d of each blade."""
    return _quantities(of, scenes, power)


@kept("of")
def _quantities(of: Power, scenes: Scene, power):
    return jax.vmap(lambda scene, power: _quantity(of, scene, power))(scenes, power)


@kept("of")
def directional_derivatives(scenes: Scene, power, directions: Scene, power_directions, of: Power):
    """The derivatives of `of` along directions of scenes and of what `_quantity` takes, all with a leading axis."""
    return jax.vmap(lambda *point_and_direction: _directional_derivative(of, *point_and_direction))(
        scenes, power, directions, power_directions
    )


def _directional_derivative(of: Power, scene: Scene, power, direction: Scene, power_direction):
    def quantity(scene, power):
        return _quantity(of, scene, power)

    return jax.jvp(quantity, (scene, power), (direction, power_direction))[1]


def smoothed_gradient(
    scene: Scene,
    wrt: Sequence[str],
    of: Quantity,
    orbit: PeriodicOrbit,
    sigma: float,
    pairs: int,
    plan: Plan,
    seed: int,
) -> PowerGradient:
    """The gradient of the average of `of` over normally distributed parameters, by antithetic pairs.

    The gradient is fitted to the differences of the pairs by least squares. Its expectation is the gradient of the
    average; where `of` is linear across the neighbourhood it is exact for any samples. A number that is 0 has no
    relative width, and no derivative.
    """
    levels = np.array([level_of(scene, key) for key in wrt])
    has_width = levels != 0
    if not has_width.any():
        raise InputError(f"{wrt[0]} is 0: a relative width says nothing about it.")
    centre = levels[has_width]
    wrt = [key for key, kept in zip(wrt, has_width, strict=True) if kept]
    xi = np.random.default_rng(seed).standard_normal((pairs, len(wrt)))
    signed = np.concatenate([xi, -xi])
    level, noise, number, ok, both = _sampled_levels(scene, wrt, centre * (1 + sigma * signed), of, plan)
    complete = ok[:pairs] & ok[pairs:]
    if complete.sum() < len(wrt) + 2:
        message = f"Only {complete.sum()} of {pairs} pairs ran to their end; too few for {len(wrt)} derivatives."
        raise NumericalError(message)
    difference = (level[:pairs] - level[pairs:])[complete] / 2
    slope, slope_ci = _least_squares(xi[complete], difference)
    residual = np.std(difference - xi[complete] @ slope)
    own_noise = np.sqrt(np.nanmean(np.append(noise, 0.0) ** 2)) / 1.96
    structured = len(np.unique(number)) > 1 or residual > max(
        STRUCTURED_FACTOR * own_noise, STRUCTURED_SHARE * np.std(difference)
    )
    flags = (*orbit.flags, *(["structured"] if structured else []), *([] if complete.all() else ["lanes stopped"]))
    flags = (*flags, *([] if has_width.all() else ["no width"]))
    means = ((level[:pairs] + level[pairs:]) / 2)[complete]
    return PowerGradient(
        kind="smoothed",
        value=_with_nan_elsewhere(slope / (sigma * centre), has_width),
        ci=_with_nan_elsewhere(slope_ci / np.abs(sigma * centre), has_width),
        level=float(means.mean()),
        level_ci=float(stdtrit(len(means) - 1, 0.975) * means.std(ddof=1) / np.sqrt(len(means))),
        orbit=orbit,
        conditioning=float("nan"),
        sigma=sigma,
        flags=flags,
        **{name: float(np.mean(a[np.tile(complete, 2)])) for name, a in both._asdict().items()},
    )


def _with_nan_elsewhere(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The values in those places, and NaN elsewhere."""
    filled = np.full(places.shape, np.nan)
    filled[places] = values
    return filled


def _sampled_levels(scene: Scene, wrt: Sequence[str], values: np.ndarray, of: Quantity, plan: Plan):
    """At each row of parameter values: `of`, its interval's half width, the period number, and whether it is OK.

    Then P_d and that of the vibration alone, NaN of other quantities.
    """
    scenes = in_precision(without_given(scenes_around(scene, wrt, values)), plan.method.precision)
    method = plan.method._replace(amplitudes=amplitude_of(of) is not None, vibration=is_reduction(of))
    plan = replace(plan, method=method)
    runs = run_lanes(scenes, initial_states(scenes), plan, lambda _: None)
    both = _Reductions._make(np.full((2, len(values)), np.nan))
    if is_reduction(of):
        both = _Reductions._make(levels_of(one, scenes, runs.samples).value for one in ("P_d", "P_d_vibration"))
    return *levels_of(of, scenes, runs.samples), runs.last.status == Status.OK, both


def _least_squares(xi: np.ndarray, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least-squares slope (parameters,) of `difference` in `xi`, and the half width of its 95 % interval.

    The scatter about the line is not constant (curvature, windows), which the heteroscedasticity-consistent covariance
    allows for.
    """
    n, size = xi.shape
    inverse = np.linalg.inv(xi.T @ xi)
    slope = inverse @ xi.T @ difference
    residuals = (difference - xi @ slope) / (1 - np.einsum("ij,jk,ik->i", xi, inverse, xi))  # leave-one-out residuals
    covariance = inverse @ (xi.T * residuals**2) @ xi @ inverse
    return slope, stdtrit(n - size, 0.975) * np.sqrt(np.diag(covariance))
