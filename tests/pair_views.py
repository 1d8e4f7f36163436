"""How a pair is seen by the march, for tests: its right-hand side and its guards at a state of users."""

import jax.numpy as jnp

from jaxshroud.batch.lanes import carried_state
from jaxshroud.march.events import GuardEvaluation
from jaxshroud.march.row_events import interface_view, row_torques
from jaxshroud.model.prepared import Model, State
from jaxshroud.model.rhs import Recorded, StateDerivative
from jaxshroud.model.row import RowModel, alone, at_only_interface, clusters_of, row_rhs

STILL = (jnp.asarray(0.0), jnp.asarray(0.0))  # (sin, cos) of omega t: no drive


def contact_of(row: RowModel) -> Model:
    """The contact of a pair."""
    return at_only_interface(row.interfaces)


def rates_in(state: State, row: RowModel, wave=STILL) -> StateDerivative:
    """The derivative of the state of a pair."""
    now = carried_state(state, row)
    return row_rhs(wave, now, clusters_of(now, row), row, Recorded(), alone)[0]


def view_in(state: State, row: RowModel, wave=STILL) -> GuardEvaluation:
    """The kinematics of contact and the guards of a pair."""
    torque, _ = row_torques(carried_state(state, row), wave, row, alone)
    return interface_view(at_only_interface(torque), state, contact_of(row))
