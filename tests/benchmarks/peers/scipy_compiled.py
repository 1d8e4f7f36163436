"""SciPy's solve_ivp with DOP853, restarted at every change of the contact; right-hand side and guards are compiled.

Guards are terminal events that rise through zero. What holds between two of them is an argument of the compiled
functions.
"""

import importlib.util
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from problem import PERIODS, Problem

try:
    from numba import njit
    from scipy.integrate import solve_ivp
except ImportError:  # told by missing()
    njit = lambda **_: lambda f: f

NAME = "SciPy DOP853, terminal events, compiled functions"
SETTINGS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # relative tolerances
LANES = 16  # the most to be given: a lane takes milliseconds per period

APART, STICK, SLIP_PLUS, SLIP_MINUS = range(4)
LIFT, TURN, HEIGHT, RUB = range(4)
# Guards are lowered by this much [m; rad]: more than they change in the 1e-15 s to which roots are known, so that one
# that was crossed just now starts below zero. Else SciPy would miss that it is crossed again in the next step.
SHIFT, TURN_SHIFT = 1e-14, 2e-13
LONGEST = 1 / 50  # step, in periods: guards are looked at where steps end
MODE, UPPER, LEFT_TIP, U_S, SPRING = range(5)  # what holds between two events: five numbers


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    absent = [name for name in ("scipy", "numba") if importlib.util.find_spec(name) is None]
    return f"needs {' and '.join(absent)}" if absent else None


def scales(p: Problem) -> np.ndarray:
    """Size of each motion number, for absolute tolerances."""
    turn = p.M_0 / abs(p.k_T - p.I * p.omega**2)
    place = p.F_0 / min(p.k_x, p.k_y) + p.gap
    return np.array([place] * 4 + [turn] * 2 + [place * p.omega] * 4 + [turn * p.omega] * 2)


def functions(p: Problem) -> tuple[Callable, Callable, Callable]:
    """Right-hand side, a function (v, u, their rates, height, turn) of a contact, and the four guards, compiled."""
    half, lean, height = p.l_oa / 2, p.l_ab * math.cos(p.alpha) / 2, p.l_ab * math.sin(p.alpha) / 2
    sin_alpha, cos_alpha, gap, k_d, mu, omega = math.sin(p.alpha), math.cos(p.alpha), p.gap, p.k_d, p.mu, p.omega
    F_x, F_y, M_0 = p.F_0 * math.cos(p.beta), p.F_0 * math.sin(p.beta), p.M_0
    (phase_1, phase_2), m, I = p.phase, p.m, p.I
    k_x, k_y, k_T, c_x, c_y, c_T = p.k_x, p.k_y, p.k_T, p.c_x, p.c_y, p.c_T

    @njit(fastmath=True)
    def corners(y: Any, trig: tuple, upper: bool) -> tuple:
        s1, w1, s2, w2 = trig
        side = 1.0 if upper else -1.0
        l0, r0, y0 = side * lean + half, side * lean - half, side * height
        l_dx, l_dy, r_dx, r_dy = y0 * s1 - l0 * w1, y0 * w1 + l0 * s1, y0 * s2 - r0 * w2, y0 * w2 + r0 * s2
        e_x, e_y = (y[0] - y[1] - gap) + (l_dx - r_dx), (y[2] - y[3]) - (l_dy - r_dy)
        return l0 + l_dx, y0 - l_dy, r0 + r_dx, y0 - r_dy, e_x, e_y

    @njit(fastmath=True)
    def trigonometry(y: Any) -> tuple:
        return math.sin(y[4]), 2 * math.sin(y[4] / 2) ** 2, math.sin(y[5]), 2 * math.sin(y[5] / 2) ** 2

    @njit(fastmath=True)
    def on_face(pair: tuple, trig: tuple, left_tip: bool) -> tuple:
        s_f, w_f = (trig[2], trig[3]) if left_tip else (trig[0], trig[1])
        s_A = sin_alpha - (sin_alpha * w_f + cos_alpha * s_f)
        c_A = cos_alpha - (cos_alpha * w_f - sin_alpha * s_f)
        return s_A, c_A, pair[4] * s_A - pair[5] * c_A, pair[4] * c_A + pair[5] * s_A

    @njit(fastmath=True)
    def rhs(t: float, y: Any, held: Any) -> Any:
        R_x = R_y = M_1 = M_2 = 0.0
        if held[MODE] != APART:
            trig, left_tip = trigonometry(y), held[LEFT_TIP] > 0
            pair = corners(y, trig, held[UPPER] > 0)
            s_A, c_A, v, u = on_face(pair, trig, left_tip)
            N = held[SPRING] * v
            F = k_d * (u - held[U_S]) if held[MODE] == STICK else mu * N if held[MODE] == SLIP_PLUS else -mu * N
            R_x, R_y = -N * s_A - F * c_A, N * c_A - F * s_A
            M_1, M_2 = pair[1] * R_x - pair[0] * R_y, pair[2] * R_y - pair[3] * R_x
            if left_tip:
                M_2 += u * N - v * F
            else:
                M_1 += u * N - v * F
        s_1, s_2 = math.sin(omega * t + phase_1), math.sin(omega * t + phase_2)
        d = np.empty(12)
        d[:6] = y[6:]
        d[6] = (F_x * s_1 + R_x - c_x * y[6] - k_x * y[0]) / m
        d[7] = (F_x * s_2 - R_x - c_x * y[7] - k_x * y[1]) / m
        d[8] = (F_y * s_1 + R_y - c_y * y[8] - k_y * y[2]) / m
        d[9] = (F_y * s_2 - R_y - c_y * y[9] - k_y * y[3]) / m
        d[10] = (M_0 * s_1 + M_1 - c_T * y[10] - k_T * y[4]) / I
        d[11] = (M_0 * s_2 + M_2 - c_T * y[11] - k_T * y[5]) / I
        return d

    @njit(fastmath=True)
    def look(y: Any, held: Any) -> tuple:
        """Upper and left tip (while apart as the positions choose), v, u, their rates, height and turn."""
        trig, turn = trigonometry(y), y[4] - y[5]
        upper = turn > 0 if held[MODE] == APART else held[UPPER] > 0
        pair = corners(y, trig, upper)
        natural = pair[5] < 0 if upper else pair[5] > 0
        left_tip = natural if held[MODE] == APART else held[LEFT_TIP] > 0
        s_A, c_A, v, u = on_face(pair, trig, left_tip)
        w = y[11] if left_tip else y[10]
        d_x = (y[6] - y[7]) + y[10] * pair[1] - y[11] * pair[3]
        d_y = (y[8] - y[9]) - y[10] * pair[0] + y[11] * pair[2]
        v_rate, u_rate = d_x * s_A - d_y * c_A - w * u, d_x * c_A + d_y * s_A + w * v
        return upper, left_tip, v, u, v_rate, u_rate, pair[5], turn

    @njit(fastmath=True)
    def guards(y: Any, held: Any) -> tuple:
        """By kind: negative while what is held may go on."""
        upper, left_tip, v, u, v_rate, u_rate, height, turn = look(y, held)
        if held[MODE] == APART:
            return v - SHIFT, -1.0, -1.0, -1.0
        lag = mu * held[SPRING] / k_d
        if held[MODE] == STICK:
            rub = abs(u - held[U_S]) - lag * v - SHIFT
        else:
            rub = lag * v_rate - (u_rate if held[MODE] == SLIP_PLUS else -u_rate)
        turn, height = -turn if upper else turn, height if upper == left_tip else -height
        return -v - SHIFT, turn - TURN_SHIFT, height - SHIFT, rub

    @njit(fastmath=True)
    def change(y: Any, held: Any, kind: int) -> None:
        """The transition of a guard."""
        upper, left_tip, v, u, v_rate, u_rate, _, _ = look(y, held)
        lag = mu * held[SPRING] / k_d
        held[UPPER], held[LEFT_TIP] = upper, left_tip
        if kind == LIFT and held[MODE] == APART:
            slips = abs(u_rate) > lag * v_rate
            held[MODE] = (SLIP_PLUS if u_rate > 0 else SLIP_MINUS) if slips else STICK
            held[U_S] = u
        elif kind == LIFT:
            held[MODE] = APART
        elif kind == RUB and held[MODE] == STICK:
            held[MODE] = SLIP_PLUS if u > held[U_S] else SLIP_MINUS
        elif kind == RUB:
            held[U_S] = u - (lag if held[MODE] == SLIP_PLUS else -lag) * v
            held[MODE] = STICK
        else:
            if kind == TURN:  # 1 <-> 4, 2 <-> 3: the tip's block changes too
                held[UPPER] = 1 - held[UPPER]
            held[LEFT_TIP] = 1 - held[LEFT_TIP]
            held[U_S] += look(y, held)[3] - u

    @njit(fastmath=True)
    def settle(y: Any, held: Any, kind: int) -> None:
        """The transition of a guard and those that it sets off at the same instant."""
        handled = 0
        while kind >= 0:
            change(y, held, kind)
            handled |= 1 << kind
            if kind == LIFT:
                handled |= 1 << RUB
            values, kind = guards(y, held), -1
            for other in range(4):
                if kind < 0 and values[other] > 0 and not handled >> other & 1:
                    kind = other

    def event(kind: int) -> Callable:
        @njit(fastmath=True)
        def guard(t: float, y: Any, held: Any) -> float:
            return guards(y, held)[kind]

        guard.terminal, guard.direction = True, 1.0
        return guard

    return rhs, settle, [event(kind) for kind in range(4)]


def prepare(problem: Problem) -> Callable[[float], np.ndarray]:
    """Integrate all lanes at a relative tolerance."""
    rhs, settle, events = functions(problem)
    scale, period = scales(problem), 2 * math.pi / problem.omega

    def march(k: float, rtol: float) -> np.ndarray:
        t, end, y, held = 0.0, PERIODS * period, np.zeros(12), np.array([APART, 0.0, 0.0, 0.0, k])
        limits = {"rtol": rtol, "atol": rtol * scale, "max_step": LONGEST * period}
        step = None
        while t < end:
            run = solve_ivp(rhs, (t, end), y, "DOP853", events=events, args=(held,), first_step=step, **limits)
            if run.status < 0:
                raise RuntimeError(run.message)
            t, y = run.t[-1], run.y[:, -1]
            step = min(np.diff(run.t).max(), end - t)
            if run.status == 1:
                settle(y, held, next(kind for kind, found in enumerate(run.t_events) if len(found)))
        return y

    def integrate(rtol: float) -> np.ndarray:
        return np.array([march(float(k), rtol) for k in problem.gamma * problem.k_x])

    y, held = np.zeros(12), np.array([APART, 0.0, 0.0, 0.0, problem.k_x])
    settle(y, held, -1)  # compiles, as the others are at first call
    for f in (rhs, *events):
        f(0.0, y, held)
    return integrate
