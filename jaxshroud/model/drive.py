"""The drive of a blade: its forces at a phase, their rate and their power, as sums of harmonics (Sec. 3.1)."""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxshroud.model.arithmetic import ZERO, Scalar, summed
from jaxshroud.model.series import Series
from jaxshroud.scene.drive import AnyLoad, ComplexLoad, Drive
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import COORDINATES

Wave = tuple[Any, ...]  # sin(n omega t + phase) for each harmonic n, or it and the cosine: of one blade, or `Series`


class HarmonicForce(NamedTuple):
    """The amplitudes and the phase of one harmonic, the force resolved in x and y: of both blades, or of one."""

    x: Any  # F_0 cos(beta) [N]: of each blade, a `Pair`, or one blade's, as are the next
    y: Any  # F_0 sin(beta) [N]
    theta: Any  # M_0 [N m]
    sin_phase: Any
    cos_phase: Any

    def wave(self, s: Scalar, c: Scalar) -> Scalar:
        """The wave from the sine and the cosine of n omega t."""
        return s * self.cos_phase + c * self.sin_phase

    def force(self, name: str, wave: Any) -> Any:
        """The force along x or y [N], or the moment on theta [N m], at a wave."""
        return getattr(self, name) * wave

    def on_mode(self, j: int, wave: Any) -> Any:
        """The force on a mode itself: there is none."""
        del j, wave
        return ZERO

    def power(self, wave: Any, z: Motion) -> Any:
        """The power on a motion [W]."""
        return (self.x * z.v_x + self.y * z.v_y + self.theta * z.v_theta) * wave

    @property
    def loads(self) -> list[Any]:
        """The amplitudes of all forces and moments."""
        return [self.x, self.y, self.theta]


class ComplexForce(NamedTuple):
    """The complex amplitudes and the phase of one harmonic of both blades or of one; its wave is sine and cosine."""

    parts: dict[str, tuple[Any, Any]]  # real and imaginary, along x and y [N], on theta [N m], on modes [N kg^-1/2]
    sin_phase: Any
    cos_phase: Any

    def wave(self, s: Scalar, c: Scalar) -> tuple[Scalar, Scalar]:
        """The sine and the cosine of n omega t + phase."""
        return s * self.cos_phase + c * self.sin_phase, c * self.cos_phase - s * self.sin_phase

    def force(self, name: str, wave: Any) -> Any:
        """The force along x or y [N], the moment on theta [N m], or the force on a mode, such as "Q0", at a wave."""
        sine, cosine = wave
        re, im = self.parts.get(name, (ZERO, ZERO))
        return re * sine + im * cosine

    def on_mode(self, j: int, wave: Any) -> Any:
        """The force on a mode itself [N kg^-1/2]."""
        return self.force(f"Q{j}", wave)

    def power(self, wave: Any, z: Motion) -> Any:
        """The power on a motion [W]."""
        return self.force("x", wave) * z.v_x + self.force("y", wave) * z.v_y + self.force("theta", wave) * z.v_theta

    @property
    def loads(self) -> list[Any]:
        """The parts of the amplitudes of all forces and moments, and of those on modes."""
        return [part for parts in self.parts.values() for part in parts]


class Excitation(eqx.Module):
    """The harmonics of a drive by their order n, prepared for stepping: of both blades, as pairs, or of one.

    Methods are of one blade. A `wave` is what a phase gives once for all of its coordinates.
    """

    harmonics: dict[int, HarmonicForce | ComplexForce]

    @property
    def loads(self) -> list[Any]:
        """The amplitudes of all forces and moments."""
        return [load for one in self.harmonics.values() for load in one.loads]

    def wave(self, s: Scalar, c: Scalar) -> Wave:
        """The wave at a phase, from its sine and cosine; the series of it, if the sine is one of the phase."""
        if isinstance(s, Series):
            return self.wave_series(self.wave(s[0], c[0]), self.wave_rate(c[0], -s[0]))
        return tuple(one.wave(*multiple_angle(s, c, n)) for n, one in self.harmonics.items())

    def wave_rate(self, s: Scalar, c: Scalar) -> Wave:
        """The rate of the wave per radian, from the sine and the cosine of the phase a quarter of a turn later."""

        def rate(n: int, one: HarmonicForce | ComplexForce) -> Any:
            wave = one.wave(*_turned_back(*multiple_angle(s, c, n), n - 1))
            return jax.tree.map(lambda a: a if n == 1 else n * a, wave)

        return tuple(rate(n, one) for n, one in self.harmonics.items())

    def wave_series(self, wave: Wave, rate: Wave) -> Wave:
        """The power series of the wave in the phase, from the wave and its rate at the start."""
        starts = zip(self.harmonics, wave, rate, strict=True)
        return tuple(jax.tree.map(partial(_sine_series, n), *start) for n, *start in starts)

    def force(self, name: str, wave: Wave) -> Any:
        """The force along x or y [N], or the moment on theta [N m], at a wave: a number, or a `Series` if it is one."""
        return summed(one.force(name, w) for one, w in zip(self.harmonics.values(), wave, strict=True))

    def on_mode(self, j: int, wave: Wave) -> Any:
        """The force on a mode itself [N kg^-1/2]; absent where there is none."""
        return summed(one.on_mode(j, w) for one, w in zip(self.harmonics.values(), wave, strict=True))

    def power(self, wave: Wave, z: Motion) -> Any:
        """The power on a motion [W]."""
        return summed(one.power(w, z) for one, w in zip(self.harmonics.values(), wave, strict=True))


def excitation(drive: Drive) -> Excitation:
    """The drive of a scene, prepared for stepping; fields (blades,)."""
    return Excitation({n: _prepared(one) for n, one in drive.harmonics().items()})


def _prepared(one: AnyLoad) -> HarmonicForce | ComplexForce:
    """One harmonic, prepared for stepping."""
    if isinstance(one, ComplexLoad):
        names = *COORDINATES, *dict.fromkeys(key.rpartition("_")[0] for key in one.modal)
        parts = {name: one.in_phase_and_quadrature(name) for name in names}
        return ComplexForce(parts, jnp.sin(one.phase), jnp.cos(one.phase))
    return HarmonicForce(one.F_x, one.F_y, one.M_0, jnp.sin(one.phase), jnp.cos(one.phase))


def multiple_angle(s: Scalar, c: Scalar, n: int) -> tuple[Scalar, Scalar]:
    """(sin, cos) of `n` times the angle with this sine and cosine, by angle addition."""
    if n == 0:
        return jnp.zeros_like(s), jnp.ones_like(c)
    turned = s, c
    for _ in range(n - 1):
        sine, cosine = turned
        turned = sine * c + cosine * s, cosine * c - sine * s
    return turned


def _turned_back(s: Scalar, c: Scalar, quarters: int) -> tuple[Scalar, Scalar]:
    """(sin, cos) of an angle so many quarters of a turn before."""
    return ((s, c), (-c, s), (-s, -c), (c, -s))[quarters % 4]


def _sine_series(n: int, value: Scalar, rate: Scalar) -> Series:
    """The series of a sine of `n` times the phase from its value and its rate per radian."""
    derivatives = (value, rate, -value, -rate)
    return Series(lambda k: derivatives[k % 4] * (n ** (k - k % 2) / math.factorial(k)))
