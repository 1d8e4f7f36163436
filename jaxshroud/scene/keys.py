"""The numbers of a scene, one line each: all that files, `vary`, results, pictures and docs/keys.md know of them.

A new number is one line here and one field of its class in `scene.py`.
"""

import math
import re
from types import EllipsisType
from typing import Any, NamedTuple

from jaxshroud.scene.checks import hint
from jaxshroud.scene.errors import KeyNameError

BLADE = re.compile(r"(?P<name>.*?)(\[(?P<blade>[01])\])?")


class Range(NamedTuple):
    """The values that a number may have."""

    words: str
    least: float = -math.inf
    open: bool = False  # `least` itself is no such value
    most: float = math.inf

    def holds(self, value):
        """Whether a number, or each of an array, is in the range."""
        above = value > self.least if self.open else value >= self.least
        return (abs(value) < math.inf) & above & (value <= self.most)

    def fault(self, value: float) -> str:
        """What is wrong with a number outside."""
        if not abs(value) < math.inf:
            return "must be a finite number"
        if value > self.most:
            return f"must be less than or equal to {self.most}"
        return f"must be greater than {'' if self.open else 'or equal to '}{self.least:g}"


class Key(NamedTuple):
    """One number of a scene."""

    name: str  # table.key
    unit: str  # SI, as messages write it
    pair: bool  # one value per blade
    range: Range
    symbol: str  # LaTeX
    label: str  # on an axis
    example: str | float | list[str]  # as in a file
    about: str  # what it is
    default: float | EllipsisType | None  # where a file may leave it out; None: it has no value then

    @property
    def parts(self) -> tuple[str, str]:
        """Table and key."""
        table, key = self.name.split(".")
        return table, key

    @property
    def netcdf(self) -> str:
        """The SI unit as NetCDF files write it: "N m rad-1" for "N m/rad"."""
        above, _, below = self.unit.replace("^", "").partition("/")
        return f"{above} {below}-1" if below else above or "1"

    @property
    def shown(self) -> tuple[str, float]:
        """Unit of pictures, and how many of it are one SI unit."""
        return SHOWN.get(self.unit, (self.unit, 1.0))


ANY, POSITIVE, FROM_0 = Range("any"), Range("> 0", 0.0, open=True), Range(">= 0", 0.0)
FACE = Range("> 0, <= pi/2", 0.0, open=True, most=math.pi / 2)
SHOWN = {  # SI unit -> unit of pictures, and how many of it are one SI unit
    "rad": ("°", 180 / math.pi),
    "m": ("mm", 1e3),
    "kg": ("g", 1e3),
    "kg m^2": ("g m²", 1e3),
    "N/m": ("kN/m", 1e-3),
}


def one(
    name: str,
    unit: str,
    allowed: Range,
    symbol: str,
    label: str,
    example: str | float | list[str],
    about: str = "",
    default: float | EllipsisType | None = ...,
) -> Key:
    """A number of the whole scene; see `Key`."""
    return Key(name, unit, False, allowed, symbol, label, example, about or label, default)


def pair(*row: Any, **more: Any) -> Key:
    """A number per blade."""
    return one(*row, **more)._replace(pair=True)


ROWS = (
    # name, unit, range, symbol, words on an axis, example, what it is (if more than that), default (if any)
    pair("blades.m", "kg", POSITIVE, "m", "mass", "0.08 kg"),
    pair("blades.I", "kg m^2", POSITIVE, "I", "moment of inertia", "2.46e-3 kg m^2"),
    pair("blades.k_x", "N/m", POSITIVE, "k_x", "bending stiffness", "1e5 N/m", "bending stiffness in x"),
    pair("blades.k_y", "N/m", POSITIVE, "k_y", "bending stiffness", "3e6 N/m", "bending stiffness in y"),
    pair("blades.k_T", "N m/rad", POSITIVE, "k_T", "torsion stiffness", "2000 N m/rad"),
    pair("blades.c_x", "N s/m", FROM_0, "c_x", "damping", "3.57 N s/m", "damping in x"),
    pair("blades.c_y", "N s/m", FROM_0, "c_y", "damping", "19.6 N s/m", "damping in y"),
    pair("blades.c_T", "N m s/rad", FROM_0, "c_T", "torsion damping", "0.506 N m s/rad"),
    pair("blades.m_y", "kg", POSITIVE, "m_y", "mass in y", "0.08 kg", "mass against motion in y", default=None),
    one("shroud.alpha", "rad", FACE, r"\alpha", "shroud angle", "60 deg", "acute angle of the block, at most pi/2"),
    one("shroud.l_oa", "m", POSITIVE, "l_{oa}", "side of the block", "50 mm", "side along x"),
    one("shroud.l_ab", "m", POSITIVE, "l_{ab}", "contact side", "35 mm", "side along the contact face"),
    one("shroud.gap", "m", ANY, r"\Delta", "initial gap", "0.022 mm", "initial gap along x; negative: interference"),
    one("contact.k", "N/m", FROM_0, "k", "contact stiffness", "2.5e5 N/m", "impact stiffness", default=None),
    one("contact.gamma", "", FROM_0, r"\gamma = k/k_x", "stiffness ratio", 2.5, "stiffness ratio k / k_x", None),
    one("contact.width", "m", POSITIVE, "w", "width of smooth contact", "0.1 um", default=None),
    one("friction.k_d", "N/m", FROM_0, "k_d", "friction stiffness", "1e6 N/m", "tangential stiffness"),
    one("friction.mu", "", FROM_0, r"\mu", "friction coefficient", 0.5),
    one(
        "drive.omega",
        "rad/s",
        POSITIVE,
        r"\omega",
        "drive frequency",
        "536 rad/s",
        "circular frequency, 2 pi times the frequency",
    ),
    pair("drive.beta", "rad", ANY, r"\beta", "force direction", "30 deg", "direction of the force"),
    pair("drive.F_0", "N", ANY, "F_0", "force amplitude", "60 N"),
    pair("drive.M_0", "N m", ANY, "M_0", "moment amplitude", "100 N m"),
    pair("drive.phase", "rad", ANY, r"\phi", "drive phase", ["0 deg", "180 deg"], "phases of the drive"),
    pair("initial.x", "m", ANY, "x(0)", "initial displacement", "0.01 mm", "displacement in x", 0.0),
    pair("initial.y", "m", ANY, "y(0)", "initial displacement", "0.01 mm", "displacement in y", 0.0),
    pair(
        "initial.theta", "rad", ANY, r"\theta(0)", "initial angle", "0.1 deg", "torsion angle, positive clockwise", 0.0
    ),
    pair("initial.v_x", "m/s", ANY, "v_x(0)", "initial velocity", "0.01 m/s", "velocity in x", default=0.0),
    pair("initial.v_y", "m/s", ANY, "v_y(0)", "initial velocity", "0.01 m/s", "velocity in y", default=0.0),
    pair("initial.v_theta", "rad/s", ANY, r"v_\theta(0)", "initial rate", "0.1 rad/s", "torsion rate", default=0.0),
)
KEYS = {row.name: row for row in ROWS}
OTHERS = (  # numbers of files alone, from which `given` works out those of the scene
    pair("blades.f_x", "Hz", POSITIVE, "f_x", "natural frequency", "178 Hz", "natural frequency in x, for k_x"),
    pair("blades.f_y", "Hz", POSITIVE, "f_y", "natural frequency", "975 Hz", "natural frequency in y, for k_y"),
    pair("blades.f_T", "Hz", POSITIVE, "f_T", "natural frequency", "144 Hz", "torsion frequency, for k_T"),
    pair("blades.zeta_x", "", FROM_0, r"\zeta_x", "damping ratio", 0.02, "damping ratio in x, for c_x"),
    pair("blades.zeta_y", "", FROM_0, r"\zeta_y", "damping ratio", 0.02, "damping ratio in y, for c_y"),
    pair("blades.zeta_T", "", FROM_0, r"\zeta_T", "damping ratio", 0.02, "damping ratio of torsion, for c_T"),
    one("drive.f", "Hz", POSITIVE, "f", "drive frequency", "85.3 Hz", "drive frequency, for omega"),
    one("drive.engine_order", "", POSITIVE, "e", "engine order", 6.0, "drive periods in a revolution, for omega"),
    one("drive.speed", "rad/s", POSITIVE, r"\Omega", "speed", "853 rpm", "speed of the rotor, for omega"),
)


def rows_of(table: str) -> list[Key]:
    """The numbers of a table."""
    return [row for row in KEYS.values() if row.parts[0] == table]


def found(key: str, where: str = "") -> tuple[Key, int | None]:
    """The number that a key names, and the blade (None: both, or neither).

    Args:
        key: `table.name`, or `table.name[0]`, `table.name[1]` for one blade only.
        where: What the message of an error names first.

    Raises:
        KeyNameError: A scene has no such number.
    """
    match = BLADE.fullmatch(key)
    name, blade = (match["name"], match["blade"]) if match else (key, None)
    where = f"{where}: " if where else ""
    if name not in KEYS:
        key = " ".join(key.split())
        other = next((row for row in OTHERS if row.name == name), None)
        if other is not None:
            number = f"{other.parts[0]}.{other.about.rpartition(' ')[2]}"
            raise KeyNameError(f"{where}{name} is a way to give {number} in files; name that instead")
        alike = [known for known in KEYS if known.endswith(f".{key}")]
        cure = f"; did you mean `{alike[0]}`?" if alike else hint(key, list(KEYS))
        raise KeyNameError(f"{where}the scene has no number `{key}`{cure}")
    if blade is not None and not KEYS[name].pair:
        raise KeyNameError(f"{where}{name} is one number, not one per blade; drop the [{blade}]")
    return KEYS[name], None if blade is None else int(blade)


def key_parts(key: str) -> tuple[str, str, int | None]:
    """Table, name and blade (None: both, or neither) that a key names.

    Raises:
        KeyNameError: A scene has no such number.
    """
    row, blade = found(key)
    return *row.parts, blade
