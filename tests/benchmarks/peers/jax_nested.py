"""The obvious way to write it in JAX: a vmapped RK4 step, and a bisection for all lanes wherever one of them needs it.

Each round makes one trial step of all lanes to the end of the fixed step. If no lane has crossed a guard the step is
over; else 20 bisections of all lanes follow, the lanes concerned change their mode at the crossing, and another round
takes these lanes through the rest of their step.
"""

import importlib.util
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from problem import PERIODS, Problem

try:
    import jax
    import jax.numpy as jnp
    from jax import lax
except ImportError:  # told by missing()
    pass

NAME = "JAX, vmapped RK4 + nested bisection"
SETTINGS = (250, 500, 1000)  # steps per period

BISECTIONS = 20
TINY = 1e-16  # [m] by which the friction spring may exceed its limit: rounding
APART, STICK, SLIP_PLUS, SLIP_MINUS = range(4)
LIFT, TURN, HEIGHT, RUB = range(4)


class Held(NamedTuple):
    """What stays fixed between two events."""

    mode: Any
    case: Any
    u_s: Any


class Touch(NamedTuple):
    """The pair of corners of one case."""

    left: tuple  # corner of the left block about its centre
    right: tuple
    offset: tuple  # of the left block's corner from the right one's
    normal: tuple  # (sin A, cos A) of the face
    v: Any
    u: Any


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    return "needs jax" if importlib.util.find_spec("jax") is None else None


def sincos(x: Any, terms: int) -> tuple:
    """Sine and cosine of a small angle."""
    square, sine, cosine = x * x, 0.0, 0.0
    for n in reversed(range(terms)):
        sine = sine * square + (-1) ** n / math.factorial(2 * n + 1)
        cosine = cosine * square + (-1) ** n / math.factorial(2 * n)
    return sine * x, cosine


def touch(p: Problem, q: tuple, trig: tuple, upper: Any, left_tip: Any) -> Touch:
    """Corners, penetration and slide of one case."""
    lean, half, height = p.l_ab * math.cos(p.alpha) / 2, p.l_oa / 2, p.l_ab * math.sin(p.alpha) / 2
    (s1, c1), (s2, c2) = trig
    l0 = jnp.where(upper, half + lean, half - lean)
    r0 = jnp.where(upper, lean - half, -lean - half)
    y0 = jnp.where(upper, height, -height)
    left = l0 * c1 + y0 * s1, y0 * c1 - l0 * s1
    right = r0 * c2 + y0 * s2, y0 * c2 - r0 * s2
    e_x = q[0] - q[1] + (left[0] - l0) - (right[0] - r0) - p.gap
    e_y = q[2] - q[3] + (left[1] - right[1])
    s_f, c_f = jnp.where(left_tip, s2, s1), jnp.where(left_tip, c2, c1)
    s_A = math.sin(p.alpha) * c_f - math.cos(p.alpha) * s_f
    c_A = math.cos(p.alpha) * c_f + math.sin(p.alpha) * s_f
    return Touch(left, right, (e_x, e_y), (s_A, c_A), e_x * s_A - e_y * c_A, e_x * c_A + e_y * s_A)


def natural_case(p: Problem, q: tuple, trig: tuple) -> Any:
    """The case that the positions choose."""
    upper = q[4] > q[5]
    height = touch(p, q, trig, upper, True).offset[1]
    tip_is_left = jnp.where(upper, height < 0, height > 0)
    return jnp.where(upper, 2, 4) - tip_is_left


def accelerations(p: Problem, z: tuple, wave: tuple, at: Touch, left_tip: Any, N: Any, F: Any) -> tuple:
    """Equation of motion under the drive, whose phase has (sin, cos) = `wave`, and the contact forces."""
    s_A, c_A = at.normal
    R_x, R_y = -N * s_A - F * c_A, N * c_A - F * s_A
    (l_x, l_y), (r_x, r_y), (e_x, e_y) = at.left, at.right, at.offset
    on_left = 1.0 - left_tip  # the point of contact is the right block's corner
    M_1 = (l_y - on_left * e_y) * R_x - (l_x - on_left * e_x) * R_y
    M_2 = (r_x + left_tip * e_x) * R_y - (r_y + left_tip * e_y) * R_x
    result = []
    for axis, (mass, spring, damper, amplitude, loads) in enumerate(
        (
            (p.m, p.k_x, p.c_x, p.F_0 * math.cos(p.beta), (R_x, -R_x)),
            (p.m, p.k_y, p.c_y, p.F_0 * math.sin(p.beta), (R_y, -R_y)),
            (p.I, p.k_T, p.c_T, p.M_0, (M_1, M_2)),
        )
    ):
        for i, phase in enumerate(p.phase):
            drive = amplitude * math.cos(phase) / mass * wave[0] + amplitude * math.sin(phase) / mass * wave[1]
            place, speed = z[2 * axis + i], z[6 + 2 * axis + i]
            result.append(drive + loads[i] * (1 / mass) - damper / mass * speed - spring / mass * place)
    return tuple(result)


def rhs(p: Problem, z: tuple, wave: tuple, k: Any, held: Held) -> tuple:
    """Derivative of the 12 motion numbers; `wave` is (sin, cos) of the drive's phase."""
    upper, left_tip = held.case <= 2, held.case % 2 == 1
    at = touch(p, z, (sincos(z[4], 7), sincos(z[5], 7)), upper, left_tip)
    sigma = jnp.where(held.mode == SLIP_PLUS, 1.0, 0.0) - jnp.where(held.mode == SLIP_MINUS, 1.0, 0.0)
    N = jnp.where(held.mode == APART, 0.0, k * at.v)
    F = jnp.where(held.mode == STICK, p.k_d * (at.u - held.u_s), sigma * p.mu * N)
    return (*z[6:], *accelerations(p, z, wave, at, left_tip, N, F))


def unfused(f: Callable, one: Any, *args: Any) -> Any:
    """`f(*args)` behind a condition that always holds: XLA:CPU would recompute each stage in every use of it."""
    never = lambda *_: jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(f, *args))
    return lax.cond(one > 0, f, never, *args)


def rk4(p: Problem, z: tuple, h: Any, done: Any, grid: tuple, k: Any, held: Held) -> tuple:
    """One step of length `h`, which starts `done` after a grid point; `grid`: the drive's sine and cosine there, 1."""

    def wave(t: Any) -> tuple:
        s, c = sincos(p.omega * t, 5)
        return grid[0] * c + grid[1] * s, grid[1] * c - grid[0] * s

    def shifted(a: Any, slope: tuple) -> tuple:
        return tuple(x + a * d for x, d in zip(z, slope, strict=True))

    slope = partial(unfused, partial(rhs, p), grid[2])
    middle = wave(done + h / 2)
    k1 = slope(z, wave(done), k, held)
    k2 = slope(shifted(h / 2, k1), middle, k, held)
    k3 = slope(shifted(h / 2, k2), middle, k, held)
    k4 = slope(shifted(h, k3), wave(done + h), k, held)
    return shifted(h / 6, tuple(a + 2 * (b + c) + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))


def rates(z: tuple, at: Touch, left_tip: Any) -> tuple:
    """Rates of v and u."""
    (l_x, l_y), (r_x, r_y), (s_A, c_A) = at.left, at.right, at.normal
    e_x, e_y = z[6] - z[7] + z[10] * l_y - z[11] * r_y, z[8] - z[9] - z[10] * l_x + z[11] * r_x
    w = jnp.where(left_tip, z[11], z[10])
    return e_x * s_A - e_y * c_A - w * at.u, e_x * c_A + e_y * s_A + w * at.v


def look(p: Problem, z: tuple, k: Any, held: Held) -> tuple:
    """The case, the pair of corners, the rates of v and u, and which guards are crossed."""
    trig = sincos(z[4], 7), sincos(z[5], 7)
    apart = held.mode == APART
    case = jnp.where(apart, natural_case(p, z, trig), held.case)
    upper, left_tip = case <= 2, case % 2 == 1
    at = touch(p, z, trig, upper, left_tip)
    v_rate, u_rate = rates(z, at, left_tip)
    lag, turn, height = p.mu * k / p.k_d, z[4] - z[5], at.offset[1]
    slip_back = jnp.where(
        held.mode == SLIP_PLUS, u_rate - lag * v_rate < 0, (held.mode == SLIP_MINUS) & (u_rate + lag * v_rate > 0)
    )
    crossed = (
        jnp.where(apart, at.v > 0, at.v < 0),
        ~apart & jnp.where(upper, turn < 0, turn > 0),
        ~apart & jnp.where(upper == left_tip, height > 0, height < 0),
        jnp.where(held.mode == STICK, abs(at.u - held.u_s) - lag * at.v > TINY, slip_back),
    )
    return case, at, v_rate, u_rate, crossed


def violated(p: Problem, z: tuple, k: Any, held: Held) -> Any:
    """Whether any guard is crossed."""
    lift, turn, height, rub = look(p, z, k, held)[-1]
    return lift | turn | height | rub


def change(p: Problem, z: tuple, k: Any, held: Held) -> Held:
    """The transition of the first crossed guard."""
    case, at, v_rate, u_rate, (lift, turn, height, rub) = look(p, z, k, held)
    turn, height = ~lift & turn, ~lift & ~turn & height
    rub &= ~lift & ~turn & ~height
    lag = p.mu * k / p.k_d
    slips = abs(u_rate) > lag * v_rate
    new_mode = jnp.where(slips, jnp.where(u_rate > 0, SLIP_PLUS, SLIP_MINUS), STICK)
    onset = lift & (held.mode == APART)
    mode = jnp.where(lift, jnp.where(onset, new_mode, APART), held.mode)
    slide = jnp.where(at.u > held.u_s, SLIP_PLUS, SLIP_MINUS)
    mode = jnp.where(rub, jnp.where(held.mode == STICK, slide, STICK), mode)

    case = jnp.where(turn, 5 - case, jnp.where(height, case - 1 + 2 * (case % 2), case))
    new = touch(p, z, (sincos(z[4], 7), sincos(z[5], 7)), case <= 2, case % 2 == 1)
    sigma = jnp.where(held.mode == SLIP_PLUS, 1.0, -1.0)
    u_s = jnp.where(onset | lift, at.u, jnp.where(turn | height, held.u_s + new.u - at.u, held.u_s))
    u_s = jnp.where(rub & (held.mode != STICK), at.u - sigma * lag * at.v, u_s)
    return Held(mode, case, u_s)


def march(p: Problem, steps: int, k: Any) -> Any:
    """All lanes through all periods."""
    step_all = jax.vmap(partial(rk4, p), in_axes=(0, 0, 0, None, 0, 0))
    change_all, violated_each = jax.vmap(partial(change, p)), jax.vmap(partial(violated, p))
    length = 2 * math.pi / p.omega / steps
    none = jnp.zeros_like(k)

    def violated_all(one: Any, z: tuple, held: Held) -> Any:
        return unfused(violated_each, one, z, k, held)

    def choose(which: Any, new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(which, a, b), new, old)

    def locate(grid: tuple, z: tuple, held: Held, done: Any, left: Any, trial: tuple, bad: Any) -> tuple:
        def halve(_: Any, bracket: tuple) -> tuple:
            low, high, at_high = bracket
            middle = (low + high) / 2
            at_middle = step_all(z, middle, done, grid, k, held)
            beyond = violated_all(grid[2], at_middle, held)
            return (
                *(jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)),
                choose(beyond, at_middle, at_high),
            )

        _, high, at_high = lax.fori_loop(0, BISECTIONS, halve, (none, left, trial))
        held = choose(bad, change_all(at_high, k, held), held)
        return choose(bad, at_high, trial), held, done + high, jnp.where(bad, left - high, 0.0)

    def step(i: Any, carry: tuple) -> tuple:
        angle = 2 * jnp.pi * (i % steps) / steps
        grid = jnp.sin(angle), jnp.cos(angle), jnp.where(i < 0, 0, 1)

        def round_of_trials(state: tuple) -> tuple:
            z, held, done, left = state
            trial = step_all(z, left, done, grid, k, held)
            bad = violated_all(grid[2], trial, held) & (left > 0)
            return lax.cond(
                bad.any(),
                lambda: locate(grid, z, held, done, left, trial, bad),
                lambda: (trial, held, done + left, none),
            )

        z, held, _, _ = lax.while_loop(
            lambda state: (state[-1] > 0).any(), round_of_trials, (*carry, none, none + length)
        )
        return z, held

    still = jnp.zeros_like(k, int)
    z, _ = lax.fori_loop(0, PERIODS * steps, step, ((none,) * 12, Held(still, still + 1, none)))
    return jnp.stack(z, axis=-1)


def prepare(problem: Problem) -> Callable[[int], np.ndarray]:
    """Integrate all lanes with so many steps per period; compiled at the first call with that number."""
    jax.config.update("jax_enable_x64", True)
    k = jnp.asarray(problem.gamma * problem.k_x, float)
    run = jax.jit(partial(march, problem), static_argnums=0)
    return lambda steps: np.asarray(run(steps, k))
