"""A row of blades: at each interface the contact of a pair, and Eq. (1) of every blade.

Interface j is the right face of block j against the left face of block j + 1: N - 1 interfaces of a chain, N of a
closed row, whose last one is between block N - 1 and block 0. The row is unrolled: neighbours' axes are parallel, as
in the article's Sec. 2.1 with a large radius; the angle 2 pi / N between them is neglected.

Arrays have an axis of blades (N) or of interfaces (E) first, then the lanes. A function of one blade, or of one
interface, is applied to all of them by `over`, as one kernel. The physics of an interface is that of the pair.

**Flat contact.** Blocks whose faces are flat on each other turn as one: a cluster. The resultants inside a cluster act
where all its angular accelerations agree, so that its angular acceleration is the mean of those of its blocks, weighted
by their inertia, wherever the resultants act. Their places follow from the angular momentum that each has to pass on,
block by block. In a closed row that is flat all round a uniform circulating torque is undetermined: its least norm is
taken.
"""

import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshroud.model.arithmetic import (
    ZERO,
    Unrolled,
    Zero,
    both_sides,
    is_unrolled,
    is_zero,
    left_of_interfaces,
    right_of_interfaces,
    sum_at_blades,
    times_along,
    total,
    where,
)
from jaxshroud.model.blade import (
    AnyBlade,
    BladeForces,
    ModalBlade,
    blades_of_row,
    dot,
)
from jaxshroud.model.coupling import (
    AeroMatrices,
    NeighbourSprings,
    aero_matrices,
    forces_of_flow,
    forces_of_springs,
    half_losses,
    mode_pulls,
    mode_stretches,
    neighbour_springs,
    spring_energies,
)
from jaxshroud.model.drive import Excitation, excitation
from jaxshroud.model.geometry import gyration, rotation
from jaxshroud.model.linear import StaticPosition, static_position
from jaxshroud.model.modes import FLAT
from jaxshroud.model.prepared import State, prepared_model
from jaxshroud.model.rhs import (
    ContactEffects,
    Integrals,
    Ledger,
    Means,
    Moments,
    Recorded,
    StateDerivative,
    blade_mean_square,
    contact_effects,
    position_of,
)
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.scene import Contact, Friction, Scene, Shroud

if TYPE_CHECKING:
    OfBlades = Float[Array, "blades lanes"]
    OfInterfaces = Float[Array, "interfaces lanes"]
    CaseOfInterfaces = Int[Array, "interfaces lanes"]
    FlagOfInterfaces = Bool[Array, "interfaces lanes"]
else:
    OfBlades = Float[Array, "blades lanes"] | Unrolled | Zero
    OfInterfaces = Float[Array, "interfaces lanes"] | Unrolled | Zero
    CaseOfInterfaces = Int[Array, "interfaces lanes"] | Unrolled
    FlagOfInterfaces = Bool[Array, "interfaces lanes"] | Unrolled
Each = Callable[..., Any]  # (f, *trees) -> `f(*trees)` for every element of the leading axis


class RowModel(eqx.Module):
    """A scene of a row prepared for stepping."""

    blades: AnyBlade  # of each blade, with its mistuning
    drive: Excitation
    inverse: Any  # `InverseMasses`: what multiplies forces to accelerations; None for blades by modes
    gyration: Any  # J_A / A [m^2], one for the row
    static: StaticPosition | None  # of each blade, from which power is measured; None: from rest
    interfaces: Any  # the `Model` of the pair at each interface
    coupling: NeighbourSprings | None  # between neighbours
    kappa: tuple[Any, ...]  # between equal modes of neighbours [1/s^2]; empty without any
    aero: AeroMatrices | None  # of the flow
    closed: bool = eqx.field(static=True)
    parts: Parts = eqx.field(static=True)

    @property
    def is_pair(self) -> bool:
        """Whether it is an unrolled pair."""
        return is_unrolled(self.blades.I)

    @property
    def turns(self) -> bool:
        """Whether the blocks can turn."""
        return "theta" in self.parts.motion

    @property
    def turns_by_events(self) -> bool:
        """Whether contact moves from corner to corner by events, and may be flat."""
        return self.turns and self.interfaces.law.has_events and not self.interfaces.law.has_points


def along_blades(tree: Any) -> Any:
    """A tree of arrays (2,) along an unrolled axis of blades."""
    return jax.tree.map(lambda a: Unrolled(a[0], a[1]) if jnp.ndim(a) == 1 else a, tree)


def at_interface(tree: Any) -> Any:
    """A tree of numbers of the only interface along an unrolled axis of interfaces."""
    return jax.tree.map(Unrolled, tree)


def at_only_interface(tree: Any) -> Any:
    """The inverse of `at_interface`."""
    return jax.tree.map(lambda a: a[0] if is_unrolled(a) else a, tree, is_leaf=is_unrolled)


def prepared_row(scene: Scene) -> RowModel:
    """The constants of a row, or of a pair, which is an unrolled one; without an axis of lanes."""
    scene.check_modal_loads()
    row, parts, modes = scene.row, scene.parts, scene.mode_numbers
    blades = blades_of_row(scene)
    of_blades = blades, excitation(scene.drive), blades.inverse_masses(parts), static_position(scene)
    between = neighbour_springs(scene), () if modes is None else modes.kappa
    if row is None:
        of_blades = along_blades(of_blades)
        between = at_interface(between)
        interfaces = at_interface(prepared_model(scene))
    else:
        interfaces = jax.vmap(lambda j: prepared_model(pair_at(scene, j)))(jnp.arange(row.interfaces))
    blades, drive, inverse, static = of_blades
    coupling, kappa = between
    if parts.neighbour == "rigid":
        inverse = _of_left_alone(inverse)
        if isinstance(blades, ModalBlade):
            blades = replace(blades, shapes=_of_left_alone(blades.shapes))
    return RowModel(
        blades=blades,
        drive=drive,
        inverse=inverse,
        gyration=gyration(scene.shroud),
        static=static,
        interfaces=interfaces,
        coupling=coupling,
        kappa=kappa,
        aero=aero_matrices(scene),
        closed=scene.layout.closed,
        parts=parts,
    )


def _of_left_alone(tree: Any) -> Any:
    """A tree of numbers of both blades, of which the right one has none."""
    return jax.tree.map(lambda a: Unrolled(a[0], ZERO), tree, is_leaf=is_unrolled)


def pair_at(scene: Scene, j: Any, by_modes: bool = False) -> Scene:
    """The pair of blades at interface `j`, without their mistuning, which contact does not feel; a pair is its own.

    Contact feels no more of the modes of blades than lumped ones that stand for them; `by_modes` keeps the modes.
    """
    row, s = scene.row, scene.running_shroud
    if row is None:
        return scene
    sides = jnp.stack([j, (j + 1) % row.blades])

    def take(tree):
        return jax.tree.map(lambda a: a[sides], tree)

    width = None if scene.contact.width is None else scene.contact.width[j]
    return Scene(
        take(scene.running_modes if by_modes and scene.mode_numbers is not None else scene.running_blades),
        Shroud(s.alpha, s.l_oa, s.l_ab, s.gap[j]),
        Contact(scene.k[j], None, width=width, points=scene.contact.points),
        Friction(scene.friction.k_d[j], scene.friction.mu[j]),
        scene.drive.of_blades(sides),
        take(scene.initial),
        scene.parts,
        scene.laws,
    )


def alone(f: Callable[..., Any], *trees: Any) -> Any:
    """`f` of one element: an `Each`."""
    return f(*trees)


def over(each: Each, f: Callable[..., Any], *trees: Any) -> Any:
    """`f` of one blade, or of one interface, for all of them and all lanes, as one kernel.

    Args:
        each: How a function of one element is applied to a leading axis.
        f: A function of scalars.
        trees: Trees of arrays (M, lanes), or (lanes,), which count for all M.
    """
    lengths = {len(a) for a in jax.tree.leaves(trees, is_leaf=is_unrolled) if is_unrolled(a)}
    if lengths:
        (length,) = lengths
        return unrolled_places([each(f, *_at(i, trees)) for i in range(length)])
    if each is alone:
        return f(*trees)
    shape = max((a.shape for a in jax.tree.leaves(trees)), key=len)
    flat = jax.tree.map(lambda a: jnp.reshape(jnp.broadcast_to(a, shape), -1), trees)
    return jax.tree.map(lambda a: jnp.reshape(a, shape), each(f, *flat))


def _at(i: int, trees: Any) -> Any:
    """Trees with the numbers of one blade, or of one interface."""
    return jax.tree.map(lambda a: a[i] if is_unrolled(a) else a, trees, is_leaf=is_unrolled)


def unrolled_places(trees: Sequence[Any]) -> Any:
    """The tree of the numbers along an axis, from a tree for each of its places."""

    def along(*numbers):
        return ZERO if all(map(is_zero, numbers)) else Unrolled(*numbers)

    return jax.tree.map(along, *trees, is_leaf=is_zero)


def pair_states(state: State, model: RowModel) -> State:
    """The state of the pair at each interface."""
    return State(both_sides(model.blades.shroud(state.motion), model.closed), state.u_s, state.mode, state.case)


def blade_forces(effects: ContactEffects, shroud: Motion, model: RowModel) -> BladeForces:
    """The forces on each blade of contact, of its neighbours and of the flow, at a motion of the shrouds."""
    forces = contact_forces_on_blades(effects, model)
    if model.coupling is not None:
        forces = forces.plus(forces_of_springs(shroud, model.coupling, model.closed))
    if model.aero is not None:
        forces = forces.plus(BladeForces(forces_of_flow(shroud, model.aero, model.closed), ZERO, ZERO))
    return forces


def contact_forces_on_blades(effects: ContactEffects, model: RowModel) -> BladeForces:
    """The forces of contact on each blade."""
    load = effects.load
    at_blades = partial(sum_at_blades, closed=model.closed)
    if is_zero(load.R_x):
        return BladeForces(ZERO, ZERO, ZERO)
    M = at_blades(*load.M) if model.turns else ZERO
    return BladeForces(at_blades(load.R_x, -load.R_x), at_blades(load.R_y, -load.R_y), M)


class Cluster(NamedTuple):
    """The blocks that are flat on each other, as matrices over blades; a block without a flat face is alone."""

    flat: FlagOfInterfaces
    share: Any  # (N, N, lanes): of block k in the mean of the cluster of block i
    joint: OfInterfaces  # inertia against a turn towards each other of the clusters at each interface [kg m^2]
    before: Any  # (E, N, lanes): block k is in the cluster of the flat interface j, and not right of it
    all_round: Bool[Array, "..."]  # a closed row that is flat at every interface

    def mean(self, a: OfBlades) -> OfBlades:
        """The mean of each cluster, weighted by inertia, for each of its blocks."""
        return times_along(self.share, a)

    def torques(self, own: OfBlades, model: RowModel) -> OfInterfaces:
        """The torque on theta_j - theta_(j+1) of each interface with contact at the corner of its case [N m].

        It is the inertia of both clusters against a turn towards each other times the relative angular acceleration; of
        flat faces the torque that they pass on to the block right of them. See `torques_along_face`.

        Args:
            own: The angular acceleration of each block by itself, with contact at the corner of its case [rad/s^2].
            model: The constants.
        """
        mean = self.mean(own)
        apart = self.joint * (left_of_interfaces(mean, model.closed) - right_of_interfaces(mean, model.closed))
        excess = model.blades.I * (own - mean)
        torque = jnp.sum(jnp.where(self.before, excess[None], 0.0), axis=1)
        passed = torque - jnp.where(self.all_round, jnp.mean(torque, axis=0), 0.0)[None]
        return where(self.flat, passed, apart)


class FlatPair(NamedTuple):
    """The `Cluster` of two blocks with one interface."""

    flat: FlagOfInterfaces  # whether they are flat on each other
    share: Any  # see `Mobility`, as is the next
    joint: OfInterfaces

    def mean(self, a: Any) -> Any:
        """The mean of both blocks, weighted by inertia, where they are flat on each other, else their own numbers."""
        left, right = a
        flat = self.flat[0]
        mean = right + self.share * (left - right)
        return Unrolled(where(flat, mean, left), right if is_zero(right) else where(flat, mean, right))

    def torques(self, own: Any, model: RowModel) -> Any:
        """As of a `Cluster`."""
        del model
        left, right = own
        return self.joint * (left - right)


def clusters(case: CaseOfInterfaces, model: RowModel) -> Cluster | FlatPair:
    """The clusters of blocks from the case of each interface (E, lanes)."""
    flat = case == FLAT
    I = model.blades.I
    closed = model.closed
    if is_unrolled(flat):
        mobility = model.interfaces.mobility
        return FlatPair(flat, mobility.share[0], mobility.joint)
    breaks = jnp.cumsum(~flat, axis=0, dtype=jnp.int32)  # interfaces that are not flat, up to each
    label = jnp.concatenate([jnp.zeros_like(breaks[:1]), breaks[:-1] if closed else breaks])  # left of each block
    all_round = breaks[-1] == 0 if closed else jnp.zeros_like(flat[0])
    wraps = label == breaks[-1:] if closed else jnp.zeros_like(label, bool)  # its cluster goes on at block 0
    place = jnp.arange(len(I), dtype=jnp.int32)[:, None]
    first = jnp.where(wraps & ~all_round[None], place - len(I), jnp.broadcast_to(place, label.shape))
    label = jnp.where(wraps, 0, label)
    same = label[:, None] == label[None]
    inertia = jnp.sum(jnp.where(same, I[None], 0.0), axis=1)
    left = first if closed else first[:-1]
    before = flat[:, None] & same[: len(flat)] & (first[None] <= left[:, None])
    left = left_of_interfaces(inertia, closed)
    right = right_of_interfaces(inertia, closed)
    share = jnp.where(same, I[None] / inertia[:, None], 0.0)
    return Cluster(flat, share, left * right / (left + right), before, all_round)


def clusters_of(state: State, model: RowModel) -> Cluster | FlatPair | None:
    """The blocks that are flat on each other; None where no blocks can be."""
    return clusters(state.case, model) if model.turns_by_events else None


def of_blades_that_count(tree: Any, model: RowModel) -> Any:
    """A tree along an axis of blades with those that count: the left one of a pair, all of a row."""

    def counting(a: Any) -> Any:
        return Unrolled(a[0]) if is_unrolled(a) else a

    return jax.tree.map(counting, tree, is_leaf=is_unrolled) if model.is_pair else tree


def positions_that_count(z: Motion, model: RowModel) -> Means:
    """The position of each blade that counts."""
    return over(alone, position_of, of_blades_that_count(z, model))


class BladeRates(NamedTuple):
    """The accelerations of one blade, and the rates of its integrals."""

    acceleration: Any  # of its coordinates
    power: Any  # square displacement, `blade_mean_square`
    drive: Any = None  # power of the drive; None where it is not recorded, as is the next
    viscous: Any = None
    means: Any = None  # `Means`; None where they are not recorded


def blade_rates(
    z: Any,
    wave: Any,
    R: BladeForces,
    blade: AnyBlade,
    drive: Excitation,
    inverse: Any,
    gyration: Any,
    static: StaticPosition | None,
    recorded: Recorded,
) -> BladeRates:
    """The rates of one blade; `wave` is (sin, cos) of omega t."""
    Q = drive.wave(*wave)
    shroud = blade.shroud(z)
    acceleration = blade.accelerations(z, Q, drive, R, inverse)
    work, viscous = (blade.drive_power(z, Q, drive), blade.viscous_power(z)) if recorded.ledger else (None, None)
    means = position_of(shroud) if recorded.means else None
    power = blade_mean_square(shroud.x, shroud.y, *rotation(shroud.theta), gyration, static)
    return BladeRates(acceleration, power, work, viscous, means)


def rates_of_blades(z: Any, wave: Any, R: BladeForces, model: RowModel, recorded: Recorded, each: Each) -> BladeRates:
    """`blade_rates` of every blade: fields (N, lanes)."""
    rates = partial(blade_rates, recorded=recorded)
    found = over(each, rates, z, wave, R, model.blades, model.drive, model.inverse, model.gyration, model.static)
    if not model.kappa:
        return found
    pulls = mode_pulls(model.kappa, z.q, model.closed)
    return found._replace(acceleration=tuple(map(operator.add, found.acceleration, pulls)))


def row_rhs(
    wave: Any, now: State, cluster: Cluster | FlatPair | None, model: RowModel, recorded: Recorded, each: Each
) -> tuple[StateDerivative, Integrals]:
    """The accelerations of a row and the rates of the `recorded` integrals while modes and cases are fixed.

    Args:
        wave: (sin, cos) of omega t, (lanes,) each.
        now: The state: motion of the blades' coordinates (N, lanes), and slider, mode and case (E, lanes).
        cluster: The blocks that are flat on each other; None where no blocks can be.
        model: The constants.
        recorded: The integrals beside the power.
        each: How a function of one element is applied to a leading axis.

    Returns:
        The derivative; and the rates of the integrals of each blade, those of contact of each interface.
    """
    blades = model.blades
    effects = over(each, partial(contact_effects, recorded=recorded), pair_states(now, model), model.interfaces)
    R = blade_forces(effects, blades.shroud(now.motion), model)
    rates = rates_of_blades(now.motion, wave, R, model, recorded, each)
    a = rates.acceleration
    if cluster is not None:
        a = blades.turned(a, cluster.mean(blades.turning(a)), model.inverse)
    ledger = None
    if recorded.ledger:
        viscous = rates.viscous + coupling_losses(now.motion, model)
        drive, viscous, lost = (in_one_ledger(a, model) for a in (rates.drive, viscous, effects.lost))
        ledger = Ledger(drive, abs(drive), viscous, lost)
    moments = None
    if recorded.moments:
        z = blades.shroud(now.motion)
        first = (z.x, z.y, z.theta)
        moments = Moments(first, jax.tree.map(lambda a: a * a, first))
    means = of_blades_that_count(rates.means, model)
    return StateDerivative(a, effects.u_s), Integrals(rates.power, ledger, moments, effects.loads, means)


def in_one_ledger(work: Any, model: RowModel) -> Any:
    """Works along an axis as a ledger has them: of a pair their sum, of a row each by itself."""
    return total(work) if model.is_pair else work


def turned_as_one(z: Any, cluster: Cluster | FlatPair, when: Any, model: RowModel) -> Any:
    """The motion where blocks that are flat on each other turn as one, with their angular momentum, `when` that is."""
    shroud = model.blades.shroud(z)
    theta, v_theta = (where(when, cluster.mean(a), a) for a in (shroud.theta, shroud.v_theta))
    return model.blades.with_turn(z, theta, v_theta, model.inverse)


def coupling_losses(z: Any, model: RowModel) -> Any:
    """The power lost between blades [W]: half of each damper for both of its blades, and what the flow takes.

    It is absent where nothing couples the blades.
    """
    shroud = model.blades.shroud(z)
    lost = ZERO
    if model.coupling is not None:
        lost = lost + half_losses(shroud, model.coupling, model.closed)
    if model.aero is not None:
        lost = lost - forces_of_flow(shroud, model.aero, model.closed) * shroud.v_x
    return lost


def coupling_energies(z: Any, model: RowModel) -> Any:
    """The energy of the springs between neighbours at each interface [J]; absent without them."""
    between = ZERO
    if model.coupling is not None:
        between = between + spring_energies(model.blades.shroud(z), model.coupling, model.closed)
    if model.kappa:
        between = between + dot(model.kappa, [a * a for a in mode_stretches(z.q, model.closed)]) / 2
    return between


def blade_energies(z: Any, model: RowModel, each: Each) -> OfBlades:
    """The kinetic energy and the energy of the springs of each blade [J]."""
    return over(each, lambda z, blade: blade.twice_energy(z), z, model.blades) / 2
