"""What pairs or rows of blades alone have, and why: one table, by which verbs, arguments and parts are refused."""

from collections.abc import Container
from typing import Any, Literal, NamedTuple

from jaxshroud.scene.checks import InputError
from jaxshroud.scene.layout import PAIR, Layout

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
        """The line with which the others are refused; `name` says in what words it was asked for."""
        return f"{name or self.name} {REFUSALS[self.holder]}: {self.reason}."


OWN_LAWS = '`parts.contact` = "own"'  # user laws; a law of contact of one's own may know rows
NO_CONTACT = '`parts.contact` = "none"'  # which scenes may have, and verbs refuse
TWO_BLADES = "it reads the state as the 13 numbers of two blades with one slider"
CAPABILITIES = (
    Capability("`attractors`", "pair so far", "motions are told apart by orbits of two blades with one slider"),
    Capability("`basins`", "pair so far", "motions are told apart by orbits of two blades with one slider"),
    Capability("`fit`", "pair so far", "the columns of measurements name a left and a right blade"),
    Capability("`lyapunov`", "pair so far", f"{TWO_BLADES}, and what sets the slider by one mode"),
    Capability("`trade`", "pair so far", "power series and the solvers of diffrax, which it compares, march pairs"),
    Capability("`method_for`", "pair so far", "methods are not tried on rows, for which no accuracy is examined"),
    Capability("`period_map`", "pair so far", "inside JAX's transformations the motion of a row has no derivatives"),
    Capability("`most_trials`", "pair so far", "the march of a row takes no bound of its trials"),
    Capability("`largest_frequency`", "pair so far", "`explain` gives a bound of that of a row, as `omega_max`"),
    Capability("`check_laws`", "pair so far", "the kernels of rows know springs and smooth contact only"),
    Capability("Argument `events`", "pair so far", "the march of a row keeps no states on both sides of its events"),
    Capability("Argument `lyapunov`", "pair so far", TWO_BLADES),
    Capability("Argument `most_trials`", "pair so far", "the march of a row takes no bound of its trials"),
    Capability("the method taylor", "pair so far", "rows are marched by Runge-Kutta methods, not by power series"),
    Capability(OWN_LAWS, "pair so far", "the kernels of rows know springs and smooth contact only"),
    Capability(NO_CONTACT, "pair", "a row without contact is many single blades; simulate one as a pair"),
    Capability('`parts.neighbour` = "rigid"', "pair", "every blade of a row has a neighbour that is a blade"),
    Capability("`contact.reading` but consistent", "pair", "the article's misprints are in equations of two blades"),
    Capability(
        "a mean displacement as an aim", "pair", "its sign differs from blade to blade of a row; take rms or peak"
    ),
    Capability("`mistune`", "rows", "it scatters the stiffnesses of many blades; add a table [row]"),
    Capability("P_d_worst", "rows", "of a pair one blade counts, the left one; take P_d"),
)
LIMITED = {capability.name: capability for capability in CAPABILITIES}


POINTS_OF_CONTACT = "faces with several points of contact"
KNOW_POINTS = ("simulate", "power", "sweep", "explain", "check")  # verbs


def require_points(verb: str, points: object, where: str = "") -> None:
    """Raise an InputError if there are `points`, but a verb, or a function, knows no faces with several of them."""
    if points is not None and verb not in KNOW_POINTS:
        raise InputError(f"{where}`{verb}` does not know {POINTS_OF_CONTACT} yet; drop `contact.points`.")


def holders(layout: Layout) -> Container[Holder]:
    """Whose capabilities scenes with a layout have."""
    return ("pair", "pair so far") if layout == PAIR else ("rows",)


def require_parts(parts: Any, reading: Container[str], layout: Layout) -> None:
    """Raise an InputError if a scene with a layout cannot have these parts, a `Parts` or as a file has them."""
    asked = {f'`parts.{name}` = "{getattr(parts, name)}"' for name in ("neighbour", "contact")} - {NO_CONTACT, OWN_LAWS}
    for name in (*sorted(asked), *(["`contact.reading` but consistent"] if reading else [])):
        require_capability(name, layout)


def require_capability(name: str, layout: Layout, where: str = "", asked: str = "") -> None:
    """Raise an InputError if scenes with a layout lack what is in `CAPABILITIES` under a name.

    Args:
        name: What is asked for; what is not in the table, all scenes have.
        layout: The layout of the scene.
        where: What the message begins with.
        asked: The words in which it was asked for, by default the name.
    """
    capability = LIMITED.get(name)
    if capability is not None and capability.holder not in holders(layout):
        raise InputError(where + capability.refusal(asked))
