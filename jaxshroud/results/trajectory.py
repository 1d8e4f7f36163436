"""The samples of simulated runs."""

import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Self, Unpack

import numpy as np

from jaxshroud.io.lane_status import FLAGS
from jaxshroud.io.variable import (
    EVENT_AFTER,
    EVENT_PREFIX,
    Attribute,
    CountsVariable,
    Entry,
    MotionVariable,
    Variable,
    with_events,
)
from jaxshroud.model.modes import Mode
from jaxshroud.results.amplitudes import WithAmplitudes
from jaxshroud.results.base import Result
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.typed import typed

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.prepared import State
    from jaxshroud.plotting.style import LookOptions

MODES = {"flag_values": [int(m) for m in Mode], "flag_meanings": " ".join(m.name for m in Mode)}
CASES = "contact case 1-4 of Sec. 2.3; 5: face to face; 0 when apart"
SAMPLE_BEFORE_EVENT = "sample that the event comes after"
CONTACT_POINT = (
    "where contact acts, up the left block's face from its middle; of flat contact the resultant; NaN when apart"
)


class RunEvents(Variable["Trajectory | None"]):
    """The states at events: all that varies in time once more, under names and a dimension of its own."""

    def entries(self, values: Mapping[str, object], lanes: tuple[str, ...]) -> Iterator[Entry]:  # type: ignore[override]
        """One variable for each field of the states, one for their times, and one for the samples before them."""
        values = dict(values)
        for name, attributes in (
            (f"{EVENT_PREFIX}t", {"units": "s", "long_name": "time"}),
            (EVENT_AFTER, {"long_name": SAMPLE_BEFORE_EVENT}),
        ):
            yield name, (("event",), np.asarray(values.pop(name.removeprefix(EVENT_PREFIX))), attributes)
        for name, value in values.items():
            for entry, (dims, array, attributes) in Trajectory.variables[name].entries(value, lanes):
                yield f"{EVENT_PREFIX}{entry}", (tuple("event" if d == "time" else d for d in dims), array, attributes)

    def among(self, data: "xr.Dataset") -> list[str]:
        """The names with the prefix of events."""
        return [str(name) for name in data.data_vars if str(name).startswith(EVENT_PREFIX)]

    def read(self, data: "xr.Dataset") -> "Trajectory | None":
        """The states at events as a trajectory, or None if they were not kept."""
        if EVENT_AFTER not in data:
            return None
        states = data[self.among(data)].drop_vars(EVENT_AFTER)
        names = {name: str(name).removeprefix(EVENT_PREFIX) for name in states.data_vars}
        states = states.rename(names | {"event": "time"})
        times = ("time", states["t"].to_numpy(), states["t"].attrs)
        return Trajectory(states.assign_coords(time=times).drop_vars("t"))


class Trajectory(WithAmplitudes, Result):
    """The samples of one run or of many, the initial state first: after what happens there at once.

    Arrays start with the axes of the scenes, and those of `motion` end with the blade. A single scene has no leading
    axes, and a plain number for every quantity that each run has one value of.
    """

    stored_as = "trajectory"

    motion = MotionVariable("NaN after the run has stopped", dims=("time",))
    u_s = Variable("slider of the friction element; NaN when apart", "m", ("time",))
    mode = Variable("contact mode", None, ("time",), stored=np.int8, kind=np.int32, more=MODES)
    case = Variable(CASES, None, ("time",), stored=np.int8, kind=np.int32)
    N = Variable("normal force of contact; 0 when apart", "N", ("time",))
    F = Variable("friction force of contact, positive against sliding to larger u; 0 when apart", "N", ("time",))
    v = Variable("penetration at the corner in contact; when apart, negative: the gap left there", "m", ("time",))
    u = Variable("slide of the left block against the right one, up the face", "m", ("time",))
    contact_point = Variable(CONTACT_POINT, "m", ("time",))
    events = RunEvents("states on both sides of every event, the earlier one first; None where they were not kept")
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    counters = CountsVariable("events", prefix="count_")
    energy_residual = Variable("energy residual over the drive's work; NaN without a ledger", "1", alone=True)
    energy_dropped = Variable(
        "energy dropped by beginnings of flat contact, over the drive's gross work", "1", alone=True
    )
    work_drive = Variable("work of the drive over the run", "J", alone=True)
    loss_viscous = Variable("lost in the dampers over the run", "J", alone=True)
    loss_friction = Variable("lost in sliding contact over the run", "J", alone=True)
    time_apart = Variable("fraction of the time of the whole run: apart", "1", alone=True)
    time_stick = Variable("fraction of the time of the whole run: stick", "1", alone=True)
    time_slip = Variable("fraction of the time of the whole run: slip", "1", alone=True)
    omega = Variable("circular frequency of the drive", "rad s-1", alone=True)
    gap = Variable("initial gap", "m", alone=True)
    every = Attribute(int)  # steps from one sample to the next
    turns = Attribute(name="end_turns")  # drive phase of the last sample [turns]

    @property
    def t(self) -> np.ndarray:
        """The time of each sample [s], (..., time)."""
        return self.data["t" if "t" in self.data else "time"].to_numpy()

    @property
    def last(self) -> "State":
        """The state at the last sample, from which a run can go on; the slider is 0 when apart."""
        from jaxshroud.model.prepared import State

        mode, u_s = self.mode[..., -1], self.u_s[..., -1]
        motion = Motion(*(a[..., -1, :] for a in self.motion))
        return State(motion, np.where(mode == Mode.APART, 0, u_s).astype(u_s.dtype), mode, self.case[..., -1])

    def with_events(self) -> "xr.Dataset":
        """All that varies in time, at the samples and on both sides of each event, in order of time."""
        return with_events(self.data)

    @typed
    def lane(self, *at: int) -> Self:
        """One of many runs, as a result of its own; see `Result.lane`."""
        run = super().lane(*at)
        return type(self)(run.data.assign_coords(time=("time", self.t[at])).drop_vars("t"))

    @typed
    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        kind: str | None = None,
        settled_from: float = 0.5,
        **options: "Unpack[LookOptions]",
    ) -> "Figure":
        """Time history, phase portrait, Poincare points and spectrum of a single run, or panels of contact.

        Args:
            ax: Draw one panel there, by default the first.
            panel: Draw only this panel: "history", "phase", "poincare", "spectrum", "forces", "ribbon" (states and
                cases over the period), "loop" (friction force over slide) or "path" (the point of contact on the face).
            kind: The whole figure: one of the panels, or a page of the first four ("motion"), of the others ("forces")
                or of "all".
            settled_from: The share of the run that all panels but the time history leave out as its transient.
            options: The options of `Result.plot`.

        Raises:
            ValueError: There are many runs (`lane` gives one of them), there is no such panel, or too little is stored
                for it.
        """
        from jaxshroud.plotting.pictures import picture

        return picture("trajectory", self.data, ax, panel, kind=kind, settled_from=settled_from, **options)

    @typed
    def animate(
        self, path: str | os.PathLike[str], *, periods: int | None = None, factor: float | None = None
    ) -> float:
        """Write the last periods of a single run as an animation of both blocks, the contact point and the forces.

        Args:
            path: A name that ends in .gif, or in .mp4 where ffmpeg is installed.
            periods: Drive periods shown; by default those after which the motion repeats, or four.
            factor: The factor by which motion and gap are exaggerated; by default so that the motion is well visible.

        Returns:
            The factor.

        Raises:
            ValueError: There are many runs, the suffix is neither, ffmpeg is missing, or too little is stored.
            WriteError: The place cannot be written.
        """
        from jaxshroud.plotting.animation import save_animation

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
