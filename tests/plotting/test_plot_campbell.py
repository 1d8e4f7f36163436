"""Campbell diagrams: what they show."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from test_plot import drawing, entries, texts

from jaxshroud.plotting.style import BLUE, INK, ORANGE
from jaxshroud.results.data_sheet import Campbell, NaturalMode, crossings_between

RPM = 2 * np.pi / 60  # rad/s


def mode(contact, motion, blades, frequency):
    """A mode whose shares do not matter."""
    return NaturalMode(contact, motion, blades, frequency, 0.01, (1.0, 0.0, 0.0), 0.5)


MODES = (
    mode("apart", "x", "either", 95.0),
    mode("apart", "y", "either", 900.0),
    mode("stuck", "x", "in phase", 95.0),
    mode("stuck", "x", "out of phase", 160.0),
    mode("corner", "x", "out of phase", 120.0),
)


def campbell(modes=MODES, orders=(2.0, 4.0, 8.0), start=0.0, stop=2000.0):
    """A diagram at 1,450 rpm, where order 4 has the drive's frequency."""
    speeds = {"speed": 1450 * RPM, "start": start * RPM, "stop": stop * RPM}
    return Campbell.of_modes(modes, orders, {**speeds, "drive_order": 4.0})


def axes_of(**options):
    """The only axes of the picture, drawn."""
    (axes,) = drawing("campbell", campbell(**options).data).axes
    return axes


def dots(axes, color):
    """The speeds [rpm] and the frequencies [Hz] of the dots of one colour."""
    (line,) = (one for one in axes.lines if one.get_marker() == "o" and to_hex(one.get_color()) == color.lower())
    return np.column_stack(line.get_data())


def test_dots_are_where_engine_orders_meet_natural_frequencies():
    axes = axes_of()
    expected = [(60 * 95 / order, 95) for order in (4, 8)]  # order 2 meets it at 2,850 rpm only
    np.testing.assert_allclose(sorted(map(tuple, dots(axes, BLUE))), sorted(expected))
    expected += [(60 * 160 / 8, 160)]  # order 4 at 2,400 rpm
    np.testing.assert_allclose(sorted(map(tuple, dots(axes, ORANGE))), sorted(expected))


def test_a_crossing_at_an_end_of_the_range_is_told():
    # A speed in rpm is converted to rounding: a crossing there belongs to the range, at both of its ends.
    for frequency in np.linspace(80.0, 120.0, 200):
        modes, end = [mode("apart", "x", "either", float(frequency))], 60 * float(frequency) / 4 * RPM
        for start, stop in ((0.0, end), (end, 2 * end)):
            (found,) = crossings_between(modes, [4.0], end, start, stop)
            assert found.speed == pytest.approx(end, rel=1e-12)
        assert not crossings_between(modes, [4.0], end, 0.0, end * (1 - 1e-6))


def test_lines_of_engine_orders_rise_by_their_order():
    lines = [line for line in axes_of().lines if line.get_marker() != "o"]
    rays = [line for line in lines if np.ptp(line.get_xdata()) and np.ptp(line.get_ydata())]
    slopes = {round(60 * np.ptp(line.get_ydata()) / np.ptp(line.get_xdata()), 9): line for line in rays}
    assert sorted(slopes) == [2, 4, 8]
    assert [order for order, line in slopes.items() if line.get_color() == INK] == [4]  # the drive's


def test_names_are_those_of_what_is_shown():
    told = texts(axes_of().figure)
    for words in ("bending along x", "bending along x, out of phase", "speed [rpm]", "order 4, the drive's", "8"):
        assert words in told
    assert "bending along x, in phase" not in told  # its line is that of free blades
    assert "bending along y" not in told  # beyond 2.5 times what the orders reach


def test_the_legend_has_no_state_without_a_line():
    def labels(modes):
        figure = drawing("campbell", campbell(modes=modes).data)
        return {word for legend in figure.legends for word in entries(legend)}

    assert {"apart", "stuck"} <= labels(MODES)
    assert not {"apart"} & labels(MODES[2:])  # of faces that are pressed on each other at all speeds


@pytest.mark.parametrize("start", [0.0, 1400.0])
def test_a_range_of_speeds_is_the_axis(start):
    axes = axes_of(start=start)
    assert axes.get_xlim() == pytest.approx((start, 2000))
    at = np.concatenate([dots(axes, BLUE), dots(axes, ORANGE)])[:, 0]
    assert ((at >= start) & (at <= 2000)).all()


@pytest.mark.parametrize(
    "options",
    [
        {"modes": MODES[:2]},  # without contact
        {"modes": (*MODES[:2], mode("sliding", "x", "out of phase", 150.0))},  # without friction
        {"orders": (4.0,)},
        {"orders": (4.0, 36.0, 0.5)},
        {"stop": 1.0},  # no crossing at all
        {"orders": tuple(np.arange(1.0, 101.0))},
    ],
)
def test_few_and_many_lines_are_drawn(options):
    legend = axes_of(**options).figure.legends[0]
    contacts = entries(legend)[:2]
    touching = {one.contact for one in options.get("modes", MODES)} - {"apart", "corner"}
    assert contacts[0] == "apart"
    assert set(contacts[1:]) >= touching


def test_a_stored_diagram_is_that_of_the_result(reopened):
    result = campbell()
    again = reopened(result)
    xr.testing.assert_identical(again.data, result.data)
    assert again.plot(width=180).get_figwidth() == pytest.approx(180 / 25.4)
    assert len(again.plot(panel="frequency").axes) == 1


def test_a_wheel_has_bands_with_their_ends():
    # 31 nodal diameters are a band with two lines, its ends, and their numbers; those of a pair are single lines.
    modes = [mode("apart", "x", f"nodal diameter {n}", 100.0 + n) for n in range(31)]
    axes = axes_of(modes=modes)
    level = [
        float(line.get_ydata()[0]) for line in axes.lines if len(line.get_xdata()) and not np.ptp(line.get_ydata())
    ]
    assert {100.0, 130.0} <= set(level)
    assert 115.0 not in level
    told = texts(axes.figure)
    assert all(words in told for words in ("ND 0", "ND 30", "bending along x"))
    assert len(axes.collections) == 1
    assert not axes_of().collections


def test_all_orders_of_the_drive_are_bold():
    speeds = {"speed": 1450 * RPM, "start": 0.0, "stop": 2000 * RPM, "drive_order": 4.0}
    figure = drawing("campbell", Campbell.of_modes(MODES, (2.0, 4.0, 8.0), speeds, harmonics=(1, 2)).data)
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts if text.get_weight() == "bold"} == {"4", "8"}
    assert "orders 4 and 8, the drive's" in texts(figure)
