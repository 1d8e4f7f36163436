"""Results for other programs hold the numbers of the result, to the last digit."""

import csv
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from jaxshroud.cli import commands as cli
from jaxshroud.io.convert import convert
from jaxshroud.scene.checks import InputError


@pytest.fixture
def lanes():
    """Two lanes by three, with four samples of both blades."""
    random = np.random.default_rng(0)
    dims = ("gamma", "F_0")
    made = {
        "x": ((*dims, "period", "blade"), random.random((2, 3, 4, 2)), {"units": "m"}),
        "P_d": (dims, random.random((2, 3)) / 3, {"units": "percent"}),
        "P": ((*dims, "blade"), random.random((2, 3, 2)), {"units": "m4"}),
        "status": (dims, np.array([[0, 1, 0], [0, 0, 2]], np.int8), {}),
        "count-of 1": (dims, np.arange(6).reshape(2, 3), {}),
    }
    coords = {"gamma": [1.0, 2.0], "F_0": ("F_0", [10.0, 20.0, 30.0], {"units": "N"}), "blade": [0, 1]}
    return xr.Dataset(made, coords, {"version": "0", "title": "two by three", "flags": [1, 2]})


def read(path):
    with path.open(newline="") as file:
        head, *lines = csv.reader(file)
    return head, lines


def test_a_table_of_lanes(lanes, tmp_path):
    convert(lanes, tmp_path / "a.csv")
    head, lines = read(tmp_path / "a.csv")
    assert head == ["gamma", "F_0 [N]", "P_d [percent]", "P[0] [m4]", "P[1] [m4]", "status", "count-of 1"]
    assert len(lines) == 6
    assert [float(line[2]) for line in lines] == lanes["P_d"].to_numpy().ravel().tolist()  # no digit is lost
    assert [float(line[4]) for line in lines] == lanes["P"].to_numpy()[..., 1].ravel().tolist()


def test_a_table_of_samples(lanes, tmp_path):
    convert(lanes, tmp_path / "a.csv", "sample")
    head, lines = read(tmp_path / "a.csv")
    assert len(lines) == 24
    at = head.index("x[1] [m]")
    assert [float(line[at]) for line in lines] == lanes["x"].to_numpy()[..., 1].ravel().tolist()


def test_one_run_has_a_row_for_each_sample(lanes, tmp_path):
    one = lanes.isel(gamma=0, F_0=0, drop=True).drop_vars(["status", "P_d", "P", "count-of 1"])
    convert(one, tmp_path / "a.csv")
    assert len(read(tmp_path / "a.csv")[1]) == 4
    with pytest.raises(InputError, match="a single lane"):
        convert(one, tmp_path / "a.csv", "lane")


def test_matlab(lanes, tmp_path):
    convert(lanes, tmp_path / "a.mat")
    back = loadmat(tmp_path / "a.mat", simplify_cells=True)
    for name in ("x", "P_d", "P", "status"):
        np.testing.assert_array_equal(back[name], lanes[name].to_numpy())
    np.testing.assert_array_equal(back["count_of_1"], lanes["count-of 1"].to_numpy())
    assert back["dims"]["x"] == "gamma F_0 period blade"
    assert back["units"]["P"] == "m4"
    assert back["attributes"]["title"] == "two by three"


def test_netcdf_comes_back(lanes, tmp_path):
    convert(lanes, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as back:
        xr.testing.assert_equal(back.load(), lanes)


def test_the_command(lanes, tmp_path, capsys):
    source, out = tmp_path / "a.nc", tmp_path / "b.csv"
    convert(lanes, source)
    words = ["convert", str(source), "--out", str(out)]
    assert cli.main(words) == 0
    assert out.read_text().startswith("gamma,F_0 [N]")
    for wrong, message in (
        (words, "exists and is kept"),
        (["convert", str(source), "--out", str(tmp_path / "b.xls")], "must end in .csv, .mat, .nc"),
        (["convert", str(source), "--rows", "lane", "--out", str(tmp_path / "b.mat")], "rows are those of .csv"),
        (["convert", str(tmp_path / "none.nc"), "--out", str(tmp_path / "c.csv")], "no such file"),
    ):
        capsys.readouterr()
        assert cli.main(wrong) == 2
        assert message in capsys.readouterr().err


def test_nothing_slow_is_imported(lanes, tmp_path):
    convert(lanes, tmp_path / "a.nc")
    code = (
        "import sys\nfrom jaxshroud.cli import commands\n"
        f"commands.main(['convert', {str(tmp_path / 'a.nc')!r}, '--out', {str(tmp_path / 'a.csv')!r}])\n"
        "assert not {'jax', 'matplotlib'} & set(sys.modules), set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
