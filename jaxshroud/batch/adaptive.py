"""Lanes marched by diffrax's adaptive solvers, for scenes without located events."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.periods import Sample
from jaxshroud.batch.states import carried_state
from jaxshroud.batch.tangents import direction
from jaxshroud.cache.programs import kept
from jaxshroud.model.arithmetic import Scalar, Symbolic, filled
from jaxshroud.model.drive import drive_waves
from jaxshroud.model.linear import free_rms_displacement
from jaxshroud.model.prepared import State, initial_state, prepared_model
from jaxshroud.model.rhs import Recorded, rhs
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene, without_given

MovingState = tuple[Motion, Array | Symbolic]  # motion and slider, with or without an axis of lanes


def adaptive_samples(
    scenes: Scene, periods: int, solver: str, rtol: float
) -> tuple[Sample, Int[Array, "lanes periods"]]:
    """Samples (lanes, periods) from the scenes' own starts, and the steps of each period.

    Args:
        scenes: Scenes (leading axis) with smooth contact or without contact.
        periods: The number of drive periods.
        solver: The name of a solver of diffrax.
        rtol: Its tolerance relative to each number; for displacements also relative to `free_rms_displacement`.
    """
    moving, blocks = jax.vmap(_start)(scenes), []
    for _ in range(periods):
        moving, sample, steps = _one_period(scenes, moving, rtol, solver)
        blocks.append((sample, steps))
    return jax.tree.map(lambda *a: jnp.stack(a, axis=1), *blocks)


def adaptive_gap_slopes(scenes: Scene, periods: int, solver: str, rtol: float) -> np.ndarray:
    """The derivative of each lane's mean power with respect to the gap, (lanes,)."""

    def power(scenes):
        return adaptive_samples(scenes, periods, solver, rtol)[0].power[0].mean(axis=1)

    return np.asarray(jax.jvp(power, (without_given(scenes),), (direction(scenes, "shroud.gap"),))[1])


def _start(scene: Scene) -> MovingState:
    """The motion and the slider at t = 0."""
    first = carried_state(initial_state(scene.initial), prepared_model(scene))
    return first.motion, first.u_s


@kept("solver")
def _one_period(
    scenes: Scene, moving: MovingState, rtol: float | Scalar, solver: str
) -> tuple[MovingState, Sample, Int[Array, " lanes"]]:
    return jax.vmap(lambda scene, moving: _lane_period(scene, moving, rtol, solver))(scenes, moving)


def _lane_period(scene: Scene, moving: MovingState, rtol: float | Scalar, solver: str):
    """One period of one lane, from drive phase 0."""
    import diffrax

    model, period, omega = prepared_model(scene), scene.drive.period, scene.drive.omega
    first = carried_state(initial_state(scene.initial), model)

    def field(t, y, _):
        z, u_s, _ = y
        Q = drive_waves(jnp.sin(omega * t), jnp.cos(omega * t), model.drive)
        slope, rates = rhs(Q, State(z, u_s, first.mode, first.case), model, Recorded())
        return Motion(z.v_x, z.v_y, z.v_theta, *slope.acceleration), slope.u_s, rates.power

    no_power = jax.tree.map(jnp.zeros_like, field(0.0, (*moving, None), None)[2])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        getattr(diffrax, solver)(),
        t0=jnp.zeros_like(period),
        t1=period,
        dt0=None,
        y0=(*moving, no_power),
        stepsize_controller=diffrax.PIDController(rtol, rtol * lax.stop_gradient(free_rms_displacement(scene))),
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
        throw=False,
    )
    assert solution.ys is not None
    z, u_s, total = jax.tree.map(lambda a: a[0], solution.ys)
    motion, power = filled((z, jax.tree.map(lambda a: a / period, total)), period)
    return (z, u_s), Sample(motion, power), solution.stats["num_steps"]
