"""The line of a sweep with amplitudes: where the largest one is, of which blade, and the smallest P_d."""

import numpy as np
import pytest
from command_line import read_json, run

import jaxshroud as js
from jaxshroud.io.scene_numbers import key_attrs
from jaxshroud.model.modes import Status
from jaxshroud.results.extremes import largest_amplitude, passed_sides, smallest_reduction
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.units import RPM

RING, PAIR = js.load("row_ring12").text(), js.load("table1").text()
SPEEDS = np.array([1550.0, 1750.0, 1800.0])


def swept(peaks, free, *, P_d=(50.0, 50.0, 50.0), ci=0.0, scene=RING, key="drive.speed", values=SPEEDS / RPM, **more):
    """A sweep along a number with these amplitudes of x (lanes, blades) [m] and reductions [%]."""
    given = {
        "status": np.zeros(len(values), int),
        "P_d": np.array(P_d),
        "P_d_vibration": np.array(P_d),
        "settling": np.ones(len(values), int),
        "settled": np.ones(len(values), bool),
        "period_number": np.ones(len(values), int),
        **{name: np.zeros(len(values)) for name in ("periods_more", "periods_to_keep", "P_d_settled", "P_d_ci_short")},
        "x_peak": np.array(peaks),
        "x_free": np.array(free),
        **more,
    }
    given |= {f"{name}_ci": np.full(len(values), ci) for name in ("P_d", "P_d_vibration")}
    coords = {"number": ("number", values, key_attrs(key)), "period": range(4)}
    return SweepResult.from_values(given, lanes=("number",), coords=coords, attrs={"scene": scene})


def ring(largest, blades):
    """Amplitudes of a ring of 12 (lanes, blades): 1 mm, but those of some blades of the second lane."""
    levels = np.full((3, 12), 1e-3)
    levels[1, blades] = largest
    return levels


FREE = np.array([23.2e-3, 5e-3, 2e-3])[:, None]


def test_the_largest_amplitude_is_told_with_its_place_its_blade_and_that_without_contact():
    result = swept(ring(4.438e-3, [7]), FREE * np.ones(12), settling=np.array([1, 0, 1]))
    told = largest_amplitude(result, "x_peak")
    want = "4.44 mm at 1750 rpm (blade 7), transient not over; without contact 23.2 mm at 1550 rpm"
    assert (told.name, told.words) == ("largest amplitude of x", want)
    summary = result.summary()["largest amplitude of x"]
    assert summary["drive.speed [rpm]"] == 1750
    assert summary["amplitude [m]"] == 4.438e-3
    assert (summary["blades"], summary["settled"]) == (["7"], False)
    assert summary["without contact"] == {"amplitude [m]": 23.2e-3, "drive.speed [rpm]": 1550}
    # Control: of a settled lane nothing is said of its transient; of one that may not be, no more than that.
    assert "transient" not in largest_amplitude(swept(ring(4e-3, [7]), FREE * np.ones(12)), "x_peak").words
    unknown = swept(ring(4e-3, [7]), FREE * np.ones(12), settling=np.array([1, 2, 1]))
    assert "(blade 7), transient perhaps not over;" in largest_amplitude(unknown, "x_peak").words


@pytest.mark.parametrize(
    ("blades", "named"),
    [([2, 5, 8, 11], "blades 2, 5, 8, 11"), (range(12), "all blades"), (range(8), "blade 0 and 7 others")],
)
def test_blades_that_swing_alike_are_named_together(blades, named):
    assert f"({named});" in largest_amplitude(swept(ring(4e-3, [*blades]), FREE * np.ones(12)), "x_peak").words


def test_blades_of_a_pair_are_left_and_right():
    free = FREE * np.ones(2)
    assert "(right blade)" in largest_amplitude(swept([[1e-3, 2e-3]] * 3, free, scene=PAIR), "x_peak").words
    assert "(both blades)" in largest_amplitude(swept([[2e-3, 2e-3]] * 3, free, scene=PAIR), "x_peak").words
    # Where the left one alone counts, as in a response, it is the left one.
    of_left = largest_amplitude(swept([[1e-3, 2e-3]] * 3, free, scene=PAIR), "x_peak", slice(1))
    assert (of_left.value, of_left.blades) == (1e-3, ("left",))


def test_lanes_that_stopped_have_no_largest_amplitude_but_one_without_contact():
    stopped = np.array([Status.OK, Status.NOT_FINITE, Status.OK])
    free = FREE[::-1] * np.ones(12)
    told = largest_amplitude(swept(ring(9e-3, [7]), free, status=stopped), "x_peak")
    assert told.words == "1 mm at 1550 rpm (all blades); without contact 23.2 mm at 1800 rpm"
    assert largest_amplitude(swept(ring(9e-3, [7]), free, status=np.full(3, Status.NOT_FINITE)), "x_peak") is None


def test_a_number_without_a_unit_is_named():
    result = swept(ring(4e-3, [7]), FREE * np.ones(12), key="contact.gamma", values=np.array([1.0, 2.0, 4.0]))
    assert largest_amplitude(result, "x_peak").words.startswith("4 mm at contact.gamma = 2 (blade 7)")


@pytest.mark.parametrize(
    ("P_d", "vibration", "ci", "worse"),
    [
        ((50.0, 40.0, -723.0), -723.0, 3.5, True),
        ((50.0, 40.0, -2.0), -2.0, 3.5, False),  # the interval reaches beyond 0
        ((50.0, 40.0, -2.0), -2.0, np.nan, False),  # or is not known
        ((50.0, 40.0, -80.0), 20.0, 3.5, False),  # interference bends the blades; it does not make them vibrate
        ((50.0, 40.0, 10.0), 10.0, 0.0, False),
    ],
)
def test_contact_makes_it_worse_where_the_vibration_is_larger_by_more_than_its_interval(P_d, vibration, ci, worse):
    of_vibration = np.array([*P_d[:2], vibration])
    result = swept(ring(4e-3, [7]), FREE * np.ones(12), P_d=P_d, ci=ci, P_d_vibration=of_vibration)
    told = smallest_reduction(result, "P_d")
    assert told["contact makes it worse"] is worse
    assert told["words"].endswith("at 1800 rpm: contact makes it worse" if worse else "at 1800 rpm")
    assert result.summary()["smallest P_d"]["P_d"] == P_d[-1]


def test_an_amplitude_beyond_the_side_of_its_own_block_is_warned_of():
    # Blocks of 50 mm, and of 20, 45 and 80 mm where their side is swept: the share of the side counts.
    assert not list(passed_sides(swept([[49e-3, 0]] * 3, FREE * np.ones(2), scene=PAIR)))
    (line,) = passed_sides(swept([[51e-3, 0]] * 3, FREE * np.ones(2), scene=PAIR))
    assert line.startswith("the amplitude of x is 51 mm at 1550 rpm, more than the block's side of 50 mm")
    sides = {"scene": PAIR, "key": "shroud.l_oa", "values": np.array([0.02, 0.045, 0.08])}
    (line,) = passed_sides(swept([[21e-3, 0], [46e-3, 0], [70e-3, 0]], FREE * np.ones(2), **sides))
    assert "21 mm at 20 mm, more than the block's side of 20 mm" in line
    # The other side is along the faces.
    upright = swept([[0, 0]] * 3, FREE * np.ones(2), scene=PAIR, y_peak=np.full((3, 2), 36e-3))
    assert ["the block's side of 35 mm" in line for line in passed_sides(upright)] == [True]


def test_the_command_prints_the_line_and_warns(tmp_path, capsys):
    strong = "--set parts.motion=[x] --set drive.F_0=3e4"
    short = "--periods 2 --transient 0 --steps-per-period 100 --amplitudes"
    run(f"sweep table1 {strong} --along drive.omega --values 500,536 {short} --out {tmp_path}")
    told = capsys.readouterr()
    largest = read_json(tmp_path / "summary.json")["largest amplitude of x"]
    (row,) = (line for line in told.out.splitlines() if line.startswith("largest amplitude of x"))
    assert largest["words"].startswith(row.removeprefix("largest amplitude of x").strip()[:30])
    assert "transient" in largest["words"]
    assert "smallest P_d" in told.out
    assert "largest amplitude of x [m]" not in told.out  # it is in the line, and a number of summary.json
    assert "largest amplitude of y " not in told.out  # which these blades lack
    assert "warning: the amplitude of x is" in told.err
