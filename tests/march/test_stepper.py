"""What every stepper keeps: lanes march alone as beside others, and a lane that has arrived stays as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.lanes import carried_state
from jaxshroud.batch.xla import vmapped
from jaxshroud.march.carry import Fixed, time_grid
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.stepper import stepper_for
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.model.prepared import initial_state
from jaxshroud.model.row import alone, prepared_row

METHODS = {"rk4": FAST, "power series": Choices(TaylorOptions(4, 1e-4), "series", False)}
STEPS, TRIALS, GAPS = 40, 60, np.array([1e-5, 3e-5])


def lane_and_constants(gap, method, stop):
    """A lane at its start, and its constants."""
    scene = js.vary(js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"']).scene, "shroud.gap", gap)
    model, grid = prepared_row(scene), time_grid(jnp.zeros_like(gap), jnp.full_like(gap, STEPS), scene.drive.period)
    start = carried_state(initial_state(scene.initial), model)
    return stepper_for(method).begin(start, model, method, alone), Fixed(model, grid, stop)


def after_trials(gaps, stop, method, each):
    """Lanes (leading axis, or one alone) after some trials, that march to the start of step `stop`."""
    stepper = stepper_for(method)

    def one(_, lanes):
        return stepper.trial(lanes, fixed, method, each)

    lanes, fixed = each(lambda gap: lane_and_constants(gap, method, stop), gaps)
    return jax.lax.fori_loop(0, TRIALS, one, lanes)


@pytest.fixture(scope="module", params=METHODS)
def method(request):
    return METHODS[request.param]


@pytest.fixture(scope="module")
def marched_alone(method):
    """The march of one lane as one program."""
    return jax.jit(lambda gap, stop: after_trials(gap, stop, method, alone))


@pytest.mark.full
def test_a_lane_marches_alone_as_beside_others(method, marched_alone):
    # The same operations in two programs: to rounding, which 60 trials and some impacts multiply.
    beside = jax.jit(lambda gaps: after_trials(gaps, jnp.int32(STEPS), method, vmapped))(GAPS)
    assert (beside.accumulator.log.counters.onset_slip[0] > 0).any()  # control: they have met events
    for i, gap in enumerate(GAPS):
        lane = marched_alone(gap, np.int32(STEPS))
        close = lambda a, b, i=i: np.testing.assert_allclose(b[i], a, rtol=1e-9, atol=1e-13)
        jax.tree.map(close, lane.state, beside.state)
        assert lane.step == beside.step[i]


@pytest.mark.full(but=["rk4"])
def test_a_lane_that_has_arrived_stays_as_it_is(method, marched_alone):
    begun = jax.jit(lambda gap: lane_and_constants(gap, method, jnp.int32(0))[0])(GAPS[0])
    jax.tree.map(np.testing.assert_array_equal, marched_alone(GAPS[0], np.int32(0)), begun)
