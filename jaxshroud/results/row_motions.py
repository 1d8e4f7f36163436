"""The motions that a row of blades settles on from random starts."""

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Variable
from jaxshroud.results.attractors import Attractors


class RowMotions(Attractors):
    """The motions that a row settles on from random starts, the most frequent first.

    They are told apart by their points at the strobe over the kept periods: no orbit is closed, and nothing is said of
    their stability but that runs stay on them. In a ring the copies of a motion that begin at another blade are motions
    of their own.
    """

    stored_as = "row_motions"

    P_d_worst = Variable("least reduction of any blade, of any start", "percent")
    x_peak = Variable("amplitude of x of each blade, from the first of the starts", "m", ("blade",))
    x_free = Variable("amplitude of x of each blade without contact, closed form", "m", ("blade",))
    N_max = Variable("largest normal force of any start, at events and ends of steps", "N")
    v_max = Variable("largest penetration, likewise", "m")

    def blade_cells(self, motion: int) -> list[str]:
        """Of a motion: the least P_d of any blade [percent], and the largest amplitude of x with its blade [mm]."""
        peaks = self.x_peak[motion]
        blade = int(np.argmax(peaks))
        return [f"{self.P_d_worst[motion]:.5g}", f"{1e3 * peaks[blade]:.5g} (blade {blade})"]

    def summary(self) -> dict[str, JSONValue]:
        """The shares and P_d of the motions in plain numbers."""
        more = json_values({name: getattr(self, name) for name in ("P_d_worst", "x_peak", "N_max", "v_max")})
        return {**super().summary(), **more}
