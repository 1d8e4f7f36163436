"""The samples around the events of a row: as many as are counted, and each where its interface says so."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.model.modes import Mode

METHOD = js.RungeKutta("rk4", steps=200)


@pytest.mark.full
def test_the_events_of_a_ring_are_those_that_are_counted():
    ring = js.load("row_ring12", ['parts.motion=["x"]', "row.blades=3", "drive.engine_order=1", "contact.gamma=4"])
    run = js.simulate(ring, n_periods=2, every=20, events=True, method=METHOD)
    data = run.data
    before, after = (data.event_mode.values[side::2] for side in (0, 1))
    v, force = data.event_v.values[::2], data.event_N.values
    onset = (before == Mode.APART) & (after != Mode.APART)
    separation = (before != Mode.APART) & (after == Mode.APART)
    counted = {name: np.sum(count) for name, count in run.counters.items()}
    assert np.sum(onset) == counted["onset_slip"] + counted["onset_stick"] > 0
    assert np.sum(separation) == counted["separation"] > 0
    rubs = (before != after) & ~onset & ~separation
    assert np.sum(rubs) == counted["stick_slip"] + counted["slip_stick"] > 0
    # Contact begins where the penetration is zero to the tolerance of events, and no normal force jumps.
    assert np.abs(v[onset]).max() < 1e-5 * np.abs(v).max()
    assert np.abs(v[~onset]).max() > 0.1 * np.abs(v).max()  # control: elsewhere it is not
    assert np.abs(force[1::2] - force[::2]).max() < 1e-5 * force.max()
    assert np.all(np.diff(data.event_t.values) >= 0)
    # Between samples: what comes before an event is in time before it.
    at = data.event_after.values[::2]
    assert np.all(run.t[at] <= data.event_t.values[::2] + 1e-12)
