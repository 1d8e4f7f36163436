"""The lumped blades of a scene, masses on springs, and what couples blades beside their contact."""

from typing import Any

import equinox as eqx

from jaxshroud.scene.fields import PerBlade, per_blade, scalar
from jaxshroud.scene.keys import AERO_KEYS
from jaxshroud.scene.laws import Number
from jaxshroud.scene.speed import grown
from jaxshroud.scene.valid import check_given, check_numbers


class Blades(eqx.Module):
    """Both blades as lumped masses on springs (Sec. 2.1, Table 1).

    One value per blade: `blades.m[0]` is the paper's m_1. A single number means two equal blades.
    `m_y` differs from `m` only where Eq. (21) is taken literally. The stiffnesses are those at rest; at the speed Omega
    of the rotor they are k_x + B_x m Omega^2, k_y + B_y m_y Omega^2 and k_T + B_T I Omega^2.
    """

    m: PerBlade = eqx.field(converter=per_blade)  # mass [kg]
    I: PerBlade = eqx.field(converter=per_blade)  # moment of inertia about z [kg m^2]
    k_x: PerBlade = eqx.field(converter=per_blade)  # bending stiffness [N/m]
    k_y: PerBlade = eqx.field(converter=per_blade)  # bending stiffness [N/m]
    k_T: PerBlade = eqx.field(converter=per_blade)  # torsion stiffness [N m/rad]
    c_x: PerBlade = eqx.field(converter=per_blade)  # damping [N s/m]
    c_y: PerBlade = eqx.field(converter=per_blade)  # damping [N s/m]
    c_T: PerBlade = eqx.field(converter=per_blade)  # damping [N m s/rad]
    m_y: PerBlade | None = eqx.field(converter=per_blade, default=None)  # mass in y [kg]; None: m

    B_x: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)  # growth with speed; None: 0
    B_y: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)
    B_T: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)

    def __check_init__(self):
        check_numbers("blades", self)

    @property
    def inertia_y(self) -> Any:
        """The mass against motion in y [kg]."""
        return self.m if self.m_y is None else self.m_y

    @property
    def oscillators(self) -> dict[str, tuple[Any, Any, Any]]:
        """The mass, damping and stiffness of the blades along x, y and theta."""
        y = self.inertia_y, self.c_y, self.k_y
        return {"x": (self.m, self.c_x, self.k_x), "y": y, "theta": (self.I, self.c_T, self.k_T)}

    @property
    def grow(self) -> bool:
        """Whether a stiffness grows with the speed."""
        return any(B is not None for B in (self.B_x, self.B_y, self.B_T))

    def at_speed(self, square: Any) -> "Blades":
        """The blades at the square of a speed [rad^2/s^2], whose stiffnesses grow no further."""
        growths = (self.B_x, self.B_y, self.B_T)
        masses, stiffnesses = (self.m, self.inertia_y, self.I), (self.k_x, self.k_y, self.k_T)
        k = [grown(*numbers, square) for numbers in zip(stiffnesses, growths, masses, strict=True)]

        def places(b):
            return [b.k_x, b.k_y, b.k_T, b.B_x, b.B_y, b.B_T]

        return eqx.tree_at(places, self, [*k, None, None, None], is_leaf=lambda part: part is None)


class Coupling(eqx.Module):
    """Springs and dampers between neighbouring blades, along x, y and theta of their shrouds: the disk.

    The force on blade i is -k_x (2 x_i - x_(i-1) - x_(i+1)) - c_x (2 x_i' - x_(i-1)' - x_(i+1)'); at the end of a chain
    there is one neighbour. Numbers are one for each interface of a row, as are those of contact. What is None is not
    there.
    """

    k_x: Number | None = eqx.field(converter=scalar, default=None)  # [N/m]
    k_y: Number | None = eqx.field(converter=scalar, default=None)  # [N/m]
    k_T: Number | None = eqx.field(converter=scalar, default=None)  # [N m/rad]
    c_x: Number | None = eqx.field(converter=scalar, default=None)  # [N s/m]
    c_y: Number | None = eqx.field(converter=scalar, default=None)  # [N s/m]
    c_T: Number | None = eqx.field(converter=scalar, default=None)  # [N m s/rad]

    def __check_init__(self):
        check_numbers("coupling", self)

    @property
    def exists(self) -> bool:
        """Whether there is any."""
        return any(number is not None for number in vars(self).values())


class Aero(eqx.Module):
    """The forces of the flow on the blades of a row by their motion along x: complex influence coefficients.

    The force along x on blade i is -(L0 x_i + L1 x_(i+1) + L_1 x_(i-1)) where all x move as exp(i omega t) at the base
    frequency of the drive. They are marched as stiffnesses Re L and dampings Im L / omega; a negative damping feeds
    the vibration. What is None is not there.
    """

    L0_re: Number | None = eqx.field(converter=scalar, default=None)  # by a blade's own motion [N/m]
    L0_im: Number | None = eqx.field(converter=scalar, default=None)
    L1_re: Number | None = eqx.field(converter=scalar, default=None)  # by that of the next blade, i + 1
    L1_im: Number | None = eqx.field(converter=scalar, default=None)
    L_1_re: Number | None = eqx.field(converter=scalar, default=None)  # by that of the one before, i - 1
    L_1_im: Number | None = eqx.field(converter=scalar, default=None)

    def __check_init__(self):
        check_given([(key, value) for key in AERO_KEYS if (value := getattr(self, key.parts[1])) is not None])

    @property
    def exists(self) -> bool:
        """Whether there is any."""
        return any(number is not None for number in vars(self).values())

    def coefficient(self, name: str) -> tuple[Any, Any] | None:
        """The real and the imaginary part of L0, L1 or L_1, with zero for one that is None; None for both."""
        re: Any = getattr(self, f"{name}_re")
        im: Any = getattr(self, f"{name}_im")
        if re is None:
            return None if im is None else (0 * im, im)
        return re, 0 * re if im is None else im
