"""The choice of a march by power series: its order, and the tolerance that its steps keep."""

from typing import NamedTuple

import jax

from jaxshroud.scene.checks import checked
from jaxshroud.scene.errors import InputError

ORDERS = (4, 24)
TOLERANCES = (1e-16, 1e-1)


@checked
class Taylor(NamedTuple):
    """A march by power series; ValueError for what is out of range."""

    order: int = 12
    tolerance: float | jax.Array = 1e-9  # of the last terms of the speeds, over the largest speed

    def __check_init__(self):
        (least, most), (finest, coarsest) = ORDERS, TOLERANCES
        if type(self.order) is not int or not least <= self.order <= most:
            raise InputError(f"Argument `order` must be a whole number from {least} to {most}, but is {self.order!r}.")
        if not isinstance(self.tolerance, jax.Array) and not finest <= self.tolerance <= coarsest:
            bounds = f"from {finest:g} to {coarsest:g}"
            raise InputError(f"Argument `tolerance` must be a number {bounds}, but is {self.tolerance!r}.")

    @property
    def name(self) -> str:
        """As results call it."""
        return f"taylor {self.order} {self.tolerance:g}"


def named_taylor(text: str) -> Taylor:
    """The march of that `name`."""
    _, order, tolerance = text.split()
    return Taylor(int(order), float(tolerance))
