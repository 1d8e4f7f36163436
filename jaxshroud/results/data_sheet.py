"""The data sheet of a scene as `check` returns it: numbers, natural modes, and where engine orders meet them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import PlainResult, Result
from jaxshroud.scene.layout import COORDINATES, PAIR, Layout, row_layout


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the free blades: a number for each, the left blade first."""

    frequency: tuple[float, ...]  # natural, undamped [Hz]
    zeta: tuple[float, ...]  # damping ratio
    static: tuple[float, ...]  # displacement under the largest load of the drive as a static one [m or rad]
    amplitude: tuple[float, ...]  # steady, at the drive's frequency, about the mean [m or rad]
    resonant: tuple[float, ...]  # steady, of the strongest harmonic at the undamped natural frequency; inf undamped


@dataclass(frozen=True)
class SettledMotion:
    """Whether the settled motion from the static equilibrium is linear: contact then stays in one state."""

    state: str  # apart, stuck, or in contact: throughout, without friction; empty where the motion is marched
    reason: str  # why it is marched; empty where it is linear
    exact: bool  # without torsion; with it terms of the order of the angles are neglected, and that the corner changes
    equilibria: int  # static ones that were found; the motion is about that of least energy
    N: float = math.nan  # the margins, negative where the state is left: least normal force [N]; inf apart
    slip: float = math.nan  # least mu N - |F| [N]; inf without friction
    gap: float = math.nan  # least opening of the faces along their normal [m]; inf in contact

    @property
    def words(self) -> str:
        """The judgement in words, with its margins."""
        margins = [f"N at least {self.N:.4g} N"] if math.isfinite(self.N) else []
        margins += [f"mu N - |F| at least {self.slip:.4g} N"] if math.isfinite(self.slip) else []
        margins += [f"the gap at least {self.gap * 1e3:.4g} mm"] if math.isfinite(self.gap) else []
        number = (
            "" if self.equilibria <= 1 else f"; {self.equilibria} static equilibria, this about that of least energy"
        )
        about = "exact without torsion" if self.exact else "neglecting terms of the order of the angles"
        text = f"linear: {self.state} throughout, {about}" if self.state else f"marched: {self.reason}"
        return f"{'; '.join([text, *margins])}{number}"


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
    modes: "tuple[NaturalMode, ...]" = ()  # apart and in contact, at the scene's speed
    drive_order: float = 1.0  # engine order of the drive: the scene's own, or else the first of those requested
    is_own_order: bool = False  # whether it is the scene's own
    engine_orders: tuple[float, ...] = ()  # those of the crossings
    speed: float = 0.0  # at which the drive has its frequency, by `drive_order` [rad/s]
    start: float = 0.0  # of the range of speeds [rad/s]
    stop: float = 0.0
    crossings: "tuple[Crossing, ...]" = ()  # of engine orders with natural frequencies in that range
    pressed: tuple[float, ...] = ()  # displacement of each block by interference alone, without rotation [m]
    in_phase: float = math.nan  # of a pair: share of the mean square of its free shifts in which both blades move alike
    gaps: tuple[float, ...] = ()  # of a row, as are all that follow: at each interface [m]
    approaches: tuple[float, ...] = ()  # see `approach` [m]
    advice: tuple[str, ...] = ()  # what may do better; of pairs too
    slides: tuple[float, ...] = ()  # see `slide` [m]
    gammas: tuple[float, ...] = ()  # k / k_x of the blade left of each interface
    closed: bool = False  # the last blade touches the first
    static_gaps: tuple[float, ...] = ()  # under mean loads, at each interface, without contact [m]
    settled: "SettledMotion | None" = None  # from the static equilibrium; None where it is not judged
    harmonics: tuple[int, ...] = (1,)  # the orders of the drive's harmonics, multiples of its frequency
    flow_modes: "tuple[FlowMode, ...]" = ()  # of a row in a flow, apart
    over_speed: "SpeedLines | None" = None  # where stiffnesses or gaps depend on the speed

    def summary(self) -> dict[str, JSONValue]:
        """The fields as plain numbers and strings, as JSON holds them; None for numbers that are not finite."""
        summary = super().summary()
        return summary if self.over_speed else {k: v for k, v in summary.items() if k != "over_speed"}

    @property
    def campbell(self) -> "Campbell":
        """The natural frequencies and the engine orders over speed, as a dataset with a picture."""
        attributes = {name: getattr(self, name) for name in ("speed", "drive_order", "start", "stop")}
        lines = self.over_speed
        return Campbell.of_modes(self.modes, self.engine_orders, attributes, self.layout, lines, self.harmonics)

    @property
    def layout(self) -> Layout:
        """The layout of the blades."""
        return row_layout(len(self.inertia), self.closed) if self.gaps else PAIR


MOTION_NAMES = {"x": "bending along x", "y": "bending along y", "theta": "torsion"}


@dataclass(frozen=True)
class NaturalMode:
    """A natural mode of both blades in one state of contact."""

    contact: str  # apart; sliding or stuck, face on face; or corner: stuck at one pair of corners
    motion: str  # the coordinate that has most of the kinetic energy: x, y or theta
    blades: str  # either, left, right, in phase or out of phase; of a row a blade, nodes or a nodal diameter
    frequency: float  # natural, undamped [Hz]
    zeta: float  # damping ratio
    energy: tuple[float, float, float]  # shares of the kinetic energy in x, y and theta
    driven: float  # share of the drive that works on the mode

    @property
    def name(self) -> str:
        """The motion and the blades in words."""
        suffix = " blade" if self.blades in ("left", "right", "either") else ""
        return f"{MOTION_NAMES[self.motion]}, {self.blades}{suffix}"


@dataclass(frozen=True)
class FlowMode:
    """A mode along x of the blades of a row in a flow, apart: a wave exp(lambda t)."""

    nodal_diameter: int | None  # of a tuned ring, positive where the wave travels forward; None: of another row
    frequency: float  # |lambda| / 2 pi [Hz]
    zeta: float  # damping ratio, -Re lambda / |lambda|; the motion grows where it is negative
    zeta_flow: float  # what the flow adds to it


@dataclass(frozen=True)
class Crossing:
    """A speed at which an engine order meets a natural frequency."""

    contact: str
    mode: str  # its name
    engine_order: float
    speed: float  # [rad/s]
    margin: float  # by which the scene's own speed is above it [%]
    excited: bool | None = None  # whether the order excites the mode of a tuned ring; None: another scene


@dataclass(frozen=True)
class SpeedLines:
    """Natural frequencies that depend on the speed."""

    speeds: tuple[float, ...]  # [rad/s]
    frequencies: tuple[tuple[float, ...], ...]  # of each mode at each speed [Hz]; NaN where it is not so in contact
    crossings: tuple[tuple[float, ...], ...]  # the speed at which each engine order meets each mode; NaN: none
    pressed: tuple[tuple[float, float], ...]  # the ranges of speeds in which the faces are pressed together at rest


AT_END = 1e-9  # relative distance within which a crossing is at an end of the range: units are converted to rounding


class Campbell(Result):
    """Natural frequencies against the speed, with the lines of engine orders and their crossings.

    Where stiffnesses grow with the speed, or the gap changes with it, `frequency_at_speed` has the frequencies over
    the speed: those in contact where the faces are pressed together at rest, those apart elsewhere. Else there is one
    of each mode. The picture has one panel, "frequency".
    """

    stored_as = "campbell"
    required = ("frequency", "crossing_speed")

    contact = Variable("state of contact", None, ("family",))
    frequency = Variable("natural frequency, undamped", "Hz", ("family",))
    frequency_at_speed = Variable("natural frequency over the speed, undamped", "Hz", ("family", "rotor_speed"))
    zeta = Variable("damping ratio", "1", ("family",))
    energy = Variable("share of the kinetic energy", "1", ("family", "coordinate"))
    driven = Variable("share of the drive that works on the mode", "1", ("family",))
    crossing_speed = Variable(
        "speed at which the engine order meets the natural frequency", "rad s-1", ("family", "engine_order")
    )
    margin = Variable("margin of the scene's own speed above that", "percent", ("family", "engine_order"))
    excited = Variable(
        "whether the engine order excites the mode of a tuned ring; in tuned rings only",
        None,
        ("family", "engine_order"),
        stored=np.int8,
        kind=bool,
    )
    own = Variable("whether the drive has the engine order", None, ("engine_order",), stored=np.int8, kind=bool)
    speed = Attribute()  # the scene's own [rad/s]
    drive_order = Attribute()  # engine order of the drive at that speed
    start = Attribute()  # of the range of speeds [rad/s]
    stop = Attribute()

    @classmethod
    def of_modes(
        cls,
        modes: Sequence[NaturalMode],
        engine_orders: Sequence[float],
        attributes: Mapping[str, float],
        layout: Layout = PAIR,
        lines: SpeedLines | None = None,
        harmonics: Sequence[int] = (1,),
    ) -> "Campbell":
        """The result from the modes, the engine orders, `speed`, `drive_order`, `start` and `stop`, and the layout.

        With `lines` the frequencies depend on the speed; `harmonics` are the drive's, multiples of `drive_order`.
        """
        columns = {name: [getattr(mode, name) for mode in modes] for name in ("contact", "zeta", "energy", "driven")}
        frequency = np.array([mode.frequency for mode in modes])
        crossing = crossing_speeds(frequency, engine_orders, lines)
        margin = 100 * (attributes["speed"] / crossing - 1)
        values = {**columns, "frequency": frequency, "crossing_speed": crossing, "margin": margin, **attributes}
        values["own"] = np.isin(engine_orders, [n * attributes["drive_order"] for n in harmonics])
        values["excited"] = excited_by(modes, engine_orders, layout)
        coords = {
            "family": [mode.name for mode in modes],
            "engine_order": [float(order) for order in engine_orders],
            "coordinate": [*COORDINATES],
        }
        if lines is not None:
            values["frequency_at_speed"] = np.array(lines.frequencies)
            coords["rotor_speed"] = [*lines.speeds]
        return cls.from_values(values, coords=coords)

    def summary(self) -> dict[str, JSONValue]:
        """All families, engine orders, crossing speeds and margins in plain numbers."""
        labels = {name: self.data[name].to_numpy() for name in ("family", "engine_order")}
        values = {name: getattr(self, name) for name in self.variables if getattr(self, name) is not None}
        return json_values({**labels, **values, **self.origin})

    def __repr__(self) -> str:
        return "Campbell of {} families and {} engine orders".format(*self.crossing_speed.shape)


def crossings_between(
    modes: Sequence[NaturalMode],
    engine_orders: Sequence[float],
    speed: float,
    start: float,
    stop: float,
    layout: Layout = PAIR,
    lines: SpeedLines | None = None,
) -> tuple[Crossing, ...]:
    """The crossings from the speed `start` to `stop`, both included, the slowest first.

    Margins are those of `speed` [rad/s].
    """
    excited = excited_by(modes, engine_orders, layout)
    crossing = crossing_speeds(np.array([mode.frequency for mode in modes]), engine_orders, lines)
    inside = np.argwhere((crossing >= start * (1 - AT_END)) & (crossing <= stop * (1 + AT_END)))
    found = (
        Crossing(
            modes[i].contact,
            modes[i].name,
            float(engine_orders[j]),
            at,
            100 * (speed / at - 1),
            excited[i][j] if excited else None,
        )
        for i, j in inside
        for at in [float(crossing[i, j])]
    )
    return tuple(sorted(found, key=lambda crossing: crossing.speed))


def excited_by(modes: Sequence[NaturalMode], engine_orders: Sequence[float], layout: Layout) -> list[list[bool]] | None:
    """Whether each engine order excites each mode of a tuned ring; None for other scenes.

    Order EO excites nodal diameter EO modulo N, aliased into 0 to N/2; orders that are not whole excite all.
    """
    known = all(mode.blades.startswith(("nodal diameter", "each blade")) for mode in modes)
    if not layout.closed or not known:
        return None

    def excites(order: float, blades: str) -> bool:
        diameter = min(order % layout.blades, -order % layout.blades)
        return blades == "each blade" or order % 1 != 0 or blades == f"nodal diameter {diameter:g}"

    return [[excites(float(order), mode.blades) for order in engine_orders] for mode in modes]


def crossing_speeds(
    frequency: np.ndarray, engine_orders: Sequence[float], lines: SpeedLines | None = None
) -> np.ndarray:
    """The speeds [rad/s] (families, orders) at which each engine order meets each natural frequency [Hz]."""
    if lines is not None:
        return np.array(lines.crossings)
    return 2 * np.pi * frequency[:, None] / np.asarray(engine_orders, float)
