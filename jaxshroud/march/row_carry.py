"""The state that a row of blades carries through the march, and its constants; see `model.row` for its axes."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.carry import TimeGrid
from jaxshroud.march.events import (
    Guards,
)
from jaxshroud.march.locate import (
    Target,
)
from jaxshroud.march.row_step import OfLanes
from jaxshroud.march.tally import (
    ContactPeaks,
    Counters,
    DisplacementRange,
    EventMargins,
    Impacts,
    StepExtrema,
    displacements_of,
    half_position,
)
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Integrals, Means
from jaxshroud.model.row import (
    OfInterfaces,
    RowModel,
    blade_positions,
)
from jaxshroud.scene.keys import Motion


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


class RowLog(NamedTuple):
    """A `Log` of what has happened at each interface, and of the displacements of each blade."""

    time_apart: OfInterfaces  # [s]
    time_stick: OfInterfaces  # [s]
    time_slip: OfInterfaces  # [s]
    v_max: OfInterfaces  # largest penetration at ends of trials [m]
    largest: tuple[Any, Any, Any]  # magnitudes of x, y [m] and theta [rad] at ends of trials, (N, lanes) each
    counters: Counters
    within: StepExtrema | None  # None unless it was requested, as are the next three
    forces: ContactPeaks | None
    impacts: Impacts | None
    extent: DisplacementRange | None  # of each blade
    positions: Means | None  # of each blade, as of a `Log`

    @property
    def of_contact(self) -> tuple[StepExtrema | None, ContactPeaks | None, Impacts | None]:
        """What trials are searched for at each interface."""
        return self.within, self.forces, self.impacts

    @property
    def searches_contact(self) -> bool:
        """Whether it has any of these."""
        return any(one is not None for one in self.of_contact)


class RowTally(NamedTuple):
    """The integrals and the log of a row so far."""

    integrals: Integrals  # of each blade, those of contact of each interface
    springs: OfInterfaces  # energy gained by the contact springs at events [J]
    dropped: OfLanes  # energy lost where flat contact ended a rocking motion [J]
    log: RowLog | None  # None where derivatives are computed
    margins: EventMargins | None = None  # at each interface; None unless they were requested


class RowLane(eqx.Module):
    """The loop state of a row."""

    state: State  # motion (N, lanes); slider, mode and case (E, lanes)
    step: Int[Array, " lanes"]
    search: RowSearch
    guards: Guards | None  # of each interface at the start of the trial; None where there are no events
    tally: RowTally
    status: Int[Array, " lanes"]


class RowFixed(NamedTuple):
    """The constants of rows during a march."""

    model: RowModel
    grid: TimeGrid
    stop: Int[Array, " lanes"]  # the march ends at the start of this step


class Lift(NamedTuple):
    """Whether contact begins or ends at an interface."""

    onset: Bool[Array, ""]
    impact: Bool[Array, ""]  # an onset from a gap
    separation: Bool[Array, ""]


class InterfaceChange(NamedTuple):
    """The change of one interface at an event."""

    u_s: Any
    mode: Int[Array, ""]
    case: Int[Array, ""]
    becomes_flat: Bool[Array, ""]
    turns: Int[Array, ""] | None  # changes of case within this step; None where the blocks do not turn
    jumped: Bool[Array, ""]  # guards may have jumped
    springs: Scalar  # energy gained by the contact springs [J]
    counters: Counters | None  # None where there is no log
    v: Scalar  # penetration before it [m]
    margins: EventMargins | None  # None where they are not logged
    lift: Lift | None  # None where no log asks for it


def tally_of_new_period(tally: RowTally, z: Motion) -> RowTally:
    """The tally with what is told of each period reset, at the motion `z`, as `log_of_new_period` does."""
    zeros, log = jax.tree.map(jnp.zeros_like, tally)._replace(margins=tally.margins), tally.log
    if log is None:
        return zeros
    extent = None if log.extent is None else DisplacementRange(displacements_of(z), displacements_of(z))
    positions = None if log.positions is None else half_position(blade_positions(z))
    impacts = None if log.impacts is None else zeros.log.impacts._replace(now=log.impacts.now)
    lasting = {"v_max": log.v_max, "counters": log.counters, "within": log.within, "impacts": impacts}
    return zeros._replace(log=zeros.log._replace(**lasting, extent=extent, positions=positions))
