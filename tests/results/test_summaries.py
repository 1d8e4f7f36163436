"""Every result tells itself in plain numbers, keeps them through files, and says where it comes from."""

import importlib
import json
import pkgutil

import numpy as np
from matplotlib.figure import Figure

import jaxshroud as js
import jaxshroud.results
from jaxshroud.results.base import Result
from jaxshroud.results.trade import Trade

SCENE = js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"'])


def test_all_kinds_are_known_by_their_names():
    for module in pkgutil.iter_modules(jaxshroud.results.__path__):
        importlib.import_module(f"jaxshroud.results.{module.name}")
    assert {"trajectory", "sweep", "power", "basins", "lyapunov"} <= set(Result.classes)
    for kind, cls in Result.classes.items():
        assert cls.stored_as == kind != ""


def test_a_trade_is_a_sequence_of_settings_with_a_front(reopened):
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
    again = reopened(trade)
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
