"""Diffrax's adaptive Tsit5 over a contact law without events.

The law is one ordinary differential equation: forces depend on the positions and on the stretch of the friction spring,
which is a state variable that follows the slide inside its limit and the limit outside of it. The case is the one the
positions choose. The step control has to find the kinks and jumps of the right-hand side by rejecting steps.
"""

import importlib.util
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from problem import PERIODS, Problem

from peers.jax_nested import accelerations, natural_case, rates, sincos, touch, unfused

try:
    import diffrax
    import jax
    import jax.numpy as jnp
except ImportError:  # told by missing()
    pass

NAME = "diffrax, Tsit5, contact law without events"
SETTINGS = (1e-3, 1e-4, 1e-5)  # relative tolerances

# In slip the stretch is led to this much [m] outside its limit, within this time [s]: at the limit itself any error
# would throw it back and forth between slip and stick.
MARGIN, RETURN = 1e-8, 1e-4


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    absent = [name for name in ("jax", "diffrax") if importlib.util.find_spec(name) is None]
    return f"needs {' and '.join(absent)}" if absent else None


def wave(angle: Any) -> tuple:
    """Sine and cosine of the drive's phase."""
    s, c = sincos((angle - 2 * math.pi * jnp.round(angle / (2 * math.pi))) / 4, 9)
    for _ in range(2):
        s, c = 2 * s * c, 1 - 2 * s * s
    return s, c


def scales(p: Problem) -> np.ndarray:
    """What the 13 state variables are measured in so that one tolerance fits all: lengths by speed and frequency."""
    speed = p.omega * p.M_0 / abs(p.k_T - p.I * p.omega**2)
    slow = [math.sqrt(p.k_y / p.m)] * 4 + [math.sqrt(p.k_T / p.I)] * 2
    return np.array([*(speed / w for w in slow), *[speed] * 6, speed / slow[0]])


def slope(p: Problem, t: Any, z: tuple, k: Any) -> tuple:
    """Derivative of the 12 motion numbers and of the friction spring's stretch."""
    trig = sincos(z[4], 7), sincos(z[5], 7)
    case = natural_case(p, z, trig)
    left_tip = case % 2 == 1
    at = touch(p, z, trig, case <= 2, left_tip)
    v_rate, u_rate = rates(z, at, left_tip)
    lag, stretch = p.mu * k / p.k_d, z[12]
    limit = lag * jnp.maximum(at.v, 0.0)
    sigma = jnp.sign(stretch)
    outward = (abs(stretch) >= limit) & (sigma * u_rate > lag * v_rate)
    slips = sigma * lag * v_rate + (sigma * (limit + MARGIN) - stretch) / RETURN
    follows = jnp.where(at.v > 0, jnp.where(outward, slips, u_rate), -stretch / RETURN)
    N, F = k * jnp.maximum(at.v, 0.0), p.k_d * jnp.clip(stretch, -limit, limit)
    motion = accelerations(p, z, wave(p.omega * t), at, left_tip, N, F)
    return (*z[6:12], *motion, follows)


def prepare(problem: Problem) -> Callable[[float], np.ndarray]:
    """Integrate all lanes at a tolerance."""
    jax.config.update("jax_enable_x64", True)
    scale = scales(problem).tolist()
    k = jnp.asarray(problem.gamma * problem.k_x, float)

    def scaled(t: Any, y: Any, k: Any) -> Any:
        z = tuple(a * b for a, b in zip(y, scale, strict=True))
        return tuple(a * (1 / b) for a, b in zip(slope(problem, t, z, k), scale, strict=True))

    def field(t: Any, y: Any, args: tuple) -> Any:
        k, one = args
        return unfused(scaled, one, t, y, k)

    def run(k: Any, tolerance: Any, one: Any) -> Any:
        end = PERIODS * 2 * math.pi / problem.omega
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            0.0,
            end,
            1e-3 / problem.omega,
            (jnp.zeros(()),) * 13,
            (k, one),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3),
            max_steps=None,
        )
        return jnp.stack([a[0] * b for a, b in zip(solution.ys[:12], scale[:12], strict=True)])

    run_all = jax.jit(jax.vmap(run, in_axes=(0, None, None)))
    return lambda tolerance: np.asarray(run_all(k, tolerance, 1))
