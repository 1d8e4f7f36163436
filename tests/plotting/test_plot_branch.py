"""Pictures of branches: every orbit is drawn once."""

import numpy as np
import xarray as xr
from test_plot import drawing, drawn, entries

from jaxshroud.model.modes import BIFURCATION_KINDS
from jaxshroud.plotting.pictures import picture
from jaxshroud.plotting.plot_branch import MARKERS
from jaxshroud.plotting.style import BLUE


def branch_of(samples, gamma, stable=False, kind=None, gap=1e-5):
    """A stored branch: samples (points, q) [m] of x_1 over gamma."""
    n, q = samples.shape
    x = np.zeros((n, q, 6))
    x[:, :, 0] = samples
    whole = {"q": np.full(n, q), "branch": np.zeros(n, int), "stable": np.full(n, stable), "P_d": 40 + gamma}
    whole |= {"kind": np.zeros(n, int) if kind is None else kind, "slider_is_free": np.zeros(n, bool)}
    whole |= {"gap": np.broadcast_to(gap, n), "value": gamma}
    data = {name: ("point", value) for name, value in whole.items()}
    data["samples"] = ("point", "turn", "displacement"), x
    data |= {f"multipliers_{part}": (("point", "multiplier"), np.full((n, 13), 0.5)) for part in ("real", "imag")}
    made = xr.Dataset(data, attrs={"title": ""})
    made["value"].attrs |= {"key": "contact.gamma", "units": "1"}
    return made


def around(n, turns):
    """A branch of period 2 that leaves a flip; half a turn on its two samples change places."""
    phase = np.linspace(0.05, 2 * np.pi * turns - 0.05, n)
    return 1e-5 * np.stack([np.sin(phase), -np.sin(phase)], axis=-1), 3 - np.cos(phase)


def lengths(figure):
    """Of the lines drawn in each panel, without marks and the unit circle's line."""
    lines = [[line.get_xydata() for line in panel.lines if line.get_color() == BLUE] for panel in figure.axes]
    return [sum(np.nansum(np.linalg.norm(np.diff(one, axis=0), axis=1)) for one in panel) for panel in lines]


def test_a_loop_that_the_branch_passes_twice_is_drawn_once():
    # Dashes over other dashes appearance solid, that is stable. Pieces at the turn are drawn twice: 2 of 100.
    once, twice = (picture("branch", branch_of(*around(n, turns))) for n, turns in ((100, 0.5), (200, 1.0)))
    np.testing.assert_allclose(lengths(drawn(twice)), lengths(drawn(once)), rtol=0.03)


def test_orbits_that_differ_are_all_drawn():
    # Control: the same way back with the second sample a tenth higher is another orbit.
    samples, gamma = around(200, 1.0)
    samples[100:, 1] += 1e-6
    once = lengths(drawing("branch", branch_of(*around(100, 0.5))))
    assert lengths(drawing("branch", branch_of(samples, gamma)))[0] > 1.9 * once[0]


def test_marks_of_a_loop_are_drawn_once():
    samples, gamma = around(201, 1.0)
    kind = np.zeros(201, int)
    kind[[50, 150]] = BIFURCATION_KINDS.index("fold")
    panel = drawing("branch", branch_of(samples, gamma, kind=kind)).axes[0]
    marks = [line.get_xydata() for line in panel.lines if line.get_marker() == MARKERS["fold"][0]]
    assert sum(np.isfinite(one[:, 1]).sum() for one in marks) == 2  # one for each sample


def test_the_legend_names_marks_that_are_seen():
    samples, gamma = around(201, 1.0)
    kind = np.zeros(201, int)
    kind[50], kind[150] = BIFURCATION_KINDS.index("fold"), BIFURCATION_KINDS.index("jump")
    figure = drawing("branch", branch_of(samples, gamma, kind=kind))
    assert entries(figure.legends[0]) == ["unstable", "fold"]


def test_a_branch_along_the_gap_is_not_divided_by_it():
    gap = np.linspace(1e-5, 2e-5, 20)
    ds = branch_of(np.full((20, 1), 1e-5), gap, gap=gap)
    ds["value"].attrs |= {"key": "shroud.gap", "units": "m"}
    panel = drawing("branch", ds).axes[0]
    assert panel.get_ylabel() == "$x_1$ [mm]"
    np.testing.assert_allclose(panel.lines[0].get_ydata(), 0.01)
