"""The words by which ways to march are called."""

from typing import Literal

TABLEAUS = {"rk4": 4, "tsit5": 5, "dop853": 8, "dopri8": 8}  # Runge-Kutta method -> order
METHODS = (*TABLEAUS, "taylor")
# "bisection": halve the bracket; "cubic": go where the guard's cubic crosses zero; "none": change mode at the end of
# the step (first order, for comparison only); "series": where the guard's power series crosses zero
Locate = Literal["bisection", "cubic", "none", "series"]
