"""Forces between blades that do not touch: of springs and dampers between neighbours, and of the flow.

Numbers are those of one interface, of a pair for instance, or arrays for all of a row; what a scene does not have is
absent. Both are linear: `linear_system.coupling_matrix` has them as matrices.
"""

import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxshroud.model.arithmetic import (
    ZERO,
    Scalar,
    is_zero,
    left_of_interfaces,
    neighbours,
    right_of_interfaces,
    sum_at_blades,
    summed,
)
from jaxshroud.model.blade import BladeForces
from jaxshroud.scene.blades import Aero, Coupling
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene

SUFFIXES = {"x": "x", "y": "y", "theta": "T"}  # of stiffnesses and dampings, by coordinate


class SpringForces(NamedTuple):
    """The forces of the springs and dampers at an interface on the blade left of it; the right one has the opposite."""

    x: Any  # [N]
    y: Any
    M: Any  # [N m]


class NeighbourSprings(eqx.Module):
    """The springs and dampers between neighbours of one interface, or of each."""

    k_x: Any  # [N/m]
    k_y: Any
    k_T: Any  # [N m/rad]
    c_x: Any  # [N s/m]
    c_y: Any
    c_T: Any  # [N m s/rad]

    def forces(self, left: Motion, right: Motion) -> SpringForces:
        """The forces on the left blade."""
        return SpringForces(
            self.k_x * (right.x - left.x) + self.c_x * (right.v_x - left.v_x),
            self.k_y * (right.y - left.y) + self.c_y * (right.v_y - left.v_y),
            self.k_T * (right.theta - left.theta) + self.c_T * (right.v_theta - left.v_theta),
        )

    def lost(self, left: Motion, right: Motion) -> Scalar:
        """The power lost in the dampers [W]."""
        along = self.c_x * (right.v_x - left.v_x) ** 2 + self.c_y * (right.v_y - left.v_y) ** 2
        return along + self.c_T * (right.v_theta - left.v_theta) ** 2

    def twice_energy(self, left: Motion, right: Motion) -> Scalar:
        """Twice the energy of the springs [J]."""
        along = self.k_x * (right.x - left.x) ** 2 + self.k_y * (right.y - left.y) ** 2
        return along + self.k_T * (right.theta - left.theta) ** 2


def neighbour_springs(scene: Scene) -> NeighbourSprings | None:
    """The springs and dampers of a scene, without those along coordinates that no block has; None without any."""
    coupling = scene.coupling

    def number(kind, name):
        return getattr(coupling, f"{kind}_{SUFFIXES[name]}") if scene.parts.has(name, 0) else None

    numbers = {f"{kind}_{SUFFIXES[name]}": number(kind, name) for kind in "kc" for name in COORDINATES}
    if all(a is None for a in numbers.values()):
        return None
    return NeighbourSprings(**{name: ZERO if a is None else a for name, a in numbers.items()})


def mode_stretches(q: tuple[Any, ...], closed: bool) -> list[Any]:
    """The difference of each mode's coordinates right and left of each interface."""
    return [right_of_interfaces(a, closed) - left_of_interfaces(a, closed) for a in q]


def mode_pulls(kappa: tuple[Any, ...], q: tuple[Any, ...], closed: bool) -> list[Any]:
    """The accelerations of the modes of each blade by equal modes of its neighbours."""
    pulls = map(operator.mul, kappa, mode_stretches(q, closed))
    return [sum_at_blades(pull, -pull, closed) for pull in pulls]


def _on_both_sides(z: Motion, closed: bool) -> tuple[Motion, Motion]:
    """The motion of the blade left of each interface, and of that right of it."""

    def side(of):
        return Motion._make(a if is_zero(a) else of(a, closed) for a in z)

    return side(left_of_interfaces), side(right_of_interfaces)


def forces_of_springs(z: Motion, springs: NeighbourSprings, closed: bool) -> BladeForces:
    """The forces of a row's springs and dampers on each blade, from the motion of the shrouds (N, lanes)."""
    on_left = springs.forces(*_on_both_sides(z, closed))
    return BladeForces._make(a if is_zero(a) else sum_at_blades(a, -a, closed) for a in on_left)


def half_losses(z: Motion, springs: NeighbourSprings, closed: bool) -> Any:
    """The power lost in a row's dampers, half of each for both of its blades (N, lanes) [W]."""
    lost = springs.lost(*_on_both_sides(z, closed))
    return lost if is_zero(lost) else sum_at_blades(lost / 2, lost / 2, closed)


def spring_energies(z: Motion, springs: NeighbourSprings, closed: bool) -> Any:
    """The energy of the springs at each interface (E, lanes) [J]."""
    energy = springs.twice_energy(*_on_both_sides(z, closed))
    return energy if is_zero(energy) else energy / 2


class InfluenceForce(NamedTuple):
    """What the motion of one blade along x does to another, or to itself."""

    k: Any  # Re L [N/m]
    c: Any  # Im L / omega [N s/m]

    def at(self, x: Any, v_x: Any) -> Any:
        """The force against it [N]."""
        return self.k * x + self.c * v_x


class AeroMatrices(NamedTuple):
    """The forces of the flow on each blade by its own motion, and by that of the next blade and the one before."""

    own: InfluenceForce | None
    next: InfluenceForce | None
    before: InfluenceForce | None


def aero_matrices(scene: Scene) -> AeroMatrices | None:
    """The forces of the flow as stiffnesses and dampings at the base frequency of the drive; None without any."""
    if not scene.aero.exists:
        return None
    parts = (scene.aero.coefficient(name) for name in ("L0", "L1", "L_1"))
    return AeroMatrices._make(None if L is None else InfluenceForce(L[0], L[1] / scene.drive.omega) for L in parts)


def forces_of_flow(z: Motion, aero: AeroMatrices, closed: bool) -> Any:
    """The force of the flow along x on each blade of a row (N, lanes) [N]."""
    against = ZERO
    for force, shift in ((aero.own, 0), (aero.next, -1), (aero.before, 1)):
        if force is not None:
            moved = [neighbours(a, shift, closed) if shift else a for a in (z.x, z.v_x)]
            against = against + force.at(*moved)
    return -against


def couplings_of_pairs(row: Scene) -> tuple[Coupling, Aero]:
    """The coupling of pairs at every interface of a row (leading axis), twice that of the row, and a bound of the flow.

    The bound acts on each blade alone, by the sum of all magnitudes.
    """

    def at_interfaces(a: Any) -> Any:
        return jnp.broadcast_to(a, (row.layout.interfaces,))

    flow = [L for name in ("L0", "L1", "L_1") if (L := row.aero.coefficient(name)) is not None]
    bound = Aero()
    if flow:
        re, im = (at_interfaces(summed(map(jnp.abs, parts))) for parts in zip(*flow, strict=True))
        bound = Aero(L0_re=re, L0_im=im)
    return jax.tree.map(lambda k: 2 * at_interfaces(k), row.coupling), bound
