"""What swings about a static position in a linear motion: its equations by harmonics, and their solutions.

They are solved by LAPACK on the host: within compiled programs many systems at once may wait for each other without end
(jaxlib 0.10, matrices of 45 and more on two cores).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxshroud.batch.equilibrium import PRESSED, coordinates_at, friction_free
from jaxshroud.batch.held_contact import HeldContact
from jaxshroud.cache.programs import kept
from jaxshroud.model.coupling import coupled_damping
from jaxshroud.model.modes import Mode
from jaxshroud.model.resting_contact import resting_contact_of
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene


class Equations(NamedTuple):
    """Linear systems of lanes."""

    matrix: Any  # (lanes, n, n)
    right: Any  # (lanes, n)


class LinearMatrices(NamedTuple):
    """The matrices of a linear motion over the directions in which the blocks can move."""

    M: Any
    C: Any
    K: Any


class HeldRest(NamedTuple):
    """The static position of lanes in a state of contact, what acts there, and the matrices of motions about it."""

    q: Any  # (lanes, 3 blades)
    N: Any  # (lanes, interfaces, points) normal forces, as the next three
    F: Any
    open_v: Any  # (lanes, interfaces, corners) penetrations, see `RestingContact`
    N_q: Any  # (lanes, interfaces, points, 6) derivatives by the coordinates, as the next two
    F_q: Any
    open_v_q: Any
    matrices: LinearMatrices


SwingWaves = dict[int, Any]  # complex amplitudes of lanes over the directions in which the blocks can move, by order


def steady_swings(scenes: Scene, held: HeldContact) -> tuple[HeldRest, SwingWaves]:
    """The static positions of scenes (leading axis), and the motions about them.

    Source:
        (K - n^2 omega^2 M + i n omega C) A_n = Q_n, where K is the stiffness of the blades and the derivative of the
        forces of contact at the static equilibrium, over the directions in which the blocks can move.
    """
    rest, driven = _about_rest(scenes, held, _solution(_balance(scenes, held)))
    return rest, {n: _solution(one) for n, one in driven.items()}


def steady_swing_tangents(
    scenes: Scene, held: HeldContact, along: Scene
) -> tuple[tuple[HeldRest, SwingWaves], tuple[HeldRest, SwingWaves]]:
    """The same, and the derivatives along directions of the scenes."""
    step = _solution_and_tangent(*_balance_tangents(scenes, held, along))
    (rest, driven), (rest_by, driven_by) = _about_rest_tangents(scenes, held, along, *step)
    both = {n: _solution_and_tangent(driven[n], driven_by[n]) for n in driven}
    return (rest, {n: value for n, (value, _) in both.items()}), (rest_by, {n: by for n, (_, by) in both.items()})


def _solution(equations: Equations) -> np.ndarray:
    """The solutions (lanes, n); NaN where there is none, as without damping at resonance."""
    matrix, right = map(np.asarray, equations)
    try:
        return np.linalg.solve(matrix, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        if len(matrix) == 1:
            return np.full_like(right, np.nan)
        return np.concatenate([_solution(Equations(matrix[i : i + 1], right[i : i + 1])) for i in range(len(matrix))])


def _solution_and_tangent(equations: Equations, by: Equations) -> tuple[np.ndarray, np.ndarray]:
    """The solutions of equations and their derivatives, from those of the equations."""
    value = _solution(equations)
    by_matrix, by_right = map(np.asarray, by)
    right = by_right - (by_matrix @ value[..., None])[..., 0]
    return value, _solution(Equations(equations.matrix, right))


@kept()
def _balance(scenes: Scene, held: HeldContact) -> Equations:
    return jax.vmap(_balance_of)(scenes, held)


@kept()
def _balance_tangents(scenes: Scene, held: HeldContact, along: Scene) -> tuple[Equations, Equations]:
    def one(scene, held, along):
        return jax.jvp(lambda scene: _balance_of(scene, held), (scene,), (along,))

    return jax.vmap(one)(scenes, held, along)


@kept()
def _about_rest(scenes: Scene, held: HeldContact, step: Any) -> tuple[HeldRest, dict[int, Equations]]:
    return jax.vmap(_about_rest_of)(scenes, held, step)


@kept()
def _about_rest_tangents(scenes: Scene, held: HeldContact, along: Scene, step: Any, step_by: Any) -> Any:
    def one(scene, held, along, step, step_by):
        return jax.jvp(lambda scene, step: _about_rest_of(scene, held, step), (scene, step), (along, step_by))

    return jax.vmap(one)(scenes, held, along, step, step_by)


def _balance_of(scene: Scene, held: HeldContact) -> Equations:
    """What the static position leaves unbalanced, and the stiffness: a step of 0 to rounding, with its derivatives."""
    blades, blocks = scene.blades.m.shape[-1], block_directions(scene, held)
    springs, q = _springs(scene), lax.stop_gradient(held.q)
    if scene.start == "from rest":
        rest = resting_contact_of(scene, q, held.mode, held.case, held.u_s)
    else:
        loose = jnp.where(held.mode == Mode.STICK, int(PRESSED), held.mode).astype(jnp.int32)
        rest = resting_contact_of(friction_free(scene), q, loose, held.case, held.u_s)
    mean = scene.drive.harmonics().get(0)
    load = jnp.zeros_like(springs) if mean is None else jnp.concatenate([mean.load(name) for name in COORDINATES])
    unbalanced = load - springs * q.ravel() + _gathered(rest.load, blades)
    stiffness = blocks.reduced(jnp.diag(springs) + _assembled(rest.load_q, blades))
    return Equations(stiffness, blocks.over(jnp.where(_moving(scene), unbalanced, 0.0)))


def _about_rest_of(scene: Scene, held: HeldContact, step: Any) -> tuple[HeldRest, dict[int, Equations]]:
    """The static position, and the equations of the harmonics of the motion about it."""
    b, blades, blocks = scene.mistuned_blades, scene.blades.m.shape[-1], block_directions(scene, held)
    q = lax.stop_gradient(held.q).ravel() + blocks.expanded(step, 3 * blades)
    sliders = held.u_s if scene.start == "from rest" else None
    at = resting_contact_of(scene, q.reshape(3, blades), held.mode, held.case, sliders)
    K = blocks.reduced(jnp.diag(_springs(scene)) + _assembled(at.load_q, blades))
    M = blocks.reduced_diagonal(jnp.concatenate([b.m, b.inertia_y, b.I]))
    C = blocks.reduced_diagonal(jnp.concatenate([b.c_x, b.c_y, b.c_T]))
    if scene.is_coupled:
        C = C + blocks.reduced(coupled_damping(scene))
    driven = {}
    for n, one in scene.drive.harmonics().items():
        if n == 0:
            continue
        omega = scene.drive.frequency(n)
        parts = [one.parts(name) for name in COORDINATES]
        re, im = (jnp.where(_moving(scene), jnp.concatenate(part), 0.0) for part in list(zip(*parts, strict=True))[:2])
        Q = lax.complex(blocks.over(re), blocks.over(im))
        driven[n] = Equations(lax.complex(K - omega**2 * M, omega * C), Q)
    numbers = {name: getattr(at, name) for name in HeldRest._fields if hasattr(at, name)}
    return HeldRest(q=q, matrices=LinearMatrices(M, C, K), **numbers), driven


def _springs(scene: Scene) -> Any:
    """The stiffnesses (3 blades,) of the blades by themselves."""
    b = scene.mistuned_blades
    return jnp.concatenate([b.k_x, b.k_y, b.k_T])


def _moving(scene: Scene) -> np.ndarray:
    """Which coordinates (3 blades,) move."""
    blades = range(scene.blades.m.shape[-1])
    return np.array([scene.parts.has(name, min(i, 1)) for name in COORDINATES for i in blades])


class BlockDirections(NamedTuple):
    """The directions in which blocks move: the first coordinates, or those of blocks that may turn together."""

    size: int  # of the first coordinates
    rigid: Any  # (3 blades, 3 blades) as columns; None where the blocks do not turn

    def over(self, a: Any) -> Any:
        """A vector of forces over the directions."""
        return a[: self.size] if self.rigid is None else a @ self.rigid

    def reduced(self, K: Any) -> Any:
        """A matrix over the directions; 1 for one that is none."""
        if self.rigid is None:
            return K[: self.size, : self.size]
        idle = jnp.diag(1.0 - jnp.max(jnp.abs(self.rigid), axis=0))
        return self.rigid.T @ K @ self.rigid + idle

    def reduced_diagonal(self, numbers: Any) -> Any:
        """A diagonal matrix over the directions, which are orthogonal."""
        return jnp.diag(numbers[: self.size] if self.rigid is None else numbers @ self.rigid**2)

    def expanded(self, y: Any, size: int) -> Any:
        """The displacements of so many coordinates from those along the directions."""
        if self.rigid is None:
            return jnp.concatenate([y, jnp.zeros(size - self.size, y.dtype)])
        return self.rigid.astype(y.dtype) @ y


def block_directions(scene: Scene, held: HeldContact) -> BlockDirections:
    """The directions in which the blocks of a scene move in its state of contact."""
    turning = "theta" in scene.parts.motion
    size = scene.blades.m.shape[-1] * len(scene.parts.motion)
    return BlockDirections(size, lax.stop_gradient(held.rigid) if turning else None)


def _assembled(load_q: Any, blades: int) -> Any:
    """The stiffness of contact over all coordinates from the derivatives of its loads (interfaces, 6, 6)."""
    places = coordinates_at(blades, load_q.shape[0])
    return jnp.zeros((3 * blades,) * 2, load_q.dtype).at[places[:, :, None], places[:, None, :]].add(-load_q)


def _gathered(load: Any, blades: int) -> Any:
    """The loads of contact (interfaces, 6) on each coordinate."""
    return jnp.zeros(3 * blades, load.dtype).at[coordinates_at(blades, load.shape[0])].add(load)
