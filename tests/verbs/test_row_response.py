"""Responses of rows: peaks against closed forms and the pair, broken waves, stores and pictures."""

import io
from contextlib import redirect_stdout

import numpy as np
import pytest
from command_line import refused, run, sets
from numpy.testing import assert_allclose, assert_array_equal
from row_runs import CHAIN_OF_TWO, PAIR

import jaxshroud as js
from jaxshroud.cli.orbits import _blades_text
from jaxshroud.plotting.plot_amplitude import BROKEN_STYLE
from jaxshroud.plotting.plot_branch import MARKERS
from jaxshroud.scene import layout
from jaxshroud.scene.quantities import counted_amplitude
from jaxshroud.verbs.response import _places

METHOD = js.RungeKutta("dopri8", steps=60)
IN_X = 'parts.motion=["x"]'
DAMPED = [IN_X, "blades.c_x=40"]
RING = [*DAMPED, "row.blades=4", "drive.engine_order=1"]
STUCK = [*RING, "shroud.gap=-1mm", "drive.F_0=6"]  # pressed together so that no face parts or slips
SHORT = {"n_periods": 4, "transient": 40, "method": METHOD}


def oscillator(scene, diameter, share=1.0):
    """Place, amplitude and half-power values of the peak of one blade's x in a linear ring, by Eq. (1).

    The blade has that share of the stiffness k_x.
    """
    number = lambda a: float(np.ravel(a)[0])
    alpha, blades = number(scene.shroud.alpha), scene.blades
    stiffness = number(scene.k) * np.sin(alpha) ** 2 + number(scene.friction.k_d) * np.cos(alpha) ** 2
    k = share * number(blades.k_x) + 4 * np.sin(np.pi * diameter / scene.row.blades) ** 2 * stiffness
    m, c, F = number(blades.m), number(blades.c_x), number(scene.drive.F_0) * np.cos(number(scene.drive.beta))
    zeta, omega = c / (2 * np.sqrt(k * m)), np.sqrt(k / m)
    top = F / k / (2 * zeta * np.sqrt(1 - zeta**2))
    ends = omega * np.sqrt(1 - 2 * zeta**2 + np.array([-1, 1]) * 2 * zeta * np.sqrt(1 - zeta**2))
    return omega * np.sqrt(1 - 2 * zeta**2), top, ends, zeta


@pytest.fixture(scope="module")
def stuck(tmp_path_factory):
    """What the command prints of a ring that sticks, and its result; the amplitude is the root mean square."""
    out, printed = tmp_path_factory.mktemp("stuck") / "out", io.StringIO()
    along = "--start 3200 --stop 3850 --num 2 --of x_rms --doublings 0"
    march = "--tableau dopri8 --steps-per-period 60 --periods 4 --transient 40"
    with redirect_stdout(printed):
        run(f"response row_ring12 {sets(*STUCK)} {along} {march} --out {out}")
    return printed.getvalue(), js.open(out / "response.nc")


@pytest.mark.full
def test_a_stuck_ring_peaks_at_the_frequency_of_its_nodal_diameter(stuck):
    _, found = stuck
    scene = js.load("row_ring12", STUCK).scene
    place, top, ends, zeta = oscillator(scene, diameter=1)
    (peak,) = found.peaks
    # An amplitude is flat at its top; its mean square is an integral of the march, of order 8 with 60 steps a period.
    assert peak["value"] == pytest.approx(place, rel=1e-5)
    assert peak["amplitude"] == pytest.approx(top / np.sqrt(2), rel=1e-7)
    assert (peak["low"], peak["high"]) == pytest.approx(ends, rel=1e-6)
    assert peak["zeta"] == pytest.approx(zeta, rel=zeta)  # the half-power rule itself is of first order
    assert found.branch().is_wave.all()
    assert found.branch().stable.all()
    # Control: the family of nodal diameter 0, that of blades apart, is far away.
    assert abs(oscillator(scene, diameter=0)[0] / place - 1) > 0.5


@pytest.mark.full
def test_the_command_tells_the_blades_that_swing_most(stuck):
    printed, found = stuck
    (row,) = (line for line in printed.splitlines() if " yes " in line)
    assert row.rstrip().endswith("all")
    assert found.peaks[0]["blades"] == [0, 1, 2, 3]
    levels = np.array([[3.0, 1.0, 3.0 * (1 - 1e-9), 2.0]])
    told = js.Response(found.data.assign(peak_blades=(("peak", "blade"), levels)))
    assert [peak["blades"] for peak in told.peaks] == [[0, 2]]
    assert _blades_text(told, [0, 2]) == "0, 2"


@pytest.mark.release
@pytest.mark.full
def test_a_mistuned_ring_apart_peaks_where_its_softest_blade_does():
    scene = js.load("row_ring12", [*RING, "shroud.gap=1m", "row.mistuning=[0,-0.2,0,0]"]).scene
    place, top, _, _ = oscillator(scene, diameter=0, share=0.8)
    found = js.response(scene, "drive.omega", 0.95 * place, 1.1 * place, num=2, **SHORT)
    (peak,) = found.peaks
    assert peak["value"] == pytest.approx(place, rel=1e-5)  # flat at its top
    # Between 60 steps the displacement is a cubic, whose height is off by (2 pi / 60)^4 / 384 = 3e-7.
    assert peak["amplitude"] == pytest.approx(top, rel=1e-6)
    assert (peak["shift"], peak["ratio"]) == pytest.approx((0, 1), abs=1e-5)
    assert peak["blades"] == [1]
    assert not found.branch().wave_parts.any()
    # Control: the left blade, which counts in a pair, peaks elsewhere.
    assert abs(oscillator(scene, diameter=0)[0] / place - 1) > 0.1


@pytest.fixture(scope="module")
def chain():
    along = ("contact.gamma", 2.0, 3.0)
    return js.response(js.load("row_ring12", DAMPED + CHAIN_OF_TWO).scene, *along, num=3, most_points=8, **SHORT)


@pytest.mark.release
@pytest.mark.full
def test_a_chain_of_two_responds_like_the_pair(chain):
    pair = js.response(
        js.load("table1", DAMPED + PAIR).scene, "contact.gamma", 2.0, 3.0, num=3, most_points=8, doublings=1, **SHORT
    )
    assert len(chain.peaks) == len(pair.peaks)
    ours, theirs = chain.branch(), pair.branch()
    # Both close to 1e-9, and their steps are the same.
    assert_allclose(ours.value, theirs.value, rtol=1e-7)
    assert_allclose(ours.x_peak, theirs.x_peak, rtol=1e-7)
    assert ours.ends == theirs.ends
    assert_allclose(chain.free_amplitude, pair.free_amplitude, rtol=1e-12)
    # P_d of a row is that of both blades: in anti-phase that of the left one. Control: not that of the other end.
    assert_allclose(ours.P_d, theirs.P_d, rtol=1e-7)
    assert abs(ours.P_d[0] / theirs.P_d[-1] - 1) > 1e-3


def test_the_amplitude_of_a_row_is_that_of_its_largest_blade():
    levels = np.array([[1.0, 3.0, 2.0], [4.0, 1.0, np.nan]])
    assert_array_equal(counted_amplitude(levels, layout.row_layout(3, closed=True)), [3.0, np.nan])
    assert_array_equal(counted_amplitude(levels, layout.PAIR), [1.0, 4.0])


@pytest.fixture(scope="module")
def broken():
    """The ring of four in anti-phase, past where its shift breaks, and the broken wave that begins there."""
    scene = js.load("row_ring12", [IN_X, "row.blades=4", "drive.engine_order=2", "drive.omega=920"]).scene
    how = {"n_periods": 4, "transient": 200, "method": METHOD, "most_points": 30}
    return js.response(scene, "drive.omega", 920.5, 924.2, num=2, **how)


@pytest.mark.release
@pytest.mark.full
def test_a_broken_branch_is_followed_to_where_sweeps_settle(broken):
    branch, swept = broken.branch(), broken.sweep()
    (one,) = (one for one in branch.special if one.kind == "localisation")
    assert branch.ends == [("start", "stop"), ("localisation", "stop")]
    waves, others = (np.flatnonzero(branch.branch == b) for b in (0, 1))
    assert branch.is_wave[waves].all()
    assert not branch.is_wave[others].any()
    assert broken.values[0] < one.value < broken.values[1]
    # Both branches end at the last value, where the sweeps from rest and upwards are on the broken one.
    wave, last = (branch.x_peak[points[-1]] for points in (waves, others))
    settled = counted_amplitude(swept.x_peak, layout.row_layout(swept.x_peak.shape[-1], closed=True))[:2, -1]
    assert_allclose(settled, last.max(), rtol=1e-3)  # what is left of the transient
    # Controls: neither the wave nor the mean of all blades is there.
    assert abs(wave.max() / last.max() - 1) > 0.1
    assert abs(last.mean() / last.max() - 1) > 0.1


@pytest.mark.release
@pytest.mark.full
def test_the_response_of_a_row_is_stored_and_drawn_again(broken, reopened):
    again = reopened(broken)
    assert again.summary() == broken.summary()
    ours, theirs = again.branch(), broken.branch()
    assert isinstance(ours, js.Branch)
    assert (ours.ends, ours.special, ours.summary()) == (theirs.ends, theirs.special, theirs.summary())
    for name in ("P_d_worst", "wave_multipliers", "x_peak", "u_s"):
        assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert len(ours.plot().axes) == 3
    amplitude, _ = again.plot().axes
    assert amplitude.get_ylabel().startswith("largest amplitude of $x$")
    looks = [line.get_color() for line in amplitude.lines if line.get_linestyle() in ("-", "--")]
    assert {BROKEN_STYLE["color"]} < {*looks}
    (mark,) = (
        line for line in amplitude.lines if line.get_marker() == MARKERS["localisation"][0] and line.get_xdata().size
    )
    (one,) = (one for one in ours.special if one.kind == "localisation")
    assert_allclose(mark.get_xdata(), one.value)
    assert_allclose(mark.get_ydata(), 1e3 * ours.x_peak[one.point].max())  # mm


@pytest.mark.full
def test_a_wave_is_begun_with_where_there_is_one(broken):
    data = broken.sweep().data
    swept = js.SweepResult(data.assign(settled=1 + 0 * data["settled"], period_number=1 + 0 * data["period_number"]))
    wave, other = broken.values.tolist()
    assert _places(swept, broken.values, own=other, layout=layout.row_layout(data.sizes["blade"], True)) == [
        wave,
        other,
    ]
    # Control: by the distance alone, as for a pair.
    assert _places(swept, broken.values, own=other, layout=layout.PAIR) == [other, wave]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--set parts.contact=none", "many single blades"),
        ("--over shroud.gap[9]=1um", "shroud.gap[9]"),
        ("--at 5000", "drive.omega"),
    ],
)
def test_what_a_row_cannot_do_is_refused_in_one_line(words, told, tmp_path, capsys):
    line = f"response row_ring12 {sets(*RING)} --start 500 --stop 600 --num 2 {words} --out {tmp_path}/out"
    assert told in refused(capsys, line)
