"""Tangents of rows of blades through every event of any interface, against differences."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import from_vector, to_vector
from jaxshroud.batch.tangents import direction, run_flow
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.march import row_step as row_event_time
from jaxshroud.march.locate import one_after_the_other
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import TaylorOptions, tableau
from jaxshroud.model.modes import Mode, Status
from jaxshroud.scene.scene import without_given

STEPS, LANES = 100, 4
METHOD = Choices(tableau("dopri8"), "cubic", False)
SERIES = Choices(TaylorOptions(12, 1e-13), "series", False)
KEYS = ("shroud.gap", "row.mistuning[1]", "drive.omega", "friction.mu")
IN_X = ["row.blades=3", 'parts.motion=["x"]']
HEAVY = ["blades.I=2.46e-3", "drive.M_0=30"]  # the article's inertia: a few case switches in a period
ROWS = {
    "ring of 3 in x": ["drive.engine_order=1", *IN_X],
    "chain of 4": ["row.closed=false", "row.blades=4", "drive.engine_order=1", *HEAVY],
    # Blades 0 and 2 move as one, to the last bit, and so do 1 and 3: every event happens at two interfaces at once.
    "ring of 4 in anti-phase": ["row.blades=4", 'drive.phase=["0 deg","180 deg","0 deg","180 deg"]', *HEAVY],
}


class Course:
    """One period of a row from a state with contact, along random directions of the state and of four numbers."""

    def __init__(self, options, method=METHOD):
        file = js.load("row_ring12", options)
        self.scene, self.method = without_given(file.scene), as_differentiable(method)
        run = js.simulate(file.scene, n_periods=3, method=js.RungeKutta("dopri8", steps=STEPS))
        self.start = jax.tree.map(np.asarray, run.last)
        rng, size = np.random.default_rng(0), self.scene.state_size
        self.z, blades = to_vector(self.start), self.scene.row.blades
        scale = np.abs(self.z[: 6 * blades].reshape(6, blades)).max(axis=1)
        self.scale = np.append(np.repeat(np.where(scale > 0, scale, 1.0), blades), np.full(size - 6 * blades, scale[0]))
        self.along = rng.standard_normal((LANES, size)) * np.where(np.abs(self.z) > 0, self.scale, 0.0)
        self.along[:, 6 * blades :] *= self.start.mode == Mode.STICK  # else the mode determines the slider
        by_number = [direction(file.scene, key) for key in KEYS]
        sizes = [1e-5, 1e-2, 5.0, 1e-2]
        self.number = jax.tree.map(lambda *a: np.stack([s * d for s, d in zip(sizes, a, strict=True)]), *by_number)

    def flow(self, step, along=None):
        """The end and the powers of the lanes, `step` along their directions, in their sizes; with their tangents."""
        scenes, none = repeat_lane(self.scene, LANES), np.zeros_like(self.along)
        scenes = jax.tree.map(lambda a, d: a + step * d, scenes, self.number)
        state = lambda z: from_vector(z, None, None, self.scene)
        begin = repeat_lane(self.start, LANES)
        moved = state(self.z + step * self.along)
        begin = type(begin)(moved.motion, moved.u_s, begin.mode, begin.case)
        by = self.number if along is not None else jax.tree.map(np.zeros_like, self.number)
        flows = run_flow(Dual(scenes, by), Dual(begin, state(none if along is None else along)), 1, STEPS, self.method)
        assert np.all(flows.value.status == Status.OK)
        in_sizes = lambda flow: np.concatenate(
            [to_vector(flow.state) / self.scale, flow.power / self.scale[0] ** 2], axis=-1
        )
        return in_sizes(flows.value), in_sizes(flows.tangent)

    def error(self):
        """The largest difference of tangents and fourth-order differences, over the largest tangent, (lanes,)."""
        exact, best = self.flow(0.0, self.along)[1], np.full(LANES, np.inf)
        for h in (1e-4, 1e-5, 1e-6):
            ends = [self.flow(c * h)[0] for c in (-2, -1, 1, 2)]
            slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
            best = np.minimum(best, np.abs(slope - exact).max(axis=1) / np.abs(exact).max(axis=1))
        return best


@pytest.mark.release(only=["chain of 4", "ring of 4 in anti-phase"])
@pytest.mark.full
@pytest.mark.parametrize("name", ROWS)
def test_tangents_are_those_of_differences(name):
    # Differences of fourth order lose some five digits to rounding. Where symmetry makes events simultaneous, one side
    # computes them in another order than the other, which differ by the error of the step.
    assert np.max(Course(ROWS[name]).error()) < (1e-6 if "anti-phase" in name else 1e-8)


@pytest.mark.release(only=["chain of 4"])
@pytest.mark.full
@pytest.mark.parametrize("name", ["chain of 4", "ring of 4 in anti-phase"])
def test_tangents_by_power_series_are_those_of_differences(name):
    # The second of two simultaneous events is that of a trial of no length.
    assert np.max(Course(ROWS[name], SERIES).error()) < (1e-6 if "anti-phase" in name else 1e-8)


@pytest.mark.full
def test_tangents_without_the_instants_of_events_are_wrong(monkeypatch):
    # Control: the instants of events have no derivative, as differentiating through the search would leave it.
    monkeypatch.setattr(row_event_time, "at_event", lambda quantities, *_: quantities)
    naive = METHOD._replace(tableau=METHOD.rk._replace(name="naive"))  # another name: compiled anew
    assert np.min(Course(ROWS["chain of 4"], naive).error()) > 1e-2


def together(*args):
    """The first of the events of an instant, which moves as the first of all does."""
    first, _, left = one_after_the_other(*args)
    return first, args[-1], left


TOGETHER = METHOD._replace(tableau=METHOD.rk._replace(name="together"))  # compiled anew, as an order of its own is


@pytest.mark.release
@pytest.mark.full
@pytest.mark.parametrize(
    ("trial", "naive"),
    [("row_trial", TOGETHER), ("taylor_trial", SERIES._replace(tableau=TaylorOptions(11, 1e-13)))],
    ids=["dopri8", "series"],
)
def test_simultaneous_events_have_instants_of_their_own(trial, naive, monkeypatch):
    # Control: events of one instant that move as the first of them does.
    monkeypatch.setattr(f"jaxshroud.march.{trial}.one_after_the_other", together)
    assert np.median(Course(ROWS["ring of 4 in anti-phase"], naive).error()) > 1e-3
