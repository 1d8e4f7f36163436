"""Pictures of tunings and scatters: they show what is told."""

import numpy as np
import pytest
import xarray as xr
from test_plot import drawing, entries

OVER = {"shroud.gap": [1e-5, 4e-5], "contact.gamma": [1.0, 4.0]}
GRID = {"first": [1e-5, 4e-5], "second": [1.0, 4.0], "objective": [[40.0, 41.0], [42.0, 43.0]]}


def tuning(**other):
    """Two paths of two updates, the second the best, and two rounds of samples around its end."""
    ends = [[[1e-5, 1.0], [2e-5, 2.0]], [[1e-5, 1.1], [2e-5, 2.5]], [[1e-5, 1.2], [2e-5, 3.0]]]
    told = {"title": "a tuning", "goal": "mean", "over": OVER, "points": ends, "map": None}
    told |= {"scores": [[40.0, 45.0], [41.0, 46.0], [42.0, 47.0]], "design": {"shroud.gap": 3e-5, "contact.gamma": 3.5}}
    return {**told, "polished": [[2e-5, 3.0], [3e-5, 3.5]], "polished_scores": [47.0, 48.5], **other}


def last_points(panel):
    return [line.get_xydata()[-1].tolist() for line in panel.lines]


@pytest.mark.parametrize("grid", [None, GRID], ids=["keys", "map"])
def test_a_tuning_is_drawn_to_the_design_and_the_objective_told(grid):
    left, right = drawing("tuned", tuning(map=grid)).axes[:2]
    assert [4.0, 48.5] in last_points(right)  # two updates, then two rounds
    ends = np.log([3, 3.5]) / np.log(4)  # places between the bounds
    wanted = [pytest.approx([4.0, end]) for end in ends] if grid is None else [pytest.approx([0.03, 3.5])]
    for end in wanted:
        assert end in [one for one, line in zip(last_points(left), left.lines, strict=True) if line.get_marker() != "*"]


def test_a_tuning_of_one_number_is_drawn_over_its_values():
    gap, told = {"shroud.gap": [-1e-5, 4e-5]}, {"points": [[[2e-5]]], "scores": [[40.0]]}
    scan = {"scanned": [[0.0], [3e-5], [1e-5]], "scanned_scores": [10.0, 30.0, 20.0], "scanned_ci": [1.0, np.nan, 2.0]}
    best = {"design": {"shroud.gap": 2.5e-5}, "best_between": {"shroud.gap": (2e-5, 3e-5)}}
    rounds = {"polished": [[2.5e-5]], "polished_scores": [42.0]}
    (panel,) = drawing("tuned", tuning(over=gap, **told, **scan, **best, **rounds)).axes
    values, *_ = panel.containers[0]
    np.testing.assert_allclose(values.get_xydata(), [[0.0, 10.0], [0.01, 20.0], [0.03, 30.0]])
    assert pytest.approx([0.025, 42.0]) in last_points(panel)
    assert entries(panel.figure.legends[0])[0] == "scan, with 95 % intervals"


def scattered(low, high):
    """A scatter of two numbers with intervals of the shares that they have alone; in all they lie between 0 and 1."""
    keys = {"first": [0.05, 0.9], "first_low": low, "first_high": high}
    keys |= {"total": [0.1, 0.9], "total_low": [0.05, 0.8], "total_high": [0.2, 0.95]}
    data = {name: ("key", np.array(value)) for name, value in keys.items()}
    return xr.Dataset({**data, "P_d": ("draw", np.linspace(30.0, 40.0, 16))}, {"key": list(OVER)}, {"title": ""})


def test_intervals_of_shares_that_leave_0_to_1_are_cut_and_marked():
    figure = drawing("scatter", scattered([-0.1, 0.8], [0.2, 1.2]))
    shares = figure.axes[1]
    assert shares.get_xlim() == (0, 1)
    marks = {line.get_marker(): line.get_xydata().tolist() for line in shares.lines if line.get_marker() in "<>"}
    assert marks == {"<": [[0.0, -0.18]], ">": [[1.0, pytest.approx(0.82)]]}
    told = entries(figure.legends[0])
    assert {"95 % interval goes below 0", "95 % interval goes above 1"} <= set(told)
    for x in np.concatenate([one.get_segments() for one in shares.collections])[..., 0]:
        assert np.all((x >= 0) & (x <= 1))


def test_intervals_of_shares_within_0_to_1_have_no_mark():
    figure = drawing("scatter", scattered([0.0, 0.8], [0.2, 1.0]))
    assert not [one for one in entries(figure.legends[0]) if "95 %" in one]
