"""Pictures of multipliers and of Lyapunov exponents, and of a row's run by its kind: what they show."""

import numpy as np
import pytest
import xarray as xr
from command_line import refused, run
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose
from referee import complaints
from test_plot import drawing, texts
from test_row_animation import stored

import jaxshroud as js
from jaxshroud.plotting.style import BLUE, ORANGE

MULTIPLIERS = np.array([-1.2, 0.5 + 0.3j, 0.5 - 0.3j, 0.0])


def orbit(multipliers=MULTIPLIERS, reduced=None, **attrs):
    """A stored orbit, as far as its picture looks."""
    parts = {"multipliers_real": multipliers.real, "multipliers_imag": multipliers.imag}
    data = {name: ("multiplier", values) for name, values in parts.items()}
    if reduced is not None:
        data |= {f"wave_multipliers_{part}": ("wave", getattr(reduced, part)) for part in ("real", "imag")}
        attrs["wave_parts"] = 3
    return xr.Dataset(data, attrs={"kind": "orbit", "status": 0, "q": 2, "title": "", **attrs})


def marks(axes, color):
    """The points drawn in a colour, as complex numbers."""
    lines = (line for line in axes.lines if line.get_marker() in "ox" and to_hex(line.get_color()) == color.lower())
    return np.concatenate([line.get_xdata() + 1j * np.asarray(line.get_ydata()) for line in lines])


def test_multipliers_outside_the_unit_circle_stand_out():
    figure = drawing("orbit", orbit())
    assert not complaints(figure)
    plane, sizes = figure.axes
    assert_allclose(marks(plane, ORANGE), MULTIPLIERS[:1])
    assert_allclose(np.sort_complex(marks(plane, BLUE)), np.sort_complex(MULTIPLIERS[1:]))
    assert plane.get_aspect() == 1
    (line,) = (line for line in sizes.lines if line.get_marker() == "o")
    assert_allclose(line.get_ydata(), np.abs(MULTIPLIERS[:3]))  # the 0 has no place on its scale


def test_a_ring_shows_the_multipliers_of_its_wave_too():
    reduced = np.array([0.9j, -0.9j])
    figure = drawing("orbit", orbit(reduced=reduced))
    assert not complaints(figure)
    for value in reduced:
        assert np.abs(marks(figure.axes[0], BLUE) - value).min() < 1e-12
    assert "of the travelling wave" in texts(figure)


def exponents(values, ci):
    """Stored exponents whose growth alternates about them."""
    values = np.asarray(values)
    growth = values + 0.5 * (-1.0) ** np.arange(100)[:, None]
    data = {"exponents": ("direction", values), "ci": ("direction", np.asarray(ci))}
    attrs = {"kind": "lyapunov", "status": 0, "title": ""}
    return xr.Dataset(data | {"growth": (("period", "direction"), growth)}, attrs=attrs)


def test_exponents_are_drawn_with_their_intervals_and_forgotten_ones_marked():
    ds = exponents([0.3, -1.0, np.nan, -np.inf], [0.02, 0.1, np.nan, np.nan])
    figure = drawing("lyapunov", ds)
    assert not complaints(figure)
    panel, averages = figure.axes
    points = panel.containers[0].lines[0]
    assert_allclose(points.get_xydata(), [[1, 0.3], [2, -1.0]])
    (arrow,) = (line for line in panel.lines if line.get_marker() == "v")
    assert arrow.get_xdata().tolist() == [4]
    assert "forgotten" in texts(figure)
    assert [text.get_text() for text in averages.texts] == ["1", "2"]
    curves = [line for line in averages.lines if len(line.get_xdata()) == 100]
    assert_allclose([line.get_ydata()[-1] for line in curves], [0.3, -1.0], atol=1e-12)  # of an even number
    assert_allclose([line.get_ydata()[0] for line in curves], [0.8, -0.5])


@pytest.mark.parametrize(
    ("ds", "told"),
    [
        (orbit(q=0), "no periodic orbit was found"),
        (exponents([-np.inf, np.nan], [np.nan, np.nan]), "no exponent is a number"),
        (xr.Dataset({"status": ("lane", [0, 0])}, attrs={"kind": "orbit", "title": ""}), "choose one"),
        (xr.Dataset({"status": ("lane", [0, 0])}, attrs={"kind": "lyapunov", "title": ""}), "choose one"),
    ],
)
def test_what_has_nothing_to_show_says_so(ds, told):
    assert told in texts(drawing(ds.attrs["kind"], ds)).replace("\n", " ")


def test_a_run_of_a_row_has_its_motion_and_no_other_kind(tmp_path, capsys):
    ds, place = stored(closed=True, x=1e-3), tmp_path / "run.png"
    extent = {f"x_{of}": ("blade", np.full(4, 1e-3)) for of in ("peak", "free")}
    ds = ds.assign(extent).assign_coords(blade=np.arange(4))
    ds.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    run(f"plot {tmp_path}/run.nc --kind motion --out {place}")
    assert place.stat().st_size > 10_000
    assert "run.nc: Argument `kind` cannot be 'forces'" in refused(capsys, f"plot {tmp_path}/run.nc --kind forces")
    assert isinstance(js.Trajectory(ds).plot(kind="motion").axes, list)
