"""The data sheet of a scene."""

import json

import numpy as np
import pytest
from command_line import read_json, refused, run

import jaxshroud as js
from jaxshroud.results.data_sheet import Campbell
from jaxshroud.scene.config import parse

SMALL = ["blades.I=2.46e-5", "blades.c_T=0.01", "drive.M_0=0.1"]


def test_the_sheet_tells_what_the_numbers_mean():
    # By hand: sqrt(k/m)/2 pi, c / 2 sqrt(k m), F cos(beta) / k, and F / (c omega_n) at resonance.
    sheet = js.check(js.load("table1"))
    x = sheet.coordinates["x"]
    assert x.frequency == pytest.approx([np.sqrt(1e5 / 0.08) / (2 * np.pi)] * 2, rel=1e-12)
    assert x.zeta == pytest.approx([3.57 / (2 * np.sqrt(1e5 * 0.08))] * 2, rel=1e-12)
    force = 60 * np.cos(np.pi / 6)
    assert x.static == pytest.approx([force / 1e5] * 2, rel=1e-12)
    assert x.resonant == pytest.approx([force / (3.57 * np.sqrt(1e5 / 0.08))] * 2, rel=1e-12)
    dynamic = force / np.hypot(1e5 - 0.08 * 536**2, 3.57 * 536)
    assert x.amplitude == pytest.approx([dynamic] * 2, rel=1e-12)
    # The longer diagonal of a parallelogram of 50 mm and 35 mm whose acute angle is 60 degrees, by the cosine rule.
    diagonal = np.sqrt(0.05**2 + 0.035**2 + 0.05 * 0.035)
    assert sheet.corner == pytest.approx(np.array(sheet.coordinates["theta"].amplitude) * diagonal / 2, rel=1e-12)
    assert sheet.gamma == pytest.approx(2.5)
    assert sheet.inertia == pytest.approx([2.46e-3 / (0.08 * (0.05**2 + 0.035**2) / 12)] * 2, rel=1e-12)


def test_the_free_blades_approach_as_their_steady_motion_does():
    # Along the normal, divided by sin(alpha): as a gap along x, which it closes. The steady motion is sampled here.
    sheet = js.check(js.load("table1"))
    phase = [np.angle(1 / (k - 0.08 * 536.0**2 + 1j * c * 536.0)) for c, k in ((3.57, 1e5), (19.6, 3e6))]
    tau, alpha = np.linspace(0, 2 * np.pi, 100_001), np.pi / 3
    x, y = (2 * sheet.coordinates[n].amplitude[0] * np.sin(tau + p) for n, p in zip("xy", phase, strict=True))
    assert sheet.approach == pytest.approx(np.max(x - y / np.tan(alpha)), rel=1e-6)


@pytest.mark.parametrize(
    ("overrides", "doubts"),
    [
        ([], ["M_0 turns", "I is 99.1 times"]),
        (SMALL, []),
        ([*SMALL, "blades.c_T=0.6"], ["torsion is overdamped"]),
        ([*SMALL, "shroud.gap=5 mm"], ["do not come near enough"]),
        ([*SMALL, "blades.c_x=0"], ["bending along x has no damping"]),
        (
            [*SMALL, "drive.F_0=1e4"],
            [
                "bending along x: a free block moves by 112 mm, 2.17e+03 mm at resonance",
                "bending along y: a free block moves by 1.68 mm, 41.7 mm at resonance",
                "approach by 10131 gaps",
                "faces slide by 115 mm, 3.3 of their length",
            ],
        ),
        ([*SMALL, "blades.c_x=0.2"], ["232 mm at resonance"]),
        ([*SMALL, "shroud.gap=1 um"], ["check the unit of shroud.gap"]),
        ([*SMALL, "shroud.gap=8 um"], ["approach by 167 gaps"]),
        ([*SMALL, "shroud.gap=14 um"], []),  # 95 gaps
        (["blades.I=2.46e-5", "blades.c_T=0.01", "drive.M_0=400"], ["M_0 turns a free block's", "by 11.5 degrees"]),
        (['parts.motion=["x"]'], []),
    ],
)
def test_doubts(overrides, doubts):
    told = js.check(js.load("table1", overrides)).doubts
    assert len(told) == len(doubts)
    for text, start in zip(told, doubts, strict=True):
        assert text.startswith(start) or start in text


@pytest.mark.parametrize(
    ("overrides", "share"),
    [
        (["drive.phase=[0, 0]"], 100.0),
        (['drive.phase=["0 deg", "20 deg"]'], 100 * np.cos(np.radians(10)) ** 2),
        (['drive.phase=["0 deg", "30 deg"]'], None),  # 93 %
        ([], None),  # opposite phases
        (["drive.phase=[0, 0]", "blades.I=2.46e-5", "drive.M_0=9"], None),  # torsion in phase turns corners together
        (["drive.phase=[0, 0]", "blades.m=[0.08, 0.3]"], None),  # blades that differ part all the same
        (["drive.phase=[0, 0]", 'parts.neighbour="rigid"'], None),
    ],
)
def test_a_pair_in_phase_is_no_wheel(overrides, share):
    sheet = js.check(js.load("table1", ["drive.M_0=0", *overrides]))
    told = [line for line in sheet.doubts if "in phase" in line]
    assert len(told) == (share is not None)
    if share is not None:
        assert 100 * sheet.in_phase == pytest.approx(share, rel=1e-9)
        assert told[0].startswith(f"{share:.3g} % of the motion of the free blades is in phase")
        assert "contact hardly acts, and a pair is no wheel" in told[0]


def test_the_command_prints_the_sheet(capsys):
    run("check table1")
    told = capsys.readouterr().out
    for words in ("177.94", "99.1 times", "check the unit of drive.M_0", "455 steps a period"):
        assert words in told


DESIGNER = """
[blades]
m = "0.12 kg"
I = "block"
f_x = "95 Hz"
f_y = "520 Hz"
f_T = "380 Hz"
zeta_x = "0.3 %"
zeta_y = "0.3 %"
zeta_T = "0.3 %"
[shroud]
alpha = "55 deg"
l_oa = "60 mm"
l_ab = "30 mm"
gap = "0.05 mm"
[contact]
k = "2e6 N/m"
[friction]
k_d = "2e6 N/m"
mu = 0.25
[drive]
f = "96.6666666667 Hz"
F_0 = "25 N"
M_0 = 0
phase = ["0 deg", "180 deg"]
beta = "30 deg"
[run]
periods = 64
"""
RPM = 2 * np.pi / 60  # rad/s


def designer(*overrides):
    """A blade given by its frequencies, driven by engine order 4 at 1,450 rpm."""
    return parse(DESIGNER, "designer.toml", overrides)


def test_what_is_doubtful_of_a_lightly_damped_blade_is_doubted():
    # 14 mm at the drive's frequency and 84 mm at resonance, with blocks of 60 mm; the faces approach by 564 gaps.
    told = js.check(designer()).doubts
    starts = ("bending along x: a free block moves by 14.1 mm, 84.4 mm at", "the drive is 1.8 % above bending along x")
    starts += ("the free faces approach by 564 gaps", "the free faces slide by 16.2 mm, 0.54 of their length")
    assert len(told) == len(starts)
    assert all(text.startswith(start) for text, start in zip(told, starts, strict=True))


@pytest.mark.parametrize(
    ("f", "words"),
    [
        (95.0, "at the resonance of bending along x, either blade, apart"),
        (94.72, "at the resonance"),  # 0.295 % below, and the half-power band ends at 0.3 %
        (94.70, "0.32 % below bending along x"),
        (90.6, "4.6 % below"),
        (90.0, None),  # 5.3 %
        (485.0, "0.66 % above bending along y, out of phase, stuck (481.84 Hz)"),
        (380.0, None),  # torsion, which M_0 = 0 does not drive
    ],
)
def test_a_drive_near_a_natural_frequency_that_it_excites_is_doubted(f, words):
    told = [text for text in js.check(designer(f"drive.f={f} Hz")).doubts if text.startswith("the drive is")]
    assert len(told) == (words is not None)
    assert words is None or words in told[0]


def test_engine_orders_meet_natural_frequencies_at_speeds_by_hand():
    # Order e meets f at 60 f / e rpm; the margin is that of 1,450 rpm, where order 4 has the drive's frequency.
    sheet = js.check(designer(), engine_orders=[4, 3, 5])
    assert sheet.speed == pytest.approx(1450 * RPM)
    assert (sheet.drive_order, sheet.is_own_order, sheet.engine_orders) == (4.0, False, (3.0, 4.0, 5.0))
    apart = [crossing for crossing in sheet.crossings if crossing.contact == "apart"]
    assert [crossing.speed / RPM for crossing in apart] == pytest.approx([60 * 95 / e for e in (5, 4, 3)])
    assert [crossing.margin for crossing in apart] == pytest.approx([100 * (1450 * e / 5700 - 1) for e in (5, 4, 3)])
    assert sheet.stop == pytest.approx(1.5 * 1450 * RPM)
    wide = js.check(designer(), engine_orders=[4], start=7000 * RPM, stop=8000 * RPM)
    assert [crossing.mode for crossing in wide.crossings if crossing.contact == "apart"] == [
        "bending along y, either blade"
    ]


def test_the_range_of_speeds_reaches_the_lowest_modes():
    # Of table1 the lowest ones are at 1.7 times the drive's frequency apart and at 1.9 times it stuck.
    sheet = js.check(js.load("table1"))
    assert sheet.engine_orders == (1.0,)
    assert sheet.speed == pytest.approx(536)
    assert {crossing.contact for crossing in sheet.crossings} >= {"apart", "stuck"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        *(({"engine_orders": orders}, "must be positive numbers") for orders in ([], [0, 1], [np.nan], [np.inf])),
        ({"engine_orders": range(1, 200)}, "at most 100 numbers"),
        ({"engine_orders": "1"}, "engine_orders"),
        ({"start": 10.0, "stop": 10.0}, "must be a range from 0 on"),
        ({"start": -1.0}, "must be a range from 0 on"),
        *(({"stop": stop}, "must be a range from 0 on") for stop in (np.inf, np.nan)),
    ],
)
def test_orders_and_ranges_that_are_none_are_refused(arguments, words):
    with pytest.raises(js.InputError, match=words):
        js.check(js.load("table1"), **arguments)


def test_the_command_writes_the_sheet_and_its_picture(tmp_path, capsys):
    words = f"check table1 --engine-orders 2..4 --stop 6000rpm --out {tmp_path}/sheet"
    run(words)
    told = capsys.readouterr().out
    files = "check.nc, check.json, check.png"
    assert all(text in told for text in ("without centrifugal stiffening", "torsion, either blade", "4305.2", files))
    written = read_json(tmp_path / "sheet" / "check.json")
    assert [mode["contact"] for mode in written["modes"][:3]] == ["apart"] * 3
    assert {crossing["engine_order"] for crossing in written["crossings"]} == {2.0, 3.0, 4.0}
    again = js.open(tmp_path / "sheet" / "check.nc")
    assert isinstance(again, Campbell)
    assert again.crossing_speed.shape == (len(written["modes"]), 3)
    assert again.crossing_speed[0] == pytest.approx(2 * np.pi * again.frequency[0] / np.array([2, 3, 4]))
    assert repr(again) == "Campbell of 19 families and 3 engine orders"
    assert json.dumps(again.summary(), allow_nan=False)
    assert "exists and is kept" in refused(capsys, words)
    run(f"{words} --force")
    run(f"plot {tmp_path}/sheet")
