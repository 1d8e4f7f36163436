"""Closed forms in NumPy, written from the article with its half angles and lengths; shared by the tests.

At the end, what hands such positions to the package.

Everything is over arrays of n random positions. A position is (x_1, x_2, y_1, y_2, theta_1, theta_2), the last axis
of `q`; angles are positive clockwise, y points up, SI units.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxshroud.model.geometry import (
    ContactKinematics,
    ContactRates,
    Corners,
    Pose,
    contact_kinematics,
    contact_rates,
    corners,
    pose,
)
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Shroud

Floats = NDArray[np.float64]
CASES = (1, 2, 3, 4)
MISPRINTS = ("gap_sign", "friction_components", "M_N2_case1", "M_N1_case2", "M_N1_case4", "levers")
PRINTED = frozenset(MISPRINTS)
CONSISTENT = frozenset()


class Sides(NamedTuple):
    """The two alike blocks by their sides, with the initial gap."""

    alpha: Floats
    l_oa: Floats
    l_ab: Floats
    gap: Floats

    def records(self) -> list[dict[str, float]]:
        """One dictionary of plain numbers per block."""
        return [dict(zip(self._fields, row, strict=True)) for row in np.stack(self, axis=-1).tolist()]


class Lengths(NamedTuple):
    """The same blocks by the article's lengths and angles, faces leaning right going up."""

    l_ap: Floats
    l_ob: Floats
    varphi_1: Floats
    varphi_2: Floats


class Draw(NamedTuple):
    """n random blocks, each at a random position and rate."""

    sides: Sides
    q: Floats  # (n, 6)
    rate: Floats  # (n, 6)


def draw(n: int, seed: int = 1) -> Draw:
    """Blocks from 2 to 12 cm, displaced by millimetres and turned by up to 0.5 rad."""
    rng = np.random.default_rng(seed)
    alpha, l_oa, l_ab = rng.uniform([[0.8], [0.02], [0.015]], [[1.5], [0.12], [0.08]], (3, n))
    sides = Sides(alpha, l_oa, l_ab, rng.normal(0, 1e-3, n))
    q = np.concatenate([rng.normal(0, 2e-3, (n, 4)), rng.uniform(-0.5, 0.5, (n, 2))], axis=1)
    rate = np.concatenate([rng.normal(0, 1.0, (n, 4)), rng.normal(0, 30.0, (n, 2))], axis=1)
    return Draw(sides, q, rate)


def lengths(b: Sides) -> Lengths:
    """l_ap, l_ob, varphi_1, varphi_2 from the sides: corner a is the far right one, b below it to its left."""
    lean, height = b.l_ab * np.cos(b.alpha) / 2, b.l_ab * np.sin(b.alpha) / 2
    a_x, b_x = b.l_oa / 2 + lean, b.l_oa / 2 - lean
    angles = np.arctan2(height, a_x), np.arctan2(height, b_x)
    return Lengths(2 * np.hypot(a_x, height), 2 * np.hypot(b_x, height), *angles)


def corner_displacements(b: Sides, q: Floats) -> dict[str, tuple[Floats, Floats]]:
    """Displacements of the corners a, b, c, d in x and y, Eqs. (3)-(6)."""
    l_ap, l_ob, varphi_1, varphi_2 = lengths(b)
    x_1, x_2, y_1, y_2, theta_1, theta_2 = np.moveaxis(q, -1, 0)
    s_1, s_2 = np.sin(theta_1 / 2), np.sin(theta_2 / 2)
    e_a, e_b = (2 * varphi_1 - theta_1) / 2, (2 * varphi_2 + theta_1) / 2
    e_c, e_d = (2 * varphi_2 + theta_2) / 2, (2 * varphi_1 - theta_2) / 2
    return {
        "a": (x_1 + l_ap * s_1 * np.sin(e_a), y_1 - l_ap * s_1 * np.cos(e_a)),
        "b": (x_1 - l_ob * s_1 * np.sin(e_b), y_1 - l_ob * s_1 * np.cos(e_b)),
        "c": (x_2 + l_ob * s_2 * np.sin(e_c), y_2 + l_ob * s_2 * np.cos(e_c)),
        "d": (x_2 - l_ap * s_2 * np.sin(e_d), y_2 + l_ap * s_2 * np.cos(e_d)),
    }


def relative_displacement(b: Sides, q: Floats, case: int) -> tuple[Floats, Floats]:
    """Displacement of the left block's corner minus that of the right block's: a - c above, b - d below."""
    r = corner_displacements(b, q)
    left, right = (r["a"], r["c"]) if case <= 2 else (r["b"], r["d"])
    return left[0] - right[0], left[1] - right[1]


def face_angle(b: Sides, q: Floats, case: int) -> Floats:
    """alpha - theta of the block whose face is touched: the right one in cases 1 and 3."""
    return b.alpha - q[..., 5 if case in (1, 3) else 4]


def penetration_and_slide(b: Sides, q: Floats, case: int, gap_sign: float = -1.0) -> tuple[Floats, Floats]:
    """v and u of the face; `gap_sign` +1 is the sign of d_y that Eqs. (7), (11), (15), (18) print."""
    (d_x, d_y), A = relative_displacement(b, q, case), face_angle(b, q, case)
    e_x = d_x - b.gap
    return e_x * np.sin(A) + gap_sign * d_y * np.cos(A), e_x * np.cos(A) - gap_sign * d_y * np.sin(A)


def case_of(b: Sides, q: Floats) -> NDArray[np.int64]:
    """The case by the headings of Sec. 2.3."""
    above, below = relative_displacement(b, q, 1)[1], relative_displacement(b, q, 3)[1]
    return np.where(q[..., 4] > q[..., 5], np.where(above < 0, 1, 2), np.where(below > 0, 3, 4))


def placed(b: Sides, case: int, theta: tuple[float, float], v: float, height: float) -> Floats:
    """The position with the left block moved so that penetration and height of the case's corners are given."""
    turned = np.array([0.0, 0.0, 0.0, 0.0, *theta])
    (d_x, d_y), A = relative_displacement(b, turned, case), face_angle(b, turned, case)
    e_x = (v + height * np.cos(A)) / np.sin(A)
    return turned + np.array([e_x + b.gap - d_x, 0.0, height - d_y, 0.0, 0.0, 0.0])


def approach(b: Sides, case: int, theta: tuple[float, float], v_rate: float, u_rate: float) -> Floats:
    """Rates of the left block, not turning, at which v and u change as given."""
    A = face_angle(b, np.array([0.0, 0.0, 0.0, 0.0, *theta]), case)
    v_x, v_y = v_rate * np.sin(A) + u_rate * np.cos(A), u_rate * np.sin(A) - v_rate * np.cos(A)
    return np.array([v_x, 0.0, v_y, 0.0, 0.0, 0.0])


def furthest(got, want) -> float:
    """Largest difference relative to the largest magnitude that was wanted."""
    return float(np.max(np.abs(np.asarray(got) - want)) / np.max(np.abs(want)))


def share_beyond(got, want, margin: float) -> float:
    """Share of the samples that differ by more than `margin` of what was wanted: a control's strength."""
    return float(np.mean(np.abs(np.asarray(got) - want) > margin * np.abs(want)))


def motion(q, rate) -> Motion:
    """A position and its rates, (6,) each, as the package's motion of pairs."""
    return Motion(*((a[i], a[i + 1]) for a in (q, rate) for i in (0, 2, 4)))


def posed(q) -> Pose:
    """A position (6,) as the package's pose."""
    return pose((q[0], q[1]), (q[2], q[3]), (q[4], q[5]))


def shrouds(b: Sides) -> Shroud:
    """Blocks (n,) as a batch of the package's shrouds."""
    return jax.vmap(Shroud)(*map(jnp.asarray, b))


def touch_at(shroud: Shroud, q, case, reading: frozenset[str] = CONSISTENT) -> tuple[ContactKinematics, Corners]:
    """The package's corner pair of one position."""
    block = corners(shroud, reading)
    return contact_kinematics(posed(q), case, block, reading), block


def over_draws(per_state):
    """`per_state(reading, case, shroud, ...)` over arrays of states, compiled once per reading and not per case."""
    lanes = lambda reading, case, *states: jax.vmap(partial(per_state, reading, case))(*states)
    compiled = jax.jit(lanes, static_argnums=0)
    return lambda reading, case, *states: compiled(reading, jnp.int32(case), *jax.tree.map(jnp.asarray, states))


@over_draws
def _touch_and_rates(reading: frozenset[str], case, shroud: Shroud, q, rate) -> tuple[ContactKinematics, ContactRates]:
    at, _ = touch_at(shroud, q, case, reading)
    return at, contact_rates(at, motion(q, rate), case, reading)


def touches(d: Draw, case: int, reading: frozenset[str] = CONSISTENT) -> tuple[ContactKinematics, ContactRates]:
    """The package's corner pairs and their rates at all positions of a draw."""
    return _touch_and_rates(reading, case, shrouds(d.sides), d.q, d.rate)
