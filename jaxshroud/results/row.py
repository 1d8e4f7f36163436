"""The samples of a simulated row of blades."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from jaxshroud.io.variable import Attribute, CountsVariable, Entry, Variable
from jaxshroud.model.modes import Mode
from jaxshroud.motion.waves import BladeSpectrum, RowWave, blade_spectrum, participation_ratio, row_wave
from jaxshroud.results.trajectory import CASES, CONTACT_POINT, MODES, Trajectory
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.parts import COORDINATES
from jaxshroud.scene.typed import typed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jaxshroud.model.prepared import State
    from jaxshroud.plotting.style import LookOptions

AT_INTERFACES = ("time", "interface")


class InterfaceCounts(CountsVariable):
    """The numbers of events at each interface by name."""

    def entries(self, values: Mapping[str, Any], lanes: tuple[str, ...]) -> Iterator[Entry]:
        """One variable for each counter."""
        for name, (dims, array, attributes) in super().entries(values, lanes):
            yield name, ((*dims, "interface"), array, attributes)


class RowTrajectory(Trajectory):
    """The samples of one run of a row of blades or of many, the initial state first: after what happens there at once.

    Arrays start with the axes of the scenes. `motion` and amplitudes end with the blade; what is told of contact ends
    with the interface: interface j is between blades j and j + 1. Amplitudes are those of the second half of the run.
    """

    stored_as = "row"

    u_s = Variable("slider of the friction element; NaN when apart", "m", AT_INTERFACES)
    mode = Variable("contact mode", None, AT_INTERFACES, stored=np.int8, kind=np.int32, more=MODES)
    case = Variable(CASES, None, AT_INTERFACES, stored=np.int8, kind=np.int32)
    N = Variable("normal force of contact; 0 when apart", "N", AT_INTERFACES)
    F = Variable("friction force of contact, positive against sliding to larger u; 0 when apart", "N", AT_INTERFACES)
    v = Variable("penetration at the corner in contact; when apart, negative: the gap left there", "m", AT_INTERFACES)
    u = Variable("slide of the left block against the right one, up the face", "m", AT_INTERFACES)
    contact_point = Variable(CONTACT_POINT, "m", AT_INTERFACES)
    counters = InterfaceCounts("events", prefix="count_")
    energy_residual = Variable("energy residual of the row over the drive's work", "1", alone=True)
    work_drive = Variable("work of the drive on each blade over the run", "J", ("blade",))
    loss_viscous = Variable("lost in the dampers of each blade over the run", "J", ("blade",))
    loss_friction = Variable("lost in sliding contact at each interface over the run", "J", ("interface",))
    slip = Variable("path of the slider on the face over the run", "m", ("interface",))
    N_mean = Variable("mean normal force over the run, the time apart included", "N", ("interface",))
    N_slip = Variable("mean normal force over the run while the faces slip; NaN if they do not", "N", ("interface",))
    time_apart = Variable("fraction of the time of the whole run: apart", "1", ("interface",))
    time_stick = Variable("fraction of the time of the whole run: stick", "1", ("interface",))
    time_slip = Variable("fraction of the time of the whole run: slip", "1", ("interface",))
    closed = Attribute(int)  # whether the last blade touches the first

    @property
    def last(self) -> "State":
        """The state at the last sample, from which a run can go on; the sliders are 0 when apart."""
        from jaxshroud.model.prepared import State

        mode, u_s = self.mode[..., -1, :], self.u_s[..., -1, :]
        motion = Motion(*(a[..., -1, :] for a in self.motion))
        return State(motion, np.where(mode == Mode.APART, 0, u_s).astype(u_s.dtype), mode, self.case[..., -1, :])

    @typed
    def spectrum(self, name: str = "x", periods: int = 1) -> BladeSpectrum:
        """The motion of the last periods as waves: amplitudes by harmonic and nodal diameter, see `blade_spectrum`.

        Args:
            name: "x", "y" or "theta".
            periods: Drive periods.

        Raises:
            ValueError: The samples do not divide the period, or there are too few.
        """
        return blade_spectrum(getattr(self.motion, name), self._samples_per_period, periods)

    @property
    def wave_distance(self) -> np.ndarray:
        """The share of the motion that is no travelling wave of the drive, (...): 0 to rounding for such a wave.

        It is told over the last whole orbit, without one over the second half of the run, and of x, y and theta for the
        one for which it is the largest; `wave` tells which. NaN where the phases are those of no engine order, the run
        has stopped or nothing moves.
        """
        if "status" in self.data.attrs:
            return np.asarray(self.wave.distance.share)
        lanes = np.shape(self.status)
        return np.array([self.lane(*at).wave.distance.share for at in np.ndindex(lanes)]).reshape(lanes)

    @property
    def wave(self) -> RowWave:
        """How far a single run is from a travelling wave of its drive; its `words` tell it.

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
        from jaxshroud.scene.engine_order import order_of_phases

        return order_of_phases(parse(self.scene, "the scene of this result").scene.drive.phase) if self.scene else None

    @property
    def _repeats(self) -> int:
        """The drive periods after which the motion is known to repeat; 0 where the samples have to tell."""
        return 0

    @property
    def participation_ratio(self) -> np.ndarray:
        """How many blades take part in the motion, of all: 1 if all alike, 1/N if one alone, (...)."""
        return participation_ratio(self.x_rms)

    @property
    def _samples_per_period(self) -> float:
        return self.steps_per_period / self.every

    @typed
    def plot(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        ax: "Axes | None" = None,
        *,
        panel: str | None = None,
        kind: str | None = None,
        **options: "Unpack[LookOptions]",
    ) -> "Figure":
        """The row in time and space: displacements over blades and time, amplitudes, and nodal diameters.

        Args:
            ax: Draw one panel there, by default the first.
            panel: Draw only this panel: "map", "amplitudes" or "diameters".
            kind: The whole figure: "motion", which a row alone has.
            options: The options of `Result.plot`.

        Raises:
            ValueError: There are many runs (`lane` gives one of them), or there is no such panel or figure.
        """
        if kind not in (None, "motion"):
            raise InputError(f"A run of a row has the picture motion, and no {kind}.")
        from jaxshroud.plotting.pictures import picture

        return picture("row", self.data, ax, panel, **options)

    def __repr__(self) -> str:
        kind = "ring" if self.closed else "chain"
        blades = self.data.sizes["blade"]
        return f"RowTrajectory of a {kind} of {blades}: {self.t.shape[-1]} samples; {self.ended}"
