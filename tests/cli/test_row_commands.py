"""Commands on rows of blades: a run that goes on from a file."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli import commands as cli
from jaxshroud.cli import projection

RING = ["--set", 'parts.motion=["x"]', "--set", "row.blades=3", "--set", "drive.engine_order=1"]
HOW = ["--tableau", "rk4", "--steps-per-period", "100", "--force"]


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "first.nc"
    assert cli.main(["simulate", "row_ring12", *RING, *HOW, "--periods", "2", "--out", str(path)]) == 0
    return path


def going_on(first, *changes, ring=RING):
    out = first.with_name("second.nc")
    words = ["simulate", "row_ring12", *ring, *changes, *HOW, "--periods", "1", "--from", str(first)]
    return cli.main([*words, "--out", str(out)]), out


@pytest.mark.full
def test_a_row_goes_on_from_a_file(first, capsys):
    code, out = going_on(first)
    assert code == 0
    assert "another scene" not in capsys.readouterr().err
    scene = js.load("row_ring12", RING[1::2]).scene
    long, run = js.simulate(scene, n_periods=3, method=js.RungeKutta("rk4", 100, "bisection")), js.open(out)
    assert np.any(run.mode[0] > 0)  # it goes on in contact
    # The same arithmetic, but for the phase of the drive being rebuilt from the file.
    np.testing.assert_allclose(run.motion.x, long.motion.x[200:], rtol=0, atol=1e-12 * np.max(np.abs(long.motion.x)))
    np.testing.assert_array_equal(run.mode, long.mode[200:])


@pytest.mark.full
def test_a_row_that_goes_on_differently_says_how(first, capsys):
    assert going_on(first, "--set", "row.mistuning=[0,0.01,0]")[0] == 0
    assert "row.mistuning was" in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.parametrize(
    ("ring", "told"),
    [
        (["--set", 'parts.motion=["x"]'], "it is of a ring of 3, but this scene of a ring of 12"),
        ([*RING, "--set", "row.closed=false"], "it is of a ring of 3, but this scene of an open chain of 3"),
        (["--set", 'parts.motion=["x", "y"]', *RING[2:]], "its model has motion"),
    ],
)
def test_a_row_goes_on_only_in_its_own_model(first, ring, told, capsys):
    assert going_on(first, ring=ring)[0] == 2
    assert told in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.full
def test_a_long_sweep_of_rows_is_projected(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(projection, "LONG_ROW_STEPS", 0)
    words = ["sweep", "row_ring12", *RING, *HOW, "--along", "contact.gamma", "--values", "2,3", "--periods", "4"]
    assert cli.main([*words, "--transient", "2", "--out", str(tmp_path / "out")]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("2 runs: about ")]
    assert "MiB of memory" in told[0]
