"""Numba, one lane at a time: RK4 of fixed step, and 20 bisections of a step that crosses a guard.

Numbers travel in tuples, which the compiler keeps in registers, and every function is inlined into one. As q' = r for
positions q and rates r, the classical Runge-Kutta step is written in its Nystroem form, which needs the accelerations
only. The contact of a step's end serves both its guards and the first stage of the next step.
"""

import importlib.util
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from problem import PERIODS, Problem

try:
    from numba import njit

    inlined = njit(fastmath=True, forceinline=True)
    compiled = njit(fastmath=True, cache=False)
except ImportError:  # told by missing()
    inlined = compiled = lambda f: f

NAME = "Numba, scalar RK4 + 20 bisections"
SETTINGS = (125, 250, 500, 1000)  # steps per period

BISECTIONS = 20
TINY = 1e-16  # [m] by which the friction spring may exceed its limit: rounding
MAX_EVENTS = 64  # in a step
APART, STICK, SLIP_PLUS, SLIP_MINUS = range(4)
LIFT, TURN, HEIGHT, LIMIT, REVERSE = (1 << i for i in range(5))  # guards, in order of precedence


class Model(NamedTuple):
    """A scene. Triples are of x, y and theta, divided by the inertia."""

    sine: tuple  # drive, as factors of the sine and the cosine of its phase; pairs of blades
    cosine: tuple
    damping: tuple
    spring: tuple
    inverse_m: float
    inverse_I: float
    half: float  # corners: a and b of the left block are (half + lean, height), (half - lean, -height)
    lean: float
    height: float
    sin_alpha: float
    cos_alpha: float
    gap: float
    k_d: float
    mu: float
    omega: float
    k: float
    lag: float


class Held(NamedTuple):
    """What stays fixed between two events."""

    mode: int
    upper: bool
    left_tip: bool
    u_s: float


class Touch(NamedTuple):
    """The pair of corners of one case."""

    l_x: float  # corners about the centres of their blocks
    l_y: float
    r_x: float
    r_y: float
    s_A: float
    c_A: float
    height: float
    v: float
    u: float


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    return "needs numba" if importlib.util.find_spec("numba") is None else None


def model(p: Problem, gamma: float) -> Model:
    """The scene of one lane."""
    inertia, k = (p.m, p.m, p.I), gamma * p.k_x
    drive = p.F_0 * math.cos(p.beta), p.F_0 * math.sin(p.beta), p.M_0
    per = lambda values: tuple(float(a / b) for a, b in zip(values, inertia, strict=True))
    blades = lambda f: tuple(a * f(phase) for a in per(drive) for phase in p.phase)
    sin_alpha, cos_alpha = math.sin(p.alpha), math.cos(p.alpha)
    block = p.l_oa / 2, p.l_ab * cos_alpha / 2, p.l_ab * sin_alpha / 2, sin_alpha, cos_alpha, p.gap
    own = blades(math.cos), blades(math.sin), per((p.c_x, p.c_y, p.c_T)), per((p.k_x, p.k_y, p.k_T))
    return Model(*own, 1 / p.m, 1 / p.I, *block, p.k_d, p.mu, p.omega, k, p.mu * k / p.k_d)


@inlined
def sine_versine(x: float) -> tuple:
    """Taylor series of sin x and 1 - cos x, good to 2e-14 up to pi / 4."""
    a = x * x
    b = a * a
    s01, s23, s45 = -1 / 6 + a * (1 / 120), -1 / 5040 + a * (1 / 362880), -1 / 39916800 + a * (1 / 6227020800)
    w01, w23, w45 = 1 / 2 - a * (1 / 24), 1 / 720 - a * (1 / 40320), 1 / 3628800 - a * (1 / 479001600)
    return x + x * a * (s01 + b * (s23 + b * s45)), a * (w01 + b * (w23 + b * (w45 + b * (1 / 87178291200))))


@inlined
def plus(a: tuple, x: float, b: tuple) -> tuple:
    """`a + x b`."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2], a[3] + x * b[3], a[4] + x * b[4], a[5] + x * b[5]


@inlined
def corners(m: Model, q: tuple, trig: tuple, upper: bool) -> tuple:
    """The corners, and the offset of the left block's one from the right one's."""
    s1, w1, s2, w2 = trig
    side = 1.0 if upper else -1.0
    l0, r0, y0 = side * m.lean + m.half, side * m.lean - m.half, side * m.height
    l_dx, l_dy, r_dx, r_dy = y0 * s1 - l0 * w1, y0 * w1 + l0 * s1, y0 * s2 - r0 * w2, y0 * w2 + r0 * s2
    e_x, e_y = (q[0] - q[1] - m.gap) + (l_dx - r_dx), (q[2] - q[3]) - (l_dy - r_dy)
    return l0 + l_dx, y0 - l_dy, r0 + r_dx, y0 - r_dy, e_x, e_y


@inlined
def on_face(m: Model, pair: tuple, trig: tuple, left_tip: bool) -> Touch:
    """Penetration and slide of a pair of corners."""
    l_x, l_y, r_x, r_y, e_x, e_y = pair
    s1, w1, s2, w2 = trig
    s_f, w_f = s2 if left_tip else s1, w2 if left_tip else w1
    s_A = m.sin_alpha - (m.sin_alpha * w_f + m.cos_alpha * s_f)
    c_A = m.cos_alpha - (m.cos_alpha * w_f - m.sin_alpha * s_f)
    return Touch(l_x, l_y, r_x, r_y, s_A, c_A, e_y, e_x * s_A - e_y * c_A, e_x * c_A + e_y * s_A)


@inlined
def touch(m: Model, q: tuple, upper: bool, left_tip: bool) -> Touch:
    """The contact of one case."""
    s1, w1 = sine_versine(q[4])
    s2, w2 = sine_versine(q[5])
    trig = s1, w1, s2, w2
    return on_face(m, corners(m, q, trig, upper), trig, left_tip)


@inlined
def free_accelerations(m: Model, q: tuple, r: tuple, wave: tuple) -> tuple:
    """Accelerations by drive and blades, whose phase has (sin, cos) = `wave`."""
    s, c = wave
    return (
        (m.sine[0] * s + m.cosine[0] * c) - (m.damping[0] * r[0] + m.spring[0] * q[0]),
        (m.sine[1] * s + m.cosine[1] * c) - (m.damping[0] * r[1] + m.spring[0] * q[1]),
        (m.sine[2] * s + m.cosine[2] * c) - (m.damping[1] * r[2] + m.spring[1] * q[2]),
        (m.sine[3] * s + m.cosine[3] * c) - (m.damping[1] * r[3] + m.spring[1] * q[3]),
        (m.sine[4] * s + m.cosine[4] * c) - (m.damping[2] * r[4] + m.spring[2] * q[4]),
        (m.sine[5] * s + m.cosine[5] * c) - (m.damping[2] * r[5] + m.spring[2] * q[5]),
    )


@inlined
def sign_of(mode: int) -> float:
    """The direction of slip."""
    return 1.0 if mode == SLIP_PLUS else -1.0 if mode == SLIP_MINUS else 0.0


@inlined
def accelerations(m: Model, q: tuple, r: tuple, wave: tuple, t: Touch, held: Held) -> tuple:
    """Accelerations in contact."""
    N = m.k * t.v
    F = m.k_d * (t.u - held.u_s) if held.mode == STICK else sign_of(held.mode) * m.mu * N
    R_x, R_y = N * t.s_A + F * t.c_A, N * t.c_A - F * t.s_A  # leftwards, up; on the left block
    both = t.u * N - t.v * F  # moment about the face's own corner
    M_1 = (0.0 if held.left_tip else both) - (t.l_y * R_x + t.l_x * R_y)
    M_2 = (both if held.left_tip else 0.0) + (t.r_x * R_y + t.r_y * R_x)
    a_x, a_y = R_x * m.inverse_m, R_y * m.inverse_m
    return plus(free_accelerations(m, q, r, wave), 1.0, (-a_x, a_x, a_y, -a_y, M_1 * m.inverse_I, M_2 * m.inverse_I))


@inlined
def slope(m: Model, q: tuple, r: tuple, wave: tuple, held: Held) -> tuple:
    """Accelerations in contact, of a stage."""
    return accelerations(m, q, r, wave, touch(m, q, held.upper, held.left_tip), held)


@inlined
def first_stage(m: Model, q: tuple, r: tuple, wave: tuple, t: Touch, held: Held) -> tuple:
    """Accelerations where the contact is known."""
    if held.mode == APART:
        return free_accelerations(m, q, r, wave)
    return accelerations(m, q, r, wave, t, held)


@inlined
def combined(q: tuple, r: tuple, h: float, a1: tuple, a2: tuple, a3: tuple, a4: tuple) -> tuple:
    """The end of a step."""
    both = plus(a2, 1.0, a3)
    return plus(plus(q, h, r), h * h / 6, plus(a1, 1.0, both)), plus(r, h / 6, plus(plus(a1, 2.0, both), 1.0, a4))


@inlined
def rk4(m: Model, q: tuple, r: tuple, a1: tuple, h: float, middle: tuple, end: tuple, held: Held) -> tuple:
    """One step from positions, rates and their accelerations `a1`."""
    q2, q3 = plus(q, h / 2, r), plus(plus(q, h / 2, r), h * h / 4, a1)
    r2 = plus(r, h / 2, a1)
    if held.mode == APART:
        a2 = free_accelerations(m, q2, r2, middle)
        a3 = free_accelerations(m, q3, plus(r, h / 2, a2), middle)
        a4 = free_accelerations(m, plus(plus(q, h, r), h * h / 2, a2), plus(r, h, a3), end)
        return combined(q, r, h, a1, a2, a3, a4)
    a2 = slope(m, q2, r2, middle, held)
    a3 = slope(m, q3, plus(r, h / 2, a2), middle, held)
    a4 = slope(m, plus(plus(q, h, r), h * h / 2, a2), plus(r, h, a3), end, held)
    return combined(q, r, h, a1, a2, a3, a4)


@inlined
def rk4_from(m: Model, q: tuple, r: tuple, a1: tuple, h: float, now: tuple, held: Held) -> tuple:
    """A step from where the drive's phase has (sin, cos) = `now`, and the drive at its end."""
    s, w = sine_versine(m.omega * h / 2)
    middle = now[0] - now[0] * w + now[1] * s, now[1] - now[1] * w - now[0] * s
    end = middle[0] - middle[0] * w + middle[1] * s, middle[1] - middle[1] * w - middle[0] * s
    q, r = rk4(m, q, r, a1, h, middle, end, held)
    return q, r, end


@inlined
def rates(r: tuple, t: Touch, left_tip: bool) -> tuple:
    """Rates of v and u."""
    w = r[5] if left_tip else r[4]
    d_x, d_y = (r[0] - r[1]) + r[4] * t.l_y - r[5] * t.r_y, (r[2] - r[3]) - r[4] * t.l_x + r[5] * t.r_x
    return d_x * t.s_A - d_y * t.c_A - w * t.u, d_x * t.c_A + d_y * t.s_A + w * t.v


@inlined
def look(m: Model, q: tuple, r: tuple, held: Held) -> tuple:
    """The case (while apart the one that the positions choose), its contact, and the violated guards."""
    s1, w1 = sine_versine(q[4])
    s2, w2 = sine_versine(q[5])
    trig, turn, apart = (s1, w1, s2, w2), q[4] - q[5], held.mode == APART
    upper = turn > 0 if apart else held.upper
    pair = corners(m, q, trig, upper)
    left_tip = (pair[5] < 0 if upper else pair[5] > 0) if apart else held.left_tip
    t = on_face(m, pair, trig, left_tip)
    if apart:
        return Held(APART, upper, left_tip, 0.0), t, LIFT if t.v > 0 else 0
    violated = LIFT if t.v < 0 else 0
    if turn < 0 if upper else turn > 0:
        violated |= TURN
    if t.height > 0 if upper == left_tip else t.height < 0:
        violated |= HEIGHT
    if held.mode == STICK:
        if abs(t.u - held.u_s) - m.lag * t.v > TINY:
            violated |= LIMIT
    else:
        v_rate, u_rate = rates(r, t, left_tip)
        if sign_of(held.mode) * u_rate < m.lag * v_rate:
            violated |= REVERSE
    return held, t, violated


@compiled
def change(m: Model, q: tuple, r: tuple, held: Held, t: Touch, guard: int, late: float) -> tuple:
    """The transition of one guard, crossed at most `late` ago, and what it settles at this instant."""
    mode, upper, left_tip, u_s = held
    v_rate, u_rate = rates(r, t, left_tip)
    if guard == LIFT:
        if mode != APART:
            return Held(APART, upper, left_tip, u_s), LIFT
        slips = abs(u_rate) > m.lag * v_rate
        mode = (SLIP_PLUS if u_rate > 0 else SLIP_MINUS) if slips else STICK
        since = min(t.v / v_rate, late) if v_rate > 0 else 0.0
        return Held(mode, upper, left_tip, t.u - u_rate * since), LIFT | LIMIT
    if guard == LIMIT:
        return Held(SLIP_PLUS if t.u > u_s else SLIP_MINUS, upper, left_tip, u_s), LIMIT
    if guard == REVERSE:
        return Held(STICK, upper, left_tip, t.u - sign_of(mode) * m.lag * t.v), REVERSE | LIMIT
    if guard == TURN:  # 1 <-> 4, 2 <-> 3: the tip's block changes too
        upper = not upper
    left_tip = not left_tip
    return Held(mode, upper, left_tip, u_s + touch(m, q, upper, left_tip).u - t.u), guard


@compiled
def with_events(m: Model, q: tuple, r: tuple, a1: tuple, held: Held, trial: tuple, now: tuple, left: float) -> tuple:
    """A step of length `left` whose end, `trial`, violates guards: event by event to that end."""
    q_high, r_high, end, t, violated = trial
    for event in range(MAX_EVENTS):
        low, high = 0.0, left
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            q_there, r_there, there = rk4_from(m, q, r, a1, middle, now, held)
            held_there, t_there, beyond = look(m, q_there, r_there, held)
            if beyond:
                high, q_high, r_high, end, t, violated = middle, q_there, r_there, there, t_there, beyond
                held = held_there
            else:
                low = middle
        q, r, now = q_high, r_high, end
        left -= high
        handled = 0
        while violated:
            held, done = change(m, q, r, held, t, violated & -violated, high - low)
            handled |= done
            held, t, violated = look(m, q, r, held)
            violated &= ~handled
        if left <= 0:
            break
        a1 = first_stage(m, q, r, now, t, held)
        q_high, r_high, end = rk4_from(m, q, r, a1, left, now, held)
        held, t, violated = look(m, q_high, r_high, held)
        if not violated or event + 1 == MAX_EVENTS:
            q, r = q_high, r_high
            break
    return q, r, held, t


@compiled
def march(m: Model, steps: int, waves: Any, ends: Any) -> None:
    """One lane; `waves` is the drive's sine and cosine at half steps of one period."""
    h = 2 * math.pi / m.omega / steps
    q = r = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    held, t, _ = look(m, q, r, Held(APART, False, False, 0.0))
    for _ in range(PERIODS):
        for i in range(steps):
            now, end = (waves[2 * i, 0], waves[2 * i, 1]), (waves[2 * i + 2, 0], waves[2 * i + 2, 1])
            a1 = first_stage(m, q, r, now, t, held)
            q_end, r_end = rk4(m, q, r, a1, h, (waves[2 * i + 1, 0], waves[2 * i + 1, 1]), end, held)
            held, t, violated = look(m, q_end, r_end, held)
            if violated:
                q, r, held, t = with_events(m, q, r, a1, held, (q_end, r_end, end, t, violated), now, h)
            else:
                q, r = q_end, r_end
    for i in range(6):
        ends[i], ends[6 + i] = q[i], r[i]


def prepare(problem: Problem) -> Callable[[int], np.ndarray]:
    """Integrate all lanes with so many steps per period."""
    scenes = [model(problem, float(gamma)) for gamma in problem.gamma]

    def integrate(steps: int) -> np.ndarray:
        angle = np.pi * np.arange(2 * steps + 1) / steps
        waves, ends = np.stack([np.sin(angle), np.cos(angle)], axis=-1), np.empty((len(scenes), 12))
        for scene, end in zip(scenes, ends, strict=True):
            march(scene, steps, waves, end)
        return ends

    integrate(8)  # compiles
    return integrate
