"""A run is divided into short calls to the device, also inside a period, and its numbers do not depend on how."""

import jax
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch import limits as pace
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.limits import CallPace
from jaxshroud.batch.tangents import TangentProblem, batched_tangents, direction
from jaxshroud.march.method import explicit

RK4 = js.RungeKutta(steps=100)
ROW = ("row_ring12", ["row.blades=3", "drive.engine_order=1", 'parts.motion=["x"]'])
SCENES = {"pair": ("table1", ['parts.motion=["x"]']), "row": ROW}


def swept(scene):
    return js.sweep(scene, {"shroud.gap": [1e-5, 3e-5]}, n_periods=3, transient=2, method=RK4).data


def simulated(scene):
    return js.simulate(scene, n_periods=2, every=4, method=RK4).data


def tangents(scene):
    one = jax.tree.map(lambda a: a[0], initial_states(jax.tree.map(lambda a: np.asarray(a)[None], scene)))
    problem = TangentProblem(scene, one, [direction(scene, "drive.omega")])
    return batched_tangents([problem], n=2, steps=100, method=as_differentiable(explicit(RK4)[1]))[0]


def numbers(result):
    """All numbers of a result, as bytes."""
    if isinstance(result, tuple):
        return [np.asarray(a).tobytes() for a in jax.tree.leaves(result)]
    return [v.to_numpy().tobytes() for v in result.variables.values() if v.dtype.kind in "fib"]


@pytest.fixture
def fixed_passes(monkeypatch):
    """A function that sets the passes of every call; and how often calls were cut short."""
    cut = []

    def to(passes):
        def timed(self, call, cut_short):
            result = call(np.int32(passes))
            cut.append(bool(cut_short(result)))
            return result

        cut.clear()
        monkeypatch.setattr(CallPace, "timed", timed)
        return cut

    return to


@pytest.mark.full(but=["pair-swept"])
@pytest.mark.parametrize("does", [swept, simulated, tangents])
@pytest.mark.parametrize("name", SCENES)
def test_results_are_the_same_bits_however_long_a_call_is(name, does, fixed_passes):
    source, options = SCENES[name]
    scene, found = js.load(source, options).scene, []
    for passes in (7, 60, 10**6):  # several calls a period, about one, and one for all
        cut = fixed_passes(passes)
        found.append((numbers(does(scene)), sum(cut)))
    (few, often), (some, sometimes), (whole, never) = found
    assert few == some == whole
    assert often > sometimes > never == 0


@pytest.mark.parametrize("seconds", [1e-4, 1e-3, 0.05])
def test_calls_take_the_time_that_is_aimed_at(seconds, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(pace, "perf_counter", lambda: clock[0])
    own, lengths = CallPace(1, seconds=0.3), []

    def call(passes):  # the first one compiles for a minute
        clock[0] += seconds * int(passes) + 60.0 * (not lengths)
        lengths.append(seconds * int(passes))

    for _ in range(20):
        own.timed(call, lambda _: True)
    assert max(lengths) <= 0.3 * (1 + 1e-9)
    assert lengths[-1] > 0.25


def test_a_short_run_teaches_nothing(monkeypatch):
    own = CallPace(1000)
    own.timed(lambda passes: None, lambda _: False)
    assert own.passes == 1000
