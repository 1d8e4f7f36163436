"""What users may ask of a picture, and words of pictures."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from test_plot import drawn, gamma_sweep, power, sweep, texts
from test_plot_contact import run

from jaxshroud.results import drawing, plot, plot_power, plot_run
from jaxshroud.results.dimension import about
from jaxshroud.results.drawing import Look
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.results.words import fitting, typeset, wrapped
from jaxshroud.scene.errors import InputError


@pytest.mark.parametrize(
    ("plain", "set_"),
    [
        ("bifurcation diagram of x_1 over gamma", r"bifurcation diagram of $x_{1}$ over $\gamma$"),
        ("P_d, M_0 = 2 N m, v_theta", r"$P_{d}$, $M_{0}$ = 2 N m, $v_{\theta}$"),
        ("I = 2.46e-5 kg m^2", r"I = $2.46 \times 10^{-5}$ kg m$^{2}$"),
        ("my_scene.toml, run_12 of a_long_name", "my_scene.toml, run_12 of a_long_name"),  # names of files are none
        (r"mean of $P_d$ over F_0", r"mean of $P_d$ over $F_{0}$"),
        ("gamma rays, mus", r"$\gamma$ rays, mus"),
    ],
)
def test_symbols_in_words_are_typeset(plain, set_):
    assert typeset(plain) == set_
    drawn(drawing.new_figure(plain, 3, 1))  # mathtext understands it


def test_lines_are_broken_outside_formulas():
    lines = wrapped(typeset("Fig. 9: bifurcation diagram of x_1 over the ratio gamma = 2.5e-3"), 24).split("\n")
    assert len(lines) == 3
    assert all(line.count("$") % 2 == 0 for line in lines)


@pytest.mark.parametrize(
    ("title", "keys", "kept"),
    [
        ("Fig. 9: bifurcation diagram of x_1 over the stiffness ratio gamma", ["contact.gamma"], True),
        ("Fig. 9: bifurcation diagram of x_1 over the stiffness ratio gamma", ["contact.k"], True),  # the same number
        ("Fig. 9: bifurcation diagram of x_1 over the stiffness ratio gamma", ["drive.F_0"], False),
        ("Fig. 9: bifurcation diagram of x_1 over the stiffness ratio gamma", [], False),  # a run is no diagram
        ("Fig. 10b: gamma = 2.5, printed as period 2", ["contact.gamma"], False),
        ("Fig. 10b: gamma = 2.5, printed as period 2", ["drive.F_0", "initial.x[0]"], True),
        ("Fig. 15a: P_d over the number of periods n, gamma = 7, F_0 = 60 N", ["drive.F_0"], False),
        ("m = 0.08 kg, 100 N m", ["blades.m[1]"], False),
        ("100 N m over night", ["blades.m", "made.up"], True),
    ],
)
def test_a_title_that_contradicts_what_is_swept_is_dropped(title, keys, kept):
    assert fitting(title, keys) == (title if kept else "")


def test_a_sweep_of_another_key_has_no_false_title():
    other = sweep({"F_0": (np.array([1.0, 2.0]), "drive.F_0", "N")}, np.full((2, 3), 0.5), [1, 2])
    other.attrs["title"] = "Fig. 10b: F_0 = 60 N"
    assert "Fig. 10b" not in texts(drawn(plot.bifurcation(other)))
    assert "Fig. 9" in texts(drawn(plot.bifurcation(gamma_sweep(5))))


def test_title_label_unit_and_width_are_as_asked(tmp_path):
    look = Look(title="Damping by P_d", xlabel="ratio gamma", unit="um", width=90)
    figure = drawn(plot.bifurcation(gamma_sweep(9), look=look))
    assert figure.get_suptitle() == "Damping by $P_{d}$"
    assert figure.get_figwidth() * 25.4 == pytest.approx(90)
    assert figure.axes[2].get_xlabel() == r"ratio $\gamma$"
    assert figure.axes[0].get_ylabel() == "$x_1$ [µm]"
    gap = sweep({"gap": (np.array([1e-5, 2e-5]), "shroud.gap", "m")}, np.full((2, 3), 0.52), [1, 2])
    panel = drawn(plot.bifurcation(gap, look=look)).axes[2]
    np.testing.assert_allclose(panel.lines[0].get_xdata(), [10, 20])
    assert drawn(plot.bifurcation(gamma_sweep(9), look=Look(title=""))).get_suptitle() == ""


def test_text_stays_text_in_svg(tmp_path):
    drawing.save(plot.bifurcation(gamma_sweep(9)), tmp_path / "a.svg")
    svg = (tmp_path / "a.svg").read_text()
    written = re.sub(r"\s", "", "".join(re.findall(r">([^<>]+)<", svg)))
    assert "stiffnessratio" in written  # beside a formula every letter has its place
    assert ">Fig. 9<" in svg
    assert "DejaVuSans-" not in svg  # no letter is drawn as a shape


def test_a_style_of_ones_own_goes_over_the_packages(tmp_path):
    style = tmp_path / "thesis.mplstyle"
    style.write_text("axes.linewidth: 2.5\nfont.size: 11\n")
    figure = plot_run.trajectory(run(), look=Look(style=style))
    assert figure.axes[0].spines["left"].get_linewidth() == 2.5
    assert plot_run.trajectory(run()).axes[0].spines["left"].get_linewidth() == 0.6
    with pytest.raises(InputError, match="not a style of matplotlib"):
        plot_run.trajectory(run(), look=Look(style=tmp_path / "none.mplstyle"))


@pytest.mark.parametrize("kind", ["motion", "history", "forces", "loop"])
def test_every_axis_has_ticks_at_90_mm(kind):
    figure = drawn(plot_run.picture(run(), kind, look=Look(width=90)))
    for panel in figure.axes:
        for axis in (panel.xaxis, panel.yaxis):
            low, high = sorted(axis.get_view_interval())
            assert sum(low <= at <= high for at in axis.get_majorticklocs()) >= 2 + (axis is panel.xaxis)


def test_a_periodic_lane_has_no_interval_to_name():
    ds = gamma_sweep(9)
    ds["P_d_ci"][:] = 1e-9
    assert "95 %" not in texts(drawn(plot.bifurcation(ds)))
    assert "95 %" in texts(drawn(plot.bifurcation(gamma_sweep(60))))
    data = power() | {"P_d_ci": [0.0] * len(power()["n"])}
    assert "95 %" not in texts(drawn(plot_power.power_convergence(data)))


def test_what_has_settled_is_not_magnified():
    ds = gamma_sweep(9)
    ds["x"][:] = 1e-3 * (1 + 1e-9 * np.arange(9)[:, None, None])
    ds["P_d"][:] = 50 + 1e-9 * np.arange(9)
    samples, _, powers = drawn(plot.bifurcation(ds)).axes
    assert np.ptp(powers.get_ylim()) == pytest.approx(0.1)
    assert np.ptp(samples.get_ylim()) >= 0.01 * np.abs(samples.get_ylim()).max()


def test_one_period_is_one_period():
    figure = drawn(plot_run.trajectory(run(2)))
    assert figure.axes[2].get_title(loc="left") == "Poincaré points of 1 period"


def test_results_take_the_same_words():
    assert drawn(SweepResult(gamma_sweep(9)).plot(title="a", unit="mm")).axes[0].get_ylabel() == "$x_1$ [mm]"
    of = Trajectory(run())
    assert drawn(of.plot(kind="loop", title="b", width=90)).get_suptitle() == "b"
    panel = Figure().subplots()
    of.plot(panel, panel="phase", unit="mm", xlabel="x_1", title="c")
    assert (panel.get_xlabel(), panel.get_title(), panel.get_ylabel()) == ("$x_{1}$", "c", "$v_{x1}$ [m/s]")
    for wrong, told in (({"width": 90}, "belongs to the figure"), ({"unit": "km"}, "unit")):
        with pytest.raises(InputError, match=told):
            of.plot(panel, **wrong)
    with pytest.raises(InputError, match="several x axes"):
        of.plot(xlabel="time")
    with pytest.raises(InputError, match="only where it is positive"):
        plot.bifurcation(gamma_sweep(5, gap=-1e-5), look=Look(unit="gap"))


def test_numbers_of_a_scene_are_named_as_quantities():
    assert about("initial.v_x[0]")["long_name"] == "initial velocity, left blade $v_x(0)$"
    assert about("drive.F_0") == {"key": "drive.F_0", "units": "N", "long_name": "force amplitude $F_0$"}
