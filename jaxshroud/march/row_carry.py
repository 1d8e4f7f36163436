"""The state that a row of blades carries through the march, and its constants; see `model.row` for its axes."""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Int

from jaxshroud.march.locate import Target
from jaxshroud.march.observable import Lift
from jaxshroud.march.row_step import OfLanes
from jaxshroud.march.tally import EventMargins
from jaxshroud.model.arithmetic import Scalar


class RowTarget(NamedTuple):
    """The guard that a search closes in on: its interface, and its values at the upper end of the bracket."""

    place: Int[Array, " lanes"]
    guard: Target


class RowSearch(NamedTuple):
    """The search of a row inside its current step, as `locate.Search`; every field (lanes,)."""

    done: OfLanes
    length: OfLanes
    low: OfLanes
    high: OfLanes
    bracketing: Bool[Array, " lanes"]
    probing: Bool[Array, " lanes"]
    inside: Bool[Array, " lanes"]
    recheck: Bool[Array, " lanes"]
    events: Int[Array, " lanes"]
    target: RowTarget | None  # None unless events are located by cubics
    pending: Bool[Array, "interfaces lanes"] | None  # events at this very instant; None: no derivatives
    turns: Int[Array, "interfaces lanes"] | None  # changes of case within this step; None where blocks do not turn


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
