"""Measurements from CSV files: units become SI, and whatever is wrong is one line that names the place."""

import math
import os
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

import jaxshroud as js
from jaxshroud.io.measurements import measurements_from, read_measurements
from jaxshroud.scene.csv_text import read_csv

HISTORY = "t [ms],x_left [mm],theta_right [deg]\n0,1,90\n# a comment\n\n2,-3,45\n"


def written(tmp_path, text):
    path = tmp_path / "data.csv"
    path.write_text(text, "utf-8")
    return path


def test_a_history_is_in_si_units(tmp_path):
    data = read_measurements(written(tmp_path, "\ufeff" + HISTORY))
    assert (data.kind, data.names) == ("history", ("x_left", "theta_right"))
    assert_allclose(data.at, [0, 2e-3], rtol=1e-15)
    assert_allclose(data.values, [[1e-3, math.pi / 2], [-3e-3, math.pi / 4]], rtol=1e-15)
    assert data.sigma is None


@pytest.mark.parametrize(
    "axis",
    [
        {"omega [rad/s]": [536.0, 600.0]},
        {"f [kHz]": [0.536 / math.tau, 0.6 / math.tau]},
        {"speed [rpm]": [536 * 30 / math.pi / 4, 600 * 30 / math.pi / 4], "engine_order": [4, 4]},
    ],
    ids=lambda axis: next(iter(axis)),
)
def test_a_frequency_may_be_given_in_three_ways(axis):
    data = measurements_from({**axis, "x_rms_left [um]": [1.0, 2.0], "x_rms_left_sigma [nm]": [10.0, 10.0]})
    assert data.kind == "response"
    assert_allclose(data.at, [536.0, 600.0], rtol=1e-12)
    assert_allclose(data.values, [[1e-6], [2e-6]], rtol=1e-15)
    assert_allclose(data.sigma, 1e-8, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "has no data"),
        ("t [s],x_left [mm]\n", "has no data"),
        ("t [s],x_lift [mm]\n0,1\n", "'x_lift [mm]' is unknown; did you mean `x_left`?"),
        ("t [s],x_left\n0,1\n", "x_left has no unit; write e.g. `x_left [mm]`"),
        ("t,x_left [mm]\n0,1\n", "t has no unit; write e.g. `t [s]`"),
        ("t [s],x_left [kg]\n0,1\n", "x_left [kg]: its unit is a mass, but a length is needed"),
        ("t [s],x_left [furlung]\n0,1\n", "has an unknown unit `furlung`"),
        ("f [rad/s],x_rms_left [mm]\n1,1\n", "is a circular frequency, but a frequency is needed"),
        ("omega [rpm],x_rms_left [mm]\n1,1\n", "rpm is a speed of rotation; write `speed [rpm]` beside `engine_order`"),
        ("omega [Hz],x_rms_left [mm]\n1,1\n", "is a frequency, but a circular frequency is needed"),
        ("t [s],x_left [mm]\n0,nan\n", "line 2, column x_left [mm]: 'nan' is no finite number"),
        ("t [s],x_left [mm]\n0,1\n1,\n", "line 3, column x_left [mm]: '' is no finite number"),
        ("t [s],x_left [mm]\n0,1e999\n", "is no finite number"),
        ("t [s],x_left [mm]\n0,1\n1,2,3\n", "line 3 has 3 cells, but the header has 2"),
        ("t [s],t [s],x_left [mm]\n0,0,1\n", "t is there twice"),
        ("t [s],t [ms],x_left [mm]\n0,0,1\n", "t is there twice"),
        ("t [s],x_left [mm]\n0,1\n0,1\n", "t must grow from row to row, but line 3 has 0 s"),
        ("t [s],x_left [mm]\n-1,1\n0,1\n", "t begins before 0"),
        ("x_left [mm]\n1\n", "has neither a time nor a frequency"),
        ("t [s],f [Hz],x_left [mm]\n0,1,1\n", "has both t and f"),
        ("speed [rpm],x_rms_left [mm]\n1,1\n", "speed and engine_order give the drive's frequency together"),
        ("t [s],x_rms_left [mm]\n0,1\n", "x_rms_left is no channel of a time history; give e.g. `x_left [mm]`"),
        ("f [Hz],x_left [mm]\n1,1\n", "x_left is no channel of a frequency response"),
        ("f [Hz],x_rms_left [mm]\n-1,1\n", "frequencies of the drive must be positive"),
        ("t [s]\n0\n", "measures nothing"),
        ("t [s],x_left_sigma [mm]\n0,1\n", "measures nothing"),
        ("t [s],x_left [mm],x_right_sigma [mm]\n0,1,1\n", "x_right_sigma has no column x_right"),
        ("t [s],x_left [mm],y_left [mm],x_left_sigma [mm]\n0,1,1,1\n", "y_left_sigma is not; give the noise of all"),
        ("t [s],x_left [mm],x_left_sigma [mm]\n0,1,0\n", "the noise of each value must be positive"),
        ("t [s],x_left [mm],x_left_sigma [mm]\n0,1,1e-300\n", "must be positive, and more than rounding"),
        ("t [s],x_left [mm]\n0,1e200\n", "one finite number per row, below 1e+30"),
        ('t [s],x_left [mm]\n0,"1\n2"\n', "is no finite number"),
        ("t [],x_left [mm]\n0,1\n", "its unit is a pure number, but a time is needed"),
        ("t [3 s],x_left [mm]\n0,1\n", "t [3 s]: its unit is not a number with a unit"),
        ("t [s],\n0,\n", "column '' is unknown"),
        (
            "t [s];x_left [mm]\n0;1\n",
            "separated by semicolons; separate them by commas, and write numbers with a point",
        ),
        ("t [s];x_left [mm]\n0,1;3,2\n", "separated by semicolons"),
        ("t [s]\tx_left [mm]\n0\t1\n", "separated by tabs"),
        ("# a comment\n\nt [s],x_left [mm]\n0,1\n\n0,1\n", "but line 6 has 0 s"),
        (f"t [s],x_left [mm]\n0,1\n1,{'9' * 200_000}\n", "line 3: a cell has more than 131,072 characters; shorten it"),
        ('t [s],x_left [mm]\n0,1\n1,"2\n', "line 3: is no CSV (unexpected end of data); look for a quotation mark"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path, text, told):
    path = written(tmp_path, text)
    with pytest.raises(js.InputError) as error:
        read_measurements(path)
    assert told in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(js.InputError, match="no such file"):
        read_measurements(tmp_path / "none.csv")
    with pytest.raises(js.InputError, match=r"cannot be read .is no regular file"):
        read_measurements(tmp_path)


@pytest.mark.parametrize(
    ("encoding", "told"),
    [("utf-16", "is text in UTF-16; save"), ("latin-1", "line 3 is no text in UTF-8, but perhaps in Latin-1; save")],
)
def test_another_encoding_is_named_with_its_cure(tmp_path, encoding, told):
    path = tmp_path / "a.csv"
    path.write_bytes("t [s],x_left [mm]\n0,1\n# Büchse\n1,2\n".encode(encoding))
    for read in (read_measurements, read_csv):
        with pytest.raises(js.InputError, match=told):
            read(path)


@pytest.mark.parametrize("read", [read_measurements, read_csv])
def test_what_is_no_regular_file_is_neither_waited_for_nor_read_without_end(tmp_path, read):
    os.mkfifo(tmp_path / "pipe.csv")
    for path in (tmp_path / "pipe.csv", Path("/dev/zero")):
        with pytest.raises(js.InputError, match=r"cannot be read .is no regular file.; give a CSV file"):
            read(path)


@pytest.mark.parametrize("values", [["a"], [[1.0]], [math.nan], []])
def test_a_table_holds_finite_numbers(values):
    with pytest.raises(js.InputError, match="one finite number per row"):
        measurements_from({"t [s]": values, "x_left [m]": [1.0]})


def test_the_columns_of_a_table_have_one_length():
    with pytest.raises(js.InputError, match="differ in length"):
        measurements_from({"t [s]": [0.0, 1.0], "x_left [m]": [1.0]})
