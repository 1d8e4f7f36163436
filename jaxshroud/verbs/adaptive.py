"""diffrax's adaptive solvers, explicit and implicit, as one more way to march: of scenes that have no events."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxshroud.batch.periods import Sample
from jaxshroud.batch.states import inside
from jaxshroud.batch.tangents import direction
from jaxshroud.model.absent import filled
from jaxshroud.model.modes import Status
from jaxshroud.model.ready import model
from jaxshroud.model.rhs import rhs, wave
from jaxshroud.model.state import State, start
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.setting import HORIZON, SHORT, Ran, free_size, softened

IMPLICIT = {"Kvaerno5"}


class Adaptive(NamedTuple):
    """One way to march with steps of diffrax's choice."""

    solver: str  # Tsit5, Dopri8 or Kvaerno5
    rtol: float  # tolerance relative to each number; for displacements also to the free motion's size
    width: float = 0.0  # as in `Setting`

    @property
    def kind(self) -> str:
        """The choices that are no numbers, in words."""
        return f"diffrax {self.solver}{', smooth' if self.width else ''}"

    def run(self, scenes: Scene, periods: int) -> Ran | None:
        """March lanes (leading axis) from their starts; None where that would take too long."""
        if self.solver in IMPLICIT and periods > SHORT:
            return None
        samples, steps = _solved(softened(scenes, self.width), periods, self.solver, self.rtol)
        samples, steps = jax.tree.map(np.asarray, (samples, steps))
        finite = np.isfinite(samples.power[0]).all(axis=1)
        return Ran(samples, np.where(finite, Status.OK, Status.NOT_FINITE), round(float(steps.mean())))

    def slopes(self, scenes: Scene) -> np.ndarray | None:
        """Derivative of each lane's power over the horizon with respect to the gap; None where there is none."""
        scenes = softened(scenes, self.width)
        if self.solver in IMPLICIT or scenes.parts.contact == "none":
            return None
        power = lambda scenes: _solved(scenes, HORIZON, self.solver, self.rtol)[0].power[0].mean(axis=1)  # noqa: E731
        return np.asarray(jax.jvp(power, (scenes,), (direction(scenes, "shroud.gap"),))[1])

    def __str__(self) -> str:
        width = f", width {self.width:.3g}" if self.width else ""
        return f"{self.kind}{width}, rtol {self.rtol:.0e}"


def _solved(scenes: Scene, periods: int, solver: str, rtol: float):
    """Samples (lanes, periods) from the scenes' starts, and the steps that each took."""
    moving, found = jax.vmap(_start)(scenes), []
    for _ in range(periods):
        moving, sample, steps = _one_period(scenes, moving, rtol, solver)
        found.append((sample, steps))
    return jax.tree.map(lambda *a: jnp.stack(a, axis=1), *found)


def _start(scene: Scene):
    """Motion and slider at t = 0."""
    first = inside(start(scene.initial), model(scene))
    return first.motion, first.u_s


@partial(jax.jit, static_argnames="solver")
def _one_period(scenes: Scene, moving, rtol, solver: str):
    return jax.vmap(lambda scene, moving: _periodic(scene, moving, rtol, solver))(scenes, moving)


def _periodic(scene: Scene, moving, rtol, solver: str):
    """One period of one lane from drive phase 0 on."""
    import diffrax

    ready, period, omega = model(scene), scene.drive.period, scene.drive.omega
    first = inside(start(scene.initial), ready)

    def field(t, y, _):
        z, u_s, _ = y
        Q = wave(jnp.sin(omega * t), jnp.cos(omega * t), ready.drive)
        slope, rates = rhs(Q, State(z, u_s, first.mode, first.case), ready, False)
        return Motion(z.v_x, z.v_y, z.v_theta, *slope.acceleration), slope.u_s, rates.power

    nothing = jax.tree.map(jnp.zeros_like, field(0.0, (*moving, None), None)[2])
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        getattr(diffrax, solver)(),
        t0=jnp.zeros_like(period),
        t1=period,
        dt0=None,
        y0=(*moving, nothing),
        stepsize_controller=diffrax.PIDController(rtol, rtol * lax.stop_gradient(free_size(scene))),
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
        throw=False,
    )
    assert found.ys is not None
    z, u_s, total = jax.tree.map(lambda a: a[0], found.ys)
    motion, power = filled((z, jax.tree.map(lambda a: a / period, total)), period)
    return (z, u_s), Sample(motion, power), found.stats["num_steps"]
