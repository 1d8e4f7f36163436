"""Pictures as a referee would have them: no text is cut or covered, nothing is hidden, every mark is explained."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from referee import complaints
from test_animation import animation, still
from test_plot import drawing, entries, gamma_sweep, grid_sweep, power
from test_plot_branch import around, branch_of
from test_plot_contact import run
from test_plot_mistuned import mistuned
from test_plot_tuning import GRID, scattered, tuning

from jaxshroud.model.modes import BIFURCATION_KINDS
from jaxshroud.plotting.pictures import picture
from jaxshroud.plotting.plot_run import RUN_PAGES
from jaxshroud.plotting.style import COLOURS, PALE, fit_title, new_figure
from jaxshroud.scene.keys import Motion

pytestmark = pytest.mark.full

LONG = "Table 1, the common parameters, with Fig. 10b's gap, force and gamma, but omega = 545 rad/s, M_0 = 0.1 N m"


def attractors(shares=(1.0,), kinds=None, **more):
    """Attractors with nearly the same orbit, whose shares are given."""
    n, angle = len(shares), np.linspace(0, 2 * np.pi, 200)
    size = 1e-4 * (1 + 0.001 * np.arange(n))[:, None]
    at = np.stack([size[:, 0], size[:, 0]], axis=-1)
    share = np.array(shares)
    ends = {"share_low": np.maximum(share - 0.1, 0), "share_high": np.minimum(share + 0.1, 1)}
    P_d = 40.0 + np.arange(n)
    powers = {"P_d": P_d, "P_d_least": P_d, "P_d_most": P_d, "P_d_ci": 0 * P_d, "worst": 0}
    paths = {"path_x": size * np.cos(angle), "path_v_x": 1e3 * size * np.sin(angle), "gap": 2e-5}
    motion = Motion(*(at if name == "x" else 0 * at for name in Motion._fields))
    told = {
        "kind": np.zeros(n, int) if kinds is None else np.array(kinds),
        "names": [f"{chr(65 + i)}: period 1" for i in range(n)],
        "motion": motion,
    }
    data = xr.Dataset(attrs={"title": LONG})
    return SimpleNamespace(data=data, share=share, **ends, **powers, **paths, **told, label=np.zeros(8, int), **more)


def basins(at=(0.0, 0.0)):
    """The basins of two attractors, of which the first is at that place [m, m/s]."""
    axes = {"x[0]": np.linspace(-1e-3, 1e-3, 4), "v_x[0]": np.linspace(-1, 1, 3)}
    label = np.array([[0, 1, -1], [0, 0, -2], [1, 1, 0], [0, 1, 0]])
    plane = {name: (name, values, {"key": f"initial.{name}"}) for name, values in axes.items()}
    found = attractors((0.6, 0.4), at_strobe=np.array([at, (1.0, 9.0)]), plane=("initial.x", "initial.v_x"))
    found.data, found.label = xr.Dataset({"label": ((*axes,), label)}, plane, {"title": LONG}), label
    return found


def trade():
    """Measured settings of three methods, of which one has four variants."""
    kinds = "rk4", "rk4, float32", "rk4, bisection", "rk4, not located", "rk4, smooth", "tsit5", "diffrax Tsit5, smooth"
    rows = [
        {"kind": kind, "cost": cost, "state_error": error, "P_d": error, "gradient": error, "period": 1 - error}
        for kind in kinds
        for cost, error in ((3e-5, 1e-3), (1e-4, 1e-6), (5e-4, 1e-9))
    ]
    return {"title": LONG, "horizon": 3, "settings": [row | {"front": row["kind"] == "tsit5"} for row in rows]}


def robust():
    """The robustness of a tuning to three numbers, one of them looked at at many values."""
    few, many = np.linspace(1e-5, 4e-5, 12), np.linspace(0.4, 0.6, 300)
    looked = {"shroud.gap": few, "friction.mu": many, "contact.gamma": np.linspace(1.0, 4.0, 12)}
    intervals = {
        key: {
            "looked": x,
            "loss": 2 * np.linspace(-1, 1, x.size) ** 2,
            "low": x[3],
            "high": x[-3],
            "at": x[x.size // 2],
        }
        for key, x in looked.items()
    }
    chance = {"at_least": 36.0, "probability": 0.9, "probability_low": 0.85, "probability_high": 0.93}
    draws = {"sampled_P_d": np.linspace(35, 42, 64), "nominal_P_d": [40.0], "scatter": {"friction.mu": 0.1}}
    return {"intervals": intervals, "loss": 1.0, **draws, **chance}


def branch():
    """A branch with a mark of every kind."""
    kind = np.zeros(201, int)
    kind[10:80:10] = [BIFURCATION_KINDS.index(name) for name in BIFURCATION_KINDS[1:8]]
    samples, gamma = around(201, 0.5)
    return branch_of(samples, gamma, kind=kind)


def diagnosis():
    """A diagnosis of a run in contact, with all its panels."""
    n = np.arange(1, 65)
    numbers = {"periods": 652, "period_number": 1, "status": 0, "K": 0.01, "largest_force": 102.4, "n": n}
    exponents = {
        "exponents": np.full(6, -0.26),
        "exponents_ci": np.full(6, 0.002),
        "has_multipliers": True,
        "slider_stuck": False,
    }
    powers = {
        "P_d_worst": None,
        "P_d": 40 + 1 / n,
        "P_d_ci": 8 / np.sqrt(n),
        "P_d_settled": True,
        "energy_residual": 3e-6,
    }
    times = {"time_apart": 0.563, "time_stick": 0.144, "time_slip": 0.293, "multipliers": np.exp(1j * n[:6]) / 2}
    means = {"powers": {"drive": 2.09, "viscous": 0.803, "friction": 1.29}}
    evidence = (
        "samples return after 1 to 4e-15 of their size, and an orbit closes to 3e-15, stable, largest multiplier 0.5"
    )
    told = {"data": two_rows(), "verdict": "period 1", "evidence": f"period 1: {evidence} (periods 301 to 364)"}
    return SimpleNamespace(**numbers, **exponents, **powers, **times, **means, **told)


def two_rows():
    """A run whose motion repeats after two periods."""
    ds = run()
    ds["x"] = ds["x"] * (1 + 0.1 * np.cos(536.0 * ds["time"] / 2))
    return ds.assign_attrs(title=LONG)


PICTURES = {
    **{f"run {kind}": ("trajectory", two_rows(), {"kind": kind}) for kind in RUN_PAGES},
    "sweep": ("sweep", gamma_sweep(60, failed=[(3, 3), (40, 1)]).assign_attrs(title=LONG), {}),
    "map": ("sweep", grid_sweep(8, failed=[((2, 3), 3)]).assign_attrs(title=LONG), {}),
    "power": ("power", power() | {"title": "Fig. 15: P_d over n"}, {}),
    "branch": ("branch", branch(), {}),
    "attractors": ("attractors", attractors((0.5, 0.3, 0.2)), {}),
    "basins": ("basins", basins(), {}),
    "diagnosis": ("diagnosis", diagnosis(), {}),
    "trade": ("trade", trade(), {}),
    "tuned": ("tuned", tuning(map=GRID, robust=robust()), {}),
    "tuned keys": ("tuned", tuning(), {}),
    "robustness": ("robustness", tuning(robust=robust()), {}),
    "scatter": ("scatter", scattered([-0.1, 0.8], [0.2, 1.2]), {}),
    "mistuned": ("mistuned", mistuned(0.8, searched=True).assign_attrs(title=LONG), {}),
    "mistuned little": ("mistuned", mistuned(0.05).assign_attrs(title=LONG), {}),
}


@pytest.mark.full(but=[f"{name}-90" for name in PICTURES])
@pytest.mark.parametrize("width", [None, 90])
@pytest.mark.parametrize("name", PICTURES)
def test_no_text_is_cut_covered_or_wider_than_its_panel(name, width):
    kind, content, page = PICTURES[name]
    assert complaints(picture(kind, content, width=width, **page)) == []


def test_a_referee_sees_what_is_wrong():
    # Control: a title wider than its panel, a text at the edge, and two texts in one place.
    figure = new_figure("", 3, 2)
    panel, _ = figure.subplots(1, 2)
    panel.set_title("a title that is far too long for this panel")
    panel.text(0.5, 0.5, "one")
    panel.text(0.5, 0.5, "other")
    figure.text(0.99, 0.5, "at the edge")
    told = " ".join(complaints(figure))
    for wanted in ("wider than its axes", "cut: 'at the edge'", "touch: 'one' and 'other'"):
        assert wanted in told


def test_a_long_title_is_broken_and_a_short_one_kept():
    panel = new_figure("", 2, 2).subplots()
    for text, lines in (("short", 1), ("a title of $x_1$ that is far too long for two inches", 3)):
        panel.set_title(text)
        fit_title(panel)
        assert panel.get_title().split() == text.split()
        assert panel.get_title().count("\n") >= lines - 1
    assert panel.title.get_window_extent().width <= panel.get_window_extent().width


def test_an_attractor_that_takes_all_starts_has_a_whole_mark():
    shares = drawing("attractors", attractors((1.0,))).axes[1]
    mark = shares.lines[0]
    radius = mark.get_markersize() / 2 * shares.figure.dpi / 72
    x = shares.transData.transform((1.0, 0.0))[0]
    assert x + radius < shares.get_window_extent().x1


def test_orbits_that_coincide_are_all_seen():
    orbits = drawing("attractors", attractors((0.4, 0.3, 0.2, 0.1), kinds=[0, 2, 0, 0])).axes[0]
    paths = [line for line in orbits.lines if line.get_xdata().size > 1]
    above = sorted((one for one in paths if to_hex(one.get_color()) != to_hex(COLOURS[1])), key=paths.index)
    widths = [line.get_linewidth() for line in above]
    assert all(wide - narrow > 0.5 for wide, narrow in pairwise(widths))  # later ones are on top
    letters = [text.get_text() for text in orbits.texts]
    assert letters == [chr(65 + i) for i in range(len(paths))]  # one at each point


@pytest.mark.parametrize(("at", "explained"), [((0.0, 0.0), True), ((1e-3, 1.0), True), ((9e-3, 0.0), False)])
def test_poincare_points_are_explained_where_they_are_shown(at, explained):
    figure = drawing("basins", basins(at))
    told = entries(figure.legends[0])
    assert told[:4] == ["A: period 1", "B: period 1", "undecided", "stopped"]
    assert (told[4:] == ["Poincaré point"]) == explained == bool(figure.axes[0].lines)
    assert to_hex(figure.legends[0].get_patches()[2].get_facecolor()) == PALE


def test_methods_have_the_colours_of_the_house_and_variants_their_marks():
    panel = drawing("trade", trade()).axes[0]
    lines = {line.get_label(): line for line in panel.lines}
    assert {line.get_color() for name, line in lines.items() if name != "best of all"} == set(COLOURS[:3])
    rk4 = [line for name, line in lines.items() if name.startswith("rk4")]
    assert {line.get_color() for line in rk4} == {COLOURS[0]}
    assert len({line.get_marker() for line in rk4}) == len(rk4) == 5


def test_panels_of_a_trade_are_large_enough_for_a_column():
    # At 420 px of a column of 88 mm a letter of 7 pt has 11.8 px; at 140 mm it had 7.4.
    figure = picture("trade", trade())
    assert figure.get_figwidth() * 25.4 < 90
    assert [panel.get_xlabel() for panel in figure.axes] == ["", "", "", "µs per lane and period"]


def share_of_ink(figure: Figure) -> float:
    """The share of the picture that is not white."""
    figure.canvas.draw()
    return float((np.asarray(figure.canvas.buffer_rgba())[..., :3] < 250).any(axis=-1).mean())  # type: ignore[attr-defined]


def test_a_tuning_with_a_map_is_mostly_map():
    assert share_of_ink(picture("tuned", tuning(map=GRID))) > 0.4  # side by side with its scores it was 0.34


def test_losses_at_many_values_are_dots_without_lines():
    axes = drawing("robustness", tuning(robust=robust())).axes
    looks = {len(line.get_xdata()): line.get_linestyle() for panel in axes for line in panel.lines}
    assert (looks[300], looks[12]) == ("None", "-")


def test_no_cell_of_a_robust_tuning_is_empty():
    axes = drawing("robustness", tuning(robust=robust())).axes
    rows: dict[int, float] = {}
    for panel in axes:
        box = panel.get_window_extent()
        rows[round(box.y0)] = max(rows.get(round(box.y0), 0), box.x1)
    assert np.ptp(list(rows.values())) < 5  # every row reaches the right end


def test_an_animation_is_not_mostly_white():
    shown = animation(still(), 1.0)
    shown.fix_layout()
    shown.show(15)
    shown.figure.canvas.draw()
    blocks = shown.figure.axes[0]
    frame = np.asarray(shown.figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
    left, foot, right, top = (round(end) for end in blocks.get_window_extent().extents)
    part = frame[frame.shape[0] - top : frame.shape[0] - foot, left:right]
    assert (part < 250).any(axis=-1).mean() > 0.4
    assert complaints(shown.figure) == []
    assert np.hypot(shown.arrows.U, shown.arrows.V).max() == pytest.approx(0.8 * 0.035, rel=1e-3)  # N at its largest


def test_nothing_that_moves_leaves_the_frame():
    shown = animation(still(), 5.0)
    shown.fix_layout()
    (left, right), (low, high) = shown.figure.axes[0].get_xlim(), shown.figure.axes[0].get_ylim()
    for i in range(shown.frames.sizes["time"]):
        shown.show(i)
        tips = shown.arrows.get_offsets() + np.stack([shown.arrows.U, shown.arrows.V], axis=-1)
        points = np.concatenate([*(np.asarray(path.vertices) for path in shown.shapes.get_paths()), tips])
        assert ((points > [left, low]) & (points < [right, high])).all()
    assert shown.cursor.get_xdata()[0] == pytest.approx(float(shown.frames["periods"][-1]))
