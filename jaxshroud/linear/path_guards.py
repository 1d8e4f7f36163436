"""What ends a state of contact as loads are applied slowly, and the state that follows: one lane at a time.

The states are those of a march, see `march/events`: points that are apart, stick or slip, and the case of each
interface. Instead of rates in time there are those by the share of the loads that is applied. These jump where a
stiffness does, while rates in time are continuous there. The transitions of a march, which choose what follows by the
rates before an event, and one event after the other, do not serve here.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.linear.equilibrium import ContactState
from jaxshroud.linear.resting_contact import RestingContact
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray

RATE_ROUNDING = 1e-9  # of the rate of the displacements, below which no slider is seen to turn back
TORQUE_ROUNDING = 1e-9  # of the torques at the ends of flat faces
LEAVES_LIMIT = 1e-7  # as `RATE_ROUNDING`: a point on a limit leaves it only faster than this
NO_SIZE = float(np.finfo(float).tiny)


class Rubbing(NamedTuple):
    """The friction of one lane."""

    rubs: np.ndarray  # (interfaces, 1) whether there is any
    lag: FloatArray  # (interfaces, 1) mu k / k_d: stretch of the friction spring in slip, per unit penetration
    turns: bool  # whether blocks turn
    at_corners: bool  # and touch at corners
    rounding: float  # of displacements over the largest one, below which nothing is crossed


class Placed(NamedTuple):
    """One lane in equilibrium under a share of its mean loads."""

    share: float
    q: FloatArray  # (3, blades)
    rate: FloatArray  # (3, blades) its derivative by the share
    contact: ContactState  # without the axis of lanes, as the next
    at: RestingContact

    @property
    def size(self) -> float:
        """The largest displacement."""
        return max(float(np.abs(self.q).max()), NO_SIZE)


class PathGuards(NamedTuple):
    """What is above its rounding where a state of contact has ended; the last axis: separation or onset, and friction.

    Displacements, rates and torques are relative to the largest one.
    """

    of_points: FloatArray  # (interfaces, points, 2)
    of_cases: FloatArray  # (interfaces,)
    rounding_of_points: FloatArray
    rounding_of_cases: FloatArray

    @property
    def crossed(self) -> tuple[np.ndarray, np.ndarray]:
        """Which guards of points and of cases have been crossed."""
        return self.of_points > self.rounding_of_points, self.of_cases > self.rounding_of_cases

    @property
    def reached(self) -> tuple[np.ndarray, np.ndarray]:
        """Which guards are not below zero by more than rounding."""
        return self.of_points >= -self.rounding_of_points, self.of_cases >= -self.rounding_of_cases


def rubbing_of(scenes: Scene) -> list[Rubbing]:
    """The friction of each of scenes (leading axis)."""
    scenes = jax.tree.map(jnp.asarray, scenes)
    shape = len(scenes.drive.omega), -1, 1

    def at_interfaces(a):
        return np.broadcast_to(np.asarray(a, float), np.shape(scenes.friction.mu)).reshape(shape)

    k, k_d, mu = (at_interfaces(a) for a in (scenes.k, scenes.friction.k_d, scenes.friction.mu))
    rubs = (k > 0) & (k_d > 0) & (mu > 0) & (scenes.parts.friction != "none")
    lag = np.where(rubs, mu * k / np.where(rubs, k_d, 1.0), 0.0)
    turns = "theta" in scenes.parts.motion
    rounding = 64 * float(np.finfo(jax.dtypes.canonicalize_dtype(float)).eps)
    at_corners = turns and not scenes.points
    return [Rubbing(one, stretch, turns, at_corners, rounding) for one, stretch in zip(rubs, lag, strict=True)]


def slip_direction(mode: np.ndarray) -> FloatArray:
    """+1 in slip+, -1 in slip-, else 0."""
    return 1.0 * np.equal(mode, Mode.SLIP_PLUS) - 1.0 * np.equal(mode, Mode.SLIP_MINUS)


def path_guards(now: Placed, rubbing: Rubbing) -> PathGuards:
    """The guards of the state of contact in which a lane is."""
    mode = now.contact.mode
    v_rate, u_rate = _face_rates(now)
    apart = np.equal(mode, Mode.APART)
    sticks = np.equal(mode, Mode.STICK)
    sigma = slip_direction(mode)
    v = np.where(apart & rubbing.at_corners, now.at.natural_v[:, None], now.at.v)
    lift = np.where(apart, v, -v) / now.size
    beyond = (np.abs(now.at.u - now.contact.u_s) - rubbing.lag * v) / now.size
    back = -sigma * (u_rate - sigma * rubbing.lag * v_rate) / _largest_rate(now)
    rub = np.where(rubbing.rubs & ~apart, np.where(sticks, beyond, back), -1.0)
    of_rub = np.where(sticks, rubbing.rounding, RATE_ROUNDING)
    cases = _case_guards(now, rubbing) if rubbing.at_corners else (np.full(len(mode), -1.0), np.zeros(len(mode)))
    rounding = np.stack([np.full(mode.shape, rubbing.rounding), of_rub], axis=-1)
    return PathGuards(np.stack([lift, rub], axis=-1), cases[0], rounding, cases[1])


def leaving(now: Placed, rubbing: Rubbing) -> tuple[np.ndarray, np.ndarray]:
    """Which guards of points and cases are crossed, or are on zero and rise with the loads."""
    guards = path_guards(now, rubbing)
    v_rate, u_rate = _face_rates(now)
    mode, lag = now.contact.mode, rubbing.lag
    lift_rate = np.where(np.equal(mode, Mode.APART), v_rate, -v_rate)
    beyond_rate = np.where(np.equal(mode, Mode.STICK), _way_off(now, rubbing) * u_rate - lag * v_rate, -np.inf)
    rises = np.stack([lift_rate, beyond_rate], axis=-1) > LEAVES_LIMIT * _largest_rate(now)
    points, cases = guards.crossed
    return points | (guards.reached[0] & rises), cases


def _face_rates(now: Placed) -> tuple[FloatArray, FloatArray]:
    """The derivatives of penetrations and slides by the share of the loads, (interfaces, points) each."""
    return now.at.v_q @ now.rate.ravel(), now.at.u_q @ now.rate.ravel()


def _largest_rate(now: Placed) -> float:
    return max(float(np.abs(now.rate).max()), NO_SIZE)


def _way_off(now: Placed, rubbing: Rubbing) -> FloatArray:
    """The direction in which stuck points are stretched, or if they are not, in which they move."""
    w = now.at.u - now.contact.u_s
    return np.where(np.abs(w) > rubbing.rounding * now.size, np.sign(w), np.sign(_face_rates(now)[1]))


def _case_guards(now: Placed, rubbing: Rubbing) -> tuple[FloatArray, FloatArray]:
    """The guards of the cases of corners, and their rounding: a turn, another height, or a torque beyond flat faces."""
    case = now.contact.case
    flat = np.equal(now.contact.case, FLAT)
    upper = now.contact.case <= 2
    turn = np.where(upper, -now.at.turn, now.at.turn) / now.size
    apart = np.equal(now.contact.mode[:, 0], Mode.APART)
    turned = np.abs(now.at.turn) > rubbing.rounding * now.size
    other = np.where(turned & (now.at.natural != case) & (apart | ((now.at.natural <= 2) == upper)), 1.0, -1.0)
    torques = now.at.end_torques
    outside = np.maximum(torques[:, 1], -torques[:, 0]) / np.maximum(np.abs(torques).max(axis=1), NO_SIZE)
    guard = np.where(flat & ~apart, outside, np.where(apart, other, np.maximum(turn, other)))
    return guard, np.where(flat & ~apart, TORQUE_ROUNDING, rubbing.rounding)


def contact_after(now: Placed, points: np.ndarray, cases: np.ndarray, rubbing: Rubbing) -> ContactState:
    """The state of contact once guards of points (interfaces, points, 2) and cases (interfaces,) are crossed."""
    mode, lag = now.contact.mode, rubbing.lag
    apart = np.equal(mode, Mode.APART)
    sticks = np.equal(mode, Mode.STICK)
    sigma = slip_direction(mode)
    lifts = points[..., 0] & ~(points[..., 1] & sticks)  # what sticks slips before it separates
    rubs = points[..., 1] & ~lifts
    begins = np.where(rubbing.rubs, Mode.STICK, Mode.SLIP_PLUS)
    slips = np.where(_way_off(now, rubbing) < 0, Mode.SLIP_MINUS, Mode.SLIP_PLUS)
    after = np.where(lifts, np.where(apart, begins, Mode.APART), mode)
    after = np.where(rubs, np.where(sticks, slips, Mode.STICK), after)
    u_s = np.where(lifts, now.at.u, np.where(rubs & ~sticks, now.at.u - sigma * lag * now.at.v, now.contact.u_s))
    case = np.where(cases, _case_beyond(now, rubbing), now.contact.case)
    level = (lifts & apart)[:, 0] & (np.abs(now.at.turn) <= rubbing.rounding * now.size) & rubbing.at_corners
    return ContactState(after.astype(np.int32), np.where(level, FLAT, case).astype(np.int32), u_s)


def _case_beyond(now: Placed, rubbing: Rubbing) -> np.ndarray:
    """The case of corners after its guard."""
    case, natural = now.contact.case, now.at.natural
    higher = np.isin(natural, (2, 3))  # whether the left block's corner is the higher one
    off = np.where(now.at.end_torques[:, 1] > -now.at.end_torques[:, 0], np.where(higher, 2, 1), 4 - higher)
    turn = np.where(case <= 2, -now.at.turn, now.at.turn)
    apart = np.equal(now.contact.mode[:, 0], Mode.APART)
    at_corner = np.where(apart | (turn < -rubbing.rounding * now.size), natural, FLAT)
    return np.where(np.equal(case, FLAT) & ~apart, off, at_corner)


def sliders_at(now: Placed, rubbing: Rubbing) -> FloatArray:
    """The sliders (interfaces, points): those of points that slip follow; 0 where faces are apart."""
    sigma = slip_direction(now.contact.mode)
    follow = now.at.u - sigma * rubbing.lag * now.at.v
    return np.where(np.equal(now.contact.mode, Mode.APART), 0.0, np.where(sigma != 0, follow, now.contact.u_s))
