"""Measured motions: a time history or a frequency response, with its channels."""

import re
from typing import Literal, NamedTuple

import numpy as np

from jaxshroud.scene.quantities import DISPLACEMENTS

BLADES = ("left", "right")  # of a pair, where x_1 and x_2 are other names of x_left and x_right
MEASURES = ("rms", "peak")  # of a frequency response: about the mean
NAME = re.compile(
    rf"(?P<place>{'|'.join(DISPLACEMENTS)})_(?:(?P<measure>{'|'.join(MEASURES)})_)?"
    rf"(?P<label>{'|'.join(BLADES)}|[1-9]\d{{0,2}})"
)
Kind = Literal["history", "response"]


class Channel(NamedTuple):
    """One measured quantity."""

    place: str  # x, y or theta
    label: str  # of its blade: "left", "right", or its number in the row, from 1
    measure: str = ""  # of a response: one of `MEASURES`

    @property
    def name(self) -> str:
        """The name of its column: `x_left`, or `x_rms_3` of a response."""
        return "_".join(filter(None, (self.place, self.measure, self.label)))

    @property
    def blade(self) -> int:
        """The index of its blade."""
        return BLADES.index(self.label) if self.label in BLADES else int(self.label) - 1

    def column(self, blades: int) -> int:
        """Its place among x, y and theta of so many blades, each of all blades before the next."""
        return blades * DISPLACEMENTS.index(self.place) + self.blade


def channel_named(name: str) -> Channel | None:
    """The channel of a column; None where the name is of none."""
    match = NAME.fullmatch(name)
    return match and Channel(match["place"], match["label"], match["measure"] or "")


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
