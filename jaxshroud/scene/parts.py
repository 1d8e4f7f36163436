"""The parts of the model of a scene, the misprints that it keeps, and the directions of a sweep."""

from collections.abc import Collection
from typing import Literal, NamedTuple

from jaxshroud.scene.checks import InputError, checked, hint, word_argument

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
ContactPart = Literal["spring", "smooth", "none", "own"]  # "own": the scene has `laws`


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
