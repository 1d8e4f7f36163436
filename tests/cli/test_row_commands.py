"""Commands on rows of blades: a run that goes on from a file."""

import numpy as np
import pytest
from command_line import run, sets, status_of

import jaxshroud as js
from jaxshroud.cli import projection

pytestmark = pytest.mark.full

RING = ["parts.motion=[x]", "row.blades=3", "drive.engine_order=1"]
HOW = "--tableau rk4 --steps-per-period 100 --force"


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "first.nc"
    run(f"simulate row_ring12 {sets(*RING)} {HOW} --periods 2 --out {path}")
    return path


def going_on(first, *ring):
    """The command that goes on from a file with such a row, for a period."""
    return f"simulate row_ring12 {sets(*ring)} {HOW} --periods 1 --from {first} --out {first.with_name('second.nc')}"


def test_a_row_goes_on_from_a_file(first, capsys):
    run(going_on(first, *RING))
    assert "another scene" not in capsys.readouterr().err
    second = js.open(first.with_name("second.nc"))
    long = js.simulate(js.load("row_ring12", RING), n_periods=3, method=js.RungeKutta("rk4", 100, "bisection"))
    assert np.any(second.mode[0] > 0)  # it goes on in contact
    # The same arithmetic, but for the phase of the drive being rebuilt from the file.
    np.testing.assert_allclose(second.motion.x, long.motion.x[200:], rtol=0, atol=1e-12 * np.max(np.abs(long.motion.x)))
    np.testing.assert_array_equal(second.mode, long.mode[200:])


def test_a_row_that_goes_on_differently_says_how(first, capsys):
    run(going_on(first, *RING, "row.mistuning=[0,0.01,0]"))
    assert "row.mistuning was" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ring", "told"),
    [
        (RING[:1], "it is of a ring of 3, but this scene of a ring of 12"),
        ([*RING, "row.closed=false"], "it is of a ring of 3, but this scene of an open chain of 3"),
        (["parts.motion=x,y", *RING[1:]], "its model has motion"),
    ],
)
def test_a_row_goes_on_only_in_its_own_model(first, ring, told, capsys):
    assert status_of(going_on(first, *ring)) == 2
    assert told in capsys.readouterr().err.splitlines()[-1]


def test_a_long_sweep_of_rows_is_projected(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(projection, "LONG_ROW_STEPS", 0)
    along = "--along contact.gamma --values 2,3 --periods 4 --transient 2"
    run(f"sweep row_ring12 {sets(*RING)} {HOW} {along} --out {tmp_path}/out")
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("2 runs: about ")]
    assert "MiB of memory" in told[0]
