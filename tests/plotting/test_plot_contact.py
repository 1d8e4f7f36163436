"""Pictures of what contact does: what they show, and what they say where too little is stored."""

import numpy as np
import pytest
import xarray as xr
from test_plot import drawing, entries, texts

from jaxshroud.plotting.pictures import picture
from jaxshroud.plotting.plot_run import RUN_PAGES
from jaxshroud.plotting.run_data import contact_data, run_data
from jaxshroud.scene.checks import InputError

pytestmark = pytest.mark.full

OMEGA, STEPS, HALF = 536.0, 200, 0.0175
SCENE = '[shroud]\nl_ab = 0.035\n[friction]\nmu = 0.5\n[parts]\ncontact = "spring"\n'


def run(n_periods=8, every=1, turns=True, **attrs):
    """A stored run pressed together in the first half of each period, in slip + and then in stick, flat for a while."""
    tau = 2 * np.pi * np.arange(0, n_periods * STEPS + 1, every) / STEPS
    wave = np.sin(tau)
    phase = np.rint(tau / (2 * np.pi) * STEPS) % STEPS / STEPS
    mode = np.select([(phase == 0) | (phase >= 0.5), phase < 0.25], [0, 2], 1)
    case = np.select([mode == 0, phase < 0.1], [0, 5], 1)
    N = np.where(mode > 0, 100 * wave, 0.0)
    x = np.stack([1e-3 * wave, -1e-3 * wave], axis=-1)
    motion = {name: (("time", "blade"), x) for name in ("x", "y", "theta", "v_x", "v_y", "v_theta")}
    at = {"u_s": 0 * wave, "mode": mode, "case": case, "N": N, "F": 0.5 * N, "v": 1e-4 * wave, "u": 1e-4 * np.cos(tau)}
    if turns:
        at["contact_point"] = np.where(mode > 0, HALF * wave, np.nan)
    whole = {
        "omega": OMEGA,
        "gap": 2e-5,
        "steps_per_period": STEPS,
        "every": every,
        "scene": SCENE,
        "title": "",
    }
    data = {**motion, **{name: ("time", values) for name, values in at.items()}}
    return xr.Dataset(data, {"time": tau / OMEGA}, {**whole, "end_turns": 0.0, "status": 0, **attrs})


def panel(name, ds):
    """The axes of a picture of that kind, after everything was drawn."""
    return drawing("trajectory", ds, kind=name).axes[0]


def test_the_ribbon_shows_how_long_contact_is_in_each_state():
    ribbon = panel("ribbon", run())
    widths = [sum(path.get_extents().width for path in of.get_paths()) for of in ribbon.collections]
    # States above (stick, slip +), cases below (flat, 1): to a sample at either end.
    np.testing.assert_allclose(widths, [0.25, 0.25, 0.1, 0.4], atol=2.5 / STEPS)
    assert ribbon.get_xlim() == (0, 1)
    assert entries(ribbon.figure.legends[0]) == ["stick", "slip +", "case 1", "flat"]  # and none that does not occur


def test_a_motion_that_repeats_after_two_periods_has_two_rows():
    ds = run()
    ds["x"] = ds["x"] * (1 + 0.1 * np.cos(OMEGA * ds["time"] / 2))
    assert [label.get_text() for label in panel("ribbon", ds).get_yticklabels()] == ["2", "1"]


def test_the_loop_encloses_the_work_of_friction():
    ds = run()
    lines = panel("loop", ds).lines
    u, F = np.concatenate([line.get_xydata() for line in lines]).T
    # One period: F = 50 sin over u = 100 cos [um] in the first half, so that u falls from 100 to -100.
    assert (np.nanmin(u), np.nanmax(u)) == pytest.approx((-100, 100))
    assert np.nanmax(F) == pytest.approx(50)
    assert {line.get_color() for line in lines} == {"#8c8c8c", "#56B4E9", "#E69F00"}


def test_forces_are_shown_with_the_limit_of_friction():
    forces = panel("forces", run())
    assert entries(forces.get_legend()) == [r"$\pm\mu N$", "$N$", "$F$"]
    assert forces.get_xlim() == pytest.approx((0, 1))
    without = run()
    without["F"] *= 0
    without.attrs["scene"] = ""
    assert entries(panel("forces", without).get_legend()) == ["$N$"]


def test_the_path_stays_between_the_ends_of_the_face():
    path = panel("path", run())
    ends = [line.get_ydata()[0] for line in path.lines if line.get_linestyle() == "--"]
    assert ends == pytest.approx([-1e3 * HALF, 1e3 * HALF])
    assert "the blocks do not turn" in texts(picture("trajectory", run(turns=False), kind="path"))


def test_smooth_contact_has_no_modes_but_is_told_from_none():
    ds = run()
    ds["mode"] = 0 * ds["mode"] + 4
    assert entries(panel("ribbon", ds).figure.legends[0])[0] == "contact"


@pytest.mark.parametrize("kind", sorted(RUN_PAGES))
@pytest.mark.parametrize("n_periods", [1, 8])
def test_every_kind_draws(kind, n_periods):
    figure = drawing("trajectory", run(n_periods), kind=kind)
    assert len(figure.axes) == len(RUN_PAGES[kind])


@pytest.mark.parametrize(
    ("ds", "kind", "told"),
    [
        (run().drop_vars("N"), "loop", "no forces in this run"),
        (run(every=25), "ribbon", "every 10th step at most"),
        (run(every=7, n_periods=6), "poincare", "No end of a period"),
        (run(every=150), "spectrum", "too few for a spectrum"),
        (run(), "histroy", "did you mean .history."),
    ],
)
def test_too_little_is_told(ds, kind, told):
    with pytest.raises(InputError, match=told):
        picture("trajectory", ds, kind=kind)


def test_the_usual_picture_says_it_in_the_panel():
    assert "No end of a period" in texts(picture("trajectory", run(every=7, n_periods=6))).replace("\n", " ")


def test_events_stand_between_the_samples_they_came_between():
    # Friction jumps half way between the third and the fourth sample of the last period.
    ds, at = run(2), STEPS + 3
    both = ds.isel(time=[at, at]).drop_vars("time").rename(time="event")
    both["case"][:] = [1, 2]
    events = {f"event_{name}": (both[name].dims, both[name].to_numpy()) for name in both.data_vars}
    half = float(ds["time"][at] + ds["time"][at + 1]) / 2
    ds = ds.assign({**events, "event_t": ("event", [half, half]), "event_after": ("event", [at, at])})
    shown = contact_data(run_data(ds), 1)
    np.testing.assert_array_equal(shown.case[3:7], [5, 1, 2, 5])
    np.testing.assert_allclose(np.diff(shown.t[3:7]), [0.5 / STEPS, 0, 0.5 / STEPS], atol=1e-12)
    # A piece ends on one side of the event and the next begins on the other.
    edges = [piece for piece in shown.pieces if 4 in (piece.stop - 1, piece.start)]
    assert slice(4, 5) in edges
