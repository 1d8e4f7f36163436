"""An independent second opinion of the rub-impact dynamics of two shrouded blades.

Plain floats, NumPy and SciPy only.  The motion is integrated with DOP853 between events; every event (onset,
separation, stick to slip, slip to stick, change of the contact case) is located on the dense output and the
integrator is started afresh behind it.  Equation numbers are those of the article.

Units are SI, blade 0 is the left one, angles are positive clockwise, y points up.  Positions are ordered
x1, x2, y1, y2, theta1, theta2; a state is the six positions followed by their six rates.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

APART, STICK, SLIP_PLUS, SLIP_MINUS = range(4)
SIGMA = {SLIP_PLUS: 1.0, SLIP_MINUS: -1.0}
PRINTED = frozenset({"gap_sign", "friction_components", "M_N2_case1", "M_N1_case2", "M_N1_case4", "levers"})
ONSETS, SLIPS = ("onset_slip", "onset_stick", "separation"), ("stick_slip", "slip_stick")
COUNTS = (*ONSETS, *SLIPS, "switch_14", "switch_23", "switch_12", "switch_34")
PAIRS = ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T", "m_y", "beta", "F_0", "M_0", "phase")
OPPOSITE = {1: 4, 4: 1, 2: 3, 3: 2}  # cases that meet at theta_1 = theta_2
SUBPOINTS = 16  # points of each step at which the guards are looked at
Pair = tuple[float, float]


@dataclass(frozen=True)
class Parameters:
    """Two blades, their contact and their drive: Q_i = F_0 sin(omega t + phase) at beta, M_i likewise."""

    m: Pair
    I: Pair
    k_x: Pair
    k_y: Pair
    k_T: Pair
    c_x: Pair
    c_y: Pair
    c_T: Pair
    m_y: Pair
    alpha: float
    l_oa: float
    l_ab: float
    gap: float
    k: float
    k_d: float
    mu: float
    omega: float
    beta: Pair
    F_0: Pair
    M_0: Pair
    phase: Pair
    reading: frozenset[str] = frozenset()
    initial: tuple[float, ...] = (0.0,) * 12
    k_face: float = 0.0  # rotational spring between the faces, N m/rad, critically damped; 0: corner contact

    def __post_init__(self) -> None:
        if unknown := self.reading - PRINTED:
            raise ValueError(f"unknown misprints {sorted(unknown)}")

    @cached_property
    def corners(self) -> tuple[float, float, float, float]:
        """Lengths l_ap, l_ob and angles varphi_1, varphi_2 of a parallelogram leaning to the right."""
        lean, height = self.l_ab * math.cos(self.alpha) / 2, self.l_ab * math.sin(self.alpha) / 2
        right, left = self.l_oa / 2 + lean, self.l_oa / 2 - lean
        return (
            *(2 * math.hypot(right, height), 2 * math.hypot(left, height)),
            *(math.atan2(height, right), math.atan2(height, left)),
        )

    @cached_property
    def rubs(self) -> bool:
        """Whether there is any friction force."""
        return self.mu > 0 and self.k_d > 0 and self.k > 0


@dataclass
class Outcome:
    """Where a run ended, what happened on the way, and its energy account (joule)."""

    status: str  # ok, face_to_face, too_many_events, not_finite, angle
    t: float
    y: np.ndarray
    u_s: float
    mode: int
    case: int
    counts: dict[str, int]
    events: list[tuple[float, str]]
    samples: np.ndarray
    power: tuple[float, float]
    energy: dict[str, float]


class Relative(NamedTuple):
    """Relative motion of the two corners of one case; floats, or arrays over time."""

    v: Any
    u: Any
    v_rate: Any
    u_rate: Any
    dx: Any  # the difference of the corners' x displacements less the gap
    dy: Any  # the difference of their y displacements: "corner height difference"
    face: Any  # angle of the face, alpha - theta_2 (cases 1, 3) or alpha - theta_1 (2, 4)


def relative(p: Parameters, case: int, q, rate, lib=math) -> Relative:
    """Displacements (3)-(6) of the corners; v_1 of (8), (12), (16), (19), its tangential twin, rates."""
    x1, x2, y1, y2, th1, th2 = q
    x1_, x2_, y1_, y2_, th1_, th2_ = rate
    l_ap, l_ob, phi1, phi2 = p.corners
    sin, cos = lib.sin, lib.cos
    s1, s2 = sin(th1 / 2), sin(th2 / 2)
    if case <= 2:  # corners a and c
        e1, e2 = (2 * phi1 - th1) / 2, (2 * phi2 + th2) / 2
        dx = x1 + l_ap * s1 * sin(e1) - x2 - l_ob * s2 * sin(e2) - p.gap
        dy = y1 - l_ap * s1 * cos(e1) - y2 - l_ob * s2 * cos(e2)
        dx_ = x1_ + l_ap / 2 * sin(phi1 - th1) * th1_ - x2_ - l_ob / 2 * sin(phi2 + th2) * th2_
        dy_ = y1_ - l_ap / 2 * cos(phi1 - th1) * th1_ - y2_ - l_ob / 2 * cos(phi2 + th2) * th2_
    else:  # corners b and d
        e1, e2 = (2 * phi2 + th1) / 2, (2 * phi1 - th2) / 2
        dx = x1 - l_ob * s1 * sin(e1) - x2 + l_ap * s2 * sin(e2) - p.gap
        dy = y1 - l_ob * s1 * cos(e1) - y2 - l_ap * s2 * cos(e2)
        dx_ = x1_ - l_ob / 2 * sin(phi2 + th1) * th1_ - x2_ + l_ap / 2 * sin(phi1 - th2) * th2_
        dy_ = y1_ - l_ob / 2 * cos(phi2 + th1) * th1_ - y2_ - l_ap / 2 * cos(phi1 - th2) * th2_
    face, turn = (p.alpha - th2, -th2_) if case in (1, 3) else (p.alpha - th1, -th1_)
    sa, ca = sin(face), cos(face)
    sign = 1.0 if "gap_sign" in p.reading else -1.0
    v = dx * sa + sign * dy * ca
    u = dx * ca - sign * dy * sa
    v_rate = dx_ * sa + sign * dy_ * ca + u * turn
    u_rate = dx_ * ca - sign * dy_ * sa - v * turn
    return Relative(v, u, v_rate, u_rate, dx, dy, face)


def choose_case(p: Parameters, q) -> int:
    """The four cases of Section 2.3."""
    if q[4] > q[5]:
        return 1 if relative(p, 1, q, (0.0,) * 6).dy < 0 else 2
    return 3 if relative(p, 3, q, (0.0,) * 6).dy > 0 else 4


def friction(p: Parameters, mode: int, r: Relative, u_s: float) -> float:
    """Equation (2), with the sliding force mu N in slip."""
    if not p.rubs or mode == APART:
        return 0.0
    return p.k_d * (r.u - u_s) if mode == STICK else SIGMA[mode] * p.mu * p.k * r.v


def moments(p: Parameters, case: int, q, r: Relative, N: float, F: float) -> tuple[float, float]:
    """Moments (10), (14), (17), (20) about the two centres, corrected unless the reading says otherwise."""
    l_ap, l_ob, phi1, phi2 = p.corners
    a, th1, th2 = p.alpha, q[4], q[5]
    sa, ca = math.sin(r.face), math.cos(r.face)
    if "levers" in p.reading:
        offset, arm = r.dy / sa, l_ap * math.sin(a - phi1) / 2
    else:  # along and across the face, from the face's own corner to the corner that touches it
        offset = r.dx * ca + r.dy * sa
        arm = l_ap * math.sin(a - phi1) / 2 - (r.dx * sa - r.dy * ca)
    turn = th1 - th2 if case in (1, 3) else th2 - th1  # of the corner's block against the face's
    if case in (1, 4):  # corners a and d; the face's own corners are c and b
        length, e, rest = l_ap / 2, a - phi1 + turn, l_ob / 2 * math.cos(a + phi2)
    else:
        length, e, rest = l_ob / 2, a + phi2 + turn, l_ap / 2 * math.cos(a - phi1)
    if case == 2 and "M_N1_case2" in p.reading:
        offset += r.dy / math.sin(a - phi1) - r.dy / sa
    if case == 4 and "M_N1_case4" in p.reading:
        offset += r.dy / math.sin(a - th2) - r.dy / sa
    wrong = {1: "M_N2_case1", 4: "M_N1_case4"}.get(case) in p.reading
    on_face = (N if wrong else -N) * (rest - offset) + F * arm
    at_corner = length * (F * math.sin(e) - N * math.cos(e))
    return (at_corner, on_face) if case in (1, 3) else (on_face, at_corner)


def load(p: Parameters, q, qdot, mode: int, case: int, u_s: float) -> tuple[float, ...]:
    """Contact loads: (R_x, R_y) on the left block, M_1, M_2 (clockwise), and N, F, v, u.

    The right block feels the opposite force.  `case` 0 lets the positions choose; apart, all loads vanish.
    """
    case = case or choose_case(p, q)
    return _load(p, q, relative(p, case, q, qdot), mode, case, u_s)


def _load(p: Parameters, q, r: Relative, mode: int, case: int, u_s: float) -> tuple[float, ...]:
    if mode == APART:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, r.v, r.u
    N, F = p.k * r.v, friction(p, mode, r, u_s)
    sa, ca = math.sin(r.face), math.cos(r.face)
    f_x, f_y = (F * sa, F * ca) if "friction_components" in p.reading else (F * ca, F * sa)
    M_1, M_2 = moments(p, case, q, r, N, F)
    return -N * sa - f_x, N * ca - f_y, M_1, M_2, N, F, r.v, r.u


def _upward_zero(f: Callable[[float], float], low: float, high: float) -> float:
    """Zero between `low` (f negative) and `high` (f positive), down to the spacing of floats."""
    if f(low) >= 0:
        return low
    if f(high) <= 0:
        return high
    return brentq(f, low, high, xtol=1e-16 * (high - low), rtol=1e-15, maxiter=300, disp=False)


class _Run:
    """One run: continuous state t, y (12 + drive, viscous, friction, power 1, power 2); mode, case, u_s."""

    def __init__(self, p: Parameters, rtol: float):
        self.p, self.rtol, self.period = p, rtol, 2 * math.pi / p.omega
        self.t, self.y = 0.0, np.concatenate([p.initial, np.zeros(5)]).astype(float)
        self.mode, self.case, self.u_s = APART, choose_case(p, self.y[:6].tolist()), 0.0
        self.counts, self.events, self.jump = dict.fromkeys(COUNTS, 0), [], 0.0
        self.recent: deque[tuple[float, str]] = deque(maxlen=200)
        self.restarts: deque[float] = deque(maxlen=2000)
        self.handled: set[str] = set()
        self.status, self.last = "ok", -1.0
        self._scales()
        names = ("m", "m_y", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T")
        self.blades = [
            (*(getattr(p, n)[i] for n in names), F * math.cos(b), F * math.sin(b), p.M_0[i], p.phase[i])
            for i, (F, b) in enumerate(zip(p.F_0, p.beta, strict=True))
        ]
        if self.relative().v > 0:
            self.apply("start", self.y)
        self.jump, self.stored_0 = 0.0, self.stored()

    def _scales(self) -> None:
        """Absolute tolerances, longest steps apart and in contact, rounding level of each guard."""
        p = self.p
        span = max(f / min(a, b) for f, a, b in zip(p.F_0, p.k_x, p.k_y, strict=True)) + p.gap
        span = max(span, *(abs(s) for s in p.initial[:4]), 1e-9)
        turn = max(m / k for m, k in zip(p.M_0, p.k_T, strict=True)) + span / (p.l_oa + p.l_ab)
        reach = span + turn * (p.l_oa + p.l_ab)
        work = max(p.F_0) * span + max(p.M_0) * turn + max(p.k_x) * span * span
        place = np.array([span] * 4 + [turn] * 2)
        scale = np.concatenate([place, place * p.omega, [work] * 3, [reach * reach / p.omega] * 2])
        self.atol = 0.1 * self.rtol * scale
        own = [k / m for k, m in zip(p.k_x + p.k_y + p.k_T, p.m + p.m_y + p.I, strict=True)]
        arm = (p.corners[0] / 2) ** 2
        soft = sum(1 / i for i in p.m + p.m_y) + arm * sum(1 / i for i in p.I)
        fast = math.sqrt(max(own) + (p.k + p.k_d) * soft)
        rock = math.sqrt(max(own) + (p.k + p.k_d) * soft + p.k_face * sum(1 / i for i in p.I))
        pressed = min(self.period / 400, 0.4 / fast, 1.0 / rock)
        self.longest = dict.fromkeys((STICK, SLIP_PLUS, SLIP_MINUS), pressed)
        self.longest[APART] = min(self.period / 400, 0.4 / math.sqrt(max(own)))
        tiny = 4e-16 * (p.l_oa + p.l_ab)
        self.tiny = {"theta": 1e-16, "height": tiny, "onset": tiny, "separation": tiny}
        self.tiny |= {"limit": tiny * (1 + p.mu * p.k / p.k_d) if p.rubs else 0.0}
        self.tiny |= {"reverse": self.tiny["limit"] * max(p.omega, fast)}

    def relative(self, y=None) -> Relative:
        z = (self.y if y is None else y)[:12].tolist()
        return relative(self.p, self.case_at(z), z[:6], z[6:])

    def case_at(self, q) -> int:
        """The case; with a spring between the faces the corners follow the angles without an event."""
        if self.p.k_face and (q[4] > q[5]) != (self.case <= 2):
            return OPPOSITE[self.case]
        return self.case

    def rhs(self, t: float, y: np.ndarray) -> list[float]:
        """Equation (1) and the quadratures of the energy account and of (23)."""
        p, z = self.p, y.tolist()
        q, rate = z[:6], z[6:12]
        acceleration, work, loss, rub, power = [0.0] * 6, 0.0, 0.0, 0.0, [0.0, 0.0]
        R_x = R_y = M_1 = M_2 = 0.0
        if self.mode != APART:
            case = self.case_at(q)
            r = relative(p, case, q, rate)
            R_x, R_y, M_1, M_2, N, F, _, _ = _load(p, q, r, self.mode, case, self.u_s)
            couple = self.couple(q, rate, N, case)
            M_1, M_2 = M_1 + couple, M_2 - couple
            if self.mode != STICK and p.rubs:
                rub = F * (r.u_rate - SIGMA[self.mode] * p.mu * p.k / p.k_d * r.v_rate)
        for i, side, moment in ((0, 1.0, M_1), (1, -1.0, M_2)):
            m, m_y, I, k_x, k_y, k_T, c_x, c_y, c_T, Q_x, Q_y, M_0, phase = self.blades[i]
            x, y_, th, dx, dy, dth = z[i:12:2]
            swing = math.sin(p.omega * t + phase)
            acceleration[i] = (Q_x * swing + side * R_x - c_x * dx - k_x * x) / m
            acceleration[2 + i] = (Q_y * swing + side * R_y - c_y * dy - k_y * y_) / m_y
            acceleration[4 + i] = (M_0 * swing + moment - c_T * dth - k_T * th) / I
            work += swing * (Q_x * dx + Q_y * dy + M_0 * dth)
            loss += c_x * dx * dx + c_y * dy * dy + c_T * dth * dth
            power[i] = x * x + y_ * y_ + (p.l_oa**2 + p.l_ab**2) / 3 * math.sin(th / 2) ** 2
        return [*rate, *acceleration, work, loss, rub, *power]

    def couple(self, q, rate, N: float, case: int) -> float:
        """Moves the resultant from the corner to where the spring between the faces wants it, but off no face."""
        p = self.p
        if not p.k_face:
            return 0.0
        damping = 2 * math.sqrt(p.k_face / sum(1 / i for i in p.I))
        upper, back = (1 if case <= 2 else -1), p.k_face * (q[4] - q[5]) + damping * (rate[4] - rate[5])
        half = N * p.l_ab / 2
        return upper * half - min(max(back, -half), half)

    def contact_energy(self) -> float:
        if self.mode == APART:
            return 0.0
        r, p = self.relative(), self.p
        F = friction(p, self.mode, r, self.u_s)
        return p.k * r.v**2 / 2 + (F**2 / (2 * p.k_d) if p.rubs else 0.0)

    def stored(self) -> float:
        """Energy of the blades and of the two contact springs."""
        p, y = self.p, self.y
        stiffness, inertia = np.array(p.k_x + p.k_y + p.k_T), np.array(p.m + p.m_y + p.I)
        return float(stiffness @ y[:6] ** 2 + inertia @ y[6:12] ** 2) / 2 + self.contact_energy()

    def guards(self, y: np.ndarray, lib=math) -> dict[str, Any]:
        """Functions that are negative inside the present mode and case and rise through zero at its end."""
        p, z = self.p, y if lib is np else y.tolist()
        ahead = z[4] - z[5]
        values, r = {}, relative(p, self.case, z[:6], z[6:12], lib)
        if not p.k_face:
            values["theta"] = -ahead if self.case <= 2 else ahead
        else:
            other = relative(p, OPPOSITE[self.case], z[:6], z[6:12], lib)
            here, both = (ahead > 0) == (self.case <= 2), zip(r, other, strict=True)
            r = Relative(*(np.where(here, a, b) if lib is np else a if here else b for a, b in both))
        values["height"] = r.dy if self.case in (1, 4) else -r.dy
        if self.mode == APART:
            return values | {"onset": r.v}
        values["separation"] = -r.v
        if p.rubs and self.mode == STICK:
            values["limit"] = abs(r.u - self.u_s) - p.mu * p.k * r.v / p.k_d
        elif p.rubs:
            values["reverse"] = p.mu * p.k * r.v_rate / p.k_d - SIGMA[self.mode] * r.u_rate
        return values

    def note(self, kind: str) -> None:
        self.counts[kind] += 1
        self.events.append((self.t, kind))
        self.recent.append((self.t, kind))

    def slider(self) -> float:
        """The slider's place: free in stick, dragged along in slip."""
        r, p = self.relative(), self.p
        if self.mode in SIGMA and p.rubs:
            return r.u - SIGMA[self.mode] * p.mu * p.k * r.v / p.k_d
        return self.u_s

    def apply(self, kind: str, probe: np.ndarray) -> None:
        """One transition; `probe` is a state a little later, asked only for a direction that is undecided."""
        p, r = self.p, self.relative()
        self.handled |= {kind}
        if kind in ("onset", "start"):  # in overlap the element is unstretched under N > 0, whatever the rates
            self.u_s = r.u
            slips = p.k_d * abs(r.u_rate) > p.mu * p.k * r.v_rate if kind == "onset" else not p.rubs
            self.mode = STICK if not slips else SLIP_PLUS if r.u_rate > 0 else SLIP_MINUS
            self.note("onset_slip" if slips else "onset_stick")
            self.handled |= {"onset", "separation", "limit"}
        elif kind == "separation":
            self.mode, self.u_s = APART, 0.0
            self.note(kind)
            self.handled |= {"onset"}
        elif kind == "limit":
            w = r.u - self.u_s
            if abs(w) <= self.tiny["limit"]:
                w = self.relative(probe).u - self.u_s
            self.mode = SLIP_PLUS if w > 0 else SLIP_MINUS
            self.note("stick_slip")
        elif kind == "reverse":
            self.u_s = self.slider()
            self.mode = STICK
            self.note("slip_stick")
            self.handled |= {"limit"}
        else:
            self.switch(kind, r)

    def switch(self, kind: str, r: Relative) -> None:
        """Change of the case; under load the stretch of the friction spring is carried in stick."""
        old, w = self.case, r.u - self.u_s
        self.case = (OPPOSITE if kind == "theta" else {1: 2, 2: 1, 3: 4, 4: 3})[old]
        if self.mode == APART:
            return
        self.note("switch_{}{}".format(*sorted((old, self.case))))
        if self.mode == STICK:
            self.u_s = self.relative().u - w

    def transition(self, kind: str, probe: np.ndarray) -> None:
        """A transition and whatever it sets off at the same instant; books the jump of the stored energy."""
        before = self.contact_energy()
        if self.t > self.last * (1 + 1e-14):  # else what was handled at this very instant stays so
            self.handled = set()
        self.last = self.t
        self.apply(kind, probe)
        for _ in range(12):
            due = [k for k, g in self.guards(self.y).items() if k not in self.handled and g > self.tiny[k]]
            if not due:
                break
            self.apply(due[0], probe)
        self.jump += self.contact_energy() - before

    def first_event(self, dense: Callable, start: float, end: float) -> tuple[float, str] | None:
        """The earliest guard to be crossed in one accepted step, and when."""
        ts = np.linspace(start, end, SUBPOINTS + 1)
        found = []
        for kind, g in self.guards(dense(ts), np).items():
            t = self.first_root(kind, ts, g, lambda t, kind=kind: self.guards(dense(t))[kind])
            if t is not None:
                found.append((t, kind))
        return min(found, default=None)

    def first_root(self, kind: str, ts: np.ndarray, g: np.ndarray, f: Callable) -> float | None:
        """First upward zero of one guard; a guard that starts at zero must have been negative before."""
        first = 0
        if kind in self.handled or abs(g[0]) <= self.tiny[kind]:
            first = 1
            if g[1] > self.tiny[kind]:
                for j in range(1, 41):
                    t = ts[0] + (ts[1] - ts[0]) / 2**j
                    if t > ts[0] and f(t) < 0:
                        return _upward_zero(f, t, ts[1])
                return ts[0]
        elif g[0] > 0:
            return ts[0]
        stops = np.flatnonzero((g[first:-1] < 0) & (g[first + 1 :] >= 0)) + first
        stop = int(stops[0]) if len(stops) else len(ts)
        for i in self.peaks(g):
            if i <= stop:
                top = minimize_scalar(lambda t: -f(t), bounds=(ts[i - 1], ts[i + 1]), method="bounded")
                if top.fun < -self.tiny[kind]:
                    return _upward_zero(f, ts[i - 1], top.x)
        return _upward_zero(f, ts[stop], ts[stop + 1]) if len(stops) else None

    @staticmethod
    def peaks(g: np.ndarray) -> list[int]:
        """Middle points of negative triples whose parabola comes near zero between its ends."""
        if 2 * g.min() > 3 * g.max():  # far from zero for its variation
            return []
        a, b, c = g[:-2], g[1:-1], g[2:]
        bend = a - 2 * b + c
        hidden = (a < 0) & (b < 0) & (c < 0) & (bend < 0) & (abs(a - c) <= -2 * bend)
        top = b - (a - c) ** 2 / np.where(hidden, 8 * bend, 1.0)
        return (np.flatnonzero(hidden & (top > bend / 2)) + 1).tolist()

    def advance(self, end: float) -> None:
        """Integrate to `end`, or until the run has to be given up."""
        while self.status == "ok" and self.t < end:
            try:
                with np.errstate(all="ignore"):
                    finite = self.segment(end)
            except (OverflowError, ValueError):  # raised by math on infinite arguments
                finite = False
            if finite:
                self.inspect()
            else:
                self.status = "not_finite"

    def segment(self, end: float) -> bool:
        """Integrate to the next transition, or to `end`; False where the solution is lost."""
        longest = self.longest[self.mode]
        solver = DOP853(self.rhs, self.t, self.y, end, max_step=longest, rtol=self.rtol, atol=self.atol)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                return False
            dense = solver.dense_output()
            event = self.first_event(dense, solver.t_old, solver.t)
            if event is not None:
                self.t, self.y = event[0], dense(event[0])
                self.transition(event[1], dense(min(self.t + 1e-3 * solver.step_size, solver.t)))
                break
            self.t, self.y, self.handled = solver.t, solver.y, set()
            if self.tilted():
                break
        return True

    def tilted(self) -> bool:
        """Whether a block has turned beyond 1.2 rad or a face lies within 0.02 of the x axis."""
        return any(abs(th) > 1.2 or math.sin(self.p.alpha - th) < 0.02 for th in self.y[4:6].tolist())

    def inspect(self) -> None:
        """Refuse runs whose events accumulate and blocks that turn too far."""
        self.restarts.append(self.t)
        if self.tilted():
            self.status = "angle"
            return
        recent = [kind for t, kind in self.recent if t > self.t - self.period / 200]
        crowded = len(recent) > 30
        full = len(self.recent) == 200 and self.recent[0][0] > self.t - self.period
        lost = len(self.restarts) == 2000 and self.restarts[0] > self.t - self.period
        if crowded or full or lost:
            kinds = recent if crowded else [kind for _, kind in self.recent]
            flat = sum(kind in ("switch_14", "switch_23") for kind in kinds) * 3 >= len(kinds) > 0
            self.status = "face_to_face" if flat else "too_many_events"


def simulate(p: Parameters, n_periods: int, rtol: float = 1e-12) -> Outcome:
    """Integrate `n_periods` periods of the drive from `p.initial`.

    Energy: residual = drive - viscous - friction + jump - stored_change, where jump is what instantaneous
    transitions (loaded case switches above all) add to the contact springs.
    """
    run = _Run(p, rtol)
    samples = []
    for period in range(1, n_periods + 1):
        run.advance(period * run.period)
        if run.status != "ok":
            break
        samples.append(run.y[:12].copy())
    drive, viscous, rub, *power = (float(s) for s in run.y[12:])
    energy = {"drive": drive, "viscous": viscous, "friction": rub, "jump": run.jump}
    energy["stored_change"] = run.stored() - run.stored_0
    energy["residual"] = drive - viscous - rub + run.jump - energy["stored_change"]
    mean = (power[0] / run.t, power[1] / run.t) if run.t else (math.nan, math.nan)
    place = (run.y[:12].copy(), run.slider(), run.mode, run.case if run.mode else 0)
    history = (run.counts, run.events, np.array(samples).reshape(-1, 12))
    return Outcome(run.status, run.t, *place, *history, mean, energy)


def positions_at(p: Parameters, times: np.ndarray, rtol: float = 1e-12) -> tuple[np.ndarray, dict[str, int]]:
    """The positions (times, 6) at growing times, and the events until the last; NaN from where the run has stopped."""
    run, found = _Run(p, rtol), np.full((len(times), 6), np.nan)
    for i, t in enumerate(times):
        run.advance(t)
        if run.status != "ok":
            break
        found[i] = run.y[:6]
    return found, run.counts


def table1(**changes) -> Parameters:
    """Table 1, gap and F_0 of Table 2, gamma = k / k_x = 2.5; one number given for a pair fills both."""
    values: dict[str, Any] = {
        **{"m": 0.08, "I": 2.46e-3, "k_x": 1e5, "k_y": 3e6, "k_T": 2e3, "c_x": 3.57, "c_y": 19.6},
        **{"c_T": 0.506, "alpha": math.pi / 3, "l_oa": 0.05, "l_ab": 0.035, "gap": 0.022e-3},
        **{"k_d": 1e6, "mu": 0.5, "omega": 536.0, "beta": math.pi / 6, "F_0": 60.0, "M_0": 100.0},
        **{"phase": (0.0, math.pi), "gamma": 2.5},
    } | changes
    gamma = values.pop("gamma")
    values.setdefault("m_y", values["m"])
    for name in PAIRS:
        if not isinstance(values[name], tuple):
            values[name] = (values[name],) * 2
    values.setdefault("k", gamma * values["k_x"][0])
    return Parameters(**values)


def random_parameters(rng: np.random.Generator, reading: frozenset[str] = frozenset()) -> Parameters:
    """Draw a scene around Table 1; the two blades are equal in two draws of five."""
    omega, alpha = _log(rng, 200.0, 1500.0), rng.uniform(0.4, 1.5)
    blades = [_random_blade(rng, omega) for _ in range(2)]
    if rng.random() < 0.4:
        blades[1] = blades[0] | {"phase": blades[1]["phase"]}
    pairs = {name: (blades[0][name], blades[1][name]) for name in PAIRS}
    lengths = {"l_oa": _log(rng, 0.02, 0.12), "l_ab": _log(rng, 0.015, 0.08)}
    lengths |= {"gap": float(rng.uniform(0.0, 0.2e-3)), "alpha": float(alpha)}
    contact = {"k": _log(rng, 1e3, 1e7), "k_d": _log(rng, 1e3, 1e7), "mu": _log(rng, 0.02, 1.0)}
    return Parameters(**pairs, **lengths, **contact, omega=omega, reading=frozenset(reading))


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _random_blade(rng: np.random.Generator, omega: float) -> dict[str, float]:
    """One blade; the moment is kept so small that the free block turns by less than about 0.15 rad."""
    b = {"m": _log(rng, 0.016, 0.4), "m_y": _log(rng, 0.016, 0.4), "I": _log(rng, 1e-5, 5e-3)}
    b |= {"k_x": _log(rng, 2e4, 5e5), "k_y": _log(rng, 6e5, 1.5e7)}
    b["k_T"] = b["I"] * (omega * _log(rng, 0.3, 10.0)) ** 2
    for stiffness, inertia, damping in (("k_x", "m", "c_x"), ("k_y", "m_y", "c_y"), ("k_T", "I", "c_T")):
        b[damping] = 2 * _log(rng, 0.004, 0.1) * math.sqrt(b[stiffness] * b[inertia])
    b |= {"beta": rng.uniform(-math.pi, math.pi), "phase": rng.uniform(0.0, 2 * math.pi)}
    b["F_0"] = _log(rng, 5.0, 200.0)
    dynamic = abs(complex(b["k_T"] - b["I"] * omega**2, b["c_T"] * omega))
    limit = 0.15 * min(dynamic, b["k_T"])
    b["M_0"] = min(_log(rng, 0.1, 100.0), limit)
    return {name: float(value) for name, value in b.items()}
