"""Figures of stored results: what they show and must never show. Each is drawn; a warning is an error."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from command_line import run as run_command
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.plotting.pictures import BEHIND, picture
from jaxshroud.plotting.plot_sweep import MOTION_COLOURS, NOT_OVER
from jaxshroud.plotting.style import GREY, STYLE, save_figure

pytestmark = pytest.mark.full

STATUSES = {"flag_values": np.arange(4), "flag_meanings": "OK TOO_MANY_EVENTS NOT_FINITE ANGLE_OUT_OF_RANGE"}
MOTION = ("x", "y", "theta", "v_x", "v_y", "v_theta")
OMEGA, STEPS = 536.0, 100


def logistic(r, n=100):
    """A map with every period number: periods 1, 2, 4, 8, 3 and chaos, one column per sample."""
    z = np.full(np.shape(r), 0.3)
    for _ in range(1500):
        z = r * z * (1 - z)
    samples = []
    for _ in range(n):
        z = r * z * (1 - z)
        samples.append(z)
    return np.stack(samples, axis=-1)


def period_numbers(samples):
    """0 or the smallest repeat up to 16, per lane."""
    number = np.zeros(samples.shape[:-1], int)
    for q in range(min(16, samples.shape[-1] - 1), 0, -1):
        number[np.abs(samples[..., q:] - samples[..., :-q]).max(axis=-1) < 1e-3] = q
    return number


def sweep(axes, samples, P_d, gap=0.022e-3, failed=()):
    """A stored sweep. `axes`: name -> (values, key, units); `failed`: (lane, status) pairs."""
    names, shape = tuple(axes), samples.shape[:-1]
    number, status = period_numbers(samples), np.zeros(shape, np.int8)
    x = 1e-3 * (samples - 0.5)
    P_d = np.array(P_d, dtype=float)
    for lane, code in failed:
        status[lane], number[lane], x[lane], P_d[lane] = code, 0, np.nan, 1e9
    lanes = {
        "gap": np.broadcast_to(gap, shape),
        "P_d": P_d,
        "P_d_ci": np.where(number > 0, 0, 1.5),
        "P_d_settled": np.ones(shape, bool),
        "settled": (np.arange(number.size) % 23 != 5).astype(np.int8).reshape(shape),
        "period_number": number,
    }
    data = {name: ((*names, "period", "blade"), np.stack([x, -x], axis=-1)) for name in MOTION}
    data |= {name: (names, values) for name, values in lanes.items()}
    data["status"] = (names, status, STATUSES)
    if "gap" in axes:  # the coordinate says it already
        del data["gap"]
    coords = {name: (name, v, {"key": key, "units": u}) for name, (v, key, u) in axes.items()}
    return xr.Dataset(data, coords, {"axes": ",".join(names), "title": "Fig. 9", "drive_phase": 0.0})


def gamma_sweep(n=201, **kwargs):
    gamma = np.linspace(0, 10, n)
    return sweep(
        {"gamma": (gamma, "contact.gamma", "1")},
        logistic(2.6 + 0.14 * gamma),
        60 * np.tanh(gamma / 3),
        **kwargs,
    )


def grid_sweep(n=24, **kwargs):
    gap, F_0 = np.linspace(0, 0.15e-3, n), np.linspace(10, 70, n + 6)
    samples = logistic(2.6 + 1.4 * (F_0 / 70) * (1 - gap[:, None] / 0.3e-3))
    P_d = 60 * np.tanh(F_0 / 40) - 4e5 * gap[:, None]
    return sweep({"gap": (gap, "shroud.gap", "m"), "F_0": (F_0, "drive.F_0", "N")}, samples, P_d, **kwargs)


def run(signal, n_periods=60, every=1, gap=0.022e-3):
    """A stored trajectory whose x_1 is `signal(tau)` [m]."""
    tau = 2 * np.pi * np.arange(0, n_periods * STEPS + 1, every) / STEPS
    x = np.stack([signal(tau), signal(tau + np.pi)], axis=-1)
    v = np.gradient(x, axis=0) / (tau[1] - tau[0]) * OMEGA
    wave = np.sin(tau)
    mode = np.select([wave > 0.95, wave > 0.8, wave < -0.9], [2, 1, 3], 0)
    data = {name: (("time", "blade"), v if name == "v_x" else x) for name in MOTION}
    data |= {"u_s": ("time", 0 * wave), "mode": ("time", mode), "case": ("time", mode)}
    attrs = {"omega": OMEGA, "gap": gap, "steps_per_period": STEPS, "every": every, "title": "Fig. 10b"}
    return xr.Dataset(data, {"time": tau / OMEGA}, attrs)


def power(n=400):
    periods = np.unique(np.geomspace(1, 2000, n).astype(int))
    P_d = 43 + 20 * np.sin(periods) / periods**0.7
    final = {"P_d": P_d[-1], "ci": 0.12, "n": 2000, "settled": True, "period_number": 0}
    return {
        "n": periods.tolist(),
        "P_d": P_d.tolist(),
        "P_d_ci": (8 / np.sqrt(periods)).tolist(),
        "final": final,
    }


def drawn(figure):
    """`figure` after every artist has been drawn, so that a warning or an error shows."""
    figure.canvas.draw()
    return figure


def drawing(kind, content, /, **appearance):
    """The picture of a result, drawn."""
    return drawn(picture(kind, content, **appearance))


def texts(figure):
    return "\n".join(text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text")))


def entries(legend):
    """The words of a legend."""
    return [text.get_text() for text in legend.get_texts()]


def dots(panel):
    """All points drawn in `panel`, the marks of stopped lanes left out."""
    lines = [line for line in panel.lines if not str(line.get_label()).startswith("stopped")]
    return np.concatenate([line.get_xydata() for line in lines])


def test_bifurcation_shows_every_sample_over_the_gap():
    ds = gamma_sweep()
    samples, strip, power_panel = drawing("sweep", ds).axes
    shown = dots(samples)
    assert shown.shape[0] == ds["x"][..., 0].size
    # x / gap is one division, so the extremes agree to rounding.
    extremes = ds["x"][..., 0].min() / 0.022e-3, ds["x"][..., 0].max() / 0.022e-3
    assert_allclose([shown[:, 1].min(), shown[:, 1].max()], extremes, rtol=1e-14)
    assert samples.get_ylabel() == r"$x_1/\Delta$"
    assert power_panel.get_xlabel() == r"stiffness ratio $\gamma = k/k_x$"
    assert power_panel.get_ylabel() == "$P_d$ [%]"
    assert_array_equal(power_panel.lines[0].get_ydata(), ds["P_d"])
    assert strip.get_xlim() == samples.get_xlim() == power_panel.get_xlim()


def test_bifurcation_is_one_column_wide_and_names_the_motions_present():
    figure = drawing("sweep", gamma_sweep())
    assert figure.get_figwidth() * 25.4 == pytest.approx(88)
    names = entries(figure.legends[0])
    assert names == list(MOTION_COLOURS)
    assert figure.legends[0].get_window_extent().width <= figure.bbox.width
    quiet = drawing("sweep", gamma_sweep(5).isel(gamma=[0, 1]))
    assert entries(quiet.legends[0]) == ["period 1"]


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (0, "aperiodic"),
        (1, "period 1"),
        (4, "period 4"),
        (5, "periods 5–8"),
        (8, "periods 5–8"),
        (9, "periods 9–16"),
        (16, "periods 9–16"),
    ],
)
def test_period_numbers_have_their_colour(number, name):
    ds = gamma_sweep(5)
    ds["period_number"][:] = number
    assert entries(picture("sweep", ds).legends[0]) == [name]


def test_stopped_lanes_are_marked_and_never_drawn_as_numbers():
    ds = gamma_sweep(50, failed=[(3, 3), (40, 1), (41, 3)])
    figure = drawing("sweep", ds)
    samples, strip, power_panel = figure.axes
    marks = {line.get_label(): line.get_xdata() for line in samples.lines[-2:]}
    assert set(marks) == {"stopped: TOO_MANY_EVENTS", "stopped: ANGLE_OUT_OF_RANGE"}
    assert_array_equal(marks["stopped: ANGLE_OUT_OF_RANGE"], ds["gamma"][[3, 41]])
    assert not np.isin(ds["gamma"][[3, 40, 41]], dots(samples)[:, 0]).any()
    assert np.flatnonzero(np.ma.getmaskarray(strip.collections[0].get_array())).tolist() == [3, 40, 41]
    # A stopped lane stores 1e9 as P_d here; the axis must not know it.
    assert np.isnan(power_panel.lines[0].get_ydata()[[3, 40, 41]]).all()
    assert power_panel.get_ylim()[1] < 100


def test_all_lanes_stopped_says_so():
    failed = [(i, 2 + i % 2) for i in range(9)]
    figure = drawing("sweep", gamma_sweep(9, failed=failed))
    assert figure.axes == []
    assert "no lane finished:\n5 × NOT_FINITE\n4 × ANGLE_OUT_OF_RANGE" in texts(figure)
    grid = [((i, j), 2) for i in range(3) for j in range(9)]
    assert "27 × NOT_FINITE" in texts(drawing("sweep", grid_sweep(3, failed=grid)))


def test_a_status_without_a_name_is_shown_by_its_number():
    assert "stopped: status 9" in texts(drawing("sweep", gamma_sweep(9, failed=[(2, 9)])))


@pytest.mark.parametrize("gap", [0.0, -1e-5, np.linspace(0, 1e-4, 9), np.full(9, np.nan)])
def test_without_a_positive_gap_x_is_in_mm(gap):
    ds = gamma_sweep(9, gap=gap)
    samples = drawing("sweep", ds).axes[0]
    assert samples.get_ylabel() == "$x_1$ [mm]"
    assert_allclose(dots(samples)[:, 1].max(), 1e3 * ds["x"][..., 0].max(), rtol=1e-14)


def test_sweeping_the_gap_divides_nothing_by_it():
    # x_1 over the gap would fall as 1 / gap where the motion stays as it is.
    gap = np.array([2e-5, 1e-5])  # a backward sweep: drawn ascending
    samples = np.full((2, 3), 0.52)
    ds = sweep({"gap": (gap, "shroud.gap", "m")}, samples, [1, 2])
    figure = drawing("sweep", ds)
    assert_allclose(np.unique(dots(figure.axes[0]), axis=0), [[0.01, 0.02], [0.02, 0.02]], rtol=1e-12)
    assert figure.axes[0].get_ylabel() == "$x_1$ [mm]"
    assert figure.axes[2].get_xlabel() == r"initial gap $\Delta$ [mm]"
    assert_allclose(figure.axes[2].get_xlim(), [0.005, 0.025], rtol=1e-12)
    asked = drawing("sweep", ds, unit="gap")  # whoever asks for it has it
    assert_allclose(np.unique(dots(asked.axes[0]), axis=0), [[0.01, 2], [0.02, 1]], rtol=1e-12)


@pytest.mark.parametrize(
    ("key", "units", "label", "scale"),
    [
        ("drive.F_0", "N", "force amplitude $F_0$ [N]", 1),
        ("drive.omega", "rad/s", r"drive frequency $\omega$ [rad/s]", 1),
        ("blades.k_x[1]", "N/m", "bending stiffness, right blade $k_x$ [kN/m]", 1e-3),
        ("drive.phase[0]", "rad", r"drive phase, left blade $\phi$ [°]", 180 / np.pi),
        ("made.up", "K", "made.up [K]", 1),
        ("made.up", "1", "made.up", 1),
    ],
)
def test_axis_labels(key, units, label, scale):
    ds = sweep({"value": (np.array([1.0, 2.0]), key, units)}, np.full((2, 3), 0.5), [1, 2])
    panel = drawing("sweep", ds).axes[2]
    assert panel.get_xlabel() == label
    assert_allclose(panel.lines[0].get_xdata(), [scale, 2 * scale], rtol=1e-14)


def test_unsure_powers_are_marked_by_shape():
    ds = gamma_sweep(40)
    panel = drawing("sweep", ds).axes[2]
    unsettled = ds["settled"] == 0
    aperiodic = (ds["period_number"] == 0) & ~unsettled
    marks = {line.get_label(): line for line in panel.lines[1:]}
    assert list(marks) == ["aperiodic", NOT_OVER]
    for name, lanes in (("aperiodic", aperiodic), (NOT_OVER, unsettled)):
        assert 0 < lanes.sum() < 40
        assert_array_equal(marks[name].get_xdata(), ds["gamma"][lanes])
    assert {line.get_marker() for line in marks.values()} == {"o", "x"}


def test_unsettled_lanes_are_not_called_aperiodic():
    ds = gamma_sweep(9)
    ds["period_number"][:] = 0
    ds["settled"][:] = [1, 1, 1, 1, 1, 0, 0, 0, 0]
    samples, strip, _ = drawn(figure := picture("sweep", ds)).axes
    assert entries(figure.legends[0]) == ["aperiodic", NOT_OVER]
    edge = float(ds["gamma"][4])
    colours = {line.get_color(): line.get_xdata() for line in samples.lines if line.get_xdata().size}
    assert colours[MOTION_COLOURS["aperiodic"]].max() == edge < colours[MOTION_COLOURS[NOT_OVER]].min()
    assert len(np.unique(strip.collections[0].get_facecolors(), axis=0)) == 2
    ds["period_number"][:] = 1  # a period number that was found is shown
    assert entries(picture("sweep", ds).legends[0]) == ["period 1"]


def test_odd_sweeps_draw():
    one = gamma_sweep(2).isel(gamma=[0])
    assert len(drawing("sweep", one).axes) == 3
    assert "the sweep is empty" in texts(drawing("sweep", one.isel(gamma=slice(0))))
    holes = gamma_sweep(9)
    holes["x"][4, 100:] = np.nan
    holes["P_d"][:] = np.nan
    holes["P_d_ci"][:] = np.inf
    drawing("sweep", holes)


def test_a_hundred_thousand_samples_stay_small(tmp_path):
    # Vector formats hold dots as one picture: 500 x 200 dots as paths would take about 6 MB.
    gamma = np.linspace(0, 10, 500)
    ds = sweep({"gamma": (gamma, "contact.gamma", "1")}, logistic(2.6 + 0.14 * gamma, 200), gamma)
    save_figure(picture("sweep", ds), tmp_path / "sweep.pdf")
    assert (tmp_path / "sweep.pdf").stat().st_size < 5e5


def test_power_map_masks_stopped_lanes():
    ds = grid_sweep(failed=[((2, 3), 3), ((5, 0), 1)])
    figure = drawing("sweep", ds)
    power_panel, motions = figure.axes[:2]
    for panel in (power_panel, motions):
        mask = np.ma.getmaskarray(panel.collections[0].get_array())
        assert np.argwhere(mask).tolist() == [[0, 5], [3, 2]]  # the first axis runs to the right
    assert motions.get_xlabel() == r"initial gap $\Delta$ [mm]"
    assert power_panel.get_ylabel() == "force amplitude $F_0$ [N]"
    assert power_panel.collections[0].norm.vmax < 100
    assert "stopped: TOO_MANY_EVENTS,\nANGLE_OUT_OF_RANGE" in texts(figure)


def test_power_map_with_extreme_powers():
    ds = grid_sweep(4)
    ds["P_d"][0, 0] = -1e6
    mesh = drawing("sweep", ds).axes[0].collections[0]
    assert mesh.norm.vmin == np.sort(ds["P_d"].to_numpy(), axis=None)[2]  # 5 % of 40 values, not the outlier
    ds["P_d"][:] = np.nan
    drawing("sweep", ds)


def test_trajectory_panels():
    ds = run(lambda tau: 6e-4 * np.sin(tau) + 1e-4 * np.sin(tau / 2))
    figure = drawing("trajectory", ds)
    history, phase, poincare, spectrum = figure.axes
    assert history.get_xlim() == pytest.approx((50, 60))
    assert history.get_ylabel() == r"$x_i/\Delta$"
    assert phase.get_ylabel() == "$v_{x1}$ [m/s]"
    # x_1(nT) = 1e-4 sin(n pi) = 0 for all of the last 30 periods, up to sin's rounding at 60 periods.
    assert_allclose(poincare.lines[0].get_xdata(), np.zeros(30), atol=1e-10)
    assert [text.get_text() for text in spectrum.texts] == ["$f_e$", "$f_e/2$"]
    assert entries(figure.legends[0]) == [*("$x_1$", "$x_2$", "stick", "slip +", "slip −")]


def test_contact_is_shaded_where_the_mode_says():
    # slip + where sin(tau) > 0.95: a share 2 acos(0.95) / (2 pi) of each period, to a sample at either end.
    history = drawing("trajectory", run(lambda tau: 1e-4 * np.sin(tau))).axes[0]
    spans = {c.get_label(): [p.get_extents() for p in c.get_paths()] for c in history.collections}
    widths = [span.width for span in spans["slip +"]]
    assert len(widths) == 10
    assert_allclose(widths, np.arccos(0.95) / np.pi, atol=2 / STEPS)
    assert all(span.height == 1 for span in spans["slip +"])


def test_samples_that_miss_the_periods_ends():
    # Every third of 100 steps: each third period's end is stored.
    figure = drawing("trajectory", run(lambda tau: 1e-4 * np.sin(tau), every=3))
    assert figure.axes[2].get_title(loc="left") == "10 Poincaré points"
    assert [text.get_text() for text in figure.axes[3].texts] == ["$f_e$"]


@pytest.mark.parametrize("n_periods", [1, 2, 7])
def test_short_trajectories(n_periods):
    figure = drawing("trajectory", run(lambda tau: 1e-4 * np.sin(tau) + 1e-5 * tau, n_periods=n_periods))
    assert ("no oscillation" in texts(figure)) == (n_periods == 1)  # the half kept is shorter than a period


def test_trajectory_that_stopped():
    ds = run(lambda tau: np.where(tau > 200, np.nan, 1e-4 * np.sin(tau)))
    ds.attrs["status"] = 3
    figure = drawing("trajectory", ds)
    assert "Fig. 10b (stopped: ANGLE_OUT_OF_RANGE)" in texts(figure)
    assert figure.axes[0].get_xlim()[1] == pytest.approx(
        (200 - np.pi) / (2 * np.pi), abs=2 / STEPS
    )  # x_2 is half a period ahead
    nothing = drawing("trajectory", run(lambda tau: np.full_like(tau, np.nan)))
    assert "the run has no finite step" in texts(nothing)


@pytest.mark.parametrize("gap", [0.0, -1e-5])
def test_trajectory_at_rest_without_a_gap(gap):
    figure = drawing("trajectory", run(lambda tau: 0 * tau, gap=gap))
    assert figure.axes[1].get_xlabel() == "$x_1$ [mm]"
    assert "no oscillation over\na whole period" in texts(figure)


def test_power_convergence():
    data = power()
    figure = drawing("power", data)
    (panel,) = figure.axes
    assert panel.get_xscale() == "log"
    assert_array_equal(panel.lines[0].get_ydata(), data["P_d"])
    assert f"{data['final']['P_d']:.4g} ± 0.12 % ($n$ = 2000, aperiodic)" in texts(figure)


def test_power_with_missing_numbers():
    data = power(5) | {"P_d_ci": [None] * len(power(5)["n"])}
    data["final"] |= {"ci": None, "settled": False, "period_number": 2}
    assert "% ($n$ = 2000, period 2, not settled)" in texts(drawing("power", data))
    none = data | {"P_d": [None] * len(data["n"])}
    assert "no period was finished" in texts(drawing("power", none))
    empty = {"n": [], "P_d": [], "P_d_ci": [], "final": data["final"] | {"P_d": None}}
    assert "no period was finished" in texts(drawing("power", empty))


def test_files_are_what_matplotlib_writes_with_one_layout_for_all(tmp_path):
    figure = picture("power", power())
    paths = [tmp_path / "power.png", tmp_path / "power.svg"]
    save_figure(figure, *paths)
    assert figure.get_layout_engine() is not None  # what is added later is laid out too
    with mpl.rc_context(STYLE):
        picture("power", power()).savefig(tmp_path / "again.png", dpi=200)
    assert paths[0].read_bytes() == (tmp_path / "again.png").read_bytes()
    assert b"<svg" in paths[1].read_bytes()


@pytest.mark.parametrize("name", ["power.xyz", "power"])
def test_a_failed_save_leaves_the_old_file(tmp_path, name):
    (tmp_path / name).write_text("old")
    with pytest.raises(ValueError, match=r"xyz|suffix"):
        save_figure(picture("power", power()), tmp_path / name)
    assert [(found.name, found.read_text()) for found in tmp_path.iterdir()] == [(name, "old")]


def test_no_figure_stays_open():
    import matplotlib.pyplot as plt

    drawing("power", power())
    assert plt.get_fignums() == []


@pytest.mark.parametrize("key", ["drive.level", "shroud.gap", "drive.omega", "friction.mu"])
def test_amplitudes_are_drawn_along_any_key(key, reopened):
    table1 = js.load("table1").scene
    values = {"drive.level": [0.5, 1.0], "shroud.gap": [1e-5, 2e-5], "drive.omega": [530.0, 540.0]}
    short = {"n_periods": 2, "transient": 1, "method": js.RungeKutta(steps=100)}
    swept = js.sweep(table1, {key: values.get(key, [0.1, 0.2])}, amplitudes=True, **short)
    figure = reopened(swept).plot(kind="amplitude")
    drawn = figure.axes[0].lines[0].get_ydata()
    assert drawn.shape == (2,)
    assert np.all(drawn > 0)


@pytest.mark.parametrize(("times", "marked"), [(0.5, False), (1.5, False), (100.0, True), (np.inf, True)])
def test_the_largest_amplitude_without_contact_has_an_arrow_and_a_number_where_it_is_out_of_view(times, marked):
    values = np.linspace(1000.0, 1200.0, 5)
    with_contact = np.array([1.0, 1.2, 1.5, 1.1, 1.0]) * 1e-3
    free = times * np.array([0.9, 1.0, 1.5, 3.0, 1.0]) * 1e-3  # the largest at 1150 rad/s
    blades = ("drive_omega", "blade")
    data = {
        "x_peak": (blades, np.stack([with_contact] * 2, axis=-1)),
        "x_free": (blades, np.stack([free] * 2, axis=-1)),
        **{f"{name}_peak": (blades, np.zeros((5, 2))) for name in ("y", "theta")},
        "status": ("drive_omega", np.zeros(5, np.int8), STATUSES),
        "settling": ("drive_omega", np.zeros(5)),
    }
    coords = {"drive_omega": ("drive_omega", values, {"key": "drive.omega", "units": "rad s-1"})}
    ds = xr.Dataset(data, coords, {"axes": "drive_omega", "scene": js.load("table1").text(), "title": "a pair"})
    (panel,) = picture("sweep", ds, kind="amplitude").axes
    arrows = [text for text in panel.texts if text.arrow_patch is not None]
    words = [text.get_text() for text in panel.texts if text.get_text()]
    assert len(arrows) == len(words) == marked
    # Control: what is in view reaches the axis' top at most.
    assert marked == (free.max() * 1e3 > panel.get_ylim()[1])
    if marked:
        assert words == ["300 mm\nat 1150 rad/s" if np.isfinite(times) else "without bound\nat 1000 rad/s"]
        assert arrows[0].xy == (1150.0 if np.isfinite(times) else 1000.0, 1.0)
        assert with_contact.max() * 1e3 < 0.9 * panel.get_ylim()[1]  # room for the number above what is drawn


def test_a_second_curve_is_behind_in_grey(tmp_path):
    first, second = (
        js.power(js.load("table1").scene, n_periods=n, transient=4, method=js.RungeKutta(steps=50)) for n in (16, 24)
    )
    figure = first.plot(over=second, title="both")
    grey = [line for line in figure.axes[0].lines if line.get_color() == GREY and line.get_zorder() == BEHIND]
    assert max(np.max(line.get_xdata()) for line in grey) == 24  # beyond the first one's 16
    assert figure.axes[0].get_xlim()[1] >= 24
    with pytest.raises(ValueError, match="two results of one kind"):
        first.plot(over=js.check(js.load("table1")).campbell)


@pytest.mark.parametrize("dpi", [100, 300])
def test_a_command_takes_the_dots_per_inch(tmp_path, dpi):
    run_command(f"check table1 --out {tmp_path}/sheet --dpi {dpi}")
    header = (tmp_path / "sheet" / "check.png").read_bytes()[16:24]
    assert int.from_bytes(header[:4]) == int(88 / 25.4 * dpi)
