"""The static equilibria of scenes: where mean loads, the blades' springs and contact balance, without friction.

The state of each point of contact, apart or pressed, and the case of each interface are held while Newton's method
finds the position, and then put right where the position contradicts them, until they agree. This begins from several
states, which may end in different equilibria.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.activity import counted
from jaxshroud.linear.resting_contact import RestingContact, resting_contact
from jaxshroud.model.linear_system import (
    ReducedSystem,
    directions,
    mean_loads,
    moving_coordinates,
    shroud_statics,
    solutions,
)
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray

NUMBERS_AT_ONCE = 1 << 18  # of the stiffness matrices of lanes that share a program
PRESSED = Mode.SLIP_PLUS  # of contact without friction
MOST_CHANGES = 200  # of states of contact in turn
CHANGES_AT_ONCE = 24  # of which so many change all that is wrong, then one by one, which ends where faces do not turn
MOST_UPDATES = 40  # of Newton's method in one state
CONVERGED = 1e-15  # an update of the position below this times its size ends them
STATE_ROUNDING = 64 * float(
    np.finfo(float).eps
)  # of displacements, and of torques, below which nothing is contradicted
SAME = 1e-9  # of the largest displacement: equilibria that differ by less are one


class Springs(NamedTuple):
    """The blades of lanes and what loads them, (lanes, 3 blades)."""

    stiffness: FloatArray  # (lanes, 3 blades, 3 blades)
    load: FloatArray
    moves: np.ndarray  # (3 blades,)
    closed: bool

    @property
    def blades(self) -> int:
        """The number of blades."""
        return len(self.moves) // 3


class ContactState(NamedTuple):
    """The state of contact of lanes at rest."""

    mode: np.ndarray  # (lanes, interfaces, points)
    case: np.ndarray  # (lanes, interfaces)
    u_s: FloatArray  # as the mode [m]


class Equilibrium(NamedTuple):
    """The static equilibrium of least energy of lanes."""

    q: FloatArray  # (lanes, 3, blades) x, y and theta; NaN where none is found
    found: np.ndarray  # (lanes,) how many different ones are
    contact: ContactState
    at: RestingContact
    energy: FloatArray  # (lanes,) [J]
    residual: FloatArray  # (lanes,) the largest unbalanced force over the largest force


def springs_of(scenes: Scene) -> Springs:
    """The blades of scenes (leading axis) under their mean loads."""
    arrays: Scene = jax.tree.map(with_float64, scenes)
    return Springs(
        stiffness=shroud_statics(arrays)[0],
        load=mean_loads(arrays),
        moves=moving_coordinates(arrays),
        closed=arrays.layout.closed,
    )


def with_float64(a: Any) -> np.ndarray:
    """A number of a scene; in float32 events would be told apart too coarsely."""
    return np.asarray(a, float if np.issubdtype(np.asarray(a).dtype, np.floating) else None)


def friction_free(scenes: Scene) -> Scene:
    """The scenes without friction."""
    return eqx.tree_at(lambda s: s.friction.mu, scenes, 0.0 * scenes.friction.mu)


def rubs(scenes: Scene) -> Any:
    """Whether there is friction, at each interface of scenes."""
    return (scenes.friction.mu > 0) & (scenes.friction.k_d > 0) & (scenes.parts.friction != "none")


def static_equilibria(scenes: Scene) -> Equilibrium:
    """The static equilibrium of least energy of each scene (leading axis), and how many are found.

    Friction is left out: there is none where a slider is set down at rest. Contact is the spring's, of corners or of
    several points.
    """
    return of_alike_at_rest(least_energy_equilibria, friction_free(without_given(scenes)))


def least_energy_equilibria(scenes: Scene) -> Equilibrium:
    """`static_equilibria` of each of scenes (leading axis) that are without friction already."""
    return in_pieces(_under_mean_loads, (scenes,), NUMBERS_AT_ONCE)


def of_alike_at_rest(f: Callable[[Scene], Any], scenes: Scene) -> Any:
    """`f`, which asks for nothing but what is at rest, of scenes (leading axis): once for those that are alike there.

    Those of a sweep over frequencies are, unless numbers depend on the speed.
    """
    at_rest = scenes
    if not scenes.depends_on_speed:
        at_rest = eqx.tree_at(lambda s: s.drive.omega, scenes, np.ones_like(scenes.drive.omega))
    numbers = [np.asarray(a, float).reshape(len(a), -1) for a in jax.tree.leaves(at_rest)]
    _, first, alike = np.unique(np.concatenate(numbers, axis=1), axis=0, return_index=True, return_inverse=True)
    found = f(jax.tree.map(lambda a: np.asarray(a)[first], scenes))
    return jax.tree.map(lambda a: a[alike.ravel()], found)


def in_pieces(f: Callable[..., Any], trees: tuple[Any, ...], at_once: int) -> Any:
    """`f` of lanes (leading axis), of which those with so many numbers of matrices share a program; NumPy arrays.

    The first of the `trees` are the scenes of the lanes.
    """
    scenes: Scene = trees[0]
    count = len(scenes.drive.omega)
    numbers = (3 * scenes.layout.blades) ** 2
    size = min(max(at_once // numbers, 1), 64) if count > 1 else 1  # two programs in all
    pieces = []
    with counted("scenes at rest", count) as tell:
        for begin in range(0, count, size):
            at = np.minimum(np.arange(begin, begin + size), count - 1)
            piece = f(*jax.tree.map(lambda a, at=at: np.asarray(a)[at], trees))
            pieces.append(jax.tree.map(lambda a, begin=begin: np.asarray(a)[: count - begin], piece))
            tell(min(size, count - begin))
    return jax.tree.map(lambda *a: np.concatenate(a), *pieces)


def _under_mean_loads(scenes: Scene) -> Equilibrium:
    return equilibria_under(springs_of(scenes), scenes)


def equilibria_under(springs: Springs, scenes: Scene) -> Equilibrium:
    """`static_equilibria` of few scenes (leading axis) without friction, under the loads on their `springs`."""
    if scenes.parts.contact == "none":
        q = solutions(springs.stiffness, springs.load).reshape(len(springs.load), 3, -1)
        nothing = RestingContact._make([np.zeros((len(q), 1))] * len(RestingContact._fields))._replace(
            load=0 * springs.load
        )
        return equilibrium_at(springs, alike_contact(scenes, Mode.APART, 0), nothing, q, np.ones(len(q), bool))
    ends = [_equilibrium(scenes, springs, first) for first in _first_states(scenes)]
    energies = np.array([np.where(np.isnan(end.q[:, 0, 0]), np.inf, end.energy) for end in ends])
    best = np.argmin(energies, axis=0)
    lanes = np.arange(energies.shape[1])
    found = _different(np.array([end.q for end in ends]))
    least = jax.tree.map(lambda *a: np.stack(a)[best, lanes], *ends)
    return least._replace(found=found)


def _first_states(scenes: Scene) -> list[ContactState]:
    """The states of contact from which equilibria are sought: one for all interfaces."""
    cases = (FLAT, 2, 4) if meets_at_corners(scenes) else (4,)
    return [alike_contact(scenes, Mode.APART, 0), *(alike_contact(scenes, PRESSED, case) for case in cases)]


def meets_at_corners(scenes: Scene) -> bool:
    """Whether blocks turn, and faces meet at corners or flat on each other."""
    return "theta" in scenes.parts.motion and not scenes.points


def alike_contact(scenes: Scene, mode: Any, case: int) -> ContactState:
    """The state of contact of scenes (leading axis) with one case, and one mode or that of each interface."""
    shape = len(scenes.drive.omega), scenes.layout.interfaces
    of_points = *shape, max(scenes.points, 1)
    modes = np.broadcast_to(np.reshape(mode, (-1, 1)), of_points).astype(np.int32)
    return ContactState(modes, np.full(shape, case, np.int32), np.zeros(of_points))


def _different(ends: FloatArray) -> np.ndarray:
    """How many different equilibria (starts, lanes, 3, blades) each lane has."""
    flat = ends.reshape(*ends.shape[:2], -1)
    size = SAME * np.nanmax(np.abs(flat), axis=(0, 2), initial=0.0)
    number = np.zeros(ends.shape[1], int)
    for i, own in enumerate(flat):
        with np.errstate(invalid="ignore"):
            seen = [np.max(np.abs(own - other), axis=1) <= size for other in flat[:i]]
        number += ~np.isnan(own[:, 0]) & ~np.any([np.zeros(len(size), bool), *seen], axis=0)
    return number


def _equilibrium(scenes: Scene, springs: Springs, contact: ContactState) -> Equilibrium:
    """The equilibrium to which one state of contact leads, lane by lane; NaN where to none."""
    q, at = position_in(scenes, springs, contact, np.zeros((len(springs.load), 3, springs.blades)))
    settled = np.zeros(len(q), bool)
    for change in range(MOST_CHANGES):
        new = _corrected(springs, contact, at, q)
        wrong = (new.case != contact.case) | np.any(new.mode != contact.mode, axis=-1)
        settled = ~wrong.any(axis=1)
        if settled.all():
            break
        if change >= CHANGES_AT_ONCE:
            wrong &= np.cumsum(wrong, axis=1) == 1
        contact = jax.tree.map(
            lambda a, b, wrong=wrong: np.where(wrong.reshape(wrong.shape + (1,) * (a.ndim - 2)), b, a), contact, new
        )
        q, at = position_in(scenes, springs, contact, np.where(settled[:, None, None], q, 0.0))
    return equilibrium_at(springs, contact._replace(u_s=at.u), at, q, settled)


def equilibrium_at(
    springs: Springs, contact: ContactState, at: RestingContact, q: FloatArray, settled: np.ndarray
) -> Equilibrium:
    """The equilibrium of lanes at positions in a state of contact; NaN where they are not `settled`."""
    lost = np.isnan(q).any(axis=(1, 2)) | ~settled
    left_over = _reduction(springs, contact).over(unbalanced(springs, at, q))
    residual = np.abs(left_over).max(axis=1) / np.maximum(_largest(springs, at, q), 1e-300)
    work = np.sum((_elastic(springs, q) / 2 - springs.load) * q.reshape(len(q), -1), axis=1)
    q = np.where(lost[:, None, None], np.nan, q)
    return Equilibrium(q, settled.astype(int), contact, at, work + at.energy.sum(axis=1), residual)


def position_in(
    scenes: Scene, springs: Springs, contact: ContactState, q: FloatArray
) -> tuple[FloatArray, RestingContact]:
    """The positions of equilibrium in one state of contact of each lane by Newton's method, and the contact there."""
    for _ in range(MOST_UPDATES):
        at = contact_at(scenes, q, contact)
        step = displacements_under(unbalanced(springs, at, q), springs, contact, at)
        q = q + step
        with np.errstate(invalid="ignore"):
            if not np.any(np.abs(step).max(axis=(1, 2)) > CONVERGED * np.abs(q).max(axis=(1, 2))):
                break
    return q, contact_at(scenes, q, contact)


def displacements_under(r: FloatArray, springs: Springs, contact: ContactState, at: RestingContact) -> FloatArray:
    """The displacements (lanes, 3, blades) by further forces (lanes, 3 blades), in the state of contact as it is."""
    blocks = _reduction(springs, contact)
    y = solutions(blocks.reduced(springs.stiffness - at.load_q), blocks.over(r))
    return blocks.expanded(y).reshape(len(r), 3, -1)


def contact_at(scenes: Scene, q: FloatArray, contact: ContactState) -> RestingContact:
    """The contact of scenes at positions in a state, as NumPy arrays."""
    dtype = scenes.drive.omega.dtype
    held = resting_contact(scenes, q.astype(dtype), contact.mode, contact.case, contact.u_s.astype(dtype))
    return jax.tree.map(np.asarray, held)


def unbalanced(springs: Springs, at: RestingContact, q: FloatArray) -> FloatArray:
    """The sum of the forces on each coordinate, (lanes, 3 blades)."""
    return np.where(springs.moves, springs.load - _elastic(springs, q) + at.load, 0.0)


def _elastic(springs: Springs, q: FloatArray) -> FloatArray:
    """The forces (lanes, 3 blades) that the springs of and between the blades hold."""
    return (springs.stiffness @ q.reshape(len(q), -1, 1))[..., 0]


def _largest(springs: Springs, at: RestingContact, q: FloatArray) -> FloatArray:
    """The largest force on a coordinate of each lane, forces and moments alike (lanes,)."""
    return np.abs([_elastic(springs, q), springs.load, at.load]).max(axis=(0, 2))


def held_directions(springs: Springs, contact: ContactState) -> FloatArray:
    """The directions in which the blocks can move, see `directions`."""
    return directions(springs.moves, np.equal(contact.case, FLAT), springs.closed)


def _reduction(springs: Springs, contact: ContactState) -> ReducedSystem:
    return ReducedSystem(held_directions(springs, contact))


def passed_on(springs: Springs, contact: ContactState, forces: FloatArray) -> FloatArray:
    """The torque that flat faces pass on to the block right of them, (lanes, interfaces); 0 elsewhere.

    Of a ring that is flat all round it is that of least norm.
    """
    flat = np.equal(contact.case, FLAT)
    torque = forces[:, 2 * springs.blades :]
    passed = np.zeros(flat.shape)
    for _ in range(2 if springs.closed else 1):
        for j in range(flat.shape[1]):
            before = passed[:, j - 1] * flat[:, j - 1] if j or springs.closed else 0.0
            passed[:, j] = np.where(flat[:, j], before + torque[:, j], 0.0)
    around = springs.closed & flat.all(axis=1)
    return passed - np.where(around, passed.mean(axis=1), 0.0)[:, None]


def _corrected(springs: Springs, contact: ContactState, at: RestingContact, q: FloatArray) -> ContactState:
    """The state of contact where the position agrees with it, and what follows from the position elsewhere."""
    size = np.abs(q).max(axis=(1, 2))
    noise = STATE_ROUNDING * size[:, None]
    is_apart = np.equal(contact.mode, Mode.APART)
    if at.v.shape[-1] > 1:
        pressed = np.where(is_apart, at.v > noise[..., None], at.v > -noise[..., None])
        return contact._replace(mode=np.where(pressed, PRESSED, Mode.APART).astype(np.int32))
    apart, v = is_apart[..., 0], at.v[..., 0]
    pressed = np.where(apart, at.natural_v > noise, v > -noise)
    case = np.where(contact.case == FLAT, _case_of_flat(springs, contact, at, q), at.natural)
    if springs.moves[-springs.blades]:
        upper = contact.case <= 2
        crossed = ~apart & (contact.case != FLAT) & np.where(upper, at.turn < -noise, at.turn > noise)
        parallel = ~apart & (contact.case != FLAT) & (np.abs(at.turn) <= noise)
        case = np.where(crossed, FLAT, np.where(parallel, contact.case, case))
    mode = np.where(pressed, PRESSED, Mode.APART).astype(np.int32)
    return contact._replace(mode=mode[..., None], case=np.where(pressed, case, 0).astype(np.int32))


def _case_of_flat(springs: Springs, contact: ContactState, at: RestingContact, q: FloatArray) -> np.ndarray:
    """The case of faces that are flat: still flat, or that of the corner beyond which the resultant would act."""
    passed = passed_on(springs, contact, unbalanced(springs, at, q))
    lower, upper = (at.end_torques[..., i] + passed for i in (0, 1))
    noise = STATE_ROUNDING * np.abs(at.end_torques).max(axis=-1)
    return np.where(upper > noise, 2, np.where(lower < -noise, 4, FLAT))
