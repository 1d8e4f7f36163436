"""Settled motions that stay in one state of contact at every interface: linear, and so in closed form.

The state is "apart", or "stuck": in contact throughout, without slip where there is friction. The motion is that about
the static equilibrium, with the sliders where they are put down there. Without torsion it is exact. With torsion it
neglects terms of the order of the angles, and that contact moves from corner to corner.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxshroud.linear.equilibrium import in_pieces, rubs
from jaxshroud.linear.held_contact import HeldContact, held_contact, sprung
from jaxshroud.linear.linear_swing import (
    HeldRest,
    SwingWaves,
    of_lanes,
    steady_swing_tangents,
    steady_swings,
    tangents_of_lanes,
)
from jaxshroud.model.arithmetic import sine_versine
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear import static_position
from jaxshroud.model.linear_system import ReducedSystem
from jaxshroud.model.modes import Mode
from jaxshroud.model.rhs import blade_mean_square, position_of
from jaxshroud.model.steady_numbers import SteadyNumbers, least_value, negative, steady_course, steady_extremes
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.quantities import Power
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

    displacement: Any  # (lanes, 3, blades) x, y and theta at drive phase 0
    speed: Any
    speed_square: Any  # (lanes, 3, blades) means of the squares of the speeds
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
    return in_pieces(_motions, (scenes, held), NUMBERS_OF_MOTIONS)


def _motions(scenes: Scene, held: HeldContact) -> LinearMotion:
    return of_lanes(_course, scenes, held, steady_swings(scenes, held))


def _motion_tangents(scenes: Scene, held: HeldContact, along: Scene) -> tuple[LinearMotion, LinearMotion]:
    swings, swings_by = steady_swing_tangents(scenes, held, along)
    return tangents_of_lanes(_course, scenes, held, swings, along, swings_by)


def _course(scene: Scene, held: HeldContact, swings: tuple[HeldRest, SwingWaves]) -> LinearMotion:
    """The motion of one scene in its state of contact; differentiable by the numbers of the scene and of its swing."""
    rest, waves = swings
    blades = scene.layout.blades
    blocks = ReducedSystem(held.rigid)
    swing = SteadyNumbers(rest.q, {n: blocks.expanded(a) for n, a in waves.items()})
    repeats = math.gcd(*swing.waves) or 1  # of the motion in a base period; one of them represents all
    swing = swing._replace(waves={n // repeats: a for n, a in swing.waves.items()})
    omega = repeats * scene.drive.omega
    count = SAMPLES * max(swing.waves, default=1)
    tau = jnp.linspace(0, 2 * jnp.pi, count, endpoint=False, dtype=omega.dtype)
    q, rate, _ = steady_course(swing, tau[:, None])
    place = q.reshape(count, 3, blades)
    x, y, theta = place[:, 0], place[:, 1], place[:, 2]
    sine, versine = sine_versine(theta)
    power = blade_mean_square(x, y, sine, versine, gyration(scene.shroud), static_position(scene))

    def mean(a):
        return jnp.mean(a, axis=0)

    highest, lowest = steady_extremes(swing)

    def by_row(a):
        return a.reshape(3, -1)

    margins, N, N_max, F_max, v_max, other_rest = _contact_course(scene, held, rest, swing, count)
    return LinearMotion(
        displacement=place[0],
        speed=by_row(omega * rate[0]),
        speed_square=by_row(omega**2 * mean(rate**2)),
        power=mean(power),
        means=jax.tree.map(mean, position_of((x, y, theta))),
        first=by_row(swing.mean),
        second=mean(place**2),
        highest=by_row(highest),
        lowest=by_row(lowest),
        margins=margins,
        N=N,
        N_max=N_max,
        F_max=F_max,
        v_max=v_max,
        other_rest=other_rest,
    )


def _contact_course(scene: Scene, held: HeldContact, at: HeldRest, swing: SteadyNumbers, count: int) -> tuple[Any, ...]:
    """The margins, and the forces and penetrations at each interface."""

    def at_points(mean: Any, by: Any) -> SteadyNumbers:
        waves = {n: by.astype(a.dtype) @ a for n, a in swing.waves.items()}
        return SteadyNumbers(mean, waves)

    N, F, opening = at_points(at.N, at.N_q), at_points(at.F, at.F_q), at_points(at.open_v, at.open_v_q)
    apart = held.mode == Mode.APART
    mu, can_slip = (
        jnp.broadcast_to(jnp.atleast_1d(a), held.case.shape)[:, None] for a in (scene.friction.mu, rubs(scene))
    )

    def times_mu(a):
        return lax.complex(mu * a.real, mu * a.imag)

    def limit(sign: int) -> SteadyNumbers:
        """Mu N + F, or mu N - F."""
        add = jnp.add if sign > 0 else jnp.subtract
        return SteadyNumbers(add(mu * N.mean, F.mean), {n: add(times_mu(a), F.waves[n]) for n, a in N.waves.items()})

    both_ways = least_value(limit(1), count), least_value(limit(-1), count)
    slip = jnp.minimum(*both_ways)
    other = jnp.min(jnp.where(apart | ~can_slip, jnp.inf, (both_ways[0] + both_ways[1]) / 2), axis=-1)
    margins = Margins(
        jnp.min(jnp.where(apart, jnp.inf, least_value(N, count)), axis=-1),
        jnp.min(jnp.where(apart | ~can_slip, jnp.inf, slip), axis=-1),
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

    def squares(self, of: Power) -> Any:
        """What a power depends on: the mean squares, of the vibration alone with the means."""
        return (self.power, np.stack(self.means, axis=1)) if of == "P_d_vibration" else self.power


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
    return in_pieces(_motion_tangents, (own, held, along), NUMBERS_OF_MOTIONS)
