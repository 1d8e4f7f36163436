"""Data sheets of rows of blades: natural modes by nodal diameter, what engine orders excite, and doubts."""

import numpy as np
import pytest
from command_line import read_json, run, sets

import jaxshroud as js
from jaxshroud.scene.units import RPM
from jaxshroud.verbs.sheet_tables import lines_of, shown_modes

RING = ["row.blades=4", "contact.gamma=2.5", 'parts.motion=["x", "y"]', "drive.engine_order=1"]


def frequencies(sheet, contact, motion):
    """Label -> natural frequency of the modes of one motion."""
    modes = [mode for mode in sheet.modes if (mode.contact, mode.motion) == (contact, motion)]
    return {mode.blades: mode.frequency for mode in modes}


@pytest.fixture(scope="module")
def sheet():
    return js.check(js.load("row_ring12", RING))


def test_a_tuned_ring_has_the_modes_of_travelling_waves(sheet):
    # Closed form: D_h = K + 4 sin^2(pi h / N) K_c; Table 1 with gamma 2.5 and N = 4, to the digits printed.
    for motion, want in (("x", (177.94, 522.69, 688.04)), ("y", (974.62, 1224.71, 1446.13))):
        found = frequencies(sheet, "stuck", motion)
        assert [*found] == ["nodal diameter 0", "nodal diameter 1", "nodal diameter 2"]
        np.testing.assert_allclose([*found.values()], want, rtol=0, atol=0.006)
    assert frequencies(sheet, "apart", "x") == {"each blade": pytest.approx(177.94, abs=0.006)}


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_an_engine_order_excites_its_own_nodal_diameter_alone(order):
    told = js.check(js.load("row_ring12", [*RING, f"drive.engine_order={order}"]))
    own = f"nodal diameter {min(order % 4, -order % 4)}"
    stuck = [mode for mode in told.modes if mode.contact == "stuck"]
    assert sum(mode.driven for mode in stuck) == pytest.approx(1)
    # The drive's load on another diameter vanishes by symmetry, to rounding.
    assert all(mode.driven < 1e-25 for mode in stuck if mode.blades != own)
    of_drive = [c for c in told.crossings if c.contact == "stuck" and c.engine_order == order]
    assert of_drive
    assert all(c.excited == c.mode.endswith(own) for c in of_drive)


def test_a_chain_of_two_has_the_modes_of_the_pair():
    chain = js.check(js.load("row_ring12", ["row.blades=2", "row.closed=false", "drive.engine_order=1"]))
    pair = js.check(js.load("table1", ['blades.I="block"', "contact.gamma=2.6"]))
    for contact in ("sliding", "stuck", "corner"):
        one, other = ([m.frequency for m in of.modes if m.contact == contact] for of in (chain, pair))
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_unlike_blades_and_interfaces_are_told_one_by_one(capsys):
    run(f"check row_chain5 {sets('parts.motion=[x]', 'shroud.gap[2]=5 mm')}")
    out = capsys.readouterr().out
    assert all(f"bending along x, blade {i}" in out for i in range(5))
    assert "0.015 to 5 mm" in out
    assert "interface 2: the free blades do not come near enough to touch" in " ".join(out.split())


@pytest.mark.full
def test_the_sheet_of_a_ring_is_written_and_drawn(sheet, tmp_path, capsys):
    run(f"check row_ring12 {sets(*RING)} --out {tmp_path}")
    assert "bending along x, each blade" in capsys.readouterr().out
    stored = js.open(tmp_path / "check.nc")
    np.testing.assert_allclose(stored.frequency, [mode.frequency for mode in sheet.modes])
    assert stored.excited.shape == stored.margin.shape
    assert (tmp_path / "check.json").exists()
    assert (tmp_path / "check.png").exists()


@pytest.mark.full
@pytest.mark.parametrize("mistuned", [False, True])
def test_the_sheet_of_many_blades_is_a_page(mistuned, tmp_path, capsys):
    # A page has some 60 lines; what is left out is counted, and in the file. What stays is what the drive excites.
    pattern = ["row.mistuning=[" + ",".join(f"{0.001 * (i % 7 - 3)}" for i in range(60)) + "]"] * mistuned
    changes = ["row.blades=60", 'parts.motion=["x"]', *pattern]
    run(f"check row_ring12 {sets(*changes)} --out {tmp_path}")
    out = capsys.readouterr().out
    assert 15 < len(out.splitlines()) <= 60
    sheet = js.check(js.load("row_ring12", changes))
    assert len(read_json(tmp_path / "check.json")["modes"]) == len(sheet.modes) > 60
    shown = shown_modes(sheet)
    assert f"{len(sheet.modes) - len(shown)} of {len(sheet.modes)} modes" in out
    assert "--out DIR writes all" in out
    if mistuned:
        assert all(f"{which}: blade" in out for which in ("lowest", "highest"))
        left = [mode.driven for mode in sheet.modes if mode not in shown]
        assert max(left) <= min(mode.driven for mode in shown)
    else:
        assert {mode.blades for mode in shown} == {"each blade", "nodal diameter 3"}
        assert all(mode.driven < 1e-9 for mode in sheet.modes if mode not in shown)  # the order does no work on these


def test_faces_that_open_with_speed_are_told_with_the_speed():
    # The interfaces of a ring of alike blades are pressed while their gap is negative: it is -5 um + 25 um (n / 900)^2
    # at n rpm, up to 900 / sqrt(5) rpm.
    untwist = ["shroud.gap=-5um", "shroud.gap_at=20um", "shroud.gap_at_speed=900 rpm", 'parts.motion=["x"]']
    ring, opens = js.load("row_ring12", [*RING, *untwist]), f"{900 / np.sqrt(5):.0f} rpm"
    told = lines_of(js.check(ring))["faces"]
    assert told.startswith(f"pressed together up to {opens}: stuck modes count there, modes apart elsewhere; once")
    assert "the largest amplitude with contact may be at none of these crossings" in told
    # Control: of faces that are pressed up to the end of the range nothing more is said.
    told = lines_of(js.check(ring, stop=400 / RPM))["faces"]
    assert told == "pressed together up to 400 rpm: stuck modes count there, modes apart elsewhere"
