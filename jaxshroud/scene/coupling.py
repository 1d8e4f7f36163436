"""What couples the blades of a scene beside their contact: the disk between neighbours, and the flow through a row."""

from typing import Any

import equinox as eqx

from jaxshroud.scene.fields import scalar
from jaxshroud.scene.keys import AERO_KEYS
from jaxshroud.scene.laws import Number
from jaxshroud.scene.valid import check_given, check_numbers


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
