"""Measured motions: a time history or a frequency response, with its channels."""

from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.scene.quantities import DISPLACEMENTS

BLADES = ("left", "right")
MEASURES = ("rms", "peak")  # of a frequency response: about the mean
Kind = Literal["history", "response"]


class Channel(NamedTuple):
    """One measured quantity."""

    place: str  # x, y or theta
    blade: int
    measure: str = ""  # of a response: one of `MEASURES`

    @property
    def name(self) -> str:
        """The name of its column: `x_left`, or `x_rms_left` of a response."""
        return "_".join(filter(None, (self.place, self.measure, BLADES[self.blade])))

    @property
    def column(self) -> int:
        """Its place among x, y and theta, left before right."""
        return 2 * DISPLACEMENTS.index(self.place) + self.blade


class Measurements(NamedTuple):
    """A time history of displacements, or a frequency response, in SI units."""

    kind: Kind
    at: np.ndarray  # (n,) time since drive phase 0 [s], or circular frequency of the drive [rad/s]
    channels: tuple[Channel, ...]
    values: np.ndarray  # (n, channels) [m, rad]
    sigma: np.ndarray | None = None  # (n, channels) standard deviations of the noise; None: unknown

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the channels."""
        return tuple(channel.name for channel in self.channels)

    @property
    def sizes(self) -> np.ndarray:
        """The root mean square of each channel."""
        return np.sqrt(np.mean(self.values**2, axis=0))
