"""An independent second opinion of blades by modes: `row_reference` and `points_reference`, with modes in plain NumPy.

Corners touch as in `row_reference`, whose state is x, y and theta of the shrouds; the coordinates of the modes are
integrated beside it. Points, and faces that cannot turn, are those of `points_reference`.
"""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import points_reference
import reference
import row_reference
from row_runs import row_scene_of

import jaxshroud as js
from jaxshroud.scene.blades import Blades

MOTIONS = ("x",), ("x", "y"), ("x", "y", "theta")


COORDINATES = ("x", "y", "theta")


class Modes(NamedTuple):
    """Modes of blades."""

    f: np.ndarray  # (n, N) [Hz]
    zeta: np.ndarray  # (n, N)
    shapes: np.ndarray  # (3, n, N), 0 where blocks cannot move

    @property
    def blades(self) -> js.ModalBlades:
        return js.modal_blades(*self, blades=self.f.shape[1])

    @property
    def k(self) -> np.ndarray:
        return (2 * np.pi * self.f) ** 2

    @property
    def c(self) -> np.ndarray:
        return 4 * np.pi * self.f * self.zeta


def modes_of_lumped(b: Blades) -> Modes:
    """The three modes of lumped blades."""
    shapes = np.zeros((3, 3, len(b.m)))
    numbers = [tuple(map(np.asarray, own)) for own in b.oscillators.values()]
    for i, (m, _, _) in enumerate(numbers):
        shapes[i, i] = 1 / np.sqrt(m)
    f = np.array([np.sqrt(k / m) / (2 * np.pi) for m, _, k in numbers])
    zeta = np.array([c / (2 * np.sqrt(k * m)) for m, c, k in numbers])
    return Modes(f, zeta, shapes)


def random_modes(rng: np.random.Generator, n: int, p: row_reference.RowParameters) -> Modes:
    """Modes of unlike blades of about the frequencies and the masses of a row; with 1 or 2 blocks turn or bend less."""
    N, drive = p.blades, p.omega / (2 * np.pi)
    f = drive * np.exp(rng.uniform(math.log(0.4), math.log(8.0), (n, 1))) * rng.uniform(0.97, 1.03, (n, N))
    size = np.array([np.mean(a) ** -0.5 for a in (p.m, p.m_y, p.I)]) * [1.0, 0.3, 0.15]
    shapes = size[:, None, None] * rng.normal(size=(3, n, 1)) * rng.uniform(0.95, 1.05, (3, n, N))
    shapes[len(motion_of(n)) :] = 0.0
    return Modes(f, rng.uniform(0.005, 0.08, (n, N)), shapes)


def motion_of(n: int) -> tuple[str, ...]:
    """The coordinates in which n modes move the shroud each by itself."""
    return MOTIONS[min(n, 3) - 1]


class ModalRun(row_reference.RowRun):
    """The run of a row by modes: behind the state of a row are the coordinates of the modes and their rates."""

    def __init__(
        self,
        p: row_reference.RowParameters,
        modes: Modes,
        rtol: float,
        kappa: np.ndarray | None = None,
        own_loads: np.ndarray | float = 0.0,  # (n, N) complex amplitudes on the modes themselves
        begin: np.ndarray | None = None,  # (2, n, N) coordinates and rates
    ):
        super().__init__(p, rtol)
        self.own_loads = own_loads
        self.kappa = np.zeros((len(modes.f), len(p.gap))) if kappa is None else kappa  # (n, interfaces)
        self.modes, self.size = modes, modes.f.size
        start = np.zeros(2 * self.size) if begin is None else begin.ravel()
        if begin is not None:
            self.y[: 6 * p.blades] = np.einsum("ajb,rjb->rab", modes.shapes, begin).ravel()
        size = np.max(self.atol[: p.blades]) / np.max(np.abs(modes.shapes[0]))
        self.y = np.concatenate([self.y, start])
        self.atol = np.concatenate([self.atol, np.repeat([size, size * p.omega], self.size)])

    def rhs(self, t, y):
        """The rates of the shrouds from those of the modes under all loads; quadratures stay 0."""
        p, modes, N = self.p, self.modes, self.p.blades
        load = np.zeros((3, N))
        for j, interface in enumerate(self.interfaces):
            R_x, R_y, M_1, M_2, _ = interface.loads(y[self.rows[j]].tolist())
            left, right = p.sides(j)
            load[:, left] += R_x, R_y, M_1
            load[:, right] += -R_x, -R_y, M_2
        swing = np.sin(p.omega * t + np.array(p.phase))
        beta, F_0 = np.array(p.beta), np.array(p.F_0)
        load += swing * np.array([F_0 * np.cos(beta), F_0 * np.sin(beta), p.M_0])
        q, rate = y[-2 * self.size :].reshape(2, *modes.f.shape)
        a = np.einsum("ajb,ab->jb", modes.shapes, load) - modes.c * rate - modes.k * q
        a += np.imag(self.own_loads * np.exp(1j * (p.omega * t + np.array(p.phase))))
        for j in range(len(p.gap)):
            left, right = p.sides(j)
            pull = self.kappa[:, j] * (q[:, right] - q[:, left])
            a[:, left] += pull
            a[:, right] -= pull
        shrouds = [np.einsum("ajb,jb->ab", modes.shapes, z).ravel() for z in (rate, a)]
        return [*np.concatenate([*shrouds, np.zeros(3 + N), rate.ravel(), a.ravel()])]


def ends_of(run: js.Trajectory, periods: int) -> np.ndarray:
    """The states (periods, 6, N) of a march of so many periods at their ends."""
    steps = (len(run.t) - 1) // periods
    names = (*COORDINATES, *(f"v_{name}" for name in COORDINATES))
    return np.stack([np.asarray(getattr(run.motion, name))[steps::steps] for name in names], axis=1)


def difference(run: js.Trajectory, wanted: np.ndarray) -> float:
    """The largest difference of a march's states at the ends of periods, over the size of each kind of number."""
    found = ends_of(run, len(wanted))
    size = np.abs(wanted).max(axis=(0, 2))[:, None]
    return np.max(np.abs(found - wanted) / np.where(size > 0, size, 1.0))


def assert_alike(run: js.Trajectory, wanted: np.ndarray, counts: dict) -> None:
    """A march has the states at the ends of periods, the events and the balance of energy of a plain integrator."""
    assert not np.any(run.status)
    # Both march to some 1e-12; contact lets errors grow.
    assert difference(run, wanted) < 1e-8
    for name, count in counts.items():
        marched = np.asarray(run.counters[name])
        of_points = np.asarray(count).reshape(marched.size, -1).sum(axis=-1)
        np.testing.assert_array_equal(marched, of_points.reshape(marched.shape))
    assert np.max(np.abs(run.energy_residual)) < 1e-8


def corner_ends(
    p: row_reference.RowParameters, modes: Modes, periods: int, kappa: np.ndarray | None = None, **further
) -> tuple[np.ndarray, dict] | None:
    """States (periods, 6, N) at the ends of periods from rest, and the counts of events; None where it gives up."""
    run, found = ModalRun(p, modes, 1e-12, kappa, **further), []
    for period in range(1, periods + 1):
        run.advance(period * run.period)
        if run.status != "ok":
            return None
        found.append(run.y[: 6 * p.blades].reshape(6, -1).copy())
    counts = {kind: np.array([one.counts[kind] for one in run.interfaces]) for kind in reference.COUNTS}
    return np.array(found), counts


def point_ends(scene: js.Scene, modes: Modes, periods: int, steps: int) -> tuple[np.ndarray, dict]:
    """The same of faces with points, or of faces that cannot turn; counts of each point."""
    lumped = dataclasses.replace(scene, blades=row_reference_blades(scene))
    row = dataclasses.replace(points_reference.row_of(lumped), m=1.0, k=modes.k, c=modes.c, shapes=modes.shapes)
    states, counts = points_reference.followed(row, np.zeros((2 * len(modes.f), modes.f.shape[1])), periods, steps)
    of_shroud = [np.concatenate([points_reference.shroud(row, z) for z in np.split(y, 2)]) for y in states]
    return np.array(of_shroud), counts


def row_reference_blades(scene: js.Scene) -> Blades:
    """Lumped blades in the place of others, of which `points_reference` reads nothing that counts."""
    one = np.ones(scene.layout.blades)
    return Blades(*[one] * 8)


def scene_of(p: row_reference.RowParameters, modes: Modes, points: int = 0) -> js.Scene:
    """The scene of a row, or of a pair where there are two blades, at rest."""
    row = row_scene_of(p)
    contact, friction = row.contact, row.friction
    numbers = {"shroud": row.shroud, "contact": contact, "friction": friction, "row": row.row}
    if p.blades == 2 and not p.closed:
        shroud = js.Shroud(p.alpha, p.l_oa, p.l_ab, jnp.array(p.gap[0]))
        friction = js.Friction(jnp.array(p.k_d[0]), jnp.array(p.mu[0]))
        numbers = {"shroud": shroud, "contact": js.Contact(p.k[0], None), "friction": friction, "row": None}
    if points:
        k = numbers["contact"].k
        numbers["contact"] = js.Contact(k, None, points=js.ContactPoints(points))
    still = np.zeros(p.blades)
    parts = js.Parts(motion=motion_of(len(modes.f)))
    return js.Scene(blades=modes.blades, drive=row.drive, initial=js.Motion(*[still] * 6), parts=parts, **numbers)
