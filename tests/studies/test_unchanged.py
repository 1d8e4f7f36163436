"""A seeded sample of the study of unchanged numbers."""

import numpy as np
import pytest
import unchanged
from reference_runs import runs

# The runs are asked for in the words of the version that stored them.
pytestmark = [pytest.mark.studies, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
GROUPS, SAMPLE = ("map, rk4, cubic, float64", "analysis"), 6  # which share one program


@pytest.fixture(scope="module")
def sample():
    """Some of the runs that do not graze."""
    kept, random = unchanged.stored().grazing, np.random.default_rng(1)
    known = {group: [run for run in runs() if run.group == group and run.path not in kept] for group in GROUPS}
    return [of[i] for of in known.values() for i in random.choice(len(of), SAMPLE, replace=False)]


def test_runs_are_as_they_were(sample):
    for group in unchanged.compare(sample, 0.0):
        assert group["passed"], group["failed"]


@pytest.mark.parametrize(("moved", "fails"), [(4 * np.finfo(float).eps, False), (1e-9, True)])
def test_a_change_is_told_from_rounding(sample, moved, fails):
    maps = [run for run in sample if run.group == GROUPS[0]]
    (told,) = unchanged.compare(maps, moved)
    assert bool(told["failed"]) == fails, told["failed"]
    if fails:
        assert len(told["failed"]) == SAMPLE


def test_every_kind_of_change_is_told():
    a, size = np.array([[1.0, -2.0], [0.0, np.nan]]), None
    for b in (a + 1e-9, np.zeros_like(a), a.astype(np.float32), a[:1]):
        assert unchanged.difference("motion", b, a, size) > 1e-10
    assert unchanged.difference("motion", a, a, size) == 0
    assert unchanged.difference("events", np.array([1, 2]), np.array([1, 3]), size) == np.inf
    assert unchanged.difference("P_d interval", np.array([[1.0], [0.1]]), np.array([[1.3], [0.1]]), size) > 1
    assert unchanged.difference("P_d interval", np.array([[1.0], [0.2]]), np.array([[1.3], [0.2]]), size) < 1
