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
from jaxshroud.results.amplitudes import OF_MODES, WithAmplitudes
from jaxshroud.results.base import Result
from jaxshroud.scene.checks import InputError, count_argument, word_argument
from jaxshroud.scene.layout import COORDINATES
from jaxshroud.scene.typed import typed
from jaxshroud.signals.waves import BladeSpectrum, RowWave, blade_spectrum, participation_ratio, row_wave

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.prepared import State
    from jaxshroud.plotting.style import AppearanceOptions

MODES = {"flag_values": [int(m) for m in Mode], "flag_meanings": " ".join(m.name for m in Mode)}
CASES = "contact case 1-4 of Sec. 2.3; 5: face to face; 0 when apart"
SAMPLE_BEFORE_EVENT = "sample that the event comes after"
CONTACT_POINT = (
    "where contact acts, up the left block's face from its middle; of flat contact the resultant; NaN when apart"
)
OF_CONTACT = ("time", "interface")  # the dimensions of quantities of contact
OF_POINTS = (*OF_CONTACT, "point")  # of quantities of each point of contact, from the lower end of the face up


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

    Arrays start with the axes of the scenes, and those of `motion` end with the blade. In a row of blades what is known
    of contact ends with the interface: interface j is between blades j and j + 1. A single scene has no leading axes,
    and a plain number for every quantity that each run has one value of. Amplitudes are those of the second half of
    the run.
    """

    stored_as = "trajectory"

    motion = MotionVariable("NaN after the run has stopped", dims=("time",))
    u_s = Variable("slider of the friction element; NaN when apart", "m", OF_CONTACT)
    mode = Variable("contact mode", None, OF_CONTACT, stored=np.int8, kind=np.int32, more=MODES)
    case = Variable(CASES, None, OF_CONTACT, stored=np.int8, kind=np.int32)
    N = Variable("normal force of contact; 0 when apart", "N", OF_CONTACT)
    F = Variable("friction force of contact, positive against sliding to larger u; 0 when apart", "N", OF_CONTACT)
    v = Variable("penetration at the corner in contact; when apart, negative: the gap left there", "m", OF_CONTACT)
    u = Variable("slide of the left block against the right one, up the face", "m", OF_CONTACT)
    contact_point = Variable(CONTACT_POINT, "m", OF_CONTACT)
    point_mode = Variable("contact mode of each point", None, OF_POINTS, stored=np.int8, kind=np.int32, more=MODES)
    point_u_s = Variable("slider of each point; NaN when apart", "m", OF_POINTS)
    point_v = Variable("penetration at each point; when apart, negative: the gap left there", "m", OF_POINTS)
    point_N = Variable("normal force at each point; 0 when apart", "N", OF_POINTS)
    point_F = Variable("friction force at each point; 0 when apart", "N", OF_POINTS)
    events = RunEvents("states on both sides of every event, the earlier one first; None where they were not kept")
    status = Variable("how the run ended", alone=True, kind=int, more=FLAGS)
    counters = CountsVariable("events", prefix="count_", dims=("interface",))
    energy_residual = Variable("energy residual over the drive's work; NaN without a ledger", "1", alone=True)
    energy_dropped = Variable(
        "energy dropped by beginnings of flat contact, over the drive's gross work", "1", alone=True
    )
    work_drive = Variable("work of the drive over the run", "J", alone=True)
    loss_viscous = Variable("lost in the dampers over the run", "J", alone=True)
    loss_friction = Variable("lost in sliding contact over the run", "J", ("interface",), alone=True)
    blade_work_drive = Variable("work of the drive on each blade over the run; in rows only", "J", ("blade",))
    blade_loss_viscous = Variable("lost in the dampers of each blade over the run; in rows only", "J", ("blade",))
    slip = Variable("path of the slider on the face in a drive period, on average", "m", ("interface",), alone=True)
    N_mean = Variable("mean normal force over the run, the time apart included", "N", ("interface",), alone=True)
    N_slip = Variable(
        "mean normal force over the run while the faces slip; NaN if they do not", "N", ("interface",), alone=True
    )
    time_apart = Variable("fraction of the time of the whole run: apart", "1", ("interface",), alone=True)
    time_stick = Variable("fraction of the time of the whole run: stick", "1", ("interface",), alone=True)
    time_slip = Variable("fraction of the time of the whole run: slip", "1", ("interface",), alone=True)
    modal = Variable("coordinates of modes and their rates at the last step", None, OF_MODES)
    omega = Variable("circular frequency of the drive", "rad s-1", alone=True)
    gap = Variable("initial gap", "m", ("interface",), alone=True)
    every = Attribute(int)  # steps from one sample to the next
    turns = Attribute(name="end_turns")  # drive phase of the last sample [turns]

    @property
    def t(self) -> np.ndarray:
        """The time of each sample [s], (..., time)."""
        return self.data["t" if "t" in self.data else "time"].to_numpy()

    @property
    def last(self) -> "State":
        """The state at the last sample, from which a run can go on; the slider is 0 when apart."""
        from jaxshroud.batch.lanes import modal_motion
        from jaxshroud.model.prepared import State

        end = type(self)(self.data.isel(time=-1))
        mode, slider = (end.mode, end.u_s) if end.point_mode is None else (end.point_mode, end.point_u_s)
        u_s = np.where(mode == Mode.APART, 0, slider).astype(slider.dtype)
        return State(end.motion if end.modal is None else modal_motion(end.modal), u_s, mode, end.case)

    @property
    def closed(self) -> bool:
        """Whether the last blade touches the first."""
        return self.data.sizes.get("interface", 1) == self.data.sizes["blade"]

    @typed
    def spectrum(self, name: str = "x", periods: int = 1) -> BladeSpectrum:
        """The motion of the last periods as waves: amplitudes by harmonic and nodal diameter, see `blade_spectrum`.

        Args:
            name: "x", "y" or "theta".
            periods: Drive periods.

        Raises:
            ValueError: There is no such displacement, the samples do not divide the period, or there are too few.
        """
        word_argument("name", name, COORDINATES)
        count_argument("periods", periods, 1)
        return blade_spectrum(getattr(self.motion, name), self._samples_per_period, periods)

    @property
    def wave_distance(self) -> np.ndarray:
        """The share of the motion that is no travelling wave of the drive, (...): 0 to rounding for such a wave.

        It is measured over the last whole orbit, without one over the second half of the run, and of x, y and theta for
        the one for which it is the largest; `wave` says which. NaN where the phases are those of no engine order, or
        the run has stopped, or nothing moves.
        """
        if "status" in self.data.attrs:
            return np.asarray(self.wave.distance.share)
        lanes = np.shape(self.status)
        return np.array([self.lane(*at).wave.distance.share for at in np.ndindex(lanes)]).reshape(lanes)

    @property
    def wave(self) -> RowWave:
        """How far a single run is from a travelling wave of its drive; its `words` say it.

        Raises:
            ValueError: There are many runs.
        """
        if "status" not in self.data.attrs:
            raise InputError("`wave` is that of one run of many: choose it by `lane`.")
        motion = {name: getattr(self.motion, name) for name in COORDINATES}
        return row_wave(motion, self._samples_per_period, self._order, self._repeats)

    @property
    def _order(self) -> int | None:
        """The engine order modulo N of a single run, by the phases of its scene; None where there is none."""
        from jaxshroud.scene.config import parse
        from jaxshroud.scene.drive_orders import order_of_drive

        named = ["parts.contact=spring"] * ('contact = "own"' in self.scene)  # for a law that no file can name
        return order_of_drive(parse(self.scene, "the scene of this result", named).scene.drive) if self.scene else None

    @property
    def _repeats(self) -> int:
        """The drive periods after which the motion is known to repeat; 0 where the samples have to show it."""
        return 0

    @property
    def participation_ratio(self) -> np.ndarray:
        """How many blades take part in the motion, of all: 1 if all alike, 1/N if one alone, (...)."""
        return participation_ratio(self.x_rms)

    @property
    def _samples_per_period(self) -> float:
        return self.steps_per_period / self.every

    def with_events(self) -> "xr.Dataset":
        """All that varies in time, at the samples and on both sides of each event, in order of time."""
        return with_events(self.data)

    @typed
    def lane(self, *at: int) -> Self:
        """One of many runs, as a result of its own; see `Result.lane`."""
        run = super().lane(*at)
        return type(self)(run.data.assign_coords(time=("time", self.t[at])).drop_vars("t"))

    def _drawn(self) -> tuple[str, object]:
        return "trajectory", self.data

    @typed
    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        over: "Result | None" = None,
        kind: str | None = None,
        settled_from: float = 0.5,
        **options: "Unpack[AppearanceOptions]",
    ) -> "Figure":
        """Time history, phase portrait, Poincare points and spectrum of a single run, or panels of contact.

        Of a row the displacements over blades and time, amplitudes, and nodal diameters.

        Args:
            ax: Draw one panel there, by default the first.
            panel: Draw only this panel: "history", "phase", "poincare", "spectrum", "forces", "ribbon" (states and
                cases over the period), "loop" (friction force over slide) or "path" (the point of contact on the face);
                of rows "map", "amplitudes" or "diameters".
            over: Another run, drawn behind this one in grey.
            kind: The whole figure: one of the panels, or a page of the first four ("motion"), of the contact ("forces")
                or of all these ("all"); of a row "motion" has the last three.
            settled_from: The share of the run that all panels but the time history leave out as its transient.
            options: The options of `Result.plot`.

        Raises:
            ValueError: There are many runs (`lane` gives one of them), there is no such panel, or too little is stored
                for it.
        """
        return super().plot(ax, panel=panel, over=over, kind=kind, settled_from=settled_from, **options)

    @typed
    def animate(
        self,
        path: str | os.PathLike[str],
        *,
        periods: int | None = None,
        factor: float | None = None,
        dpi: int = 150,
    ) -> float:
        """Write the last periods of a single run as an animation of both blocks, the contact point and the forces.

        Args:
            path: A name that ends in .gif, or in .mp4 where ffmpeg is installed.
            periods: Drive periods shown; by default those after which the motion repeats, or four.
            factor: The factor by which motion and gap are exaggerated; by default so that the motion is well visible.
            dpi: Dots per inch.

        Returns:
            The factor.

        Raises:
            ValueError: There are many runs, the suffix is neither, ffmpeg is missing, or too little is stored.
            WriteError: The place cannot be written.
        """
        from jaxshroud.plotting.animation import save_animation

        if "status" not in self.data.attrs:
            raise InputError("A moving picture shows one run of many: choose it by `lane`.")
        return save_animation(self.data, path, periods=periods, factor=factor, dpi=dpi)

    def __repr__(self) -> str:
        if np.ndim(self.status):
            lanes = " x ".join(map(str, np.shape(self.status)))
            return f"Trajectory of {lanes} lanes: {self.t.shape[-1]} samples of each; {self.ended}"
        counts = {name: np.sum(n) for name, n in self.counters.items()}
        events = ", ".join(f"{n} {name}" for name, n in counts.items() if n) or "none"
        return (
            f"Trajectory: {len(self.t)} samples from {self.t[0]:.4g} to {self.t[-1]:.4g} s; "
            f"{self.ended.split(maxsplit=1)[1]}; events: {events}; energy residual {self.energy_residual:.1e}"
        )
