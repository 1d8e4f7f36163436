"""What contact does, as runs store it: the equations of motion close with it, by the second opinion's accelerations."""

import math

import numpy as np
import pytest
import reference
from side_by_side import scene_of

from jaxshroud.march.method import RungeKutta
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.verbs.simulate import simulate

REALISTIC = {"I": 2.46e-5, "M_0": 0.5}  # nearly parallel faces: dozens of case switches a period, flat contact
PERIODS, STEPS = 2, 1200


class Sampled:
    """A run, and its states as the second opinion orders them."""

    def __init__(self, p: reference.Parameters):
        self.p, self.run = p, simulate(scene_of(p), n_periods=PERIODS, method=RungeKutta(steps=STEPS))
        self.z = np.concatenate(self.run.motion, axis=1)
        self.loaded = np.flatnonzero((self.run.mode != Mode.APART) & np.isfinite(self.run.N))

    def relative(self, i: int) -> reference.Relative:
        """Of the corner in contact; of flat contact, whose corners move alike, that of case 4."""
        return reference.relative(self.p, self.case(i), self.z[i, :6].tolist(), self.z[i, 6:].tolist())

    def case(self, i: int) -> int:
        return min(int(self.run.case[i]), 4)

    def demanded(self, i: int) -> np.ndarray:
        """What Eq. (1) demands of contact: inertia times acceleration less drive, dampers and springs."""
        p, z, run = self.p, self.z[i], self.run
        other = reference._Run(p, 1e-12)
        other.mode, other.case, other.u_s = int(run.mode[i]), self.case(i), float(run.u_s[i])
        a = np.array(other.rhs(run.t[i], np.concatenate([z, np.zeros(5)]))[6:12])
        if run.case[i] == FLAT:  # both blocks turn as one, with the angular momentum that they have
            a[4:] = np.dot(p.I, a[4:]) / sum(p.I)
        wave, F_0, beta = np.sin(p.omega * run.t[i] + np.array(p.phase)), np.array(p.F_0), np.array(p.beta)
        drive = np.concatenate([F_0 * np.cos(beta) * wave, F_0 * np.sin(beta) * wave, np.array(p.M_0) * wave])
        return np.array(p.m + p.m_y + p.I) * a + np.array(p.c_x + p.c_y + p.c_T) * z[6:] + self.springs * z[:6] - drive

    @property
    def springs(self) -> np.ndarray:
        return np.array(self.p.k_x + self.p.k_y + self.p.k_T)

    def forces(self, i: int, N: float, F: float) -> np.ndarray:
        """The two forces on the left block, x and y."""
        sa, ca = math.sin(self.relative(i).face), math.cos(self.relative(i).face)
        f_x, f_y = (F * sa, F * ca) if "friction_components" in self.p.reading else (F * ca, F * sa)
        return np.array([-N * sa - f_x, N * ca - f_y])

    def by_formula(self, i: int) -> np.ndarray:
        """What the stored forces do to the blocks, with the article's moments."""
        N, F = float(self.run.N[i]), float(self.run.F[i])
        R_x, R_y = self.forces(i, N, F)
        q = self.z[i, :6].tolist()
        return np.array([R_x, -R_x, R_y, -R_y, *reference.moments(self.p, self.case(i), q, self.relative(i), N, F)])

    def by_point(self, i: int) -> np.ndarray:
        """What the stored forces do to the blocks when they act at the stored point of the left block's face."""
        p, (x_1, x_2, y_1, y_2, theta, _) = self.p, self.z[i, :6]
        R, A = self.forces(i, float(self.run.N[i]), float(self.run.F[i])), p.alpha - theta
        middle = p.l_oa / 2 * np.array([math.cos(theta), -math.sin(theta)])
        up, inwards = np.array([math.cos(A), math.sin(A)]), np.array([-math.sin(A), math.cos(A)])
        left = middle + float(self.run.contact_point[i]) * up + self.depth(i) * inwards
        right = left + np.array([x_1 - x_2 - p.l_oa - p.gap, y_1 - y_2])
        moments = left[1] * R[0] - left[0] * R[1], right[0] * R[1] - right[1] * R[0]
        return np.array([R[0], -R[0], R[1], -R[1], *moments])

    def depth(self, i: int) -> float:
        """How deep in the left block the point is: its own corners are on its face, those of the other below it."""
        case, v, r = int(self.run.case[i]), float(self.run.v[i]), self.relative(i)
        if case != FLAT:
            return 0.0 if case in (1, 3) else v
        slide = r.dx * math.cos(r.face) + r.dy * math.sin(r.face)  # of its corners above the other block's
        low, high = (self.p.l_ab * s / 2 - (slide if (r.dy > 0) == (s > 0) else 0.0) for s in (-1, 1))
        share = (float(self.run.contact_point[i]) - low) / (high - low)
        return v * (share if r.dy > 0 else 1 - share)


@pytest.mark.full
@pytest.mark.parametrize("misprints", [frozenset(), reference.PRINTED], ids=["consistent", "printed"])
def test_equations_of_motion_close_with_the_stored_forces(misprints):
    # The second opinion's accelerations are functions of the state: what is left is rounding, 1e-14 of the forces.
    seen = set()
    for changes in ({"gamma": 0.3}, REALISTIC):
        of = Sampled(reference.table1(**changes, reading=misprints))
        corners = of.loaded[of.run.case[of.loaded] != FLAT]
        missing = np.array([of.demanded(i) - of.by_formula(i) for i in corners]).reshape(-1, 6)
        seen |= set(zip(of.run.case[corners].tolist(), of.run.mode[corners].tolist(), strict=True))
        assert np.abs(missing[:, :4]).max() < 1e-12 * np.nanmax(of.run.N)
        assert np.abs(missing[:, 4:]).max() < 1e-12 * np.nanmax(of.run.N) * of.p.l_ab
    assert seen == {(case, mode) for case in (1, 2, 3, 4) for mode in (1, 2, 3)}


@pytest.mark.full
def test_flat_contact_acts_where_both_blocks_turn_alike():
    of = Sampled(reference.table1(**REALISTIC))
    flat = of.run.case[of.loaded] == FLAT
    missing = np.array([of.demanded(i) - of.by_point(i) for i in of.loaded])
    size = np.nanmax(of.run.N)
    assert flat.sum() > 100
    # Moments differ from zero by the rounding of N l_ab, at corners and in flat contact alike.
    assert np.abs(missing[:, :4]).max() < 1e-12 * size
    assert np.abs(missing[:, 4:]).max() < 1e-11 * size * of.p.l_ab
    # Control: at a corner the resultant of flat contact would turn the blocks apart.
    cornered = np.array([of.demanded(i) - of.by_formula(i) for i in of.loaded[flat]])
    assert np.abs(cornered[:, 4:]).max() > 0.01 * size * of.p.l_ab


def test_forces_obey_the_contact_laws():
    of = Sampled(reference.table1(**REALISTIC))
    p, run = of.p, of.run
    apart, slip = run.mode == Mode.APART, (run.mode == Mode.SLIP_PLUS) | (run.mode == Mode.SLIP_MINUS)
    sigma = np.where(run.mode == Mode.SLIP_PLUS, 1, -1)
    assert np.all(run.N[apart] == 0)
    assert np.all(run.F[apart] == 0)
    assert np.all(run.v[apart] < 0)
    np.testing.assert_array_equal(np.isnan(run.contact_point), apart)
    np.testing.assert_allclose(run.N[~apart], p.k * run.v[~apart], rtol=1e-14)
    np.testing.assert_allclose(run.F[slip], (sigma * p.mu * run.N)[slip], rtol=1e-14)
    # Stick ends where the friction spring is stretched to its limit, up to the rounding of corner positions.
    assert np.all(np.abs(run.F[~apart]) <= p.mu * run.N[~apart] + 1e-9)
    # Cases are told by the corners' heights: a corner may be beyond the other face's end by what it is deep.
    assert np.nanmax(np.abs(run.contact_point)) < p.l_ab / 2 + np.nanmax(run.v)
