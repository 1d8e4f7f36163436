"""What basins of attraction come as."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.results.attractors import Attractors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Basins(Attractors):
    """Which motion each start of a plane ends on; `share` is that of the plane's starts."""

    stored_as = "basins"

    @property
    def plane(self) -> tuple[str, str]:
        """The two numbers of the start that span the plane."""
        first, second = (str(self.data[dim].attrs["key"]) for dim in self.data["label"].dims)
        return first, second

    @property
    def at_strobe(self) -> np.ndarray:
        """Where each attractor is in the plane at drive phase 0, (attractors, 2), SI."""
        places = []
        for key in self.plane:
            name, _, blade = key.removeprefix("initial.").partition("[")
            places.append(getattr(self.motion, name)[:, int(blade[:1] or 0)])
        return np.stack(places, axis=-1)

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """The plane of starts, coloured by the attractors; these are marked where they are at drive phase 0.

        Args:
            ax: Draw there.
            options: A title, xlabel, width [mm] and matplotlib style.
        """
        from jaxshroud.results import plot_attractors
        from jaxshroud.results.drawing import Look

        return plot_attractors.basins(self, ax, look=Look(**options))
