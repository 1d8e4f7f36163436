"""The closed-form motion of the blades while they do not touch: Eq. (1) without contact forces."""

from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jaxshroud.model.arithmetic import Scalar, sincos_turns, sine_versine, summed
from jaxshroud.model.drive import multiple_angle
from jaxshroud.model.geometry import gyration
from jaxshroud.model.linear_system import free_response
from jaxshroud.scene.drive import AnyLoad
from jaxshroud.scene.fields import PerBlade
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Scene, Shroud
from jaxshroud.scene.typed import typed

SWING_POINTS = 128  # over a period of the highest harmonic: exact to rounding while torsion is below 50 rad


class Amplitudes(NamedTuple):
    """Complex amplitudes: the displacement is the imaginary part of `amplitude * exp(i omega t)`."""

    x: Complex[Array, "blades"]  # [m]
    y: Complex[Array, "blades"]  # [m]
    theta: Complex[Array, "blades"]  # [rad]


def steady_amplitudes(scene: Scene) -> dict[int, Amplitudes]:
    """The steady response of the free blades to each harmonic of the drive (Sec. 3.1), by its order.

    Free blades do not touch, but are coupled as in the scene. It is infinite at an undamped natural frequency, where
    rounding alone separates both frequencies.
    """
    return {n: _response_to(scene, n, one) for n, one in scene.drive.harmonics().items()}


class StaticPosition(NamedTuple):
    """Where the mean loads hold the free blades, which is what power is measured from: a number for each blade."""

    x: Any  # [m]
    y: Any  # [m]
    sin: Any  # of theta, as the next
    versine: Any


def static_position(scene: Scene) -> StaticPosition | None:
    """The static position of the free blades under the mean loads; None where the drive has none."""
    load = scene.drive.harmonics().get(0)
    if load is None:
        return None
    x, y, theta = (jnp.imag(a) for a in _response_to(scene, 0, load))
    sine, versine = sine_versine(theta)
    return StaticPosition(x, y, sine, versine)


def about_static(means: Any, at: StaticPosition | None) -> Any:
    """Means of x, y, sin(theta) and 1 - cos(theta) as seen from a static position; as they are without one."""
    if at is None:
        return means
    X, Y, S, V = means
    return X - at.x, Y - at.y, S - S * at.versine - (1 - V) * at.sin, V + at.versine - V * at.versine - S * at.sin


def means_from_static(scene: Scene, means: Any) -> Any:
    """Means (4, blades) of x, y, sin(theta) and 1 - cos(theta) of the first blades, from their static position."""
    at = static_position(scene)
    if at is None:
        return means
    return jnp.stack(about_static(means, StaticPosition._make(a[: means.shape[-1]] for a in at)))


def _response_to(scene: Scene, order: int, load: AnyLoad) -> Amplitudes:
    """The steady response of the free blades to one harmonic."""
    return Amplitudes._make(free_response(scene, scene.drive.frequency(order), load))


def free_reach(free: dict[int, Amplitudes], name: str) -> Any:
    """The sum of the amplitudes of x, y or theta over all harmonics, which the free motion does not exceed.

    It is a bound: the amplitude is `steady_peak` of the `waves_of` this displacement.
    """
    return summed(abs(getattr(one, name)) for one in free.values())


def waves_of(free: dict[int, Amplitudes], name: str) -> dict[int, Any]:
    """The complex amplitudes of x, y or theta about its mean, by order."""
    return {n: getattr(one, name) for n, one in free.items() if n > 0}


def area(shroud: Shroud) -> Float[Array, ""]:
    """The area A of one block [m^2]."""
    return shroud.l_oa * shroud.l_ab * jnp.sin(shroud.alpha)


@typed
def free_power(scene: Scene) -> PerBlade:
    """The vibration power without contact, P_0 of Eq. (23), in closed form [m^4].

    Source:
        About the static position, over a centrally symmetric block, P_0 = A <x^2 + y^2> + 4 J_A <sin^2(theta/2)>; the
        mean of sin^2(Theta sin(tau) / 2) is (1 - J_0(Theta)) / 2, here by the trapezoidal rule, exact to rounding.
    """
    free = {n: one for n, one in steady_amplitudes(scene).items() if n > 0}
    s = scene.shroud
    points = SWING_POINTS * (1 if len(free) == 1 else max(free))
    tau = jnp.linspace(0, 2 * jnp.pi, points, endpoint=False, dtype=s.gap.dtype)
    angle = free_reach(free, "theta")
    swing = jnp.sin(_free_angles(free, angle, tau) / 2) ** 2
    translation = summed((jnp.abs(one.x) ** 2 + jnp.abs(one.y) ** 2) / 2 for one in free.values())
    return area(s) * (translation + jnp.where(jnp.isinf(angle), jnp.inf, 4 * gyration(s) * jnp.mean(swing, axis=1)))


def _free_angles(free: dict[int, Amplitudes], largest: PerBlade, tau: Float[Array, " n"]) -> Float[Array, "blades n"]:
    """The angles of the free blades over a period, up to a shift of time; 0 where the `largest` is infinite."""
    is_infinite = jnp.isinf(largest)
    if len(free) == 1:
        return jnp.where(is_infinite, 0.0, largest)[:, None] * jnp.sin(tau)[None]
    finite = {n: jnp.where(is_infinite, 0.0, one.theta)[:, None] for n, one in free.items()}
    return summed(a.real * jnp.sin(n * tau)[None] + a.imag * jnp.cos(n * tau)[None] for n, a in finite.items())


def free_rms_displacement(scene: Scene) -> Scalar:
    """The root mean square displacement of the left block without contact [m]."""
    return jnp.sqrt(free_power(scene)[0] / area(scene.shroud))


class FreeOscillation(NamedTuple):
    """One coordinate of one free block: its steady response, and the decay of deviations from it."""

    steady: dict[int, Complex[Array, "..."]]  # amplitude by the order of the harmonic
    damping: Float[Array, "..."]  # c / 2m [1/s]
    square: Float[Array, "..."]  # k / m - damping^2: of the damped circular frequency, negative if overdamped


def power_reduction(P: Any, P_0: Any) -> Any:
    """The power reduction P_d of Eq. (24) [%] from the powers with and without contact; NaN without drive (P_0 = 0)."""
    where = jnp.where if isinstance(P, jax.Array) or isinstance(P_0, jax.Array) else np.where
    driven = P_0 > 0
    return where(driven, 100 * (1 - P / where(driven, P_0, 1.0)), jnp.nan)


def vibration_square(square: Any, means: Any, gyration: Any) -> Any:
    """The mean square displacement about the mean position, from means over all of the time.

    Args:
        square: The mean square displacement about the position of rest, (blades,) [m^2].
        means: The means of x, y [m], sin(theta) and 1 - cos(theta), (4, blades).
        gyration: Polar second moment of a block's area per area [m^2].

    Returns:
        <x^2> - <x>^2 + <y^2> - <y>^2 + (2 J_A / A) (1 - R), R^2 = <cos theta>^2 + <sin theta>^2: the square
        displacement averaged over a block that turns about its mean direction.
    """
    X, Y, S, V = means
    R = ((1 - V) ** 2 + S**2) ** 0.5
    return square - X**2 - Y**2 - 2 * gyration * S**2 / (R + 1 - V)


def free_oscillations(scene: Scene) -> FreeOscillation:
    """The free oscillations of both blocks in x, y and theta: fields (2, 3)."""
    b = scene.mistuned_blades
    free = steady_amplitudes(scene)

    def stack(*columns):
        return jnp.stack(columns, axis=-1)

    mass, damping, stiffness = (stack(*a) for a in zip(*b.oscillators.values(), strict=True))
    damping = damping / (2 * mass)
    steady = {n: stack(*one) for n, one in free.items()}
    return FreeOscillation(steady, damping, stiffness / mass - damping**2)


def decay_factors(swing: FreeOscillation, t: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """The even and the odd factor by which a deviation has decayed after `t`.

    A deviation d with the rate w has become `d (even + damping odd) + w odd`.
    """
    omega = jnp.sqrt(jnp.abs(swing.square))
    under = swing.square > 0
    divisor = jnp.where(omega > 0, omega, 1.0)
    fade, slow = jnp.exp(-swing.damping * t), jnp.exp(-jnp.where(under, swing.damping, swing.damping - omega) * t)
    even = jnp.where(under, fade * jnp.cos(omega * t), slow * (1 + jnp.exp(-2 * omega * t)) / 2)
    odd = jnp.where(under, fade * jnp.sin(omega * t), slow * -jnp.expm1(-2 * omega * t) / 2) / divisor
    return even, jnp.where(omega > 0, odd, fade * t)


def free_components(
    scene: Scene, first: Motion, turns: Scalar, *, from_static: bool = False
) -> Float[Array, "2 3 components"]:
    """The deviation, its rate and the steady response of each coordinate, at the motion `first` and phase `turns`.

    The axes are the blades; x, y and theta; and the deviation, its rate, and of each harmonic the real and the
    imaginary amplitude, on which the `free_propagators` act. With `from_static` the displacement that these give is
    that from the static position under the mean loads.
    """
    swing = free_oscillations(scene)
    drive = scene.drive
    moves = jnp.array([[scene.parts.has(name, i) for name in ("x", "y", "theta")] for i in (0, 1)])
    deviation = jnp.where(moves, jnp.stack([first.x, first.y, first.theta], axis=-1), 0.0)
    rate = jnp.where(moves, jnp.stack([first.v_x, first.v_y, first.v_theta], axis=-1), 0.0)
    phase = sincos_turns(turns)
    components = []
    for n, steady in swing.steady.items():
        s, c = multiple_angle(*phase, n)
        # the amplitude with its phase measured from there
        re = steady.real * c - steady.imag * s
        im = steady.real * s + steady.imag * c
        deviation, rate = deviation - im, rate - drive.frequency(n) * re
        components += [0 * re, 0 * im] if from_static and n == 0 else [re, im]
    return jnp.stack([deviation, rate, *components], axis=-1)


def free_propagators(
    scene: Scene, t: Float[Array, " n"]
) -> tuple[Float[Array, "n 2 3 components"], Float[Array, "n 2 3 components"]]:
    """The displacement and the speed, a time `t` later, of a unit of each of the `free_components`."""
    swing = free_oscillations(scene)
    t = t[:, None, None]
    even, odd = decay_factors(swing, t)
    omegas = [scene.drive.frequency(n) for n in swing.steady]
    waves = [tuple(jnp.broadcast_to(f(omega * t), even.shape) for f in (jnp.sin, jnp.cos)) for omega in omegas]
    stiffness = swing.square + swing.damping**2
    lag = swing.damping * odd
    place = jnp.stack([even + lag, odd, *chain(*waves)], axis=-1)
    rates = ((omega * c, -omega * s) for omega, (s, c) in zip(omegas, waves, strict=True))
    return place, jnp.stack([-stiffness * odd, even - lag, *chain(*rates)], axis=-1)


def free_motion(scene: Scene, first: Motion, turns: Scalar, t: Float[Array, " n"]) -> Motion:
    """The motion of the free blades, fields (n, 2), at times `t` after the motion `first` at a drive phase [turns]."""
    start = free_components(scene, first, turns)
    parts = (jnp.einsum("nbik,bik->nbi", course, start) for course in free_propagators(scene, t))
    return Motion._make(a[..., i] for a in parts for i in range(3))
