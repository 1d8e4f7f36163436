"""What the model of a scene consists of, which misprints it keeps, and in which order a sweep goes."""

from typing import Any, Literal, NamedTuple

from jaxshroud.scene.checks import checked, hint, word_argument
from jaxshroud.scene.errors import InputError

MOTIONS = (("x",), ("x", "y"), ("x", "y", "theta"))
MISPRINTS = ("gap_sign", "friction_components", "M_N2_case1", "M_N1_case2", "M_N1_case4", "levers")  # "printed"
DOUBTS = ("corner_angles", "M_N1_sign")  # what else the article may have meant, kept where it is named


def reading_text(kept: Any) -> str | list[str]:
    """A set of misprints as files have it: "consistent", "printed" or their names."""
    names = [name for name in (*MISPRINTS, *DOUBTS) if name in kept]
    return "consistent" if not names else "printed" if set(names) == set(MISPRINTS) else names


def misprints(reading: Any) -> Any:
    """The misprints kept by a `reading`: "consistent", "printed", the name of one, or several names.

    Raises:
        ValueError: There is no such misprint.
    """
    words = isinstance(reading, str)
    names = {"consistent": (), "printed": MISPRINTS}.get(reading, (reading,)) if words else reading
    if not isinstance(names, list | tuple | set | frozenset):
        raise InputError('must be "consistent", "printed" or a list of misprints')
    for name in names:
        if name not in (*MISPRINTS, *DOUBTS):
            known = (*MISPRINTS, *DOUBTS, *(("consistent", "printed") if words else ()))
            raise InputError(f"names the unknown misprint `{name}`{hint(str(name), known)}")
    return frozenset(names)


Neighbour = Literal["blade", "rigid"]
FrictionLaw = Literal["bilinear", "none"]
ContactLaw = Literal["spring", "smooth", "none", "own"]  # "own": the scene has `laws`


@checked
class Parts(NamedTuple):
    """What the model of a scene consists of; ValueError for a part that is not known.

    What is left out is not in the compiled program.
    """

    motion: tuple[str, ...] = ("x", "y", "theta")  # coordinates of a block, see `MOTIONS`
    neighbour: Neighbour = "blade"  # "rigid": the right block stands still
    friction: FrictionLaw = "bilinear"
    contact: ContactLaw = "spring"

    def __check_init__(self):
        if self.motion not in MOTIONS:
            raise InputError(f"`motion` must be one of {', '.join(map(str, MOTIONS))}, but is {self.motion}.")
        word_argument("neighbour", self.neighbour, Neighbour)
        word_argument("friction", self.friction, FrictionLaw)
        word_argument("contact", self.contact, ContactLaw)

    def has(self, coordinate: str, blade: int) -> bool:
        """Whether a block (0: left, 1: right) moves in a coordinate."""
        return coordinate in self.motion and (blade == 0 or self.neighbour == "blade")


WAYS = ("independent", "forward", "backward")
Direction = Literal["independent", "forward", "backward", "both"]  # "both": these two and from rest
ACCURACIES = ("fast", "balanced", "reference")  # by name
