"""What contact does to the vibration, as results hold and tell it: losses, and equivalents of the first harmonic."""

from typing import Any

import numpy as np

from jaxshroud.io.variable import Variable

STIFFNESS = "first-harmonic equivalent stiffness of contact along the {} of the faces; NaN if unknown"
DAMPING = "first-harmonic equivalent damping of contact along the {} of the faces; NaN if unknown"
RATIO = "damping ratio that it adds to the relative motion along the {} of the faces; NaN if unknown"


LEAST_TOLD = 0.005  # percent of the drive's work: less is not told


class LaneNumber(Variable):
    """A number of each lane: a plain number for a single scene."""

    def __init__(self, long_name: str, units: str):
        super().__init__(long_name, units, kind=float, alone=True)


class WithEquivalent:
    """Where the drive's work goes, and the spring and damper to which contact amounts in the first harmonic."""

    work_drive = LaneNumber("work of the drive in a period, on average", "J")
    loss_viscous = LaneNumber("lost in the dampers in a period, on average", "J")
    loss_friction = LaneNumber("lost in friction in a period, on average", "J")
    work_switches = LaneNumber("given to the contact springs by case switches under load in a period, on average", "J")
    loss_flat = LaneNumber("dropped where face-to-face contact begins in a period, on average", "J")
    k_n = LaneNumber(STIFFNESS.format("normal"), "N m-1")
    k_t = LaneNumber(STIFFNESS.format("tangent"), "N m-1")
    c_n = LaneNumber(DAMPING.format("normal"), "N s m-1")
    c_t = LaneNumber(DAMPING.format("tangent"), "N s m-1")
    zeta_n = LaneNumber(RATIO.format("normal"), "1")
    zeta_t = LaneNumber(RATIO.format("tangent"), "1")
    touches = LaneNumber("whether the faces touch: 1, or 0 where they never do; NaN if unknown", "1")
    P_d_stiffness = LaneNumber("P_d of the linear blades with the equivalent stiffness alone", "percent")


RESONANCE = "Undamped at resonance, the blade alone would move without end: P_d is 100 % of any motion."


def sentences_of(result: Any) -> str:
    """What contact of one scene does, in words with numbers."""
    gained, dropped = (0.0 if a is None else a for a in (result.work_switches, result.loss_flat))  # None: an old file
    work = result.loss_friction + result.loss_viscous + dropped - gained  # of the drive, where nothing is stored
    if not work > 0:
        return "The losses are unknown." if np.isnan(work) else "Nothing is lost."
    share = lambda part: 100 * part / work
    friction, viscous = share(result.loss_friction), share(result.loss_viscous)
    told = [f"{friction:.3g} % is lost in friction", f"{viscous:.3g} % in the dampers"]
    if abs(share(dropped)) >= LEAST_TOLD:
        told.append(f"{share(dropped):.2g} % where face-to-face contact begins")
    words = f"Of the drive's work {', '.join(told)}"
    if abs(share(gained)) >= LEAST_TOLD:
        does = "give" if gained > 0 else "take"
        words += f"; case switches under load {does} {abs(share(gained)):.2g} %"
    words += "."
    if result.P_d_stiffness is None:  # of a row
        return words
    if np.isinf(result.final_P_0[0]):
        words = f"{RESONANCE} {words}"
    if not np.isfinite(result.P_d_stiffness):
        return f"{words} No equivalent of contact: {_unknown_because(result)}."
    numbers = {name: (getattr(result, f"k_{a}"), getattr(result, f"zeta_{a}")) for name, a in DIRECTIONS}
    along = [_direction(name, *values) for name, values in numbers.items() if np.isfinite(values[0])]
    still = [f"; what vibrates does not move along the {name}" for name, (k, _) in numbers.items() if np.isnan(k)]
    alone = f"that stiffness alone would give P_d = {result.P_d_stiffness:.4g} %"
    return f"{words} In the first harmonic contact acts as {' and '.join(along)}{''.join(still)}; {alone}."


DIRECTIONS = (("normal", "n"), ("tangent", "t"))


def _direction(name: str, stiffness: float, ratio: float) -> str:
    damping = f"a damping ratio of {100 * ratio:.3g} %" if np.isfinite(ratio) else "a damping of unknown ratio"
    return f"{stiffness:.4g} N/m with {damping} along the {name} of the faces"


def _unknown_because(result: Any) -> str:
    """Why the first harmonic gives no equivalent."""
    if not result.final["settling"]:
        return "the motion has not settled; give a longer transient"
    if result.touches == 0:
        return "the faces never touch"
    if result.touches == 1:
        return "the blocks do not move against each other"
    return "it takes contact, and blades that move along x and y"
