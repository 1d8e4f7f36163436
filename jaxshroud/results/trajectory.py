"""What a simulation gives."""

import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.model.modes import Mode
from jaxshroud.results.base import Result
from jaxshroud.results.instants import AFTER, BEFORE, with_events
from jaxshroud.results.status import FLAGS
from jaxshroud.results.variable import Attribute, Counts, Entry, Moving, Variable
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.motion import Motion

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.state import State

MODES = {"flag_values": [int(m) for m in Mode], "flag_meanings": " ".join(m.name for m in Mode)}
CASES = "contact case 1-4 of Sec. 2.3; 5: face to face; 0 when apart"
SAMPLE = "sample that the event comes after"
PLACE = "where contact acts, up the left block's face from its middle; of flat contact the resultant; NaN when apart"


class Instants(Variable):
    """States at events: what else varies in time, once more, with names and a dimension of their own."""

    def entries(self, values: Mapping[str, Any], lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each number of the states, their times, and the sample that each comes after."""
        values = dict(values)
        for name, told in ((f"{BEFORE}t", {"units": "s", "long_name": "time"}), (AFTER, {"long_name": SAMPLE})):
            yield name, (("event",), np.asarray(values.pop(name.removeprefix(BEFORE))), told)
        for name, value in values.items():
            for entry, (dims, array, attributes) in Trajectory.variables[name].entries(value, lanes):
                yield f"{BEFORE}{entry}", (tuple("event" if d == "time" else d for d in dims), array, attributes)

    def among(self, data: "xr.Dataset") -> list[str]:
        """All that begin so."""
        return [str(name) for name in data.data_vars if str(name).startswith(BEFORE)]

    def read(self, data: "xr.Dataset") -> "Trajectory | None":
        """The states as a trajectory of their own."""
        if AFTER not in data:
            return None
        at = data[self.among(data)].drop_vars(AFTER)
        at = at.rename({name: str(name).removeprefix(BEFORE) for name in at.data_vars} | {"event": "time"})
        return Trajectory(at.assign_coords(time=("time", at["t"].to_numpy(), at["t"].attrs)).drop_vars("t"))


class Trajectory(Result):
    """Samples of one run or of many, the initial state first; one value per blade in the last dimension of `motion`.

    Arrays start with the axes of the scenes; a single scene has none, and plain numbers where it has one of a kind.
    """

    stored_as = "trajectory"

    motion = Moving("NaN after the run has stopped", dims=("time",))
    u_s = Variable("slider of the friction element; NaN when apart", "m", ("time",))
    mode = Variable("contact mode", None, ("time",), stored=np.int8, kind=np.int32, more=MODES)
    case = Variable(CASES, None, ("time",), stored=np.int8, kind=np.int32)
    N = Variable("normal force of contact; 0 when apart", "N", ("time",))
    F = Variable("friction force of contact, positive against sliding to larger u; 0 when apart", "N", ("time",))
    v = Variable("penetration at the corner in contact; when apart, negative: the gap left there", "m", ("time",))
    u = Variable("slide of the left block against the right one, up the face", "m", ("time",))
    contact_point = Variable(PLACE, "m", ("time",))
    events = Instants("states on both sides of every event, the earlier one first; None where they were not kept")
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    counters = Counts("events", prefix="count_")
    energy_residual = Variable("energy residual over the drive's work; NaN without a ledger", "1", alone=True)
    energy_dropped = Variable(
        "energy dropped by beginnings of flat contact, over the drive's gross work", "1", alone=True
    )
    work_drive = Variable("work of the drive over the run", "J", alone=True)
    loss_viscous = Variable("lost in the dampers over the run", "J", alone=True)
    loss_friction = Variable("lost in sliding contact over the run", "J", alone=True)
    time_apart = Variable("fraction of the time: apart", "1", alone=True)
    time_stick = Variable("fraction of the time: stick", "1", alone=True)
    time_slip = Variable("fraction of the time: slip", "1", alone=True)
    omega = Variable("circular frequency of the drive", "rad s-1", alone=True)
    gap = Variable("initial gap", "m", alone=True)
    every = Attribute(int)  # steps from sample to sample
    turns = Attribute(name="end_turns")  # drive phase of the last sample [turns]

    @property
    def t(self) -> np.ndarray:
        """Time of each sample [s], (..., time)."""
        return self.data["t" if "t" in self.data else "time"].to_numpy()

    @property
    def last(self) -> "State":
        """The state at the last sample, to go on from; without a slider when apart, where it has no meaning."""
        from jaxshroud.model.state import State

        mode, u_s = self.mode[..., -1], self.u_s[..., -1]
        motion = Motion(*(a[..., -1, :] for a in self.motion))
        return State(motion, np.where(mode == Mode.APART, 0, u_s).astype(u_s.dtype), mode, self.case[..., -1])

    def with_events(self) -> "xr.Dataset":
        """All that varies in time, at samples and on both sides of events, in their order."""
        return with_events(self.data)

    def lane(self, *at: int) -> "Trajectory":
        """One of many runs, as a result of its own; see `Result.lane`."""
        one = super().lane(*at)
        return Trajectory(one.data.assign_coords(time=("time", self.t[at])).drop_vars("t"))

    def plot(self, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Time history, phase portrait, Poincare points and spectrum of a single run, or what contact does.

        Args:
            ax: Draw there, and only the panel named by `panel`.
            options: `panel`: "history", "phase", "poincare", "spectrum", "forces", "ribbon" (states and cases over the
                period), "loop" (friction force over slide) or "path" (where on the face contact acts); `kind` of a
                whole figure: one of these, or a page of the first four ("motion"), of the others ("forces") or of
                "all"; `settled_from`: the share of the run that all panels but the time history leave out; a title,
                xlabel, unit of displacements ("mm", "um", "m" or "gap", for x over the gap), width [mm] and style.

        Raises:
            ValueError: There are many runs, of which `lane` gives one, there is no such panel, or too little is stored
                for it.
        """
        from jaxshroud.results.plot_run import one_panel

        return one_panel(self.data, ax, **options)

    def animate(
        self, path: str | os.PathLike[str], *, periods: int | None = None, factor: float | None = None
    ) -> float:
        """Write the last periods of a single run as a moving picture: both blocks, contact point and forces.

        Args:
            path: A name that ends in .gif, or in .mp4 where ffmpeg is installed.
            periods: Drive periods shown; by default those after which the motion repeats, or four.
            factor: By which motion and gap are exaggerated; by default so that the motion is well seen.

        Returns:
            The factor.

        Raises:
            ValueError: There are many runs, the suffix is another, ffmpeg is missing, or too little is stored.
            WriteError: The place cannot be written.
        """
        from jaxshroud.results.animation import save_animation

        if "status" not in self.data.attrs:
            raise InputError("A moving picture shows one run of many: choose it by `lane`.")
        return save_animation(self.data, path, periods=periods, factor=factor)

    def __repr__(self) -> str:
        if np.ndim(self.status):
            lanes = " x ".join(map(str, np.shape(self.status)))
            return f"Trajectory of {lanes} lanes: {self.t.shape[-1]} samples of each; {self.ended}"
        events = ", ".join(f"{n} {name}" for name, n in self.counters.items() if n) or "none"
        return (
            f"Trajectory: {len(self.t)} samples from {self.t[0]:.4g} to {self.t[-1]:.4g} s; "
            f"{self.ended.split(maxsplit=1)[1]}; events: {events}; energy residual {self.energy_residual:.1e}"
        )
