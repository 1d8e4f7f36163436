"""An independent second opinion of faces with several points of contact: pairs and rows of blades, in plain NumPy.

It shares no code and no formula with the package: points are rotated with their blocks, their offsets are projected on
the mean normal and tangent, and forces act at the middles between partners. Steps are DOP853's of fixed length; where a
guard has risen through zero, the length of the step is solved for.

A state is x, y and theta of all blades, followed by their rates: six blocks of N numbers; of blades by modes it is the
coordinates of these and their rates.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate._ivp import dop853_coefficients
from scipy.optimize import brentq

APART, STICK, PLUS, MINUS = 0, 1, 2, 3
STAGES = dop853_coefficients.N_STAGES
A, B, C = dop853_coefficients.A[:STAGES, :STAGES], dop853_coefficients.B, dop853_coefficients.C[:STAGES]
ROUNDING = 2e-16  # of a displacement [m]: guards above zero by less are on it
WITHIN = (1e-5, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 0.97)
SIMULTANEOUS = 1e-9  # of a step
COUNTED = ("onset_slip", "onset_stick", "separation", "stick_slip", "slip_stick")


@dataclass(frozen=True)
class Row:
    """N blades in a chain or a ring; a pair is a chain of two. Arrays are of blades (N,), or of interfaces (E,)."""

    m: np.ndarray  # (3, N) masses in x, y and theta, or 1 of modes (n, N)
    k: np.ndarray  # likewise, and so is the next
    c: np.ndarray
    force: np.ndarray  # (3, N): amplitudes of the drive
    phase: np.ndarray
    omega: float
    gap: np.ndarray
    k_n: np.ndarray
    k_d: np.ndarray
    mu: np.ndarray
    alpha: float
    l_oa: float
    places: np.ndarray  # (M,) [m]
    shares: np.ndarray
    closed: bool = False
    shapes: np.ndarray | None = None  # of modes, (3, n, N)


def row_of(scene):
    """The row of a scene; a face without points is one point in its middle, which is enough where it cannot turn."""
    blades, drive, count = scene.mistuned_blades, scene.drive, scene.layout.blades
    of_blades = lambda a: np.broadcast_to(np.asarray(a, float), (count,)).copy()
    of_interfaces = lambda a: np.broadcast_to(np.asarray(a, float), (scene.layout.interfaces,)).copy()
    F_0, beta, points = of_blades(drive.F_0), of_blades(drive.beta), scene.contact.points
    return Row(
        m=np.array([of_blades(a) for a in (blades.m, blades.m, blades.I)]),
        k=np.array([of_blades(a) for a in (blades.k_x, blades.k_y, blades.k_T)]),
        c=np.array([of_blades(a) for a in (blades.c_x, blades.c_y, blades.c_T)]),
        force=np.array([F_0 * np.cos(beta), F_0 * np.sin(beta), of_blades(drive.M_0)]),
        phase=of_blades(drive.phase),
        omega=float(drive.omega),
        gap=of_interfaces(scene.shroud.gap),
        k_n=of_interfaces(scene.k),
        k_d=of_interfaces(scene.friction.k_d),
        mu=of_interfaces(scene.friction.mu),
        alpha=float(scene.shroud.alpha),
        l_oa=float(scene.shroud.l_oa),
        places=np.zeros(1) if points is None else np.asarray(points.lengths(float(scene.shroud.l_ab))),
        shares=np.ones(1) if points is None else np.asarray(points.shares),
        closed=scene.layout.closed,
    )


def mean_loads(scene):
    """The mean loads (3, N) on x, y and theta of the blades."""
    mean, count = scene.drive.harmonics().get(0), scene.layout.blades
    if mean is None:
        return np.zeros((3, count))
    return np.array([np.broadcast_to(np.asarray(a, float), (count,)) for a in (mean.F_x, mean.F_y, mean.M_0)])


@dataclass
class Run:
    """Where a run stands, and what has happened at each interface and point."""

    row: Row
    y: np.ndarray  # (6, N)
    t: float = 0.0
    mode: np.ndarray = field(default_factory=lambda: np.zeros(0, int))  # (E, M), and so is the next
    slider: np.ndarray = field(default_factory=lambda: np.zeros(0))
    counts: dict = field(default_factory=dict)


@dataclass
class Faces:
    """The faces of every interface: penetrations and slides of the points (E, M), and their rates."""

    v: np.ndarray
    u: np.ndarray
    dv: np.ndarray
    du: np.ndarray
    normal: np.ndarray  # (2, E, 1)
    tangent: np.ndarray
    lever: tuple[np.ndarray, np.ndarray]  # (2, E, M), from both centres to the middles between partners


def sides(row):
    left = np.arange(len(row.gap))
    return left, (left + 1) % len(row.phase)


def shroud(row, z):
    """x, y and theta of the blades, or their rates (3, N), from those of their coordinates."""
    return z if row.shapes is None else np.einsum("ajb,jb->ab", row.shapes, z)


def faces(row, y):
    left, right = sides(row)
    q, rate = (shroud(row, z) for z in np.split(y, 2))
    along = np.array([np.cos(row.alpha), np.sin(row.alpha)])

    def rotated(body, blades):
        """Points of the bodies after a clockwise turn, and their velocities."""
        turn, spin = q[2, blades][:, None], rate[2, blades][:, None]
        cos, sin = np.cos(turn), np.sin(turn)
        place = np.array([body[0] * cos + body[1] * sin, body[1] * cos - body[0] * sin])
        return place, spin * np.array([place[1], -place[0]])

    body = [np.array([end + row.places * along[0], row.places * along[1]]) for end in (row.l_oa / 2, -row.l_oa / 2)]
    (a, da), (b, db) = rotated(body[0], left), rotated(body[1], right)
    at_rest = (body[0] - body[1])[:, None]
    offset = (q[:2, left] - q[:2, right])[..., None] + (a - b - at_rest)
    offset[0] -= row.gap[:, None]
    moving = (rate[:2, left] - rate[:2, right])[..., None] + da - db
    mean, spin = (q[2, left] + q[2, right])[:, None] / 2, (rate[2, left] + rate[2, right])[:, None] / 2
    normal = np.array([np.sin(row.alpha - mean), -np.cos(row.alpha - mean)])
    tangent = np.array([np.cos(row.alpha - mean), np.sin(row.alpha - mean)])
    dot = lambda p, q: p[0] * q[0] + p[1] * q[1]
    return Faces(
        dot(offset, normal),
        dot(offset, tangent),
        dot(moving, normal) - spin * dot(offset, tangent),
        dot(moving, tangent) + spin * dot(offset, normal),
        normal,
        tangent,
        (a - offset / 2, b + offset / 2),
    )


def sigma(mode):
    return (mode == PLUS) * 1.0 - (mode == MINUS) * 1.0


def lag(row):
    return (row.mu * row.k_n / row.k_d)[:, None]


def point_forces(run, at):
    row = run.row
    N = np.where(run.mode != APART, row.k_n[:, None] * row.shares * at.v, 0.0)
    stuck = row.k_d[:, None] * row.shares * (at.u - run.slider)
    return N, np.where(run.mode == STICK, stuck, sigma(run.mode) * row.mu[:, None] * N)


def slope(run, t, y):
    row, at = run.row, faces(run.row, y)
    left, right = sides(row)
    N, F = point_forces(run, at)
    push = -N * at.normal - F * at.tangent
    q, rate = np.split(y, 2)
    total = row.force * np.sin(row.omega * t + row.phase)
    for blades, sign, lever in ((left, 1.0, at.lever[0]), (right, -1.0, at.lever[1])):
        moment = lever[1] * push[0] - lever[0] * push[1]
        for i, load in enumerate((push[0], push[1], moment)):
            np.add.at(total[i], blades, sign * load.sum(axis=-1))
    own = total if row.shapes is None else np.einsum("ajb,ab->jb", row.shapes, total)
    return np.concatenate([rate, (own - row.c * rate - row.k * q) / row.m])


def stepped(run, h):
    slopes = np.zeros((STAGES, *run.y.shape))
    for i in range(STAGES):
        y = run.y + h * np.tensordot(A[i, :i], slopes[:i], 1) if i else run.y
        slopes[i] = slope(run, run.t + C[i] * h, y)
    return run.y + h * np.tensordot(B, slopes, 1)


def guards(run, y):
    """Of each point what ends its mode: lift and friction, above zero where it has."""
    at, limit = faces(run.row, y), lag(run.row)
    lift = np.where(run.mode == APART, at.v, -at.v)
    sticks = np.abs(at.u - run.slider) - limit * at.v
    slips = -sigma(run.mode) * (at.du - sigma(run.mode) * limit * at.dv)
    return np.array([lift, np.where(run.mode == STICK, sticks, np.where(run.mode == APART, -1.0, slips))])


def beyond(run, values):
    return values > np.array([np.full(run.mode.shape, ROUNDING), np.where(run.mode == STICK, 4 * ROUNDING, 0.0)])


def cross(run, kind, j, m):
    """The transition at a point."""
    at, before, limit = faces(run.row, run.y), run.mode[j, m], lag(run.row)[j, 0]
    v, u, dv, du = (a[j, m] for a in (at.v, at.u, at.dv, at.du))
    if kind == 0 and before == APART:
        run.slider[j, m] = u
        overlaps = run.t == 0 and v > 1e-15
        slides = (abs(du) > limit * dv and not overlaps) or run.row.mu[j] == 0
        run.mode[j, m] = (PLUS if du >= 0 else MINUS) if slides else STICK
        name = "onset_slip" if slides else "onset_stick"
    elif kind == 0:
        run.mode[j, m], name = APART, "separation"
    elif before == STICK:
        run.mode[j, m], name = (PLUS if u >= run.slider[j, m] else MINUS), "stick_slip"
    else:
        run.slider[j, m] = u - sigma(before) * limit * v
        run.mode[j, m], name = STICK, "slip_stick"
    run.counts[name][j, m] += 1


def advance(run, end, h):
    """March to an instant in steps of at most `h` seconds."""
    crossed = 0
    while run.t < end:
        crossed += 1
        if crossed > 100_000:
            raise RuntimeError("too many events")
        now = np.argwhere(beyond(run, guards(run, run.y)))
        for _ in range(100):
            if not len(now):
                break
            cross(run, *now[0])
            now = np.argwhere(beyond(run, guards(run, run.y)))
        else:
            raise RuntimeError("points chatter")
        length = min(h, end - run.t)
        y = stepped(run, length)
        hit = np.argwhere(beyond(run, guards(run, y)))
        if not len(hit):
            run.t, run.y = (end if end - run.t <= h else run.t + length), y
            continue
        start, roots = guards(run, run.y), []
        for place in map(tuple, hit):
            begun = start[place]
            value = lambda s, at=place, g=begun, h=length: guards(run, stepped(run, s * h))[at] if s else g
            # a guard that begins on zero may fall before it rises
            below = 0.0 if begun < 0 else next((s for s in WITHIN if value(s) < 0), None)
            roots.append(0.0 if below is None else brentq(value, below, 1.0, xtol=1e-16, rtol=1e-15))
        # where slip begins as contact ends, to the rounding of their guards, contact has ended
        first = next(i for i, root in enumerate(roots) if root <= min(roots) + SIMULTANEOUS)
        if roots[first] == 0.0:  # a guard that began on zero
            rising = [i for i, r in enumerate(roots) if r == 0.0]
            first = rising[0]
        run.y, run.t = stepped(run, roots[first] * length), run.t + roots[first] * length
        cross(run, *hit[first])


def followed(row, y, periods, steps):
    """A run from a state apart: the states at the ends of periods (periods, 6, N), and the counts of each point."""
    shape = len(row.gap), len(row.places)
    counts = {name: np.zeros(shape, int) for name in COUNTED}
    run = Run(row, np.array(y, float), 0.0, np.zeros(shape, int), np.zeros(shape), counts)
    period, states = 2 * np.pi / row.omega, []
    for n in range(periods):
        advance(run, (n + 1) * period, period / steps)
        states.append(run.y.copy())
    return np.array(states), counts
