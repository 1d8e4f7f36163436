"""What a simulation gives."""

from typing import Any, NamedTuple

from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion


class Trajectory(NamedTuple):
    """Samples of one run, the initial state first; one value per blade in the last dimension of `motion`."""

    t: Any  # (n,) [s]
    motion: Motion  # (n, 2); NaN after the run has stopped
    u_s: Any  # (n,) slider [m]; NaN when apart
    mode: Any  # (n,) see `Mode`
    case: Any  # (n,) 1-4, 5 in flat contact; 0 when apart
    status: Any  # () see `Status`
    counters: dict[str, int]
    energy_residual: float  # relative to the drive's work; NaN where the method keeps no ledger
    last: State  # to go on from; at the last sample
    turns: float  # drive phase of the last sample [turns]
    energy_dropped: float = 0.0  # by beginnings of flat contact, relative to the drive's gross work; NaN likewise
    chatter: str | None = None  # what alternated where the run stopped with TOO_MANY_EVENTS

    def __repr__(self) -> str:
        events = ", ".join(f"{n} {name}" for name, n in self.counters.items() if n) or "none"
        return (
            f"Trajectory: {len(self.t)} samples from {self.t[0]:.4g} to {self.t[-1]:.4g} s; "
            f"{Status(self.status).name}; events: {events}; energy residual {self.energy_residual:.1e}"
        )
