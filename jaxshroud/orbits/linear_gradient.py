"""The exact derivatives of what a linear motion amounts to, by the closed form of the motion."""

from collections.abc import Sequence
from functools import partial
from typing import cast

import jax
import numpy as np

from jaxshroud.batch.closed_form import linear_amplitude_values, linear_amplitudes, linear_status
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
    both = {}
    if amplitude_of(of) is None:
        found = _linear_power_slopes(cast(Power, of), scenes, directions, flow, flow_by)
        if is_reduction(of):
            both = {"P_d": cycle.P_d, "P_d_vibration": cycle.P_d_vibration}
    else:
        levels, slopes = jax.jvp(partial(linear_amplitudes, of=of), (value,), (by,))
        of_blades = zip(np.asarray(levels)[0], np.asarray(slopes).T, strict=True)
        found = largest_level(
            [(float(level), slope) for level, slope in of_blades][scene.layout.counting], "blades tie"
        )
    zeros = np.zeros(len(wrt))
    flags = (*found.flags, LINEAR_FLAG)
    return PowerGradient(
        "periodic", found.slope, zeros, found.level, 0.0, cycle, cycle.conditioning, 0.0, flags, **both
    )


def _linear_power_slopes(of: Power, scenes: Scene, directions: Scene, flow, flow_by) -> AmplitudeSlope:
    """A power and its derivatives along the directions."""
    squares = flow.squares(of)
    by = flow_by.squares(of)
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
    of = cast(Power, of)
    squares = linear_flow(motion, scenes).squares(of)
    levels = np.asarray(quantity_level(of, without_given(scenes), squares), float)
    levels = levels.min(axis=-1) if of == "P_d_worst" else levels
    return np.where(linear_status(motion) == Status.OK, levels, np.nan)


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
    squares = linear_flow(jax.tree.map(lambda a: a[:1], value), lane).squares("P_d_vibration")
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
