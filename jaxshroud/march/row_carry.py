"""The state that a row of blades carries through the march, and its constants; see `model.row` for its axes."""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Int

from jaxshroud.march.observable import Lift
from jaxshroud.march.tally import EventMargins
from jaxshroud.model.arithmetic import Scalar


class InterfaceChange(NamedTuple):
    """The change of one interface at an event."""

    u_s: Any
    mode: Int[Array, ""]
    case: Int[Array, ""]
    becomes_flat: Bool[Array, ""]
    turns: Int[Array, ""] | None  # changes of case within this step; None where the blocks do not turn
    jumped: Bool[Array, ""]  # guards may have jumped
    springs: Scalar  # energy gained by the contact springs [J]
    counted: dict[str, Any]  # values of the observables that take the event
    v: Scalar  # penetration before it [m]
    margins: EventMargins | None  # None where they are not logged
    lift: Lift | None  # None where no log asks for it
