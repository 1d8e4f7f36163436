"""The table of the numbers of a scene, from which files, `vary`, results, pictures and docs/keys.md take their data."""

import re
from collections import ChainMap
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from jaxshroud.scene.checks import KeyNameError, did_you_mean, hint
from jaxshroud.scene.key import (
    ANY,
    ANY_WHOLE,
    FACE,
    FROM_0,
    POSITIVE,
    UP_TO_1,
    Key,
    Range,
    blade_key,
    interface_key,
    scene_key,
)
from jaxshroud.scene.layout import PAIR, Layout


class Motion(NamedTuple):
    """The displacements and rates of both blocks, left first; theta is positive clockwise.

    A field is `PerBlade` in a scene or state, a `Pair` in compiled loops, and an array (..., 2) in results. In a row it
    has one value for each of its blades.
    """

    x: Any  # [m]
    y: Any  # [m]
    theta: Any  # [rad]
    v_x: Any  # [m/s]
    v_y: Any  # [m/s]
    v_theta: Any  # [rad/s]


AT_REST = Motion._make([(0.0, 0.0)] * 6)
KEY_PATTERN = re.compile(r"(?P<name>.*?)(\[(?P<index>0|[1-9]\d{0,3})\])?")
HARMONIC_ENTRY = re.compile(r"harmonic\[(?P<index>0|[1-9]\d?)\]\.(?P<name>\w+)")  # of the table `drive`
MODE_ENTRY = re.compile(r"modes\[(?P<index>0|[1-9]\d?)\]\.(?P<name>\w+)")  # of the table `blades`
POINT_ENTRY = re.compile(r"point\[(?P<index>0|[1-9]\d?)\]\.(?P<name>place)")  # of the table `contact`
SINGLE_LOADS = ("beta", "F_0", "M_0")  # of a drive without a list of harmonics
MAX_ORDER = 99  # of a harmonic
MAX_MODES = 16  # of a blade
MIN_BLADES, MAX_BLADES = 2, 512  # of a row
TABLES_IN_ROW = ("coupling", "aero")  # that may stand in [row]

COUPLING_KEYS = tuple(
    interface_key(
        f"coupling.{symbol}_{name}",
        unit,
        FROM_0,
        f"{symbol}_{{c,{name}}}",
        f"coupling {words}",
        example,
        f"{words} between neighbours {way}",
        None,
    )
    for symbol, words, name, way, unit, example in (
        ("k", "stiffness", "x", "along x", "N/m", "2e4 N/m"),
        ("k", "stiffness", "y", "along y", "N/m", "2e4 N/m"),
        ("k", "stiffness", "T", "in torsion", "N m/rad", "50 N m/rad"),
        ("c", "damping", "x", "along x", "N s/m", "1 N s/m"),
        ("c", "damping", "y", "along y", "N s/m", "1 N s/m"),
        ("c", "damping", "T", "in torsion", "N m s/rad", "0.01 N m s/rad"),
    )
)
SCENE_KEYS = (
    # name, unit, range, symbol, label of an axis, example, meaning (if different), default (if any)
    blade_key("blades.m", "kg", POSITIVE, "m", "mass", "0.08 kg"),
    blade_key("blades.I", "kg m^2", POSITIVE, "I", "moment of inertia", "2.46e-3 kg m^2"),
    blade_key("blades.k_x", "N/m", POSITIVE, "k_x", "bending stiffness", "1e5 N/m", "bending stiffness in x"),
    blade_key("blades.k_y", "N/m", POSITIVE, "k_y", "bending stiffness", "3e6 N/m", "bending stiffness in y"),
    blade_key("blades.k_T", "N m/rad", POSITIVE, "k_T", "torsion stiffness", "2000 N m/rad"),
    blade_key("blades.c_x", "N s/m", FROM_0, "c_x", "damping", "3.57 N s/m", "damping in x"),
    blade_key("blades.c_y", "N s/m", FROM_0, "c_y", "damping", "19.6 N s/m", "damping in y"),
    blade_key("blades.c_T", "N m s/rad", FROM_0, "c_T", "torsion damping", "0.506 N m s/rad"),
    blade_key("blades.m_y", "kg", POSITIVE, "m_y", "mass in y", "0.08 kg", "mass against motion in y", default=None),
    blade_key("blades.B_x", "", ANY, "B_x", "growth with speed", 1.1, "growth of k_x, by m times speed^2", None),
    blade_key("blades.B_y", "", ANY, "B_y", "growth with speed", 1.1, "growth of k_y, by m times speed^2", None),
    blade_key("blades.B_T", "", ANY, "B_T", "growth with speed", 0.5, "growth of k_T, by I times speed^2", None),
    scene_key(
        "shroud.alpha", "rad", FACE, r"\alpha", "shroud angle", "60 deg", "acute angle of the block, at most pi/2"
    ),
    scene_key("shroud.l_oa", "m", POSITIVE, "l_{oa}", "side of the block", "50 mm", "side along x"),
    scene_key("shroud.l_ab", "m", POSITIVE, "l_{ab}", "contact side", "35 mm", "side along the contact face"),
    interface_key(
        "shroud.gap", "m", ANY, r"\Delta", "initial gap", "0.022 mm", "initial gap along x; negative: interference"
    ),
    interface_key("shroud.gap_at", "m", ANY, r"\Delta_\Omega", "gap at speed", "-5 um", "gap at gap_at_speed", None),
    scene_key("shroud.gap_at_speed", "rad/s", POSITIVE, r"\Omega_\Delta", "speed of gap_at", "3000 rpm", default=None),
    interface_key("contact.k", "N/m", FROM_0, "k", "contact stiffness", "2.5e5 N/m", "impact stiffness", default=None),
    interface_key(
        "contact.gamma", "", FROM_0, r"\gamma = k/k_x", "stiffness ratio", 2.5, "stiffness ratio k / k_x", None
    ),
    interface_key("contact.width", "m", POSITIVE, "w", "width of smooth contact", "0.1 um", default=None),
    interface_key("friction.k_d", "N/m", FROM_0, "k_d", "friction stiffness", "1e6 N/m", "tangential stiffness"),
    interface_key("friction.mu", "", FROM_0, r"\mu", "friction coefficient", 0.5),
    *COUPLING_KEYS,
    scene_key(
        "drive.omega",
        "rad/s",
        POSITIVE,
        r"\omega",
        "drive frequency",
        "536 rad/s",
        "circular frequency, 2 pi times the frequency",
    ),
    blade_key("drive.beta", "rad", ANY, r"\beta", "force direction", "30 deg", "direction of the force"),
    blade_key("drive.F_0", "N", ANY, "F_0", "force amplitude", "60 N"),
    blade_key("drive.M_0", "N m", ANY, "M_0", "moment amplitude", "100 N m"),
    blade_key("drive.phase", "rad", ANY, r"\phi", "drive phase", ["0 deg", "180 deg"], "phases of the drive"),
    scene_key("drive.level", "", ANY, r"\lambda", "level of the drive", 1.2, "factor of all its harmonics", None),
    blade_key("drive.F_x_mean", "N", ANY, r"\bar F_x", "mean force", "5 N", "constant force along x", None),
    blade_key("drive.F_y_mean", "N", ANY, r"\bar F_y", "mean force", "5 N", "constant force along y", None),
    blade_key("drive.M_mean", "N m", ANY, r"\bar M", "mean moment", "0.1 N m", "constant moment", None),
    blade_key("initial.x", "m", ANY, "x(0)", "initial displacement", "0.01 mm", "displacement in x", 0.0),
    blade_key("initial.y", "m", ANY, "y(0)", "initial displacement", "0.01 mm", "displacement in y", 0.0),
    blade_key(
        "initial.theta", "rad", ANY, r"\theta(0)", "initial angle", "0.1 deg", "torsion angle, positive clockwise", 0.0
    ),
    blade_key("initial.v_x", "m/s", ANY, "v_x(0)", "initial velocity", "0.01 m/s", "velocity in x", default=0.0),
    blade_key("initial.v_y", "m/s", ANY, "v_y(0)", "initial velocity", "0.01 m/s", "velocity in y", default=0.0),
    blade_key(
        "initial.v_theta", "rad/s", ANY, r"v_\theta(0)", "initial rate", "0.1 rad/s", "torsion rate", default=0.0
    ),
)
KEYS = {row.name: row for row in SCENE_KEYS}
INPUT_KEYS = (  # other ways to give numbers of the scene, which `derived_inputs` works out
    blade_key("blades.f_x", "Hz", POSITIVE, "f_x", "natural frequency", "178 Hz", "natural frequency in x, for k_x"),
    blade_key("blades.f_y", "Hz", POSITIVE, "f_y", "natural frequency", "975 Hz", "natural frequency in y, for k_y"),
    blade_key("blades.f_T", "Hz", POSITIVE, "f_T", "natural frequency", "144 Hz", "torsion frequency, for k_T"),
    blade_key("blades.zeta_x", "", FROM_0, r"\zeta_x", "damping ratio", 0.02, "damping ratio in x, for c_x"),
    blade_key("blades.zeta_y", "", FROM_0, r"\zeta_y", "damping ratio", 0.02, "damping ratio in y, for c_y"),
    blade_key("blades.zeta_T", "", FROM_0, r"\zeta_T", "damping ratio", 0.02, "damping ratio of torsion, for c_T"),
    scene_key("drive.f", "Hz", POSITIVE, "f", "drive frequency", "85.3 Hz", "drive frequency, for omega"),
    scene_key("drive.engine_order", "", POSITIVE, "e", "engine order", 6.0, "drive periods in a revolution, for omega"),
    scene_key("drive.speed", "rad/s", POSITIVE, r"\Omega", "speed", "853 rpm", "speed of the rotor, for omega"),
)

AERO_KEYS = tuple(  # the real and the imaginary part of each influence coefficient
    scene_key(
        f"aero.{name}_{part.lower()}",
        "N/m",
        ANY,
        rf"\mathrm{{{part}}}\,L_{{{index}}}",
        "influence coefficient",
        example,
        f"{words} part of the force along x by the motion of {of}",
        None,
    )
    for name, index, of in (("L0", 0, "the blade itself"), ("L1", 1, "the next blade"), ("L_1", -1, "the one before"))
    for part, words, example in (("Re", "real", "-500 N/m"), ("Im", "imaginary", "-2e3 N/m"))
)
ROW_KEYS = {  # of scenes with a row
    row.name: row
    for row in (
        blade_key(
            "row.mistuning",
            "",
            Range("> -1", -1.0, open=True),
            r"\delta",
            "mistuning",
            0.01,
            "relative deviation of the stiffnesses k_x, k_y and k_T",
            0.0,
        ),
        *AERO_KEYS,
    )
}
HARMONIC_KEYS = {  # of each table [[drive.harmonic]], by their names in it
    row.parts[1]: row
    for row in (
        blade_key("harmonic.F", "N", ANY, "F_{%s}", "force amplitude", "20 N"),
        blade_key("harmonic.beta", "rad", ANY, r"\beta_{%s}", "force direction", "30 deg", "direction of the force"),
        blade_key("harmonic.M", "N m", ANY, "M_{%s}", "moment amplitude", "0.1 N m", default=0.0),
        blade_key("harmonic.phase", "rad", ANY, r"\psi_{%s}", "phase", ["0 deg", "90 deg"], default=None),
    )
}
COMPLEX_KEYS = {  # of a harmonic by complex amplitudes, in the place of these: the imaginary part of Q exp(i n omega t)
    f"{load}_{part}": blade_key(
        f"harmonic.{load}_{part}",
        unit,
        ANY,
        rf"\mathrm{{{part.title()}}}\,{symbol}",
        f"{words} amplitude, {part_of_wave}",
        0.2 if load == "M" else 5.0,
        f"{words} amplitude {part_of_wave}",
        default=0.0,
    )
    for load, unit, symbol, words in (
        ("F_x", "N", "F_{x,%s}", "force"),
        ("F_y", "N", "F_{y,%s}", "force"),
        ("M", "N m", "M_{%s}", "moment"),
    )
    for part, part_of_wave in (("re", "with the sine"), ("im", "with the cosine"))
}
MODAL_LOAD_KEYS = {  # likewise: what acts on a mode of the blades itself
    f"Q{j}_{part}": blade_key(
        f"harmonic.Q{j}_{part}",
        "N kg^-0.5",
        ANY,
        rf"\mathrm{{{part.title()}}}\,Q_{{{j},%s}}",
        f"load of mode {j}",
        5.0,
        f"load of mode {j} with the {wave}",
        None,
    )
    for j in range(MAX_MODES)
    for part, wave in (("re", "sine"), ("im", "cosine"))
}
OF_HARMONIC = {**HARMONIC_KEYS, **COMPLEX_KEYS, **MODAL_LOAD_KEYS}
MODE_KEYS = {  # of each mode of a blade, by their names in its table [[blades.modes]]
    row.parts[1]: row
    for row in (
        blade_key("mode.f", "Hz", FROM_0, "f_{%s}", "natural frequency", "178 Hz", "natural frequency at rest"),
        blade_key("mode.zeta", "", UP_TO_1, r"\zeta_{%s}", "damping ratio", 0.002, "damping ratio at rest", 0.0),
        blade_key("mode.phi_x", "kg^-0.5", ANY, r"\phi_{x,%s}", "shape along x", 3.5, default=0.0),
        blade_key("mode.phi_y", "kg^-0.5", ANY, r"\phi_{y,%s}", "shape along y", 3.5, default=0.0),
        blade_key(
            "mode.phi_theta",
            "rad m^-1 kg^-0.5",
            ANY,
            r"\phi_{\theta,%s}",
            "turn of the shroud",
            20.0,
            "turn of the shroud, positive clockwise",
            0.0,
        ),
        blade_key("mode.q", "m kg^0.5", ANY, "q_{%s}(0)", "initial coordinate", 1e-5, default=None),
        blade_key("mode.v", "m kg^0.5 s^-1", ANY, r"\dot q_{%s}(0)", "initial rate", 1e-3, default=None),
        blade_key("mode.sigma", "Pa m^-1 kg^-0.5", ANY, r"\sigma_{%s}", "stress", 3e9, "stress of a unit of q", None),
        blade_key("mode.B", "", ANY, "B_{%s}", "growth with speed", 1.5, "growth of omega^2, by speed^2", None),
        interface_key(
            "mode.kappa", "1/s^2", ANY, r"\kappa_{%s}", "coupling", 2e4, "coupling with this mode of neighbours", None
        ),
    )
}
LIMIT_KEYS = {  # of the stress of blades by modes
    key.name: key
    for key in (
        blade_key(f"blades.{name}", "Pa", allowed, rf"\{name}", words, example, default=None)
        for name, allowed, words, example in (
            ("sigma_e", POSITIVE, "endured amplitude", "400 MPa"),
            ("sigma_u", POSITIVE, "ultimate strength", "900 MPa"),
            ("sigma_0", ANY, "constant stress", "200 MPa"),
        )
    )
}
PLACE_KEY = scene_key("contact.place", "m", ANY, "s_{%s}", "place", "17.5 mm", "place up the face from its middle")
IN_LISTS: dict[str, tuple[str, re.Pattern, Mapping[str, Key]]] = {  # kind -> its table, its entries and their keys
    "harmonic": ("drive", HARMONIC_ENTRY, OF_HARMONIC),
    "mode": ("blades", MODE_ENTRY, MODE_KEYS),
    "point": ("contact", POINT_ENTRY, {"place": PLACE_KEY}),
}


def list_length(entries: Iterable[str], pattern: re.Pattern) -> int:
    """How many tables the entries of a table have in the list of those that match a pattern."""
    matches = [pattern.fullmatch(entry) for entry in entries]
    return 1 + max((int(match["index"]) for match in matches if match), default=-1)


class KeyTable(ChainMap[str, Key]):
    """The keys by their names. Those of harmonics, modes and points of contact, of any number, are not listed."""

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or (isinstance(name, str) and numbered_key(name) is not None)

    def __missing__(self, name: str) -> Key:
        found = numbered_key(name)
        if found is None:
            raise KeyError(name)
        return found


def numbered_key(name: str) -> Key | None:
    """The key of a number of one harmonic, mode or point, such as `blades.modes[1].f`; None for any other name."""
    table, _, own = name.partition(".")
    for kind, (of, entry, rows) in IN_LISTS.items():
        match = entry.fullmatch(own)
        if table == of and match is not None and match["name"] in rows:
            row, index = rows[match["name"]], match["index"]
            words = f" of {kind} [{index}]"
            label = row.label + words
            return row._replace(name=name, symbol=row.symbol % index, label=label, about=row.about + words)
    return None


ALL_KEYS = KeyTable(LIMIT_KEYS, ROW_KEYS, {row.name: row for row in INPUT_KEYS}, KEYS)


def keys_of_table(table: str) -> list[Key]:
    """The keys of a table."""
    return [row for row in KEYS.values() if row.parts[0] == table]


def number_shape(key: Key, layout: Layout = PAIR) -> tuple[int, ...]:
    """The shape of a number of a scene: () or the number of its blades or interfaces."""
    if key.pair:
        return (layout.blades,)
    return layout.interface_shape if key.per_interface else ()


def list_words(key: Key, layout: Layout) -> str:
    """What a list of a number of each blade or interface is called."""
    kind = "interface" if key.per_interface else "blade"
    size = number_shape(key, layout)[0]
    names = ", ".join(layout.names)
    return f"a pair [{names}]" if layout == PAIR else f"a list of {size}, one for each {kind}"


def key_in(key: Key, layout: Layout) -> Key:
    """A key as in a scene with a row, whose engine order also gives the phases: it may be 0, and is whole in a ring."""
    if layout == PAIR or key.name != "drive.engine_order":
        return key
    return key._replace(range=ANY_WHOLE if layout.closed else ANY)


def key_names(layout: Layout) -> list[str]:
    """The names of the numbers of a scene; those of rows alone where it has one."""
    return [name for name in ALL_KEYS if layout != PAIR or name not in ROW_KEYS]


def without_row(key: str) -> str:
    """A key in a table of its own that a file with a row may also write as `row.coupling.k_x`."""
    own = key.strip().removeprefix("row.")
    return own if own.partition(".")[0] in TABLES_IN_ROW else key


def key_stem(key: str) -> str:
    """A key without the index of a blade or interface; what is no key, as it is."""
    match = KEY_PATTERN.fullmatch(key)
    return key if match is None else match["name"]


def parse_key(key: str, where: str = "", layout: Layout = PAIR) -> tuple[Key, int | None]:
    """The number that a key names in some scene, and the index of its blade or interface, whatever that is.

    The arguments, and what is raised, are those of `find_key`; the layout says which keys a message suggests.
    """
    match = KEY_PATTERN.fullmatch(without_row(key))
    if match is None or match["name"] not in ALL_KEYS:
        raise _unknown_key(key, where, layout)
    return ALL_KEYS[match["name"]], None if match["index"] is None else int(match["index"])


def find_key(key: str, where: str = "", layout: Layout = PAIR) -> tuple[Key, int | None]:
    """The number with a key, and the index of its blade or interface (None: all, or the only one).

    Args:
        key: `table.name`, or `table.name[i]` for blade or interface i alone, from 0.
        where: The place that an error message names first.
        layout: The layout of the scene.

    Raises:
        KeyNameError: There is no such number.
    """
    number, index = parse_key(key, where, layout)
    if layout == PAIR and number.name in ROW_KEYS:
        raise _unknown_key(key, where, layout)
    if index is None:
        return key_in(number, layout), None
    shape = number_shape(number, layout)
    if not shape:
        raise KeyNameError(f"{_place(where)}{number.name} is one number, not one per blade; drop the [{index}]")
    if index >= shape[0]:
        kind = "interfaces" if number.per_interface else "blades"
        raise KeyNameError(f"{_place(where)}{key}: the scene has {shape[0]} {kind}, from [0] to [{shape[0] - 1}]")
    return key_in(number, layout), index


def _unknown_key(key: str, where: str, layout: Layout) -> KeyNameError:
    """The error for a key that names no number."""
    key = " ".join(key.split())
    known = key_names(layout)
    fault = f"{_place(where)}the scene has no number `{key}`"
    if key_stem(without_row(key)) in ROW_KEYS:
        return KeyNameError(f"{fault}, which is one of rows of blades; give it a [row]")
    if meant := next((one for one in known if one.endswith(f".{key}")), None):
        return KeyNameError(f"{fault}; did you mean `{meant}`?")
    table, _, entry = key.partition(".")
    entries = [name.removeprefix(f"{table}.") for name in known if name.startswith(f"{table}.")]
    if entries:
        return KeyNameError(f"{fault}{hint(entry, entries, f'{table}.')}")
    tables = dict.fromkeys(f"[{name.partition('.')[0]}]" for name in known)
    others = f"; known are those of {', '.join(tables)}, such as shroud.gap"
    return KeyNameError(f"{fault}{did_you_mean(key, known) or others}")


def _place(where: str) -> str:
    return f"{where}: " if where else ""


def key_parts(key: str, layout: Layout = PAIR) -> tuple[str, str, int | None]:
    """The table, the name and the index (None: all, or the only one) of a key, see `find_key`.

    Raises:
        KeyNameError: There is no such number.
    """
    number, index = find_key(key, layout=layout)
    return *number.parts, index
