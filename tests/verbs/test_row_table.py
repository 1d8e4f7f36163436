"""Tables of designs of rows of blades: their columns, their ranks and the rows that are wrong."""

import numpy as np
import pytest
from command_line import refused
from numpy.testing import assert_array_equal

import jaxshroud as js
from jaxshroud.io.lane_status import LaneWarning
from jaxshroud.model.modes import Status

pytestmark = pytest.mark.full

CHAIN = ['parts.motion=["x"]', "row.blades=3", "row.closed=false", "drive.engine_order=1"]
HOW = {"n_periods": 4, "transient": 2, "method": js.RungeKutta("rk4", steps=200)}
DESIGNS = {"name": ["a", "b", "c"], "shroud.gap[1] [um]": ["10", "none", "40"], "contact.gamma": [2.0, 2.0, 4.0]}


@pytest.fixture(scope="module")
def ranked():
    with pytest.warns(LaneWarning, match="BAD_INPUT"):
        return js.table(js.load("row_ring12", CHAIN).scene, DESIGNS, by="P_d_worst", **HOW)


def test_a_table_of_rows_is_the_sweep_of_its_designs(ranked):
    scene = js.load("row_ring12", CHAIN)
    designs = js.scenes_from({"shroud.gap[1]": [10e-6, 40e-6], "contact.gamma": [2.0, 4.0]}, scene)
    swept = js.sweep(designs, forces=True, amplitudes=True, **HOW)
    right = [0, 2]
    for name in ("P", "P_0", "P_d", "P_d_worst", "x_peak", "v_max", "time_slip", "energy_residual", "N_max", "slip"):
        assert_array_equal(getattr(ranked, name)[right], getattr(swept, name), err_msg=name)
    assert ranked.x_peak.shape == (3, 3)
    assert ranked.N_max.shape == (3, 2)


def test_rows_are_ranked_and_told_in_columns_for_each_blade(ranked, reopened):
    assert ranked.status.tolist() == [Status.OK, Status.BAD_INPUT, Status.OK]
    first = int(np.nanargmax(ranked.P_d_worst))
    assert ranked.rank[first] == 1
    assert ranked.rank[1] == 0
    frame = ranked.to_pandas()
    assert_array_equal(frame["x_peak[2] [m]"], ranked.x_peak[:, 2])
    assert_array_equal(frame["N_max[1] [N]"], ranked.N_max[:, 1])
    assert {"P[0] [m4]", "P[2] [m4]", "P_d_worst [percent]"} <= {*frame.columns}
    assert_array_equal(reopened(ranked).data["blade"], [0, 1, 2])


def test_a_row_too_stiff_at_one_interface_is_wrong():
    with pytest.warns(LaneWarning, match="BAD_INPUT"):
        found = js.table(js.load("row_ring12", CHAIN).scene, {"blades.k_x[2]": [1e5, 1e30]}, **HOW)
    assert found.status.tolist() == [Status.OK, Status.BAD_INPUT]
    assert "too stiff" in found.reason[1]


def test_designs_are_ranked_by_the_largest_load_of_all_interfaces():
    found = js.table(js.load("row_ring12", CHAIN).scene, {"contact.gamma": [4.0, 2.0]}, by="friction_work", **HOW)
    largest = found.friction_work.max(axis=-1)
    assert found.rank.tolist() == [1 + (largest[0] > largest[1]), 1 + (largest[1] > largest[0])]


def test_numbers_that_a_scene_lacks_rank_no_designs(tmp_path, capsys):
    (tmp_path / "designs.csv").write_text("shroud.gap [um]\n20\n")
    line = f"table {tmp_path}/designs.csv --scene table1 --by P_d_worst --out {tmp_path}/out.csv"
    assert "`by` = 'P_d_worst' is of rows of blades alone" in refused(capsys, line)
