"""Equation (1): the motion of both blocks while the contact mode and case are held fixed."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxshroud.contact import Load, contact_load
from jaxshroud.friction import Springs, friction_force, normal_force, slider_speed, springs
from jaxshroud.geometry import Corners, Pose, Rates, Touch, corners, gyration, pose, touch, touch_rates
from jaxshroud.scene import Blades, Motion, Pair, PerBlade, Scalar, Scene
from jaxshroud.seam import Seam
from jaxshroud.state import State
from jaxshroud.trig import sincos_turns


def as_pairs(tree):
    """`tree` with every (2,) array as a tuple of two scalars: one flat array per number when lanes are batched."""
    return jax.tree.map(lambda a: (a[0], a[1]) if jnp.ndim(a) == 1 else a, tree)


def as_arrays(motion: Motion) -> Motion:
    """The inverse of `as_pairs` for a motion: fields of shape (2,)."""
    return Motion(*map(jnp.stack, motion))


class Excitation(NamedTuple):
    """Amplitudes and phases of the drive (Sec. 3.1), resolved in x and y."""

    F_x: PerBlade | Pair  # F_0 cos(beta) [N]
    F_y: PerBlade | Pair  # F_0 sin(beta) [N]
    M_0: PerBlade | Pair  # [N m]
    sin_phase: PerBlade | Pair
    cos_phase: PerBlade | Pair


class Model(eqx.Module):
    """A scene made ready for stepping: everything that can be computed once per lane."""

    blades: Blades
    block: Corners
    spring: Springs
    drive: Excitation
    gyration: Scalar  # J_A / A [m^2]
    reading: frozenset[str] = eqx.field(static=True)


def model(scene: Scene) -> Model:
    """`scene` with its constants worked out."""
    d, s = scene.drive, scene.shroud
    drive = Excitation(d.F_0 * jnp.cos(d.beta), d.F_0 * jnp.sin(d.beta), d.M_0, jnp.sin(d.phase), jnp.cos(d.phase))
    parts = as_pairs((scene.blades, corners(s), springs(scene), drive, gyration(s)))
    return Model(*parts, reading=scene.contact.reading)


class Integrals(NamedTuple):
    """Time integrals carried along with the motion, to the integrator's order."""

    power: Pair  # mean square displacement over the block, Eq. (23) divided by its area [m^2 s]
    drive: Scalar  # work of the drive [J]
    viscous: Scalar  # loss in the dampers [J]
    friction: Scalar  # loss in the sliding contact [J]


def wave(turns: Scalar, drive: Excitation) -> Pair:
    """sin(omega t + phase) of each blade's drive, `turns` being omega t / (2 pi)."""
    s, c = sincos_turns(turns)
    left, right = (s * drive.cos_phase[i] + c * drive.sin_phase[i] for i in (0, 1))
    return left, right


def accelerated(z: Motion, Q: Pair, load: Load, model: Model) -> Motion:
    """dz/dt by Eq. (1), with `Q` the drive's wave of each blade."""
    b, d, R_x, R_y = model.blades, model.drive, (load.R_x, -load.R_x), (load.R_y, -load.R_y)

    def rates(i: int) -> tuple[Scalar, Scalar, Scalar]:
        a_x = (d.F_x[i] * Q[i] + R_x[i] - b.c_x[i] * z.v_x[i] - b.k_x[i] * z.x[i]) / b.m[i]
        a_y = (d.F_y[i] * Q[i] + R_y[i] - b.c_y[i] * z.v_y[i] - b.k_y[i] * z.y[i]) / b.inertia_y[i]
        a_theta = (d.M_0[i] * Q[i] + load.M[i] - b.c_T[i] * z.v_theta[i] - b.k_T[i] * z.theta[i]) / b.I[i]
        return a_x, a_y, a_theta

    left, right = rates(0), rates(1)
    return Motion(z.v_x, z.v_y, z.v_theta, *zip(left, right, strict=True))


def mean_square(q: Pose, gyration: Scalar) -> Pair:
    """Square displacement averaged over each block: x^2 + y^2 + 4 (J_A/A) sin^2(theta/2) [m^2].

    Source:
        Eqs. (22), (23): over a centrally symmetric block the cross terms vanish, so no area quadrature is needed.
    """
    # 4 sin^2(theta/2) = 2 sin^2(theta) / (1 + cos(theta)), without cancellation at small angles
    left, right = (q.x[i] ** 2 + q.y[i] ** 2 + gyration * 2 * q.sin[i] ** 2 / (1 + q.cos[i]) for i in (0, 1))
    return left, right


def integrands(q: Pose, z: Motion, Q: Pair, F: Scalar, slide: Scalar, model: Model) -> Integrals:
    """Rates of the running integrals."""
    b, d = model.blades, model.drive
    drive = lambda i: (d.F_x[i] * z.v_x[i] + d.F_y[i] * z.v_y[i] + d.M_0[i] * z.v_theta[i]) * Q[i]  # noqa: E731
    viscous = lambda i: b.c_x[i] * z.v_x[i] ** 2 + b.c_y[i] * z.v_y[i] ** 2 + b.c_T[i] * z.v_theta[i] ** 2  # noqa: E731
    return Integrals(mean_square(q, model.gyration), drive(0) + drive(1), viscous(0) + viscous(1), F * slide)


@jax.jit  # traced once for all stages
def rhs(Q: Pair, z: Motion, held: State, model: Model, seam: Seam) -> tuple[Motion, Integrals]:
    """dz/dt of Eq. (1) and the rates of the running integrals while mode, case and slider of `held` stay fixed.

    `Q` is the drive's `wave` at the time in question.
    """
    q = seam(pose, z.x, z.y, z.theta)
    at = seam(touch, q, held.case, model.block, model.reading)
    rate = seam(touch_rates, at, z, held.case, model.reading)
    N, F, slide = seam(_forces, at, rate, held, model.spring)
    load = seam(contact_load, at, N, F, held.case, model.block, model.reading)
    return seam(accelerated, z, Q, load, model), seam(integrands, q, z, Q, F, slide, model)


def _forces(at: Touch, rate: Rates, held: State, spring: Springs) -> tuple[Scalar, Scalar, Scalar]:
    N = normal_force(at.v, held.mode, spring)
    F = friction_force(at.v, at.u, held.u_s, held.mode, spring)
    return N, F, slider_speed(rate.v, rate.u, held.mode, spring)


def stored_energy(z: Motion, model: Model) -> Scalar:
    """Kinetic energy and energy of the blades' own springs [J]."""
    b = model.blades

    def twice(i: int) -> Scalar:
        kinetic = b.m[i] * z.v_x[i] ** 2 + b.inertia_y[i] * z.v_y[i] ** 2 + b.I[i] * z.v_theta[i] ** 2
        return kinetic + b.k_x[i] * z.x[i] ** 2 + b.k_y[i] * z.y[i] ** 2 + b.k_T[i] * z.theta[i] ** 2

    return (twice(0) + twice(1)) / 2
