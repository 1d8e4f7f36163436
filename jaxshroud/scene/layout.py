"""The layout of a scene and the parts of its model: its blades, how they touch, and what is modelled.

What pairs or rows of blades alone have stands here, with the reason, in one table, by which verbs, arguments and parts
are refused.
"""

from collections.abc import Collection, Container
from functools import lru_cache
from typing import Any, Literal, NamedTuple

from jaxshroud.scene.checks import InputError, checked, hint, word_argument


class Layout(NamedTuple):
    """The blades of a scene and the interfaces between them; interface j is between blades j and j + 1.

    A row is an open chain, or a ring, whose last blade touches the first. The pair is a chain of two with names of its
    own: its left blade alone counts, and its only interface has no axis where users see it.
    """

    blades: int
    closed: bool
    names: tuple[str, ...]  # of the blades
    counted: int  # of the blades, from the first on: those whose vibration counts
    indices: tuple[str, ...]  # of the blades, in symbols such as x_1
    interface_shape: tuple[int, ...]  # the shape of a number of each interface
    text: str

    @property
    def interfaces(self) -> int:
        """The number of interfaces."""
        return self.blades if self.closed else self.blades - 1

    @property
    def counting(self) -> slice:
        """The blades whose vibration counts: the left one of the pair, all of a row."""
        return slice(self.counted)

    def at_interfaces(self, a: Any) -> Any:
        """Numbers (..., interfaces) as users see them: those of the pair's only interface without an axis."""
        return a if self.interface_shape else a[..., 0]

    def dims(self, dims: tuple[str, ...]) -> tuple[str, ...]:
        """Dimensions as users see them: those of the pair without `interface`."""
        return dims if self.interface_shape else tuple(dim for dim in dims if dim != "interface")

    @property
    def coords(self) -> dict[str, range]:
        """The numbers of the blades and, where users see an axis of them, of the interfaces."""
        sizes = self.blades, *self.interface_shape
        return {name: range(n) for name, n in zip(("blade", "interface"), sizes, strict=False)}

    @property
    def number_words(self) -> str:
        """How many blades there are, in words for all of them."""
        return "both blades" if self.blades == 2 else "all blades"


PAIR = Layout(2, False, ("left", "right"), 1, ("1", "2"), (), "a pair")


def layout_with(row: Any) -> Layout:
    """The layout of scenes with a row of blades, or of pairs without one."""
    return PAIR if row is None else row.layout


@lru_cache(maxsize=64)
def row_layout(blades: int, closed: bool) -> Layout:
    """The layout of a row, all of whose blades count; names are those of keys, from 0, and x_1 is that of blade 0."""
    size = blades if closed else blades - 1
    text = f"{'a ring' if closed else 'an open chain'} of {blades}"
    names = tuple(map(str, range(blades)))
    indices = tuple(map(str, range(1, blades + 1)))
    return Layout(blades, closed, names, blades, indices, (size,), text)


COORDINATES = ("x", "y", "theta")
MOTIONS = COORDINATES[:1], COORDINATES[:2], COORDINATES
MISPRINTS = (
    "gap_sign",
    "friction_components",
    "M_N2_case1",
    "M_N1_case2",
    "M_N1_case4",
    "levers",
)  # those of "printed"
# further possible readings of the article, which are kept if they are named
DOUBTFUL_READINGS = "corner_angles", "M_N1_sign"


def reading_text(misprints_kept: Collection[str]) -> str | list[str]:
    """A set of misprints as in files: "consistent", "printed" or their names."""
    names = [name for name in (*MISPRINTS, *DOUBTFUL_READINGS) if name in misprints_kept]
    return "consistent" if not names else "printed" if set(names) == set(MISPRINTS) else names


def misprints(reading: object) -> frozenset[str]:
    """The misprints of a `reading`: "consistent", "printed", the name of one, or several names.

    Raises:
        ValueError: There is no such misprint.
    """
    is_text = isinstance(reading, str)
    names = {"consistent": (), "printed": MISPRINTS}.get(reading, (reading,)) if is_text else reading
    if not isinstance(names, list | tuple | set | frozenset):
        raise InputError('must be "consistent", "printed" or a list of misprints')
    for name in names:
        if name not in (*MISPRINTS, *DOUBTFUL_READINGS):
            allowed = (*MISPRINTS, *DOUBTFUL_READINGS, *(("consistent", "printed") if is_text else ()))
            raise InputError(f"names the unknown misprint `{name}`{hint(str(name), allowed)}")
    return frozenset(names)


Neighbour = Literal["blade", "rigid"]
FrictionPart = Literal["bilinear", "none"]
ContactPart = Literal["spring", "smooth", "none", "own", "apart", "stuck"]  # "own": the scene has `laws`
SPRUNG = ("spring", "apart", "stuck")  # contact by springs; the last two are asked to stay in that state
Sector = Literal["whole", "auto"]  # what of a row is marched, see `Row.sector`
Start = Literal["motion", "static", "from rest"]  # where a march begins, see `Scene.start`


@checked
class Parts(NamedTuple):
    """The parts of the model of a scene; ValueError for an unknown part.

    The compiled program does not contain what is left out.
    """

    motion: tuple[str, ...] = ("x", "y", "theta")  # coordinates of a block, see `MOTIONS`
    neighbour: Neighbour = "blade"  # "rigid": the right block stands still
    friction: FrictionPart = "bilinear"
    contact: ContactPart = "spring"

    def __check_init__(self):
        if not isinstance(self.motion, tuple) or self.motion not in MOTIONS:
            raise InputError(f"`motion` must be one of {', '.join(map(str, MOTIONS))}, but is {self.motion}.")
        word_argument("neighbour", self.neighbour, Neighbour)
        word_argument("friction", self.friction, FrictionPart)
        word_argument("contact", self.contact, ContactPart)

    def has(self, coordinate: str, blade: int) -> bool:
        """Whether a block (0: left, 1: right) moves in a coordinate."""
        return coordinate in self.motion and (blade == 0 or self.neighbour == "blade")


SINGLE_DIRECTIONS = ("independent", "forward", "backward")
Direction = Literal["independent", "forward", "backward", "both"]  # "both": forward, backward and from rest
ACCURACIES = ("fast", "balanced", "reference")  # by name


Holder = Literal["pair", "pair so far", "rows"]  # "pair so far": nothing in the physics speaks against rows
REFUSALS: dict[Holder, str] = {
    "pair": "is of the pair alone",
    "pair so far": "does not know rows of blades yet",
    "rows": "is of rows of blades alone",
}


class Capability(NamedTuple):
    """What only a pair or only a row has."""

    name: str  # a verb, a function, an argument, a number or an entry of a scene, as messages name it
    holder: Holder
    reason: str  # a line without a full stop

    def refusal(self, name: str = "") -> str:
        """The line with which the others are refused; `name` says in what words it was requested."""
        return f"{name or self.name} {REFUSALS[self.holder]}: {self.reason}."


NO_CONTACT = '`parts.contact` = "none"'  # which scenes may have, and verbs refuse
AERO_FORCES = "[aero]"
COUPLED_WITHOUT_CONTACT = (
    'Coupled blades have no closed form through time: drop `parts.contact` = "none", and give a large shroud.gap.'
)
SECTOR_OF_CHAIN = '`row.sector` = "auto" is of closed rings: an open chain does not repeat; drop it.'
CAPABILITIES = (
    Capability("`trade`", "pair so far", "the solvers of diffrax, which it compares, march pairs"),
    Capability(NO_CONTACT, "pair", "a row without contact is many single blades; simulate one as a pair"),
    Capability('`parts.neighbour` = "rigid"', "pair", "every blade of a row has a neighbour that is a blade"),
    Capability("`contact.reading` but consistent", "pair", "the article's misprints are in equations of two blades"),
    Capability(
        "a mean displacement as an aim", "pair", "its sign differs from blade to blade of a row; take rms or peak"
    ),
    Capability("`mistune`", "rows", "it scatters the stiffnesses of many blades; add a table [row]"),
    Capability(
        AERO_FORCES, "rows", "influence coefficients are of blades with neighbours on both sides; add a table [row]"
    ),
    Capability("P_d_worst", "rows", "of a pair one blade counts, the left one; take P_d"),
)
LIMITED = {capability.name: capability for capability in CAPABILITIES}


POINTS_OF_CONTACT = "faces with several points of contact"
KNOW_LINEAR = ("power", "sweep", "response", "tune", "table", "scatter", "gradient", "check")  # verbs
LACK_POINTS = ("trade", "check_laws")  # verbs


def require_points(verb: str, points: object, where: str = "") -> None:
    """Raise an InputError if there are `points`, but a verb, or a function, knows no faces with several of them."""
    if points and verb in LACK_POINTS:
        raise InputError(f"{where}`{verb}` does not know {POINTS_OF_CONTACT} yet; drop `contact.points`.")


def require_steps(contact: str, verb: str = "", where: str = "") -> None:
    """Raise an InputError where contact is asked to stay in one state, which is in closed form, but a verb marches."""
    if contact in SPRUNG[1:] and verb not in KNOW_LINEAR:
        name = f"`{verb}` marches" if verb else "this marches"
        raise InputError(f'{where}`parts.contact` = "{contact}" is a closed form of the settled motion, and {name}.')


def holders(layout: Layout) -> Container[Holder]:
    """Whose capabilities scenes with a layout have."""
    return ("pair", "pair so far") if layout == PAIR else ("rows",)


def require_parts(parts: Any, reading: Container[str], layout: Layout) -> None:
    """Raise an InputError if a scene with a layout cannot have these parts, a `Parts` or as a file has them."""
    asked = {f'`parts.{name}` = "{getattr(parts, name)}"' for name in ("neighbour", "contact")} - {NO_CONTACT}
    for name in (*sorted(asked), *(["`contact.reading` but consistent"] if reading else [])):
        require_capability(name, layout)


def require_capability(name: str, layout: Layout, where: str = "", asked: str = "") -> None:
    """Raise an InputError if scenes with a layout lack what is in `CAPABILITIES` under a name.

    Args:
        name: What is requested; what is not in the table, all scenes have.
        layout: The layout of the scene.
        where: What the message begins with.
        asked: The words in which it was requested, by default the name.
    """
    capability = LIMITED.get(name)
    if capability is not None and capability.holder not in holders(layout):
        raise InputError(where + capability.refusal(asked))
