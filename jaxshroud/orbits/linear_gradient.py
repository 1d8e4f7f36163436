"""The exact derivatives of what a linear motion amounts to, by the closed form of the motion."""

from collections.abc import Sequence
from typing import Any, cast

import jax
import numpy as np

from jaxshroud.batch.linear_runs import linear_amplitude_values, linear_status
from jaxshroud.batch.tangents import direction
from jaxshroud.batch.xla import one_lane, repeat_lane
from jaxshroud.linear.held_contact import LinearState, held_contact
from jaxshroud.linear.linear_motion import linear_flow
from jaxshroud.linear.linear_sector import settled_linear_motions, settled_linear_tangents
from jaxshroud.linear.linear_transient import linear_multipliers
from jaxshroud.march.method import Choices
from jaxshroud.model.linear import power_reduction
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.amplitude_slopes import AmplitudeSlope, largest_level
from jaxshroud.orbits.gradient import PowerGradient, directional_derivatives, quantity_level
from jaxshroud.orbits.orbit import PeriodicOrbit, area_and_free_power
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.quantities import Power, Quantity, amplitude_of, counted_amplitude, is_reduction
from jaxshroud.scene.scene import Scene, without_given

STILL = 1e-13  # of the mean square, below which the variance of a blade that stands still is rounding
LINEAR_FLAG = "linear"  # the motion is in closed form


def linear_gradient(scene: Scene, wrt: Sequence[str], of: Quantity, steps: int, method: Choices) -> PowerGradient:
    """The derivatives of a quantity of one scene whose contact stays in a state.

    Raises:
        NumericalError: Contact leaves its state, or the motion is not finite.
    """
    lane = one_lane(without_given(scene))
    directions = jax.tree.map(lambda *a: np.stack(a), *(direction(scene, key) for key in wrt))
    value, by = settled_linear_tangents(lane, directions, len(wrt))
    status = int(linear_status(value)[0])
    if status != Status.OK:
        raise NumericalError(f"The closed form of contact that stays {scene.parts.contact} does not hold here.")
    flow, flow_by = linear_flow(value, lane), linear_flow(by, lane)
    scenes = repeat_lane(without_given(scene), len(wrt))
    cycle = _as_orbit(scene, value, steps, method)
    amplitude = amplitude_of(of)
    both = {}
    if amplitude is None:
        found = _linear_power_slopes(cast(Power, of), scenes, directions, flow, flow_by)
        if is_reduction(of):
            both = {"P_d": cycle.P_d, "P_d_vibration": cycle.P_d_vibration}
    else:
        row, counts = amplitude.row, scene.layout.counting
        levels = _linear_levels(amplitude.measure, value, by, row)
        found = largest_level(
            [(float(level), slope) for level, slope in zip(levels[0][counts], levels[1][counts], strict=True)],
            "blades tie",
        )
    zeros = np.zeros(len(wrt))
    flags = (*found.flags, LINEAR_FLAG)
    return PowerGradient(
        "periodic", found.slope, zeros, found.level, 0.0, cycle, cycle.conditioning, 0.0, flags, **both
    )


def _linear_power_slopes(of: Power, scenes: Scene, directions: Scene, flow, flow_by) -> AmplitudeSlope:
    """A power and its derivatives along the directions."""
    squares, by = flow.power, flow_by.power
    if of == "P_d_vibration":
        squares, by = ((one.power, np.stack(one.means, axis=1)) for one in (flow, flow_by))
    slope = np.asarray(directional_derivatives(scenes, squares, directions, by, of), float)
    level = np.asarray(quantity_level(of, scenes, squares), float)[0]
    if of == "P_d_worst":
        worst = largest_level([(-one, -own) for one, own in zip(level, slope.T, strict=True)], "blades tie")
        return AmplitudeSlope(-worst.level, -worst.slope, worst.flags)
    return AmplitudeSlope(float(level), slope)


def linear_levels(orbit: PeriodicOrbit, scenes: Scene, of: Quantity) -> np.ndarray:
    """The quantity `of` of scenes (leading axis) near that of `orbit`; NaN where contact leaves its state."""
    del orbit  # a linear motion has no start
    if amplitude_of(of) is not None:
        return counted_amplitude(linear_amplitude_values(scenes, of), scenes.layout)
    motion = settled_linear_motions(scenes)
    flow = linear_flow(motion, scenes)
    squares: Any = flow.power
    if of == "P_d_vibration":
        squares = flow.power, np.stack(flow.means, axis=1)
    levels = np.asarray(quantity_level(cast(Power, of), without_given(scenes), squares), float)
    levels = levels.min(axis=-1) if of == "P_d_worst" else levels
    return np.where(linear_status(motion) == Status.OK, levels, np.nan)


def _linear_levels(measure: str, value, by, row: int) -> tuple[np.ndarray, np.ndarray]:
    """The amplitudes of the blades (blades,), and their derivatives (blades, directions)."""

    def number(name):
        return (np.asarray(getattr(value, name))[0, row], np.asarray(getattr(by, name))[:, row].T)

    (mean, mean_by), (square, square_by) = number("first"), number("second")
    if measure == "mean":
        return mean, mean_by
    if measure == "rms":
        variance = square - mean**2
        rms = np.sqrt(np.where(variance > STILL * square, variance, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (square_by - 2 * mean[:, None] * mean_by) / (2 * rms[:, None])
        return rms, np.where(rms[:, None] > 0, slope, np.nan)  # that of a blade that stands still has a kink
    (high, high_by), (low, low_by) = number("highest"), number("lowest")
    upper = high - mean >= mean - low
    return np.where(upper, high - mean, mean - low), np.where(upper[:, None], high_by - mean_by, mean_by - low_by)


def _as_orbit(scene: Scene, value, steps: int, method: Choices) -> PeriodicOrbit:
    """The motion as an orbit of one period; its sliders do not move."""
    area, P_0 = area_and_free_power(scene)
    P = area * np.asarray(value.power)[0]
    counts = scene.layout.counting
    first = Motion._make(np.asarray(part)[0, i] for part in (value.displacement, value.speed) for i in range(3))
    lane = one_lane(without_given(scene))
    multipliers = linear_multipliers(lane, held_contact(lane, cast(LinearState, scene.parts.contact)))[0]
    shape = (*scene.layout.interface_shape, *((scene.points,) if scene.points else ()))
    mode = Mode.APART if scene.parts.contact == "apart" else Mode.STICK
    start = State(
        first, np.zeros(shape), np.full(shape, mode, np.int32), np.zeros(scene.layout.interface_shape, np.int32)
    )
    squares = np.asarray(value.power)[:1], np.stack([np.asarray(a)[:1, counts] for a in value.means], axis=1)
    vibration = float(np.asarray(quantity_level("P_d_vibration", lane, squares))[0])
    return PeriodicOrbit(
        scene=scene,
        start=start,
        q=1,
        P=P,
        P_0=P_0,
        P_d=float(power_reduction(P[counts].sum(), P_0[counts].sum())),
        P_d_vibration=vibration,
        residual=0.0,
        multipliers=np.pad(multipliers, (0, scene.state_size - len(multipliers))),
        conditioning=float("nan"),
        doubt=float("nan"),
        flags=(),
        updates=0,
        periods=0,
        steps_per_period=steps,
        method=method,
        status=int(Status.OK),
        jacobian=None,
    )
