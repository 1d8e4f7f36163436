"""An independent second opinion of rows of blades: `reference` at every interface, one integration for all blades.

Plain floats, NumPy and SciPy only. An interface is a pair of the reference, which knows its guards and its transitions;
those look at places and speeds alone, so that interfaces with events at one instant do not depend on their order. Here
are Eq. (1) of every blade under the sum of its loads, and the earliest event over all interfaces.

A state is x, y and theta of all blades, followed by their rates: six blocks of N numbers.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import reference
from load_opinions import nearly_parallel
from scipy.integrate import DOP853

BLADE = ("m", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T", "m_y", "beta", "F_0", "M_0", "phase")
INTERFACE = ("gap", "k", "k_d", "mu")
ANGLE_RANGE = math.pi / 4
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class RowParameters:
    """N blades in a chain or a ring: what a blade has is a tuple of N, what an interface has one of N - 1 or N."""

    m: Numbers
    I: Numbers
    k_x: Numbers
    k_y: Numbers
    k_T: Numbers
    c_x: Numbers
    c_y: Numbers
    c_T: Numbers
    m_y: Numbers
    beta: Numbers
    F_0: Numbers
    M_0: Numbers
    phase: Numbers
    gap: Numbers
    k: Numbers
    k_d: Numbers
    mu: Numbers
    omega: float
    alpha: float
    l_oa: float
    l_ab: float
    closed: bool
    mistuning: Numbers
    initial: Numbers  # 6 N
    k_face: float = 0.0  # spring between the faces, as of the pair

    @property
    def blades(self) -> int:
        return len(self.m)

    @cached_property
    def tuned(self) -> dict[str, np.ndarray]:
        """The numbers of the blades, their stiffnesses with the mistuning."""
        numbers = {name: np.array(getattr(self, name)) for name in BLADE}
        return numbers | {name: numbers[name] * (1 + np.array(self.mistuning)) for name in ("k_x", "k_y", "k_T")}

    def sides(self, j: int) -> tuple[int, int]:
        """The blades left and right of interface j."""
        return j, (j + 1) % self.blades

    def pair(self, j: int) -> reference.Parameters:
        """The pair at interface j."""
        sides = list(self.sides(j))
        blades = {name: tuple(a[sides].tolist()) for name, a in self.tuned.items()}
        contact = {name: getattr(self, name)[j] for name in INTERFACE}
        initial = np.reshape(self.initial, (6, self.blades))[:, sides].ravel().tolist()
        shape = {name: getattr(self, name) for name in ("omega", "alpha", "l_oa", "l_ab", "k_face")}
        return reference.Parameters(**blades, **contact, **shape, initial=tuple(initial))


@dataclass
class RowOutcome:
    """Where a run ended, what happened at each interface, and the energy account of the row [J]."""

    status: str  # as of the pair
    t: float
    samples: np.ndarray  # (periods, 6, N) at the ends of the periods that were reached
    counts: dict[str, list[int]]  # of each interface
    mode: list[int]
    case: list[int]
    power: np.ndarray  # mean square displacement of each blade [m^2]
    energy: dict[str, float]


class Interface(reference._Run):
    """The contact of one interface: a pair whose state is set from outside."""

    def place(self, t: float, y: np.ndarray) -> None:
        """Set the instant and the state (12,) of its blades; what was handled at this very instant stays so."""
        if t > self.last * (1 + 1e-14):
            self.handled = set()
        self.t, self.y = t, y

    def tilted(self) -> bool:
        """Whether a block has turned beyond the angles at which the march ends a run too."""
        return max(abs(self.y[4]), abs(self.y[5])) > ANGLE_RANGE or super().tilted()

    def loads(self, z: list[float]) -> tuple[float, ...]:
        """R_x, R_y on the left block, both moments, and the power lost in sliding."""
        if self.mode == reference.APART:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        p, q, rate = self.p, z[:6], z[6:]
        case = self.case_at(q)
        r = reference.relative(p, case, q, rate)
        R_x, R_y, M_1, M_2, N, F, *_ = reference._load(p, q, r, self.mode, case, self.u_s)
        couple = self.couple(q, rate, N, case)
        slides = self.mode != reference.STICK and p.rubs
        speed = r.u_rate - reference.SIGMA[self.mode] * p.mu * p.k / p.k_d * r.v_rate if slides else 0.0
        return R_x, R_y, M_1 + couple, M_2 - couple, F * speed


class RowRun:
    """One run: y holds the state (6 N), then the works of drive, dampers and friction, then N mean squares."""

    def __init__(self, p: RowParameters, rtol: float):
        self.p, self.rtol, self.period, self.n = p, rtol, 2 * math.pi / p.omega, p.blades
        self.interfaces = [Interface(p.pair(j), rtol) for j in range(len(p.gap))]
        self.t, self.status, self.restarts = 0.0, "ok", 0
        self.y = np.concatenate([p.initial, np.zeros(3 + self.n)]).astype(float)
        block = np.arange(6)[:, None] * self.n
        self.rows = [(block + list(p.sides(j))).ravel() for j in range(len(p.gap))]
        each = np.max([i.atol for i in self.interfaces], axis=0)  # of a pair: (12,), three works, two squares
        self.atol = np.concatenate([np.repeat(each[:12:2], self.n), each[12:15], np.repeat(each[15], self.n)])
        b = p.tuned
        self.numbers = [[float(b[name][i]) for name in BLADE] for i in range(self.n)]
        self.stored_0 = self.stored()

    def rhs(self, t: float, y: np.ndarray) -> list[float]:
        """Eq. (1) of every blade and the quadratures."""
        n, p, rub = self.n, self.p, 0.0
        R_x, R_y, M = [0.0] * n, [0.0] * n, [0.0] * n
        for j, interface in enumerate(self.interfaces):
            if interface.mode == reference.APART:
                continue
            left, right = p.sides(j)
            r_x, r_y, M_1, M_2, lost = interface.loads(y[self.rows[j]].tolist())
            R_x[left], R_y[left], M[left] = R_x[left] + r_x, R_y[left] + r_y, M[left] + M_1
            R_x[right], R_y[right], M[right] = R_x[right] - r_x, R_y[right] - r_y, M[right] + M_2
            rub += lost
        z = y[: 6 * n].tolist()
        rates, work, loss, power = [[0.0] * n for _ in range(3)], 0.0, 0.0, [0.0] * n
        gyration = (p.l_oa**2 + p.l_ab**2) / 3
        for i, (m, I, k_x, k_y, k_T, c_x, c_y, c_T, m_y, beta, F_0, M_0, phase) in enumerate(self.numbers):
            x, y_, th, dx, dy, dth = z[i::n]
            swing = math.sin(p.omega * t + phase)
            Q_x, Q_y, Q_T = F_0 * math.cos(beta) * swing, F_0 * math.sin(beta) * swing, M_0 * swing
            rates[0][i] = (Q_x + R_x[i] - c_x * dx - k_x * x) / m
            rates[1][i] = (Q_y + R_y[i] - c_y * dy - k_y * y_) / m_y
            rates[2][i] = (Q_T + M[i] - c_T * dth - k_T * th) / I
            work += Q_x * dx + Q_y * dy + Q_T * dth
            loss += c_x * dx * dx + c_y * dy * dy + c_T * dth * dth
            power[i] = x * x + y_ * y_ + gyration * math.sin(th / 2) ** 2
        return [*z[3 * n :], *rates[0], *rates[1], *rates[2], work, loss, rub, *power]

    def stored(self) -> float:
        """Energy of the blades and of the springs of all contacts."""
        b, z = self.p.tuned, self.y[: 6 * self.n].reshape(6, self.n)
        stiffness, inertia = [b[s] for s in ("k_x", "k_y", "k_T")], [b[s] for s in ("m", "m_y", "I")]
        own = float(np.sum(stiffness * z[:3] ** 2) + np.sum(inertia * z[3:] ** 2)) / 2
        for j, interface in enumerate(self.interfaces):
            interface.y = self.y[self.rows[j]]
        return own + sum(interface.contact_energy() for interface in self.interfaces)

    def advance(self, end: float) -> None:
        """Integrate to `end`, or until the run has to be given up."""
        while self.status == "ok" and self.t < end:
            try:
                with np.errstate(all="ignore"):
                    finite = self.segment(end)
            except (OverflowError, ValueError):  # raised by math on infinite arguments
                finite = False
            self.inspect(finite)

    def segment(self, end: float) -> bool:
        """Integrate to the next transition, or to `end`; False where the solution is lost."""
        longest = min(i.longest[i.mode] for i in self.interfaces)
        solver = DOP853(self.rhs, self.t, self.y, end, max_step=longest, rtol=self.rtol, atol=self.atol)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                return False
            dense = solver.dense_output()
            found = self.first_event(dense, solver.t_old, solver.t)
            if found is not None:
                t, kind, j = found
                self.t, self.y = t, dense(t)
                probe = dense(min(t + 1e-3 * solver.step_size, solver.t))[self.rows[j]]
                self.interfaces[j].place(t, self.y[self.rows[j]])
                self.interfaces[j].transition(kind, probe)
                return True
            self.t, self.y = solver.t, solver.y
            for interface in self.interfaces:
                interface.handled = set()
        return True

    def first_event(self, dense: Callable, start: float, end: float) -> tuple[float, str, int] | None:
        """The instant, the kind and the interface of the earliest event in one accepted step."""
        found = []
        for j, interface in enumerate(self.interfaces):
            at = lambda t, j=j: dense(t)[self.rows[j]]
            interface.place(start, at(start))
            event = interface.first_event(at, start, end)
            if event is not None:
                found.append((*event, j))
        return min(found, default=None)

    def inspect(self, finite: bool) -> None:
        """Refuse runs that are lost, whose events accumulate, or whose blocks turn too far."""
        self.restarts += 1
        for j, interface in enumerate(self.interfaces):
            interface.y = self.y[self.rows[j]]
            interface.t = self.t
            interface.inspect()
            if interface.status != "ok":
                self.status = interface.status
        if not finite:
            self.status = "not_finite"


def simulate_row(p: RowParameters, n_periods: int, rtol: float = 1e-12) -> RowOutcome:
    """Integrate `n_periods` periods of the drive from `p.initial`; energies as in `reference.simulate`."""
    run, samples = RowRun(p, rtol), []
    for period in range(1, n_periods + 1):
        run.advance(period * run.period)
        if run.status != "ok":
            break
        samples.append(run.y[: 6 * run.n].reshape(6, run.n))
    drive, viscous, rub = run.y[6 * run.n :][:3].tolist()
    jump = sum(i.jump for i in run.interfaces)
    change = run.stored() - run.stored_0
    energy = {"drive": drive, "viscous": viscous, "friction": rub, "jump": jump, "stored_change": change}
    energy["residual"] = drive - viscous - rub + jump - change
    counts = {kind: [i.counts[kind] for i in run.interfaces] for kind in reference.COUNTS}
    power = run.y[6 * run.n + 3 :] / run.t if run.t else np.full(run.n, math.nan)
    places = [i.mode for i in run.interfaces], [i.case for i in run.interfaces]
    return RowOutcome(run.status, run.t, np.array(samples).reshape(-1, 6, run.n), counts, *places, power, energy)


def nudged(p: RowParameters, by: float = 1e-12) -> RowParameters:
    """The row with every place and speed of its start moved by so much of its scale, which its springs give."""
    scale = np.repeat(RowRun(p, 1.0).atol[: 6 * p.blades : p.blades] / 0.1, p.blades)
    signs = np.resize([1.0, -1.0, 1.0, 1.0, -1.0], 6 * p.blades)
    return dataclasses.replace(p, initial=tuple((np.array(p.initial) + by * scale * signs).tolist()))


def table1_row(blades: int, closed: bool, engine_order: int = 0, **changes: Any) -> RowParameters:
    """Alike blades of Table 1 with M_0 3, gap 22 um, F_0 60, gamma 2.5.

    What is changed is one number for all blades or interfaces, or a list of them; `initial` is (6, N).
    """
    base, interfaces = reference.table1(M_0=3.0), blades if closed else blades - 1
    shape: dict[str, Any] = {name: getattr(base, name) for name in ("omega", "alpha", "l_oa", "l_ab")}
    phase = 2 * math.pi * engine_order * np.arange(blades) / blades
    each: dict[str, Any] = {name: getattr(base, name)[0] for name in BLADE} | {"phase": phase, "mistuning": 0.0}
    contact: dict[str, Any] = {name: getattr(base, name) for name in INTERFACE}
    filled = {}
    for numbers, size in ((each, blades), (contact, interfaces)):
        for name, value in numbers.items():
            filled[name] = tuple(np.broadcast_to(changes.pop(name, value), size).astype(float).tolist())
    initial = tuple(np.broadcast_to(changes.pop("initial", 0.0), (6, blades)).astype(float).ravel().tolist())
    return RowParameters(**filled, **(shape | changes), closed=closed, initial=initial)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def random_row(rng: np.random.Generator, blades: int, closed: bool, parallel: bool = False) -> RowParameters:
    """A row of unlike blades and interfaces; `parallel`: small moments, so that faces stay nearly parallel."""
    n, interfaces = blades, blades if closed else blades - 1
    if parallel:
        base = nearly_parallel(rng)
        unlike = lambda name: tuple((getattr(base, name)[0] * rng.uniform(0.9, 1.1, n)).tolist())
        names = [name for name in BLADE if name not in ("phase", "F_0", "M_0", "beta")]
        drawn: dict[str, Any] = {name: unlike(name) for name in names}
        drawn |= {"F_0": tuple(_log(rng, 5, 80) for _ in range(n)), "M_0": tuple(_log(rng, 0.05, 1) for _ in range(n))}
        drawn |= {"beta": tuple(rng.uniform(0.1, 1, n).tolist()), "phase": tuple(rng.uniform(0, 6.28, n).tolist())}
        shape: dict[str, Any] = {name: getattr(base, name) for name in ("omega", "alpha", "l_oa", "l_ab")}
    else:
        omega = _log(rng, 200.0, 1500.0)
        each = [reference._random_blade(rng, omega) for _ in range(n)]
        drawn = {name: tuple(b[name] for b in each) for name in BLADE}
        shape = {"omega": omega, "alpha": rng.uniform(0.6, 1.4), "l_oa": _log(rng, 0.03, 0.1)}
        shape |= {"l_ab": _log(rng, 0.02, 0.06)}
    contact = {"gap": tuple(rng.uniform(1e-5 if parallel else -2e-5, 2e-4, interfaces).tolist())}
    for name, low, high in (("k", 3e4, 1e6), ("k_d", 1e5, 3e6), ("mu", 0.05, 0.8)):
        contact[name] = tuple(_log(rng, low, high) for _ in range(interfaces))
    mistuning = tuple(rng.normal(0.0, 0.03, n).tolist())
    places = [rng.normal(0.0, size, n) for size in (2e-5, 2e-6, 2e-4, 5e-3, 5e-4, 5e-2)]
    initial = tuple(np.concatenate(places).tolist())
    return RowParameters(**drawn, **contact, **shape, closed=closed, mistuning=mistuning, initial=initial)
