"""Taylor series of adaptive step with heyoka.py, one SIMD lane per run, every change of the contact a terminal event.

One integrator per tolerance is compiled and serves all modes and cases: what differs between them is a runtime
parameter of the lane. The equations are arranged for few products of series, whose cost grows with the square of the
order: the drive is an oscillator carried in the state, the contact force and the moment on the face's own block are
written along the face. Guards rise through zero; the callback hands the transition to compiled code, and a lane whose
run is over takes up the next run at once.
"""

import importlib.util
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from problem import PERIODS, Problem

try:
    import heyoka as hy
    from numba import njit
except ImportError:  # told by missing()
    njit = lambda f: f

NAME = "heyoka.py, batch Taylor, terminal events"
SETTINGS = 1e-3, 1e-4, *(a * 10.0**-n for n in range(5, 12) for a in (3, 1)), 1e-12  # tolerances
CALLS = 20_000  # of a callback, timed

# Guards are lowered by this much [m or rad]: heyoka loses the next root of a series that starts at exactly zero, as a
# guard does that was crossed just now. It also keeps a transition from undoing itself, so that no cooldown is needed.
SHIFT = 2e-16
APART, STICK, SLIP_PLUS, SLIP_MINUS = range(4)
LIFT, TURN, HEIGHT, PLUS, MINUS, END = EVENTS = range(6)
ONSET, SEPARATION, THETA, LEVEL, LIMIT, REVERSE = (1 << i for i in range(6))  # what has happened at this instant
COS, CLOCK, STATES = 13, 14, 15  # the drive and the time since the start follow the 12 motion numbers
# Rows of `book`: what changes in a lane, and constants.
MODE, CASE, U_S, HANDLED, LAST, RUN, SPRING = range(7)
FREE_CASE, A_X, B_X, H_Y, SIN_ALPHA, COS_ALPHA, GAP, MU, K_D, UNIT, FAST, ROWS = range(7, 19)
# Runtime parameters of a lane. The "tip" is the block whose corner presses, the "face" is the other one.
LEFT_TIP, RIGHT_TIP, CORNER_Y, LEFT_X, RIGHT_X, REST = range(6)
K, G_U, G_V, G_0, FACE_U, FACE_V, FACE_0, LAG, SLIDE_0 = range(6, 15)
LIFT_SIGN, TURN_SIGN, HEIGHT_SIGN = range(15, 18)
PLUS_U, PLUS_V, PLUS_0, PLUS_S, MINUS_U, MINUS_V, MINUS_0, MINUS_S, PARS = range(18, 27)


def missing() -> str | None:
    """Why this peer cannot run here, if so."""
    absent = [name for name in ("heyoka", "numba") if importlib.util.find_spec(name) is None]
    return f"needs {' and '.join(absent)}" if absent else None


def equations(p: Problem) -> tuple[list, list]:
    """The right-hand side, and the six functions that rise through zero at an event."""
    motion = ["x1", "x2", "y1", "y2", "th1", "th2", "vx1", "vx2", "vy1", "vy2", "w1", "w2"]
    x1, x2, y1, y2, th1, th2, vx1, vx2, vy1, vy2, w1, w2, wave_s, wave_c, clock = state = hy.make_vars(
        *motion, "s", "c", "t"
    )
    P = [hy.par[i] for i in range(PARS)]
    sin_alpha, cos_alpha = math.sin(p.alpha), math.cos(p.alpha)
    s1, c1, s2, c2 = hy.sin(th1), hy.cos(th1), hy.sin(th2), hy.cos(th2)
    face = lambda left, right: P[RIGHT_TIP] * left + P[LEFT_TIP] * right
    tip = lambda left, right: P[LEFT_TIP] * left + P[RIGHT_TIP] * right

    left = P[LEFT_X] * c1 + P[CORNER_Y] * s1, P[CORNER_Y] * c1 - P[LEFT_X] * s1
    right = P[RIGHT_X] * c2 + P[CORNER_Y] * s2, P[CORNER_Y] * c2 - P[RIGHT_X] * s2
    e_x, e_y = x1 - x2 + left[0] - right[0] - P[REST], y1 - y2 + left[1] - right[1]
    s_f, c_f = face(s1, s2), face(c1, c2)
    s_A, c_A = sin_alpha * c_f - cos_alpha * s_f, cos_alpha * c_f + sin_alpha * s_f
    v, u = e_x * s_A - e_y * c_A, e_x * c_A + e_y * s_A

    G = P[G_U] * u + P[G_V] * v + P[G_0]  # k u - F: the force is -k e + G t, as v n = e - u t
    R_x, R_y = G * c_A - P[K] * e_x, G * s_A - P[K] * e_y
    lever_x, lever_y = (P[LEFT_TIP] * a - P[RIGHT_TIP] * b for a, b in zip(left, right, strict=True))
    on_tip = lever_y * R_x - lever_x * R_y
    on_face = G * (v + P[FACE_0]) + P[FACE_U] * u + P[FACE_V] * v
    M = tip(on_tip, on_face), face(on_tip, on_face)

    rates = []
    for axis, (mass, k, c, load) in enumerate(
        (
            (p.m, p.k_x, p.c_x, (p.F_0 * math.cos(p.beta), (R_x, -R_x))),
            (p.m, p.k_y, p.c_y, (p.F_0 * math.sin(p.beta), (R_y, -R_y))),
            (p.I, p.k_T, p.c_T, (p.M_0, M)),
        )
    ):
        for i, phase in enumerate(p.phase):
            sine, cosine = load[0] * math.cos(phase) / mass, load[0] * math.sin(phase) / mass
            drive = sine * wave_s + (cosine * wave_c if abs(cosine) > 1e-14 * abs(sine) else 0.0)
            q, rate = state[2 * axis + i], state[6 + 2 * axis + i]
            rates.append(drive + load[1][i] / mass - c / mass * rate - k / mass * q)
    derivatives = [vx1, vx2, vy1, vy2, w1, w2, *rates, p.omega * wave_c, -p.omega * wave_s, hy.expression(1.0)]

    w_t, w_f = tip(w1, w2), face(w1, w2)
    m_x, m_y = c_A - P[LAG] * s_A, s_A + P[LAG] * c_A  # t - lag n: slider speed along the corner's velocity
    speed = (vx1 - vx2 + w_t * lever_y) * m_x + (vy1 - vy2 - w_t * lever_x) * m_y + w_f * (v + P[LAG] * u + P[SLIDE_0])
    guards = [
        P[LIFT_SIGN] * v - SHIFT,
        P[TURN_SIGN] * (th1 - th2) - SHIFT,
        P[HEIGHT_SIGN] * e_y - SHIFT,
        P[PLUS_U] * u + P[PLUS_V] * v + P[PLUS_S] * speed + P[PLUS_0],
        P[MINUS_U] * u + P[MINUS_V] * v + P[MINUS_S] * speed + P[MINUS_0],
        clock - PERIODS * 2 * math.pi / p.omega,
    ]
    return list(zip(state, derivatives, strict=True)), guards


@njit
def look(z: Any, book: Any, i: int, case: int) -> tuple:
    """v, u, their rates, height and turn of lane `i` in a case."""
    s1, c1, s2, c2 = math.sin(z[4, i]), math.cos(z[4, i]), math.sin(z[5, i]), math.cos(z[5, i])
    w1, w2 = z[10, i], z[11, i]
    l0, r0, y0 = corners(book, i, case)
    l_x, l_y = l0 * c1 + y0 * s1, y0 * c1 - l0 * s1
    r_x, r_y = r0 * c2 + y0 * s2, y0 * c2 - r0 * s2
    e_x, e_y = z[0, i] - z[1, i] + (l_x - l0) - (r_x - r0) - book[GAP, i], z[2, i] - z[3, i] + (l_y - r_y)
    s_f, c_f, w_f = (s2, c2, w2) if case % 2 else (s1, c1, w1)
    s_A = book[SIN_ALPHA, i] * c_f - book[COS_ALPHA, i] * s_f
    c_A = book[COS_ALPHA, i] * c_f + book[SIN_ALPHA, i] * s_f
    v, u = e_x * s_A - e_y * c_A, e_x * c_A + e_y * s_A
    d_x, d_y = z[6, i] - z[7, i] + w1 * l_y - w2 * r_y, z[8, i] - z[9, i] - w1 * l_x + w2 * r_x
    return v, u, d_x * s_A - d_y * c_A - w_f * u, d_x * c_A + d_y * s_A + w_f * v, e_y, z[4, i] - z[5, i]


@njit
def corners(book: Any, i: int, case: int) -> tuple:
    """x of the left and of the right block's corner about its centre, and y of both."""
    if case <= 2:
        return book[A_X, i], -book[B_X, i], book[H_Y, i]
    return book[B_X, i], -book[A_X, i], -book[H_Y, i]


@njit
def settle(z: Any, pars: Any, book: Any, i: int) -> None:
    """Write the runtime parameters of lane `i` for its mode, case and slider."""
    mode, case, u_s, k = book[MODE, i], int(book[CASE, i]), book[U_S, i], book[SPRING, i]
    left_tip = case % 2 == 1
    l0, r0, y0 = corners(book, i, case)
    pars[LEFT_TIP, i], pars[RIGHT_TIP, i] = (1.0, 0.0) if left_tip else (0.0, 1.0)
    pars[CORNER_Y, i], pars[LEFT_X, i], pars[RIGHT_X, i] = y0, l0, r0
    pars[REST, i] = l0 - r0 + book[GAP, i]
    q_x, q_y = (r0, y0) if left_tip else (-l0, -y0)  # the face's own corner, turned round if on the left block
    q_n = q_x * book[SIN_ALPHA, i] - q_y * book[COS_ALPHA, i]
    q_t = q_x * book[COS_ALPHA, i] + q_y * book[SIN_ALPHA, i]

    sigma = 1.0 if mode == SLIP_PLUS else -1.0 if mode == SLIP_MINUS else 0.0
    lag = book[MU, i] * k / book[K_D, i]
    k = 0.0 if mode == APART else k
    k_d = book[K_D, i] if mode == STICK else 0.0
    pars[K, i] = k
    pars[G_U, i], pars[G_V, i], pars[G_0, i] = k - k_d, -sigma * book[MU, i] * k, k_d * u_s
    pars[FACE_U, i], pars[FACE_V, i], pars[FACE_0, i] = -k * q_n, k * q_t, q_n
    pars[LAG, i], pars[SLIDE_0, i] = sigma * lag, q_n + sigma * lag * q_t

    pars[LIFT_SIGN, i] = 1.0 if mode == APART else -1.0
    pars[TURN_SIGN, i] = -1.0 if case <= 2 else 1.0
    pars[HEIGHT_SIGN, i] = 1.0 if (case <= 2) == left_tip else -1.0
    for j in range(PLUS_U, PARS):
        pars[j, i] = 0.0
    pars[PLUS_0, i] = pars[MINUS_0, i] = -1.0
    if mode == STICK:
        pars[PLUS_U, i], pars[PLUS_V, i], pars[PLUS_0, i] = 1.0, -lag, -u_s - SHIFT
        pars[MINUS_U, i], pars[MINUS_V, i], pars[MINUS_0, i] = -1.0, -lag, u_s - SHIFT
    elif mode == SLIP_PLUS:
        pars[PLUS_S, i], pars[PLUS_0, i] = -1.0, 0.0
    elif mode == SLIP_MINUS:
        pars[MINUS_S, i], pars[MINUS_0, i] = 1.0, 0.0


@njit
def change(what: int, z: Any, book: Any, i: int) -> int:
    """One transition of lane `i`; what else it settles at this instant."""
    mode, case = book[MODE, i], int(book[CASE, i])
    v, u, v_rate, u_rate, _, _ = look(z, book, i, case)
    lag = book[MU, i] * book[SPRING, i] / book[K_D, i]
    if what == ONSET:
        slips = abs(u_rate) > lag * v_rate
        book[MODE, i] = (SLIP_PLUS if u_rate > 0 else SLIP_MINUS) if slips else STICK
        book[U_S, i] = u
        return what | SEPARATION | LIMIT
    if what == SEPARATION:
        book[MODE, i] = APART
        return what | ONSET
    if what == LIMIT:
        book[MODE, i] = SLIP_PLUS if u > book[U_S, i] else SLIP_MINUS
        return what
    if what == REVERSE:
        book[U_S, i] = u - (lag if mode == SLIP_PLUS else -lag) * v
        book[MODE, i] = STICK
        return what | LIMIT
    book[CASE, i] = 5 - case if what == THETA else case + 1 if case % 2 else case - 1
    if mode == STICK:
        book[U_S, i] += look(z, book, i, int(book[CASE, i]))[1] - u
    return what


@njit
def due(z: Any, book: Any, i: int) -> int:
    """A transition that lane `i` has to make and has not made at this instant, or 0."""
    mode, case, handled, unit = book[MODE, i], int(book[CASE, i]), int(book[HANDLED, i]), book[UNIT, i]
    v, u, v_rate, u_rate, height, turn = look(z, book, i, case)
    lag = book[MU, i] * book[SPRING, i] / book[K_D, i]
    if not handled & THETA and (-turn if case <= 2 else turn) > unit:
        return THETA
    if not handled & LEVEL and (height if case in (1, 4) else -height) > unit:
        return LEVEL
    if mode == APART:
        return ONSET if not handled & ONSET and v > unit else 0
    if not handled & SEPARATION and -v > unit:
        return SEPARATION
    if mode == STICK:
        return LIMIT if not handled & LIMIT and abs(u - book[U_S, i]) - lag * v > unit * (1 + lag) else 0
    sigma = 1.0 if mode == SLIP_PLUS else -1.0
    back = -sigma * u_rate + lag * v_rate > unit * (1 + lag) * book[FAST, i]
    return REVERSE if not handled & REVERSE and back else 0


@njit
def cross(event: int, i: int, z: Any, pars: Any, book: Any) -> bool:
    """What the crossing of a guard sets off in lane `i`."""
    if z[CLOCK, i] > book[LAST, i] + 1e-16:
        book[HANDLED, i] = 0
    book[LAST, i] = z[CLOCK, i]
    if event == LIFT:
        what = ONSET if book[MODE, i] == APART else SEPARATION
    elif event == TURN:
        what = THETA
    elif event == HEIGHT:
        what = LEVEL
    else:
        what = LIMIT if book[MODE, i] == STICK else REVERSE
    for _ in range(12):
        book[HANDLED, i] = int(book[HANDLED, i]) | change(what, z, book, i)
        what = due(z, book, i)
        if what == 0:
            break
    settle(z, pars, book, i)
    return True


@njit
def start(run: int, spring: float, i: int, z: Any, pars: Any, book: Any) -> None:
    """Put lane `i` at rest at the beginning of a run."""
    z[:, i] = 0.0
    z[COS, i] = 1.0
    book[RUN, i], book[SPRING, i] = run, spring
    book[MODE, i], book[CASE, i], book[U_S, i] = APART, book[FREE_CASE, i], 0.0
    book[HANDLED, i], book[LAST, i] = 0, -1.0
    settle(z, pars, book, i)


def constants(p: Problem, batch: int) -> np.ndarray:
    """`book` before the first run."""
    lean, half, height = p.l_ab * math.cos(p.alpha) / 2, p.l_oa / 2, p.l_ab * math.sin(p.alpha) / 2
    values = np.zeros(ROWS)
    values[[A_X, B_X, H_Y, GAP, MU, K_D]] = half + lean, half - lean, height, p.gap, p.mu, p.k_d
    values[[SIN_ALPHA, COS_ALPHA]] = math.sin(p.alpha), math.cos(p.alpha)
    values[[UNIT, FAST]] = SHIFT / 2, math.sqrt(max(p.k_y, p.k_x) / p.m)
    book = np.repeat(values[:, None], batch, axis=1)
    book[FREE_CASE] = first_case(p, book)
    return book


def first_case(p: Problem, book: np.ndarray) -> int:
    """The case just after a start from rest, where all guards are zero: that of the motion the drive sets off."""
    t = 1e-5 / p.omega
    z = np.zeros((STATES, 1))
    for i, phase in enumerate(p.phase):
        way = t * t / 2 * math.sin(phase) + t**3 * p.omega / 6 * math.cos(phase)
        z[0 + i] = p.F_0 * math.cos(p.beta) / p.m * way
        z[2 + i] = p.F_0 * math.sin(p.beta) / p.m * way
        z[4 + i] = p.M_0 / p.I * way
    if z[4, 0] > z[5, 0]:
        return 1 if look(z, book, 0, 1)[4] < 0 else 2
    return 3 if look(z, book, 0, 3)[4] > 0 else 4


class Machine:
    """An integrator of one tolerance and what its lanes carry."""

    def __init__(self, p: Problem, tolerance: float, batch: int, counted: bool = False):
        self.calls, self.crossing = 0, self.counting if counted else self.plain
        self.springs, self.batch = (p.gamma * p.k_x).tolist(), batch
        self.book, self.ends = constants(p, batch), np.empty((len(self.springs), 12))
        self.begun = self.ended = 0
        motion, guards = equations(p)
        calls = [*(self.crossing(event) for event in EVENTS[:-1]), lambda ta, sign, lane: self.over(lane)]
        how = {"direction": hy.event_direction.positive, "cooldown": 0.0}
        events = [hy.t_event_batch(g, callback=call, **how) for g, call in zip(guards, calls, strict=True)]
        state, pars = np.zeros((STATES, batch)), np.zeros((PARS, batch))
        self.ta = hy.taylor_adaptive_batch(motion, state, tol=tolerance, t_events=events, pars=pars)
        self.state, self.pars = self.ta.state, self.ta.pars  # views

    def plain(self, event: int) -> Callable:
        """The callback of a guard: a plain function, as heyoka copies what it is given."""
        return lambda ta, sign, lane: cross(event, lane, self.state, self.pars, self.book)

    def counting(self, event: int) -> Callable:
        """The same, counted."""

        def call(ta: Any, sign: int, lane: int) -> bool:
            self.calls += 1
            return cross(event, lane, self.state, self.pars, self.book)

        return call

    def begin(self, lane: int) -> None:
        """The next run; where all are taken, the last one again, to keep the lane busy."""
        run = min(self.begun, len(self.springs) - 1)
        start(self.begun, self.springs[run], lane, self.state, self.pars, self.book)
        self.begun += 1

    def over(self, lane: int) -> bool:
        """Keep the end of a run and begin the next; False once all have ended."""
        run, runs = int(self.book[RUN, lane]), len(self.springs)
        if run < runs:
            self.ends[run] = self.state[:12, lane]
            self.ended += 1
        self.begin(lane)
        return self.ended < runs

    def run(self) -> np.ndarray:
        """All runs from start to end."""
        self.begun = self.ended = 0
        self.ta.set_time(0.0)
        self.ta.reset_cooldowns()
        for lane in range(self.batch):
            self.begin(lane)
        self.ta.propagate_until(1e9)  # an end of a run stops it
        return self.ends.copy()


def callbacks(problem: Problem) -> float:
    """Seconds that all runs spend in Python and in the transitions at events: calls, times what one takes."""
    machine = Machine(problem, 1e-6, hy.recommended_simd_size(), counted=True)
    machine.run()
    begun = time.process_time()
    for _ in range(CALLS // 2):  # stick begins and ends
        machine.plain(4)(None, 1, 0)
        machine.plain(3)(None, 1, 0)
    return (time.process_time() - begun) / CALLS * machine.calls


def prepare(problem: Problem) -> Callable[[float], np.ndarray]:
    """Integrate all lanes at a tolerance; its integrator is compiled at the first call with it."""
    machines: dict[float, Machine] = {}
    batch = hy.recommended_simd_size()

    def integrate(tolerance: float) -> np.ndarray:
        if tolerance not in machines:
            machines[tolerance] = Machine(problem, tolerance, batch)
        return machines[tolerance].run()

    return integrate
