"""Amplitudes, loads and impacts of single periods against the second opinion, which integrates them otherwise."""

import load_opinions
import numpy as np
import pytest
from side_by_side import run, scene_of

from jaxshroud.batch.periods import Sample
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import TaylorOptions, tableau

pytestmark = pytest.mark.full

RK4 = Choices(tableau("rk4"), "cubic", forces=True, amplitudes=True)
MARCHES = {
    "rk4": (RK4, 10000),
    "dopri8": (RK4._replace(tableau=tableau("dopri8")), 4000),
    "series": (RK4._replace(tableau=TaylorOptions(12, 1e-11), locate="series"), 2000),
    "unlocated": (RK4._replace(locate="none"), 2000),
}


def tallied(samples: Sample) -> dict[str, np.ndarray]:
    """The numbers of each period (lanes, periods, ...) by the names of the opinions."""
    columns = lambda displacements: np.concatenate(displacements, axis=-1)
    return {
        **{name: columns(getattr(samples.moments, name)) for name in ("first", "second")},
        **{name: columns(getattr(samples.extent, name)) for name in ("highest", "lowest")},
        "loads": columns(samples.loads),
        "impacts": columns([getattr(samples.impacts, name) for name in load_opinions.IMPACTS]),
        "friction": samples.friction[..., 0],
    }


def sizes(told: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The largest value of each number over the periods of its scene."""
    size = {name: np.abs(a).max(axis=1, keepdims=True) for name, a in told.items()}
    extent, omega = np.maximum(size["highest"], size["lowest"]), np.array([p.omega for p in load_opinions.scenes()])
    size |= {"highest": extent, "lowest": extent, "first": extent * 2 * np.pi / omega[:, None, None]}
    return {name: np.where(a > 0, a, 1.0) for name, a in size.items()}


def errors(name: str) -> dict[str, np.ndarray]:
    """The largest error of each kind of number in each scene, relative to its size."""
    (method, steps), told = MARCHES[name], load_opinions.kept()
    runs = run([scene_of(p) for p in load_opinions.scenes()], load_opinions.PERIODS, steps, method)
    count, size = len(runs.last.status), sizes(told)
    assert not np.any(runs.last.status)
    return {
        kind: (np.abs(a - told[kind]) / size[kind]).reshape(count, -1).max(axis=1)
        for kind, a in tallied(runs.samples).items()
    }


@pytest.mark.release(only=["dopri8"])
@pytest.mark.parametrize("name", ["rk4", "dopri8", "series"])
def test_each_period_is_that_of_the_second_opinion(name):
    # Three periods from rest. The opinion reads extremes off parabolas, to 3e-7; RK4 locates events to some 1e-7.
    for kind, error in errors(name).items():
        assert np.all(error < 1e-6), (kind, error)
        if name == "series" and kind not in ("highest", "lowest"):
            assert np.all(error < 1e-8), (kind, error)


def test_unlocated_events_are_told_apart():
    # Control: with events at ends of steps every number that contact decides is wrong by a thousand tolerances.
    error = errors("unlocated")
    for kind in ("loads", "impacts", "friction"):
        assert np.median(error[kind]) > 1e-3, (kind, error[kind])


def test_opinions_in_the_file_are_those_of_the_reference():
    parameters, told = load_opinions.scenes(), load_opinions.kept()
    for i in (0, load_opinions.RANDOM):
        for name, a in load_opinions.opinion(parameters[i]).items():
            np.testing.assert_allclose(told[name][i], a, rtol=0, atol=1e-8 * np.abs(a).max(), err_msg=name)
