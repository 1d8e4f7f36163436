"""Settled motions that stay in one state of contact at every interface: linear, and so in closed form.

The state is "apart", or "stuck": in contact throughout, without slip where there is friction. The motion is that about
the static equilibrium, with the sliders where they are put down there. Without torsion it is exact. With torsion it
neglects terms of the order of the angles, and that contact moves from corner to corner.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxshroud.batch.equilibrium import PRESSED, coordinates_at, friction_free, in_pieces
from jaxshroud.batch.held_contact import HeldContact, held_contact, sprung
from jaxshroud.cache.programs import kept
from jaxshroud.model.arithmetic import sine_versine
from jaxshroud.model.coupling import coupled_damping
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import static_position
from jaxshroud.model.modes import Mode
from jaxshroud.model.resting_contact import resting_contact_of
from jaxshroud.model.rhs import blade_mean_square, position_at
from jaxshroud.model.steady_numbers import SteadyNumbers, least_value, negative, steady_course, steady_extremes
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.scene import Scene, without_given

SAMPLES = 128  # of the period of the highest harmonic
NUMBERS_OF_MOTIONS = 1 << 18  # numbers of the matrices of lanes that share a program


class Margins(NamedTuple):
    """How far a linear motion stays from the end of its state, the least over the motion and over the points.

    A number is negative where the state is left. One of several harmonics is a bound from below.
    """

    N: Any  # (lanes, interfaces) normal force; inf where the faces are apart [N]
    slip: Any  # (lanes, interfaces) mu N - |F|; inf without friction [N]
    gap: Any  # (lanes, interfaces) of the faces, along their normal; inf where they touch [m]

    @property
    def holds(self) -> Any:
        """Whether the state is kept, (lanes,)."""
        return np.all([np.asarray(a).min(axis=-1) > 0 for a in self], axis=0)


class LinearMotion(NamedTuple):
    """A settled linear motion over one base period, of lanes."""

    displacement: Any  # (lanes, samples, 3, blades) x, y and theta
    speed: Any
    power: (
        Any  # (lanes, blades) mean square displacement over block and period from the static position without contact
    )
    means: Any  # `Means`, (lanes, blades)
    first: Any  # (lanes, 3, blades) means of x, y and theta
    second: Any  # (lanes, 3, blades) means of their squares
    highest: Any  # (lanes, 3, blades)
    lowest: Any
    margins: Margins
    N: Any  # (lanes, interfaces) mean normal force [N]
    N_max: Any  # (lanes, interfaces) largest normal and friction force; bounds for several harmonics
    F_max: Any
    v_max: Any  # (lanes, interfaces) largest penetration
    other_rest: Any  # (lanes, interfaces) the margin of slip with sliders at the rest that is best for it, about [N]


def linear_motions(scenes: Scene, held: HeldContact) -> LinearMotion:
    """The motions of scenes (leading axis) in a state of contact."""
    scenes = without_given(sprung(scenes))
    return in_pieces(_linear_motions, (scenes, held), NUMBERS_OF_MOTIONS)


@kept()
def _linear_motions(scenes: Scene, held: HeldContact) -> LinearMotion:
    return jax.vmap(linear_motion)(scenes, held)


@kept()
def linear_motion_tangents(scenes: Scene, held: HeldContact, along: Scene) -> tuple[LinearMotion, LinearMotion]:
    """The motions of scenes (leading axis) and their derivatives along directions of the scenes."""

    def one(scene, held, along):
        return jax.jvp(lambda scene: linear_motion(scene, held), (scene,), (along,))

    return jax.vmap(one)(scenes, held, along)


def linear_motion(scene: Scene, held: HeldContact) -> LinearMotion:
    """The motion of one scene in its state of contact; differentiable by the numbers of the scene.

    Source:
        (K - n^2 omega^2 M + i n omega C) A_n = Q_n, where K is the stiffness of the blades and the derivative of the
        forces of contact at the static equilibrium, over the directions in which the blocks can move.
    """
    swing, at, _ = linear_swing(scene, held)
    omega, orders = scene.drive.omega, list(swing.waves)
    count = SAMPLES * max(orders, default=1)
    tau = jnp.linspace(0, 2 * jnp.pi, count, endpoint=False, dtype=omega.dtype)
    q, rate, _ = steady_course(swing, tau[:, None])
    shape = count, 3, scene.blades.m.shape[-1]
    place = q.reshape(shape)
    x, y, theta = place[:, 0], place[:, 1], place[:, 2]
    sine, versine = sine_versine(theta)
    power = blade_mean_square(x, y, sine, versine, gyration(scene.shroud), static_position(scene))

    def mean(a):
        return jnp.mean(a, axis=0)

    highest, lowest = steady_extremes(swing)

    def by_row(a):
        return a.reshape(3, -1)

    forces = _contact_course(scene, held, at, swing, count)
    return LinearMotion(
        place,
        (omega * rate).reshape(shape),
        mean(power),
        jax.tree.map(mean, position_at(x, y, theta)),
        by_row(swing.mean),
        mean(place**2),
        by_row(highest),
        by_row(lowest),
        *forces,
    )


class LinearMatrices(NamedTuple):
    """The matrices of a linear motion over the directions in which the blocks can move."""

    M: Any
    C: Any
    K: Any


def linear_swing(scene: Scene, held: HeldContact) -> tuple[SteadyNumbers, Any, LinearMatrices]:
    """The displacements (3 blades,) of the settled motion, the contact at rest, and the matrices of the motion."""
    b, blades, sines = scene.mistuned_blades, scene.blades.m.shape[-1], scene.drive.harmonics()
    masses = jnp.concatenate([b.m, b.inertia_y, b.I])
    dampers = jnp.concatenate([b.c_x, b.c_y, b.c_T])
    springs = jnp.concatenate([b.k_x, b.k_y, b.k_T])
    moves = np.array([scene.parts.has(name, min(i, 1)) for name in COORDINATES for i in range(blades)])
    turning = "theta" in scene.parts.motion
    blocks = _Blocks(blades * len(scene.parts.motion), lax.stop_gradient(held.rigid) if turning else None)
    q = lax.stop_gradient(held.q)
    rests_on_sliders = scene.start == "from rest"
    loose = jnp.where(held.mode == Mode.STICK, int(PRESSED), held.mode).astype(jnp.int32)
    if rests_on_sliders:
        rest = resting_contact_of(scene, q, held.mode, held.case, held.u_s)
    else:
        rest = resting_contact_of(friction_free(scene), q, loose, held.case, held.u_s)
    mean = sines[0].load if 0 in sines else None
    load = jnp.zeros_like(springs) if mean is None else jnp.concatenate([mean(name) for name in COORDINATES])
    static_K = blocks.reduced(jnp.diag(springs) + _assembled(rest.load_q, blades))
    unbalanced = jnp.where(moves, load - springs * q.ravel() + _gathered(rest.load, blades), 0.0)
    q = q.ravel() + blocks.expanded(jnp.linalg.solve(static_K, blocks.over(unbalanced)), 3 * blades)
    q = q.reshape(3, blades)
    at = resting_contact_of(scene, q, held.mode, held.case, held.u_s if rests_on_sliders else None)
    K = blocks.reduced(jnp.diag(springs) + _assembled(at.load_q, blades))
    M, C = blocks.reduced_diagonal(masses), blocks.reduced_diagonal(dampers)
    if scene.is_coupled:
        C = C + blocks.reduced(coupled_damping(scene))
    waves = {}
    for n, one in sines.items():
        if n == 0:
            continue
        omega = scene.drive.frequency(n)
        parts = [one.parts(name) for name in COORDINATES]
        re, im = (jnp.where(moves, jnp.concatenate(part), 0.0) for part in list(zip(*parts, strict=True))[:2])
        Q = lax.complex(blocks.over(re), blocks.over(im))
        answer = jnp.linalg.solve(lax.complex(K - omega**2 * M, omega * C), Q)
        waves[n] = blocks.expanded(answer, 3 * blades)
    return SteadyNumbers(q.ravel(), waves), at, LinearMatrices(M, C, K)


class _Blocks(NamedTuple):
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


def _assembled(load_q: Any, blades: int) -> Any:
    """The stiffness of contact over all coordinates from the derivatives of its loads (interfaces, 6, 6)."""
    places = coordinates_at(blades, load_q.shape[0])
    return jnp.zeros((3 * blades,) * 2, load_q.dtype).at[places[:, :, None], places[:, None, :]].add(-load_q)


def _gathered(load: Any, blades: int) -> Any:
    """The loads of contact (interfaces, 6) on each coordinate."""
    return jnp.zeros(3 * blades, load.dtype).at[coordinates_at(blades, load.shape[0])].add(load)


def _contact_course(scene: Scene, held: HeldContact, at: Any, swing: SteadyNumbers, count: int) -> tuple[Any, ...]:
    """The margins, and the forces and penetrations at each interface."""
    places = coordinates_at(scene.blades.m.shape[-1], held.case.shape[0])

    def at_points(mean: Any, by: Any) -> SteadyNumbers:
        waves = {n: jnp.einsum("jpk,jk->jp", by.astype(a.dtype), a[places]) for n, a in swing.waves.items()}
        return SteadyNumbers(mean, waves)

    N, F, opening = at_points(at.N, at.N_q), at_points(at.F, at.F_q), at_points(at.open_v, at.open_v_q)
    apart = held.mode == Mode.APART
    mu = jnp.broadcast_to(jnp.atleast_1d(scene.friction.mu), held.case.shape)[:, None]
    k_d = jnp.broadcast_to(jnp.atleast_1d(scene.friction.k_d), held.case.shape)[:, None]
    rubs = (mu > 0) & (k_d > 0) & (scene.parts.friction != "none")

    def times_mu(a):
        return lax.complex(mu * a.real, mu * a.imag)

    def limit(sign: int) -> SteadyNumbers:
        """Mu N + F, or mu N - F."""
        add = jnp.add if sign > 0 else jnp.subtract
        return SteadyNumbers(add(mu * N.mean, F.mean), {n: add(times_mu(a), F.waves[n]) for n, a in N.waves.items()})

    both_ways = least_value(limit(1), count), least_value(limit(-1), count)
    slip = jnp.minimum(*both_ways)
    other = jnp.min(jnp.where(apart | ~rubs, jnp.inf, (both_ways[0] + both_ways[1]) / 2), axis=-1)
    margins = Margins(
        jnp.min(jnp.where(apart, jnp.inf, least_value(N, count)), axis=-1),
        jnp.min(jnp.where(apart | ~rubs, jnp.inf, slip), axis=-1),
        jnp.min(jnp.where(apart.all(axis=-1)[:, None], least_value(negative(opening), count), jnp.inf), axis=-1),
    )

    def largest(a):
        return jnp.max(-least_value(negative(a), count), axis=-1)

    def sums(a):
        return SteadyNumbers(a.mean.sum(axis=-1)[:, None], {n: b.sum(axis=-1)[:, None] for n, b in a.waves.items()})

    F_sum = sums(F)
    F_max = jnp.maximum(largest(F_sum), largest(negative(F_sum)))
    N_max = jnp.where(apart.all(axis=-1), 0.0, largest(sums(N)))
    return margins, at.N.sum(axis=-1), N_max, F_max, largest(opening), other


class LinearFlow(NamedTuple):
    """What a whole period of a linear motion gives, as a march with tangents does."""

    power: Any  # (lanes, blades)
    means: Any  # `Means`, (lanes, blades that count)
    moments: tuple[Any, Any]  # means of x, y and theta and of their squares, (lanes, blades) each


def linear_flow(motion: LinearMotion, scenes: Scene) -> LinearFlow:
    """The flow of lanes from their motions, or from the derivatives of these."""
    means = jax.tree.map(lambda a: np.asarray(a)[:, scenes.layout.counting], motion.means)

    def by_row(a):
        return tuple(np.moveaxis(np.asarray(a), 1, 0))

    return LinearFlow(np.asarray(motion.power), means, (by_row(motion.first), by_row(motion.second)))


def linear_tangents(scenes: Scene, along: Scene, repeats: int) -> tuple[LinearMotion, LinearMotion]:
    """The motions of scenes (leading axis), each so often, and their derivatives along as many directions.

    Raises:
        InputError: The faces stick where loads from rest have left them, which depends on the numbers in other ways.
    """
    if scenes.parts.contact == "stuck" and scenes.start == "from rest":
        raise InputError('Closed forms with initial.friction = "from rest" have no derivatives; drop one of them.')
    own = without_given(sprung(scenes))
    held = held_contact(scenes, scenes.parts.contact)  # pyright: ignore[reportArgumentType]
    own, held = jax.tree.map(lambda a: np.repeat(np.asarray(a), repeats, axis=0), (own, held))
    along = jax.tree.unflatten(jax.tree.structure(own), jax.tree.leaves(along))
    return in_pieces(linear_motion_tangents, (own, held, along), NUMBERS_OF_MOTIONS)
