"""Results for other programs hold the numbers of the result, to the last digit."""

import csv
import subprocess
import sys
import tomllib

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from command_line import refused, run
from numpy.testing import assert_array_equal
from scipy.io import loadmat

import jaxshroud as js
from jaxshroud.io.convert import convert
from jaxshroud.io.measurements import read_measurements
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.csv_text import read_csv
from jaxshroud.scene.designs import read_designs


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


@pytest.fixture(scope="module")
def run_csv(tmp_path_factory):
    """A short run as CSV, by the commands."""
    folder = tmp_path_factory.mktemp("run")
    run(f"simulate table1 --set parts.motion=[x] --steps-per-period 100 --periods 2 --out {folder}/run.nc")
    run(f"convert {folder}/run.nc --out {folder}/run.csv")
    return folder / "run.csv"


@pytest.mark.full
def test_what_a_run_has_once_is_beside_its_table(run_csv, capsys):
    stored = js.Trajectory.load(run_csv.with_suffix(".nc"))
    shared = tomllib.loads(run_csv.with_suffix(".toml").read_text("utf-8"))
    assert shared["values"]["x_rms"] == stored.x_rms.tolist()
    assert shared["units"]["x_rms"] == "m"
    frame = pd.read_csv(run_csv)
    assert len(frame) == len(stored.t)
    assert frame["time [s]"].tolist() == stored.t.tolist()
    assert frame["x[1] [m]"].tolist() == stored.motion.x[:, 1].tolist()
    assert not [head for head in frame if head.startswith(("x_", "y_", "theta_"))]
    words = f"convert {run_csv.with_suffix('.nc')} --out {run_csv.with_name('again.csv')}"
    beside = run_csv.with_name("again.toml")
    beside.write_text("[shroud]\ngap = 1e-5\n")  # a scene of that name is lost by no option
    for more in ("", "--force"):
        assert "again.toml: exists and holds something else" in refused(capsys, f"{words} {more}")
    beside.write_bytes(run_csv.with_suffix(".toml").read_bytes())
    assert "again.toml: exists and is kept" in refused(capsys, words)
    assert not run_csv.with_name("again.csv").exists()
    run(f"{words} --force")


def test_a_run_is_read_as_measurements_and_as_a_table(run_csv):
    read = read_measurements(run_csv)
    stored = js.Trajectory.load(run_csv.with_suffix(".nc"))
    assert read.names == ("x_left", "x_right")  # the model has no y and no rotation
    assert_array_equal(read.values, stored.motion.x)
    assert_array_equal(read.at, stored.t)
    table = read_csv(run_csv)
    assert not table.faults
    columns = {**table.columns, "shroud.gap [mm]": ["0.02"] * len(stored.t)}
    designs = read_designs(columns, js.load("table1").scene)
    assert designs.keys == ("shroud.gap",)  # the columns of a run are carried along
    assert designs.heads[:2] == ("time [s]", "x[0] [m]")


def test_speeds_are_written_in_revolutions_per_minute(tmp_path):
    speeds = np.array([1200.0, 1300.0, 1450.1])
    axis = ("speed", speeds * np.pi / 30, {"units": "rad s-1", "key": "drive.speed"})
    swept = xr.Dataset({"P_d": ("speed", [1.0, 2.0, 3.0]), "status": ("speed", [0, 0, 0])}, {"speed": axis})
    convert(swept, tmp_path / "a.csv")
    head, lines = read(tmp_path / "a.csv")
    assert head[0] == "speed [rpm]"
    assert [line[0] for line in lines] == ["1200.0", "1300.0", "1450.1"]


def test_matlab(lanes, tmp_path):
    convert(lanes, tmp_path / "a.mat")
    back = loadmat(tmp_path / "a.mat", simplify_cells=True)
    for name in ("x", "P_d", "P", "status"):
        assert_array_equal(back[name], lanes[name].to_numpy())
    assert_array_equal(back["count_of_1"], lanes["count-of 1"].to_numpy())
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
    run(f"convert {source} --out {out}")
    assert out.read_text().startswith("gamma,F_0 [N]")
    for wrong, message in (
        (f"{source} --out {out}", "exists and is kept"),
        (f"{source} --out {tmp_path}/b.xls", "must end in .csv, .mat, .nc"),
        (f"{source} --rows lane --out {tmp_path}/b.mat", "rows are those of .csv"),
        (f"{tmp_path}/none.nc --out {tmp_path}/c.csv", "no such file"),
    ):
        assert message in refused(capsys, f"convert {wrong}")


@pytest.mark.full
def test_nothing_slow_is_imported(lanes, tmp_path):
    convert(lanes, tmp_path / "a.nc")
    code = (
        "import sys\nfrom jaxshroud.cli import commands\n"
        f"commands.main(['convert', {str(tmp_path / 'a.nc')!r}, '--out', {str(tmp_path / 'a.csv')!r}])\n"
        "assert not {'jax', 'matplotlib'} & set(sys.modules), set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
