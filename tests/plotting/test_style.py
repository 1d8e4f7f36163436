"""What users may ask of a picture, and words of pictures."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from test_plot import drawing, drawn, gamma_sweep, grid_sweep, power, sweep, texts
from test_plot_contact import run

from jaxshroud.io.scene_numbers import key_attrs
from jaxshroud.plotting.pictures import picture
from jaxshroud.plotting.style import fitting_title, new_figure, save_figure, typeset, wrapped
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import load, parse

pytestmark = pytest.mark.full

FIG9 = "Fig. 9: bifurcation diagram of x_1 over the stiffness ratio gamma"
BOTH = ("x_1", "P_d")


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
    drawn(new_figure(plain, 3, 1))  # mathtext understands it


def test_lines_are_broken_outside_formulas():
    lines = wrapped(typeset("Fig. 9: bifurcation diagram of x_1 over the ratio gamma = 2.5e-3"), 24).split("\n")
    assert len(lines) == 3
    assert all(line.count("$") % 2 == 0 for line in lines)


@pytest.mark.parametrize(
    ("title", "keys", "shows", "true"),
    [
        (FIG9, ["contact.gamma"], BOTH, FIG9),
        (FIG9, ["contact.k"], BOTH, FIG9),  # the same number
        (FIG9, ["drive.F_0"], BOTH, "Scene of Fig. 9"),
        (FIG9, ["contact.gamma"], ["P_d"], "Scene of Fig. 9"),  # no diagram of x_1
        (FIG9, ["contact.gamma", "shroud.gap"], [], "Scene of Fig. 9"),  # nor is a map
        (FIG9, [], [], "Scene of Fig. 9"),  # nor a run
        (f"{FIG9}, but mu = 0.3", ["contact.gamma"], BOTH, f"{FIG9}, but mu = 0.3"),
        ("Scene of Fig. 9, but mu = 0.3, M_0 = 1 N m", ["friction.mu"], BOTH, "Scene of Fig. 9, but M_0 = 1 N m"),
        ("Table 1, gamma = 2, but mu = 0.3", ["contact.gamma"], BOTH, "mu = 0.3"),
        ("Fig. 10b: gamma = 2.5, printed as period 2", [], [], "Fig. 10b: gamma = 2.5, printed as period 2"),
        ("Fig. 10b: gamma = 2.5, printed as period 2", ["contact.gamma"], BOTH, "Scene of Fig. 10b"),
        ("Fig. 10b: gamma = 2.5, printed as period 2", ["drive.F_0"], BOTH, "Scene of Fig. 10b"),
        ("Fig. 15a: P_d over the number of periods n, F_0 = 60 N", ["drive.F_0"], BOTH, "Scene of Fig. 15a"),
        ("Fig. 15a: P_d over the number of periods n", [], [], "Scene of Fig. 15a"),
        ("m = 0.08 kg, 100 N m", ["blades.m[1]"], BOTH, ""),
        ("100 N m over night", ["blades.m", "made.up"], BOTH, "100 N m over night"),
        ("Rig 3: after repair", ["drive.F_0"], BOTH, "Rig 3: after repair"),
    ],
)
def test_what_is_not_true_of_a_picture_is_no_part_of_its_title(title, keys, shows, true):
    assert fitting_title(title, keys, shows) == true


def test_a_title_tells_what_was_set():
    assert load("fig09", ["drive.M_0=0.1"]).title == "Scene of Fig. 9, but M_0 = 0.1 N m"
    assert load("fig09", ["drive.M_0=100", "run.periods=7"]).title == FIG9  # Fig. 9's own numbers
    ring = "A ring of 12 shrouded blades under engine order 3"
    assert load("row_ring12", ["friction.mu=0.3"]).title == f"{ring}, but mu = 0.3"  # no name of a figure
    others = ["shroud.gap=30um", "initial.x=[0,1e-4]", "parts.motion=x,y"]
    told = "Scene of Fig. 10b, but gap = 0.03 mm, initial x = 0 and 0.1 mm, motion = x and y"
    assert load("fig10b", others).title == told
    written = parse(load("fig10b", others).text(), "a", ["shroud.gap=40um", "friction.mu=0.3"])
    assert written.title == told.replace("gap = 0.03 mm, ", "") + ", gap = 0.04 mm, mu = 0.3"


def test_pictures_of_other_things_are_not_called_diagrams():
    ds = gamma_sweep(5)
    ds.attrs["title"] = FIG9
    assert "bifurcation diagram" in drawing("sweep", ds).get_suptitle()
    force = sweep({"F_0": (np.array([1.0, 2.0]), "drive.F_0", "N")}, np.full((2, 3), 0.5), [1, 2])
    for kind, other in (
        ("sweep", ds.drop_vars("x")),
        ("sweep", force.assign_attrs(title=FIG9)),
        ("sweep", grid_sweep(3).assign_attrs(title=FIG9)),
        ("trajectory", run().assign_attrs(title=FIG9)),
        ("power", power() | {"title": FIG9}),
    ):
        assert drawing(kind, other).get_suptitle() == "Scene of Fig. 9"
    of_power = power() | {"title": "Fig. 15: P_d over n"}
    assert drawing("power", of_power).get_suptitle() == "Fig. 15: $P_{d}$ over n"


def test_title_label_unit_and_width_are_as_asked(tmp_path):
    appearance = dict(title="Damping by P_d", xlabel="ratio gamma", unit="um", width=90)
    figure = drawing("sweep", gamma_sweep(9), **appearance)
    assert figure.get_suptitle() == "Damping by $P_{d}$"
    assert figure.get_figwidth() * 25.4 == pytest.approx(90)
    assert figure.axes[2].get_xlabel() == r"ratio $\gamma$"
    assert figure.axes[0].get_ylabel() == "$x_1$ [µm]"
    gap = sweep({"gap": (np.array([1e-5, 2e-5]), "shroud.gap", "m")}, np.full((2, 3), 0.52), [1, 2])
    panel = drawing("sweep", gap, **appearance).axes[2]
    np.testing.assert_allclose(panel.lines[0].get_xdata(), [10, 20])
    assert drawing("sweep", gamma_sweep(9), title="").get_suptitle() == ""


def test_text_stays_text_in_svg(tmp_path):
    save_figure(picture("sweep", gamma_sweep(9)), tmp_path / "a.svg")
    svg = (tmp_path / "a.svg").read_text()
    written = re.sub(r"\s", "", "".join(re.findall(r">([^<>]+)<", svg)))
    assert "stiffnessratio" in written  # beside a formula every letter has its place
    assert ">Fig. 9<" in svg
    assert "DejaVuSans-" not in svg  # no letter is drawn as a shape


def test_a_style_of_ones_own_goes_over_the_packages(tmp_path):
    style = tmp_path / "thesis.mplstyle"
    style.write_text("axes.linewidth: 2.5\nfont.size: 11\n")
    figure = picture("trajectory", run(), style=style)
    assert figure.axes[0].spines["left"].get_linewidth() == 2.5
    assert picture("trajectory", run()).axes[0].spines["left"].get_linewidth() == 0.6
    with pytest.raises(InputError, match="not a style of matplotlib"):
        picture("trajectory", run(), style=tmp_path / "none.mplstyle")


@pytest.mark.parametrize("kind", ["motion", "history", "forces", "loop"])
def test_every_axis_has_ticks_at_90_mm(kind):
    figure = drawing("trajectory", run(), kind=kind, width=90)
    for panel in figure.axes:
        for axis in (panel.xaxis, panel.yaxis):
            low, high = sorted(axis.get_view_interval())
            assert sum(low <= at <= high for at in axis.get_majorticklocs()) >= 2 + (axis is panel.xaxis)


def test_a_periodic_lane_has_no_interval_to_name():
    ds = gamma_sweep(9)
    ds["P_d_ci"][:] = 1e-9
    assert "95 %" not in texts(drawing("sweep", ds))
    assert "95 %" in texts(drawing("sweep", gamma_sweep(60)))
    data = power() | {"P_d_ci": [0.0] * len(power()["n"])}
    assert "95 %" not in texts(drawing("power", data))


def test_what_has_settled_is_not_magnified():
    ds = gamma_sweep(9)
    ds["x"][:] = 1e-3 * (1 + 1e-9 * np.arange(9)[:, None, None])
    ds["P_d"][:] = 50 + 1e-9 * np.arange(9)
    samples, _, powers = drawing("sweep", ds).axes
    assert np.ptp(powers.get_ylim()) == pytest.approx(0.1)
    assert np.ptp(samples.get_ylim()) >= 0.01 * np.abs(samples.get_ylim()).max()


def test_one_point_is_one_point():
    figure = drawing("trajectory", run(2))
    assert figure.axes[2].get_title(loc="left") == "1 Poincaré point"


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
        picture("sweep", gamma_sweep(5, gap=-1e-5), unit="gap")


def test_numbers_of_a_scene_are_named_as_quantities():
    assert key_attrs("initial.v_x[0]")["long_name"] == "initial velocity, left blade $v_x(0)$"
    assert key_attrs("drive.F_0") == {"key": "drive.F_0", "units": "N", "long_name": "force amplitude $F_0$"}


@pytest.mark.parametrize("text", [r"$\frac{1}$", "$5 to $6", r"a\$b$", "$", "$$x_1$$ by mu", "1e3 $", r"\1e3 $ x_1"])
def test_dollars_from_outside_are_drawn(text, tmp_path):
    for options, times in (({"title": text}, 1), ({"xlabel": text}, 2), ({}, 1)):
        figure = picture("sweep", gamma_sweep(5).assign_attrs(title=text), **options)
        save_figure(figure, tmp_path / "a.svg")
        drawn_text = "".join(ElementTree.parse(tmp_path / "a.svg").getroot().itertext())  # its letters are text
        assert drawn_text.count("$") == times * text.count("$")
    alone = Figure()
    picture("sweep", gamma_sweep(5), alone.subplots(), title=text)
    alone.draw_without_rendering()
