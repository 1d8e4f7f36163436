"""Every result tells itself in plain numbers, keeps them through files, and says where it comes from."""

import importlib
import json
import pkgutil

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxshroud as js
import jaxshroud.results
from jaxshroud.results.base import Result
from jaxshroud.results.trade import Trade

SCENE = js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"'])
SHORT = {"method": js.RungeKutta(steps=200)}
VERBS = {
    "trajectory": lambda: js.simulate(SCENE, n_periods=3, **SHORT),
    "sweep": lambda: js.sweep(SCENE, {"contact.gamma": [1.0, 2.0]}, n_periods=4, transient=1, **SHORT),
    "power": lambda: js.power(SCENE, n_periods=64, transient=8, **SHORT),
    "lanes": lambda: js.simulate(js.scenes_from({"contact.gamma": [1.0, 2.0]}, SCENE), n_periods=2, **SHORT),
}


@pytest.mark.full(but=["power", "trajectory"])
@pytest.mark.parametrize("name", VERBS)
def test_a_summary_is_json_that_files_keep(name, tmp_path):
    result = VERBS[name]()
    text = json.dumps(result.summary(), allow_nan=False)
    assert repr(result)
    result.save(tmp_path / "a.nc")
    assert json.dumps(js.open(tmp_path / "a.nc").summary(), allow_nan=False) == text


def test_summaries_tell_how_lanes_ended_and_from_which_scene():
    run = VERBS["trajectory"]().summary()
    assert run["status"] == {"OK": 1}
    assert run["scene"] == SCENE.text({"periods": 3, "steps_per_period": 200}) or "gamma" in run["scene"]
    assert VERBS["sweep"]().summary()["runs"] == 2


def test_all_kinds_have_what_results_have():
    for module in pkgutil.iter_modules(jaxshroud.results.__path__):
        importlib.import_module(f"jaxshroud.results.{module.name}")
    assert {"trajectory", "sweep", "power", "basins", "lyapunov"} <= set(Result.classes)
    for kind, cls in Result.classes.items():
        assert cls.stored_as == kind != ""
        assert all(callable(getattr(cls, method)) for method in ("save", "plot", "to_xarray", "summary", "__repr__"))


def test_a_trade_is_a_sequence_of_settings_with_a_front(tmp_path):
    names = ["coarse", "beaten", "fine"]
    alike = {"steps_per_period": 100, "P_d": 0.1, "ci": 0.2, "period": 1.0, "gradient": np.nan}
    values = {name: np.full(3, value) for name, value in alike.items()}
    values |= {"kind": np.array(names), "cost": np.array([1.0, 2.0, 3.0]), "horizon": 4}
    values |= dict.fromkeys(("state_error", "state_error_median"), np.array([1e-2, 1e-1, 1e-6]))
    trade = Trade.from_values(values, lanes=("setting",), coords={"setting": names}, attrs={"title": "a trade"})
    assert [one.setting for one in trade] == ["coarse", "beaten", "fine"]
    assert trade.front == [0, 2]
    best = trade.cheapest(1e-3)
    assert best is not None
    assert best.setting == "fine"
    assert trade.cheapest(1e-9) is None
    trade.save(tmp_path / "trade.nc")
    again = js.open(tmp_path / "trade.nc")
    assert repr(again) == repr(trade)
    assert again.summary() == trade.summary()
    assert again.summary()["settings"][0]["gradient"] is None  # not NaN, which JSON lacks
    assert len(again.plot().axes) == 4
    ax = Figure().subplots()
    assert again.plot(ax, panel="P_d") is ax.figure
    assert ax.has_data()


def test_plain_answers_are_saved_as_json(tmp_path):
    sheet = js.check(SCENE)
    sheet.save(tmp_path / "check.json")
    assert json.loads((tmp_path / "check.json").read_text()) == json.loads(json.dumps(sheet.summary()))
    assert json.dumps(js.explain(SCENE).summary(), allow_nan=False)


def test_a_panel_alone_needs_no_axes():
    figure = VERBS["trajectory"]().plot(panel="phase")
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["phase portrait"]
