"""The data sheet of a scene."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli import commands as cli

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
        ([*SMALL, "drive.F_0=1e4"], ["bending along x: a free block moves by", "gaps: check the unit"]),
        ([*SMALL, "blades.c_x=0.2"], ["232 mm at resonance"]),
        ([*SMALL, "shroud.gap=1 um"], ["gaps: check the unit of shroud.gap"]),
        (['parts.motion=["x"]'], []),
    ],
)
def test_doubts(overrides, doubts):
    told = js.check(js.load("table1", overrides)).doubts
    assert len(told) == len(doubts)
    for text, start in zip(told, doubts, strict=True):
        assert text.startswith(start) or start in text


def test_the_command_prints_the_sheet(capsys):
    assert cli.main(["check", "table1"]) == 0
    told = capsys.readouterr().out
    for words in ("177.94", "99.1 times", "check the unit of drive.M_0", "455 steps a period"):
        assert words in told
