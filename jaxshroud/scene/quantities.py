"""The quantities of a motion that are differentiated, tuned and scattered: powers and amplitudes.

They are those of the left blade of a pair. Of a row, P and P_d are those of all blades together, `P_d_worst` is that of
the blade that gains the least, and an amplitude is the largest of all blades. `P_d_vibration` is P_d without what a
static deflection contributes.
"""

from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.scene.layout import Layout, require_capability

if TYPE_CHECKING:
    import numpy as np

    from jaxshroud.scene.scene import Scene

Measure = Literal["mean", "rms", "peak", "a", ""]
Power = Literal["P_d", "P", "P_d_worst", "P_d_vibration"]
Quantity = Literal[
    "P_d",
    "P",
    "P_d_worst",
    "P_d_vibration",
    "x_mean",
    "x_rms",
    "x_peak",
    "y_mean",
    "y_rms",
    "y_peak",
    "theta_mean",
    "theta_rms",
    "theta_peak",
    "sigma_a",
    "goodman",
]
QUANTITY_WORDS = get_args(Quantity)
DISPLACEMENTS = ("x", "y", "theta")
WATCHED_UNITS = {"x": "m", "y": "m", "theta": "rad", "sigma": "Pa", "goodman": "1"}  # the last two of the stress
STRESSES = ("sigma_a", "goodman")
RequiredReduction = Literal["P_d", "P_d_worst", "P_d_vibration"]  # that a design is to reach
REQUIRED_REDUCTIONS = get_args(RequiredReduction)
POWER_UNITS = {"P_d": "%", "P": "m^4", "P_d_worst": "%", "P_d_vibration": "%"}


class Amplitude(NamedTuple):
    """An amplitude, see `WithAmplitudes`."""

    displacement: str  # one of `DISPLACEMENTS`, or "sigma", the stress, of half its range, "a", or "goodman"
    measure: Measure

    @property
    def row(self) -> int:
        """The place of the displacement in `DISPLACEMENTS`, after which comes the stress."""
        return min([*WATCHED_UNITS].index(self.displacement), len(DISPLACEMENTS))


def amplitude_of(of: str) -> Amplitude | None:
    """The amplitude that a quantity is; None for a power."""
    if of in POWER_UNITS:
        return None
    displacement, _, measure = of.partition("_")
    return Amplitude(displacement, measure)  # pyright: ignore[reportArgumentType]  # `of` is a `Quantity`


def free_name(of: str) -> str:
    """The name of an amplitude without contact beside `of`, e.g. "x_free" beside "x_peak" and "x_free_rms"."""
    displacement, measure = of.split("_")
    return f"{displacement}_free" if measure == "peak" else f"{displacement}_free_{measure}"


def counted_amplitude(amplitudes: "np.ndarray", layout: Layout) -> "np.ndarray":
    """The amplitude that counts, of those of each blade (..., blades): the largest of the blades that count, (...)."""
    return amplitudes[..., layout.counting].max(axis=-1)


def unit_of(of: str) -> str:
    """The unit of a quantity."""
    amplitude = amplitude_of(of)
    return POWER_UNITS[of] if amplitude is None else WATCHED_UNITS[amplitude.displacement]


def is_reduction(of: str) -> bool:
    """Whether a quantity is a reduction already, in percent: P_d, that of the worst blade or of the vibration alone."""
    return POWER_UNITS.get(of) == "%"


def quantity_symbol(of: str) -> str:
    """The symbol of a quantity, as pictures show it."""
    amplitude = amplitude_of(of)
    if of in ("P_d_worst", "P_d_vibration"):
        return rf"$P_{{d,\mathrm{{{of.removeprefix('P_d_')}}}}}$"
    if amplitude is None:
        return f"${of}$"
    letter = amplitude.displacement
    if not amplitude.measure:
        return "Goodman's utilisation"
    return rf"${letter if len(letter) == 1 else chr(92) + letter}_\mathrm{{{amplitude.measure}}}$"


def check_quantity(of: str, scene: "Scene") -> None:
    """Raise an InputError unless `of` is a quantity of a scene."""
    word_argument("of", of, QUANTITY_WORDS)
    amplitude = amplitude_of(of)
    require_capability(of, scene.layout, asked=f"Argument `of` = {of!r}")
    if of in STRESSES:
        needed = [mode.sigma for mode in getattr(scene.blades, "modes", ())]
        if all(sigma is None for sigma in needed):
            raise InputError(f"`{of}` is of blades by modes that have a stress; give modes their `sigma`.")
        if of == "goodman" and getattr(scene.blades, "sigma_e", None) is None:
            raise InputError("`goodman` is of blades with limits; give them `blades.sigma_e` and `blades.sigma_u`.")
        return
    parts = scene.parts
    if amplitude is not None and not parts.has(amplitude.displacement, 0):
        raise InputError(
            f"`of` is {of}, but the blades of this scene do not move in {amplitude.displacement}; "
            f"its `parts.motion` is {list(parts.motion)}."
        )


def check_only_P_d(name: str, value: object, of: str) -> None:
    """Raise an InputError where an argument that is about P_d is given with another quantity."""
    if value is not None and not is_reduction(of):
        raise InputError(f"Argument `{name}` is a P_d, and says nothing about {of}; leave it out.")
