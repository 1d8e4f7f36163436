"""Energy of a state, and what the balance of works and jumps misses."""

from jaxshroud.march.events import seat
from jaxshroud.march.lane import Jumps, Lanes
from jaxshroud.model.absent import Scalar
from jaxshroud.model.friction import contact_energy, stretch
from jaxshroud.model.ready import Model
from jaxshroud.model.rhs import Ledger, stored_energy
from jaxshroud.model.state import State


def energy(state: State, model: Model) -> Scalar:
    """Kinetic energy, blades' springs and contact springs [J]."""
    at = seat(state.motion, state, model)[2]
    w = stretch(at.v, at.u, state.u_s, state.mode, model.spring)
    return stored_energy(state.motion, model) + contact_energy(at.v, w, state.mode, model.spring)


def balance(ledger: Ledger, jumps: Jumps, stored: Lanes) -> Lanes:
    """What the energy balance misses [J]: works and jumps less the change of the `stored` energy."""
    return ledger.drive + jumps.springs - jumps.dropped - ledger.viscous - ledger.friction - stored
