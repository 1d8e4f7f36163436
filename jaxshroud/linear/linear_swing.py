"""What swings about a static position in a linear motion: its equations by harmonics, and their solutions.

They are solved by LAPACK on the host: within compiled programs many systems at once may wait for each other without end
(jaxlib 0.10, matrices of 45 and more on two cores).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxshroud.cache.programs import kept
from jaxshroud.linear.equilibrium import PRESSED, friction_free
from jaxshroud.linear.held_contact import HeldContact
from jaxshroud.linear.natural_modes import drive_loads
from jaxshroud.linear.resting_contact import resting_contact_of
from jaxshroud.model.linear_system import LinearSystem, ReducedSystem, free_system, mean_loads, solutions
from jaxshroud.model.modes import Mode
from jaxshroud.scene.scene import Scene


class Equations(NamedTuple):
    """Linear systems of lanes."""

    matrix: Any  # (lanes, n, n)
    right: Any  # (lanes, n)


class HeldRest(NamedTuple):
    """The static position of lanes in a state of contact, what acts there, and the matrices of motions about it."""

    q: Any  # (lanes, 3 blades)
    N: Any  # (lanes, interfaces, points) normal forces, as the next three
    F: Any
    open_v: Any  # (lanes, interfaces, corners) penetrations, see `RestingContact`
    N_q: Any  # (lanes, interfaces, points, 3 blades) derivatives by the coordinates, as the next two
    F_q: Any
    open_v_q: Any
    matrices: LinearSystem  # over the directions


SwingWaves = dict[int, Any]  # complex amplitudes of lanes over the directions in which the blocks can move, by order


def steady_swings(scenes: Scene, held: HeldContact) -> tuple[HeldRest, SwingWaves]:
    """The static positions of scenes (leading axis), and the motions about them.

    Source:
        (K - n^2 omega^2 M + i n omega C) A_n = Q_n, where K is the stiffness of the blades and the derivative of the
        forces of contact at the static equilibrium, over the directions in which the blocks can move.
    """
    step = solutions(*of_lanes(_balance, scenes, held, ()))
    rest, driven = of_lanes(_about_rest, scenes, held, step)
    return rest, {n: solutions(*one) for n, one in driven.items()}


def steady_swing_tangents(
    scenes: Scene, held: HeldContact, along: Scene
) -> tuple[tuple[HeldRest, SwingWaves], tuple[HeldRest, SwingWaves]]:
    """The same, and the derivatives along directions of the scenes."""
    step, step_by = _solution_and_tangent(*tangents_of_lanes(_balance, scenes, held, (), along, ()))
    (rest, driven), (rest_by, driven_by) = tangents_of_lanes(_about_rest, scenes, held, step, along, step_by)
    both = {n: _solution_and_tangent(driven[n], driven_by[n]) for n in driven}
    return (rest, {n: value for n, (value, _) in both.items()}), (rest_by, {n: by for n, (_, by) in both.items()})


def _solution_and_tangent(equations: Equations, by: Equations) -> tuple[np.ndarray, np.ndarray]:
    """The solutions of equations and their derivatives, from those of the equations."""
    value = solutions(*equations)
    by_matrix, by_right = map(np.asarray, by)
    right = by_right - (by_matrix @ value[..., None])[..., 0]
    return value, solutions(equations.matrix, right)


@kept("f")
def of_lanes(f: Any, scenes: Scene, held: HeldContact, given: Any) -> Any:
    """`f` of each scene (leading axis) in its state of contact, and of the numbers that are `given` for it."""
    return jax.vmap(f)(scenes, held, given)


@kept("f")
def tangents_of_lanes(f: Any, scenes: Scene, held: HeldContact, given: Any, along: Scene, given_by: Any) -> Any:
    """The same, and its derivatives along directions of the scenes, with those of the numbers that are given."""

    def one(scene, held, given, along, given_by):
        return jax.jvp(lambda scene, given: f(scene, held, given), (scene, given), (along, given_by))

    return jax.vmap(one)(scenes, held, given, along, given_by)


def _balance(scene: Scene, held: HeldContact, nothing: tuple[()]) -> Equations:
    """What the static position leaves unbalanced, and the stiffness: a step of 0 to rounding, with its derivatives."""
    del nothing
    blocks = ReducedSystem(lax.stop_gradient(held.rigid))
    stiffness = free_system(scene).stiffness
    q = lax.stop_gradient(held.q)
    if scene.start == "from rest":
        rest = resting_contact_of(scene, q, held.mode, held.case, held.u_s)
    else:
        loose = jnp.where(held.mode == Mode.STICK, int(PRESSED), held.mode).astype(jnp.int32)
        rest = resting_contact_of(friction_free(scene), q, loose, held.case, held.u_s)
    unbalanced = mean_loads(scene) - stiffness @ q.ravel() + rest.load
    return Equations(blocks.reduced(stiffness - rest.load_q), blocks.over(unbalanced))


def _about_rest(scene: Scene, held: HeldContact, step: Any) -> tuple[HeldRest, dict[int, Equations]]:
    """The static position, and the equations of the harmonics of the motion about it."""
    blocks = ReducedSystem(lax.stop_gradient(held.rigid))
    free = free_system(scene)
    q = lax.stop_gradient(held.q).ravel() + blocks.expanded(step)
    sliders = held.u_s if scene.start == "from rest" else None
    at = resting_contact_of(scene, q.reshape(held.q.shape), held.mode, held.case, sliders)
    matrices = blocks.system(free._replace(stiffness=free.stiffness - at.load_q))
    driven = {}
    for n, load in drive_loads(scene).items():
        driven[n] = Equations(matrices.dynamic(scene.drive.frequency(n)), blocks.over(load))
    numbers = {name: getattr(at, name) for name in HeldRest._fields if hasattr(at, name)}
    return HeldRest(q=q, matrices=matrices, **numbers), driven
