"""Tables of designs: rows are the runs of their scenes, wrong rows are marked, wrong tables refused in one line."""

import csv

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from command_line import refused, run

import jaxshroud as js
from jaxshroud.cli import design as command
from jaxshroud.results.table import DesignTable
from jaxshroud.scene.csv_text import read_csv
from jaxshroud.scene.designs import read_designs
from jaxshroud.verbs.table import checked_designs

SMALL = ['parts.motion=["x"]', "run.periods=4", "run.transient=4", "run.steps_per_period=100"]
MARCH = dict(n_periods=4, transient=4, method=js.RungeKutta(steps=100))
GAPS, FRICTION = [10.0, 22.0, 40.0], [0.3, 0.5, 0.1]


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", SMALL).scene


@pytest.fixture(scope="module")
def found(scene):
    cells = {"name": ["a", "b", "c", "d"], "shroud.gap [um]": [*GAPS, "wide"], "friction.mu": [*FRICTION, 0.3]}
    with pytest.warns(js.LaneWarning, match="1 of 4 lanes ended with BAD_INPUT"):
        return js.table(scene, cells, **MARCH)


@pytest.mark.full
def test_a_row_has_the_numbers_of_its_scene(scene, found):
    scenes = js.scenes_from({"shroud.gap": 1e-6 * np.array(GAPS), "friction.mu": FRICTION}, scene)
    swept = js.sweep(scenes, forces=True, amplitudes=True, **MARCH)
    # one program with the same numbers, but units by decimals: gaps may differ by a rounding, which 8 periods of
    # impacts magnify some 100 times
    for name in ("P_d", "x_peak", "N_max", "friction_work", "time_slip", "v_max"):
        np.testing.assert_allclose(getattr(found, name)[:3], getattr(swept, name), rtol=1e-10, err_msg=name)
    # control: the rows of other designs differ by far more
    assert np.abs(np.diff(found.P_d[:3])).min() > 1e-3


def test_a_wrong_row_is_marked_and_no_other_is_affected(found):
    assert found.status.tolist() == [js.Status.OK] * 3 + [js.Status.BAD_INPUT]
    assert found.reason[3] == 'shroud.gap = "wide" is not a number with a unit'
    assert found.verdict[3] == "not run"
    assert np.isnan(found.P_d[3])
    assert found.rank[3] == 0


def test_ranks_follow_the_numbers_and_rows_without_one_come_last(found):
    assert found.rank[:3].tolist() == (np.argsort(np.argsort(-found.P_d[:3])) + 1).tolist()
    frame = found.ranked
    assert frame["rank"].tolist()[:3] == [1, 2, 3]
    assert frame["rank"].isna().tolist() == [False] * 3 + [True]
    assert sorted(frame["name"]) == ["a", "b", "c", "d"]


def test_equal_designs_share_a_rank_and_loads_rank_upwards(scene):
    found = js.table(scene, {"shroud.gap [um]": [22, 10, 22]}, by="x_peak", **MARCH)
    larger = found.x_peak.max(axis=-1)
    first = int(np.argmin(larger))
    assert found.rank[0] == found.rank[2]
    assert found.rank[first] == 1
    assert sorted(found.rank.tolist()) in ([1, 1, 3], [1, 2, 2])


def test_a_frame_a_dataset_and_a_mapping_give_the_same_designs(scene):
    mapping = {"shroud.gap [um]": GAPS, "friction.mu": FRICTION}
    dataset = xr.Dataset({"shroud.gap": ("n", GAPS, {"units": "um"}), "friction.mu": ("n", FRICTION)})
    expected = checked_designs(mapping, scene)
    assert expected.values[:, 0].tolist() == [1e-5, 2.2e-5, 4e-5]  # exact: units are decimals
    for table in (
        pd.DataFrame(mapping),
        dataset,
        {"shroud.gap": [f"{gap} um" for gap in GAPS], "friction.mu": FRICTION},
    ):
        got = checked_designs(table, scene)
        assert np.array_equal(got.values, expected.values), type(table)
    # control: without its unit the same column is in metres
    assert checked_designs(dataset.drop_attrs(), scene).values[0, 0] == 10.0


def test_what_frames_have_in_place_of_a_number_is_an_empty_cell(scene):
    frame = pd.DataFrame({"friction.mu": pd.array([0.3, None, 0.5], "Float64"), "shroud.gap": [1e-5, 2e-5, np.nan]})
    designs = checked_designs(frame, scene)
    assert designs.reasons == ("", "friction.mu is empty", "shroud.gap is empty")


def test_the_best_row_has_what_the_table_is_ranked_by(found):
    by_peak = DesignTable(found.data.assign_attrs(by="x_peak"))
    best = by_peak.summary()["best"]
    assert best["x_peak"] == found.x_peak[best["row"] - 1].max()
    assert "P_d" in best


def test_a_table_is_the_same_after_a_round_through_files(found, tmp_path, reopened):
    stored = reopened(found)
    xr.testing.assert_identical(stored.data, found.data)
    found.save(tmp_path / "t.csv")
    read = pd.read_csv(tmp_path / "t.csv", index_col="row")
    assert read["P_d [percent]"].tolist()[:3] == found.ranked["P_d [percent]"].tolist()[:3]
    assert read["name"].tolist() == found.ranked["name"].tolist()
    with pytest.raises(js.InputError, match=r"must end in \.csv"):
        found.save(tmp_path / "t.txt")


def test_a_table_of_excel_in_german_is_read(tmp_path, scene):
    path = tmp_path / "d.csv"
    path.write_bytes('Name;shroud.gap [mm];friction.mu\r\nBüchse;0,022;0,3\r\n"a;b";4e-2;0,5\r\n'.encode("utf-8-sig"))
    table = read_csv(path)
    designs = checked_designs(table.columns, scene, table.faults, table.decimal_comma)
    assert designs.values.tolist() == [[2.2e-5, 0.3], [4e-5, 0.5]]
    assert designs.cells[:, 0].tolist() == ["Büchse", "a;b"]


HOSTILE = ["3,4", " a ", "\t", "007", "1,50 €", 'say "a;b"', "two\nlines", "a\rb", "ß\u00a0", "'"]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_cells_come_back_byte_for_byte(separator, scene, tmp_path):
    # Cells of columns that are no keys, and of rows that are longer than the heads; a comma is no point there.
    rows = [[note, "0.3" if separator == "," else "0,3"] for note in HOSTILE]
    rows[1] += [" more ", "4,5"]
    with (tmp_path / "d.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, delimiter=separator).writerows([["the  note", "friction.mu"], *rows])
    table = read_csv(tmp_path / "d.csv")
    designs = checked_designs(table.columns, scene, table.faults, table.decimal_comma)
    assert designs.values[[0, *range(2, len(rows))], 0].tolist() == [0.3] * (len(rows) - 1)
    assert designs.reasons[1].startswith("the row has 4 cells")
    values = {"cells": designs.cells, "rank": np.arange(len(rows)) + 1, "status": np.zeros(len(rows), int)}
    coords = {"row": np.arange(len(rows)) + 1, "column": list(designs.heads)}
    DesignTable.from_values({**values, "by": "P_d"}, lanes=("row",), coords=coords).save(tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="", encoding="utf-8") as file:
        head, *written = csv.reader(file)
    at = {name: head.index(name) for name in ("the  note", "friction.mu", "surplus 1", "surplus 2")}
    given = [[*row, *[""] * (4 - len(row))] for row in rows]
    assert [[line[j] for j in at.values()] for line in written] == given


@pytest.mark.parametrize("unit", ["rpm", "U/min", "1/min", "1 / min", "/min", "min^-1", "min⁻¹"])
def test_revolutions_per_minute_are_speeds(unit):
    base = js.load("engine_order").scene
    by_head, by_cell = {f"drive.speed [{unit}]": ["1300"]}, {"drive.speed": [f"1300 {unit}"]}
    for table in (by_head, by_cell):
        assert read_designs(table, base).values[0, 0] == pytest.approx(1300 * np.pi / 30, rel=1e-15)
    with pytest.raises(js.InputError, match=r"drive\.speed"):  # a speed of rotation is no circular frequency
        js.load("engine_order", [f'drive.omega="1300 {unit}"'])


@pytest.mark.full
def test_a_sweep_over_speeds_tells_its_best_in_revolutions_per_minute():
    base = js.load("engine_order", ['parts.motion=["x"]'])
    speeds = np.array([1300.0, 1450.0])
    swept = js.sweep(base, {"drive.speed": speeds * np.pi / 30}, **MARCH)
    assert swept.summary()["largest P_d"]["drive.speed [rpm]"] == speeds[np.argmax(swept.P_d)]


@pytest.mark.full
def test_the_command_writes_a_ranked_table_and_keeps_cells_as_they_were(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.csv").write_text("part no,drive.speed [rpm],friction.mu\n007,1300,0.30\n008,1400,0.20\n009,x,0.2\n")
    short = "--periods 4 --transient 4 --steps-per-period 100"
    words = f"table d.csv --scene engine_order --set parts.motion=[x] {short} --out r.csv"
    monkeypatch.setattr(command, "LONG_TABLE_STEPS", 0)
    run(words)
    printed = capsys.readouterr()
    assert "2 runs: about" in printed.err
    assert "ranked by P_d, the largest first" in printed.out
    read = pd.read_csv("r.csv", dtype=str)
    assert sorted(read["part no"]) == ["007", "008", "009"]
    assert sorted(read["friction.mu"]) == ["0.2", "0.20", "0.30"]
    assert read["rank"].tolist()[:2] == ["1", "2"]
    assert read["status"].tolist()[2] == "BAD_INPUT"
    assert "exists" in refused(capsys, words)


def test_a_wide_design_is_printed_in_part():
    best = {f"part {i}": "x" * 500 for i in range(300)} | {"rank": 1, "P_d": 12.5}
    shown = command._shown_design(best)
    assert len(shown) == command.SHOWN_ENTRIES + 1
    assert list(shown)[:2] == ["part 0", "part 1"]
    assert shown["further columns"] == len(best) - command.SHOWN_ENTRIES
    assert list(shown)[-2:] == ["rank", "P_d"]
    assert max(len(str(cell)) for cell in shown.values()) == command.LONGEST_CELL + len(" ... ")
    assert command._shown_design({"rank": 1}) == {"rank": 1}


HEADS = "shroud.gap [mm],friction.mu\n"
REFUSED = {  # what is wrong as a whole -> the file, and what the line must say
    "empty file": (b"", "has no designs"),
    "blank lines": (b"\n\n\n", "has no designs"),
    "heads only": (HEADS.encode(), "has no designs"),
    "a byte order mark only": (b"\xef\xbb\xbf", "has no designs"),
    "latin-1": ("Name,friction.mu\nBüchse,1\n".encode("latin-1"), "line 2 is no text in UTF-8"),
    "utf-16": ("friction.mu\n1\n".encode("utf-16"), "text in UTF-16; save the table as"),
    "a workbook": (b"PK\x03\x04\x14\x00\x06\x00\xff\xfe" * 9, "UTF-8"),
    "NUL bytes": (b"friction.mu\n1\0\n", "NUL"),
    "an open quotation": (b'name,friction.mu\n"a,1\nb,2\n', "quotation"),
    "text after a quotation": (b'name,friction.mu\n"a"b,1\n', "no CSV"),
    "a cell without end": (b"name,friction.mu\n" + b"a" * 200_000 + b",1\n", "line 2: a cell has more than 131,072"),
    "more columns than a spreadsheet has": (b"," * 100_000 + b"\n1\n", "100001 columns"),
    "no key": (b"name,note\na,b\n", "no column names a number"),
    "a typo": (b"shroud.gpa [mm]\n1\n", "did you mean `shroud.gap`"),
    "a wrong table": (b"shruod.gap [mm]\n1\n", "no number `shruod.gap`"),
    "the name alone": (b"gap [mm]\n1\n", "did you mean `shroud.gap`"),
    "upper case": (b"Shroud.Gap [mm]\n1\n", "no number `Shroud.Gap`"),
    "an unknown unit": (b"shroud.gap [furlongz]\n1\n", "unknown unit"),
    "another quantity": (b"shroud.gap [N]\n1\n", "a length is needed"),
    "a frequency": (b"drive.omega [Hz]\n1\n", "circular frequency"),
    "a unit of a pure number": (b"friction.mu [mm]\n1\n", "a pure number is needed"),
    "a third blade": (b"blades.m[2] [g]\n80\n", "the scene has 2 blades"),
    "a blade of the scene": (b"shroud.gap[0] [mm]\n1\n", "one number, not one per blade"),
    "one column twice": (b"friction.mu,friction.mu\n1,2\n", "two columns"),
    "one number twice": (b"shroud.gap [mm],shroud.gap [um]\n1,2\n", "give one number"),
    "two names of a number": (b"contact.k,contact.gamma\n1,2\n", "give one number"),
    "both and one blade": (b"blades.m,blades.m[0]\n1,2\n", "give one number"),
    "a speed without order": (b"drive.speed [rpm]\n1300\n", "drive.engine_order"),
    "a width of sharp contact": (b"contact.width [um]\n1\n", "contact is not smooth"),
    "no head": (b"friction.mu,\n0.3,a\n", "has no head"),
    "an appended column": (b"friction.mu,P_d [percent]\n0.3,1\n", "appends"),
    "a ranked table": (b"row,rank,friction.mu\n1,1,0.3\n", "appends"),
    "no right row": (b"friction.mu\nabc\n-1\n", "no row of the table is right"),
    "all too stiff": (b"contact.k\n1e30\n", "no row of the table is right"),
}
MARKED = {  # what is wrong in the first row; the second one is right
    "a text": ("abc,0.3", "not a number"),
    "an empty cell": (",0.3", "is empty"),
    "empty cells": (",", "is empty"),
    "blanks": ("   ,0.3", "is empty"),
    "not a number": ("nan,0.3", "not a number"),
    "infinity": ("inf,0.3", "not a number"),
    "too large for a double": ("0.02,1e999", "finite"),
    "beyond its range": ("0.02,-0.3", "greater than or equal to 0"),
    "an unknown unit": ("2 furlongz,0.3", "unknown unit"),
    "another quantity": ("2 kg,0.3", "a length is needed"),
    "two numbers": ("0.02 0.03,0.3", "unit"),
    "a formula": ("=A1+B1,0.3", "is not a number"),
    "an underscore": ("1_000,0.3", "unit"),
    "a hexadecimal": ("0x10,0.3", "unit"),
    "a quoted decimal comma": ('"0,022",0.3', "the decimal mark is a point"),
    "a decimal comma": ("0,022,0.3", "3 cells"),
    "too few cells": ("0.02", "1 cell,"),
    "a list": ('"[1, 2]",0.3', "is not a number"),
    "another script": ("０．０２,0.3", "unit"),
    "a long text": ("9" * 5000 + "x,0.3", "unit"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_hostile_file_is_refused_in_one_line(name, tmp_path, capsys):
    content, told = REFUSED[name]
    path, out = tmp_path / "d.csv", tmp_path / "r.csv"
    path.write_bytes(content)
    error = refused(capsys, f"table {path} --set parts.motion=[x] --out {out}")
    assert told in error
    assert str(path) in error
    assert not out.exists()


@pytest.mark.parametrize("name", MARKED)
def test_a_hostile_row_is_marked_and_the_next_one_is_not(name, tmp_path, scene):
    row, told = MARKED[name]
    path = tmp_path / "d.csv"
    path.write_text(f"{HEADS}{row}\n0.022,0.3\n", "utf-8")
    table = read_csv(path)
    designs = checked_designs(table.columns, scene, table.faults)
    assert told in designs.reasons[0]
    assert "\n" not in designs.reasons[0]
    assert designs.reasons[1] == ""
    assert designs.scenes(scene).shroud.gap.tolist() == [2.2e-5]


@pytest.mark.parametrize("cell", ["1e25", "1e30"])
def test_a_row_too_stiff_to_be_followed_is_marked_and_does_not_slow_the_others(cell, scene):
    designs = checked_designs({"contact.k": [cell, "2e5"]}, scene)
    assert "too stiff" in designs.reasons[0]
    assert designs.right.tolist() == [1]


def test_what_cannot_be_a_table_is_refused(scene, tmp_path, capsys):
    mu = "friction.mu"
    for table in (None, 3, "designs.csv", {}, {mu: []}, {mu: [[1, 2]]}, {mu: "0.3"}, [1, 2]):
        with pytest.raises(js.InputError):
            js.table(scene, table)
    with pytest.raises(js.InputError, match="columns of one length"):
        js.table(scene, {"friction.mu": [1, 2], "shroud.gap": [1]})
    with pytest.raises(js.InputError, match="did you mean `x_peak`"):
        js.table(scene, {"friction.mu": [0.3]}, by="x_peek")
    for path, out in ((".", "r.csv"), ("none.csv", "r.csv"), (".", "r.txt"), (".", "no/r.csv")):
        refused(capsys, f"table {tmp_path}/{path} --out {tmp_path}/{out}")
