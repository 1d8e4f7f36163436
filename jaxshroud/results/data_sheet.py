"""The data sheet of a scene: its numbers in an engineer's terms, as `check` returns them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from jaxshroud.results.base import PlainResult
from jaxshroud.scene.layout import PAIR, Layout, row_layout

if TYPE_CHECKING:
    from jaxshroud.results.campbell import Campbell, Crossing, NaturalMode


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the free blades: a number for each, the left blade first."""

    frequency: tuple[float, ...]  # natural, undamped [Hz]
    zeta: tuple[float, ...]  # damping ratio
    static: tuple[float, ...]  # displacement under the drive's amplitude as a static load [m or rad]
    amplitude: tuple[float, ...]  # steady, at the drive's frequency [m or rad]
    resonant: tuple[float, ...]  # steady, at the undamped natural frequency [m or rad]; inf without damping


@dataclass(frozen=True)
class DataSheet(PlainResult):
    """The numbers of a scene in an engineer's terms."""

    coordinates: dict[str, Coordinate]  # those of x, y and theta that the model has
    drive: float  # frequency [Hz]
    gap: float  # [m]
    approach: float  # displacement of the free blades' contact faces towards each other, without rotation [m]
    corner: tuple[float, ...]  # displacement of the free blocks' corners by rotation [m]
    inertia: tuple[float, ...]  # over that of a uniform block of that mass and size
    gamma: float  # k / k_x of the left blade
    omega_max: float  # largest frequency with contact and friction springs engaged [rad/s]
    steps: int  # per period, "auto", by RK4
    doubts: tuple[str, ...]  # numbers that should be checked
    slide: float = 0.0  # displacement of the free blades' contact faces along each other, without rotation [m]
    modes: "tuple[NaturalMode, ...]" = ()  # apart and in contact, without centrifugal stiffening
    drive_order: float = 1.0  # engine order of the drive: the scene's own, or else the first of those asked for
    is_own_order: bool = False  # whether it is the scene's own
    engine_orders: tuple[float, ...] = ()  # those of the crossings
    speed: float = 0.0  # at which the drive has its frequency, by `drive_order` [rad/s]
    start: float = 0.0  # of the range of speeds [rad/s]
    stop: float = 0.0
    crossings: "tuple[Crossing, ...]" = ()  # of engine orders with natural frequencies in that range
    pressed: tuple[float, ...] = ()  # displacement of each block by interference alone, without rotation [m]
    gaps: tuple[float, ...] = ()  # of a row, as are all that follow: at each interface [m]
    approaches: tuple[float, ...] = ()  # see `approach` [m]
    advice: tuple[str, ...] = ()  # what may do better; of pairs too
    slides: tuple[float, ...] = ()  # see `slide` [m]
    gammas: tuple[float, ...] = ()  # k / k_x of the blade left of each interface
    closed: bool = False  # the last blade touches the first
    static_gaps: tuple[float, ...] = ()  # under mean loads, at each interface, without contact [m]
    harmonics: tuple[int, ...] = (1,)  # the orders of the drive's harmonics, multiples of its frequency

    @property
    def campbell(self) -> "Campbell":
        """The natural frequencies and the engine orders over speed, as a dataset with a picture."""
        from jaxshroud.results.campbell import Campbell

        attributes = {name: getattr(self, name) for name in ("speed", "drive_order", "start", "stop")}
        return Campbell.of_modes(self.modes, self.engine_orders, attributes, self.layout)

    @property
    def layout(self) -> Layout:
        """The layout of the blades."""
        return row_layout(len(self.inertia), self.closed) if self.gaps else PAIR
