"""The drive of a scene: its frequency, and its force and moment on each blade by harmonics."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax

from jaxshroud.scene.fields import PerBlade, per_blade, scalar
from jaxshroud.scene.laws import Number
from jaxshroud.scene.valid import check_numbers


class DriveHarmonic(NamedTuple):
    """A force `F_0 sin(n omega t + phase)` at an angle `beta` to x, and a moment `M_0 sin(...)`, of each blade.

    Harmonic 0 is a constant load, `F_0 sin(phase)`.
    """

    beta: PerBlade  # direction of the force [rad]
    F_0: PerBlade  # force amplitude [N]
    M_0: PerBlade  # moment amplitude [N m]
    phase: PerBlade  # [rad]

    @property
    def F_x(self) -> Any:
        """The amplitude of the force along x [N], by NumPy or JAX."""
        return self.F_0 * self.beta.__array_namespace__().cos(self.beta)

    @property
    def F_y(self) -> Any:
        """The amplitude of the force along y [N], by NumPy or JAX."""
        return self.F_0 * self.beta.__array_namespace__().sin(self.beta)

    def load(self, name: str) -> Any:
        """The amplitude of the force along x or y [N], or of the moment on theta [N m]."""
        return getattr(self, {"x": "F_x", "y": "F_y", "theta": "M_0"}[name])


class Drive(eqx.Module):
    """The force `Q_i = F_0 sin(omega t + phase)` at an angle `beta` to x, and the moment `M_0 sin(...)` (Sec. 3.1).

    A drive of one's own is a class derived from this one, with fields of further numbers, whose `harmonics` are these
    fields. Everything else, from the march to the closed form without contact, follows from them. Files cannot name it.
    """

    omega: Number = eqx.field(converter=scalar)  # circular frequency, common to both blades [rad/s]
    beta: PerBlade = eqx.field(converter=per_blade)  # direction of the force [rad]
    F_0: PerBlade = eqx.field(converter=per_blade)  # force amplitude [N]
    M_0: PerBlade = eqx.field(converter=per_blade)  # moment amplitude [N m]
    phase: PerBlade = eqx.field(converter=per_blade)  # the paper's phi_1, phi_2 [rad]

    def __check_init__(self):
        check_numbers("drive", self)

    @property
    def period(self) -> Number:
        """The forcing period T = 2 pi / omega [s]."""
        return 2 * math.pi / self.omega

    def harmonics(self) -> dict[int, DriveHarmonic]:
        """The force and the moment by the order n of their frequency n omega. Their numbers are fields of the drive."""
        return {1: DriveHarmonic(self.beta, self.F_0, self.M_0, self.phase)}

    def largest_load(self, name: str) -> Any:
        """The sum over all harmonics of the amplitudes of the force along x or y [N], or of the moment on theta [N m].

        The load never exceeds it; (blades,), by NumPy or JAX.
        """
        return sum(abs(one.load(name)) for one in self.harmonics().values())

    def frequency(self, order: int) -> Number:
        """The circular frequency of a harmonic [rad/s]."""
        return self.omega if order == 1 else order * self.omega

    def of_blades(self, blades: Any) -> "Drive":
        """The drive of some `blades` of a row, by their indices."""
        return jax.tree.map(lambda a: a[blades] if a.ndim else a, self)

    def advanced(self, phase: float) -> "Drive":
        """The same drive with its phase omega t advanced by `phase` [rad]."""
        phases = lambda drive: [harmonic.phase for harmonic in drive.harmonics().values()]
        return eqx.tree_at(
            phases, self, [own + n * phase for n, own in zip(self.harmonics(), phases(self), strict=True)]
        )

    def scaled(self, factor: float) -> "Drive":
        """The same drive with all forces and moments times a `factor`."""
        loads = lambda drive: [load for one in drive.harmonics().values() for load in (one.F_0, one.M_0)]
        return eqx.tree_at(loads, self, [load * factor for load in loads(self)])
