"""The words by which ways to march are called."""

from typing import Literal

TABLEAUS = {"rk4": 4, "tsit5": 5, "dop853": 8, "dopri8": 8}  # Runge-Kutta method -> order
# "bisection": halve the bracket; "cubic": go where the guard's cubic crosses zero; "none": change mode at the end of
# the step (first order, for comparison only)
Locate = Literal["bisection", "cubic", "none"]
