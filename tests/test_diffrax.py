"""Adaptive solvers of diffrax, explicit and implicit, on scenes that are valid input for them: those without events."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batch import ends, relative_error, run, sizes
from test_parts import with_parts

from jaxshroud.integrate import FAST_WITH_LEDGER
from jaxshroud.rhs import model, rhs, wave
from jaxshroud.scene import Motion, vary
from jaxshroud.stability import largest_frequency
from jaxshroud.state import Mode, State


def solved(scene, solver, rtol: float) -> np.ndarray:
    """The motion after one period from the scene's start, (12,)."""
    ready, omega = model(scene), scene.drive.omega
    mode, case = jnp.int32(Mode.SMOOTH), jnp.int32(0)

    def field(t, y, _):
        motion = Motion(*((y[i], y[i + 1]) for i in range(0, 12, 2)))
        Q = wave(jnp.sin(omega * t), jnp.cos(omega * t), ready.drive)
        slope, _ = rhs(Q, State(motion, y[12], mode, case), ready, False)
        rates = [a for pair in slope.acceleration for a in pair]
        return jnp.stack([*y[6:12], *rates, slope.u_s])

    control = diffrax.PIDController(rtol=rtol, atol=1e-3 * rtol)
    start = jnp.concatenate([*(jnp.asarray(a) for a in scene.initial), jnp.zeros(1)])
    found = jax.jit(
        lambda y: (
            diffrax.diffeqsolve(
                diffrax.ODETerm(field),
                solver,
                t0=0.0,
                t1=scene.drive.period,
                dt0=1e-7,
                y0=y,
                stepsize_controller=control,
                max_steps=200_000,
            ).ys
        )
    )(start)
    return np.asarray(found[0, :12])


SOLVERS = {"explicit": (diffrax.Dopri8(), 1e-11, 1e-7), "implicit": (diffrax.Kvaerno5(), 1e-8, 1e-3)}


@pytest.mark.parametrize("kind", SOLVERS)
def test_smooth_contact(table1, kind):
    # The same right-hand side, another way through time. The motion amplifies errors some thousandfold in a period.
    solver, rtol, agree = SOLVERS[kind]
    scene = with_parts(vary(table1, "contact.gamma", 2.5), 2e-6, contact="smooth")
    steps = int(float(largest_frequency(scene) * scene.drive.period) / 0.1)
    ours = run([scene], 1, steps, FAST_WITH_LEDGER)
    error = relative_error(ends(ours)[0], solved(scene, solver, rtol), sizes(ours)[0])
    assert error < agree
    # Control: the spring's law is another scene.
    spring = run([vary(table1, "contact.gamma", 2.5)], 1, 1000, FAST_WITH_LEDGER)
    assert relative_error(ends(spring)[0], ends(ours)[0], sizes(ours)[0]) > 10 * error
