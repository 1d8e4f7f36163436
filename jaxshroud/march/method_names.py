"""The words that commands and verbs take: methods, ways to locate events, amplitudes and loads."""

from typing import Literal

from jaxshroud.scene.quantities import STRESSES

TABLEAUS = {"rk4": 4, "tsit5": 5, "dopri8": 8}  # Runge-Kutta method -> order
METHODS = (*TABLEAUS, "taylor")
# "bisection": halve the bracket; "cubic": take the root of the guard's cubic; "none": change the mode at the end of the
# step (first order, for comparison only); "series": take the root of the guard's power series
Locate = Literal["bisection", "cubic", "none", "series"]
RESPONSES = tuple(f"{q}_{kind}" for q in ("x", "y", "theta") for kind in ("peak", "rms"))  # amplitudes over a number
LINEAR_STATES = ("apart", "sliding", "stuck", "corner")  # of contact, in which a row is linear
LOADS = ("v_max", "N_max", "F_max", "friction_work", "slip", "archard", "impacts", "approach_max", "impulse_max")
LARGEST_FIRST = ("P_d", "P_d_vibration", "P_d_worst")  # reductions; of other numbers the smallest is first
RANKED_BY = (*LARGEST_FIRST, *RESPONSES, *STRESSES, *LOADS)
