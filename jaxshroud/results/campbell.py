"""Natural modes of both blades, and the speeds at which engine orders meet them: the numbers of a Campbell diagram."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxshroud.io.store import JSONValue, json_values
from jaxshroud.io.variable import Attribute, Variable
from jaxshroud.results.base import Result
from jaxshroud.scene.layout import PAIR, Layout
from jaxshroud.scene.parts import COORDINATES

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
class Crossing:
    """A speed at which an engine order meets a natural frequency."""

    contact: str
    mode: str  # its name
    engine_order: float
    speed: float  # [rad/s]
    margin: float  # by which the scene's own speed is above it [%]
    excited: bool | None = None  # whether the order excites the mode of a tuned ring; None: another scene


AT_END = 1e-9  # relative distance within which a crossing is at an end of the range: units are converted to rounding


class Campbell(Result):
    """Natural frequencies against the speed, with the lines of engine orders and their crossings.

    The frequencies do not depend on the speed: there is no centrifugal stiffening. The picture has one panel,
    "frequency".
    """

    stored_as = "campbell"
    required = ("frequency", "crossing_speed")

    contact = Variable("state of contact", None, ("family",))
    frequency = Variable("natural frequency, undamped", "Hz", ("family",))
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
    ) -> "Campbell":
        """The result from the modes, the engine orders, `speed`, `drive_order`, `start` and `stop`, and the layout."""
        columns = {name: [getattr(mode, name) for mode in modes] for name in ("contact", "zeta", "energy", "driven")}
        frequency = np.array([mode.frequency for mode in modes])
        crossing = crossing_speeds(frequency, engine_orders)
        margin = 100 * (attributes["speed"] / crossing - 1)
        values = {**columns, "frequency": frequency, "crossing_speed": crossing, "margin": margin, **attributes}
        values["excited"] = excited_by(modes, engine_orders, layout)
        coords = {
            "family": [mode.name for mode in modes],
            "engine_order": [float(order) for order in engine_orders],
            "coordinate": [*COORDINATES],
        }
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
) -> tuple[Crossing, ...]:
    """The crossings from the speed `start` to `stop`, both included, the slowest first.

    Margins are those of `speed` [rad/s].
    """
    excited = excited_by(modes, engine_orders, layout)
    crossing = crossing_speeds(np.array([mode.frequency for mode in modes]), engine_orders)
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


def crossing_speeds(frequency: np.ndarray, engine_orders: Sequence[float]) -> np.ndarray:
    """The speeds [rad/s] (families, orders) at which each engine order meets each natural frequency [Hz]."""
    return 2 * np.pi * frequency[:, None] / np.asarray(engine_orders, float)
