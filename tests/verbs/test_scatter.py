"""How P_d scatters, and effects of numbers side by side."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.plotting.style import save_figure
from jaxshroud.scene.vary import numbers_that_count
from jaxshroud.signals.effects import effect_step, effects
from jaxshroud.verbs.gradient import differences

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
SHORT = {"n_periods": 4, "transient": 16, "method": js.RungeKutta(steps=100)}
OVER = {"shroud.gap": (1e-5, 3e-5), "friction.mu": (0.2, 0.4)}


@pytest.fixture(scope="module")
def found():
    return js.scatter(SCENE, OVER, at_least=30.0, draws=16, **SHORT)


def test_draws_are_the_sweep_of_their_numbers(found):
    scenes = js.scenes_from({key: found.drawn[:, i] for i, key in enumerate(found.keys)}, SCENE)
    assert_array_equal(found.P_d, js.sweep(scenes, **SHORT).P_d)
    assert found.probability == np.mean(found.P_d >= 30.0)
    assert found.probability_low <= found.probability <= found.probability_high
    ends = np.array(list(OVER.values()))
    assert np.all((found.drawn >= ends[:, 0]) & (found.drawn <= ends[:, 1]))


@pytest.mark.full
def test_a_draw_has_the_least_P_d_of_its_conditions(reopened):
    conditions = {"drive.F_0": [30.0, 60.0]}
    # The scene's own F_0 counts for nothing but as what a scattering one is compared with.
    worst = js.scatter(js.vary(SCENE, "drive.F_0", 90.0), OVER, conditions=conditions, at_least=30.0, draws=4, **SHORT)
    alone = [js.scatter(js.vary(SCENE, "drive.F_0", F), OVER, draws=4, **SHORT) for F in conditions["drive.F_0"]]
    assert_array_equal(worst.P_d, np.minimum(*(one.P_d for one in alone)))
    assert not np.array_equal(worst.P_d, alone[1].P_d)  # control: no condition is the worst of every draw for free
    assert worst.N_max == max(one.N_max for one in alone)
    assert worst.runs == 2 * alone[0].runs
    assert reopened(worst).conditions == conditions
    spread = {"drive.F_0": (81.0, 99.0)}  # 10 % about 90
    moved = js.scatter(js.vary(SCENE, "drive.F_0", 90.0), spread, conditions={"drive.F_0": [30.0]}, draws=4, **SHORT)
    about = js.scatter(SCENE, {"drive.F_0": (27.0, 33.0)}, draws=4, **SHORT)
    assert_allclose(moved.P_d, about.P_d, rtol=1e-9)  # rounding of F_0 over a few periods


def test_a_scatter_is_stored_and_drawn(found, reopened):
    again = reopened(found)
    assert isinstance(again, js.Scatter)
    assert_array_equal(again.total, found.total)
    assert again.probability == found.probability
    assert repr(again) == repr(found)
    assert len(again.plot().axes) == 2
    assert again.plot(title="Mine").get_suptitle() == "Mine"


@pytest.mark.parametrize(("over", "of"), [({"drive.F_0": (30.0, 60.0)}, "P_d"), ({"friction.mu": (0.2, 0.4)}, "P")])
def test_shares_of_what_does_not_vary_are_undefined(over, of, tmp_path):
    # Blades that never touch are linear: P_d does not depend on the force, and nothing on friction.
    found = js.scatter(js.vary(SCENE, "shroud.gap", 1.0), over, of=of, draws=4, **SHORT)
    assert np.isnan([found.first, found.first_low, found.first_high, found.total]).all()
    assert found.share_text("total", 0) == "undefined"
    assert "varies by no more than rounding" in repr(found)
    assert found.summary()["undefined"] == found.undefined
    save_figure(found.plot(), tmp_path / "a.png")


@pytest.mark.full
def test_a_draw_that_stops_counts_as_missed(tmp_path):
    wild = js.vary(SCENE, "initial.x", [1e25, 0.0])
    coarse = js.RungeKutta(steps=100, precision="float32")  # in which their squares overflow
    with pytest.warns(js.LaneWarning):
        lost = js.scatter(wild, {"initial.v_x": (0.0, 1e30)}, at_least=-1e9, draws=4, **{**SHORT, "method": coarse})
    assert lost.stopped > 0
    assert lost.probability < 1


@pytest.mark.parametrize(
    ("over", "told"),
    [
        ({}, "at least one"),
        ({"shroud.gap": (2.0, 1.0)}, "in order"),
        ({"shroud.gab": (1.0, 2.0)}, "gap"),
        ({"friction.mu": (-0.1, 0.1)}, r"friction\.mu, at its bounds, = -0\.1"),
    ],
)
def test_wrong_bounds_are_named(over, told):
    with pytest.raises(js.Error, match=told):
        js.scatter(SCENE, over, **SHORT)


def test_effects_are_per_one_percent_and_sorted():
    told = effects(
        {"shroud.gap": -50.0, "shroud.alpha": 2.0},
        {"shroud.gap": 0.0, "shroud.alpha": 0.1},
        {"shroud.gap": 2e-5, "shroud.alpha": 1.0},
    )
    assert [e.key for e in told] == ["shroud.alpha", "shroud.gap"]
    assert told[0].change == pytest.approx(2 * np.pi / 180)
    assert told[0].per == "1°"
    assert told[1].change == pytest.approx(-50 * 2e-7)
    assert effect_step("drive.M_0", 0.0) == (1.0, "1 N m")


def test_all_numbers_are_those_of_the_model():
    keys = numbers_that_count(SCENE)
    assert "blades.I" not in keys
    assert "contact.k" not in keys
    assert {"shroud.gap", "contact.gamma", "drive.phase[1]"} <= set(keys)
    whole = js.load("table1").scene
    assert {"blades.I", "shroud.l_oa", "drive.M_0"} <= set(numbers_that_count(whole))
    apart = js.vary(whole, "blades.m", [0.08, 0.09])
    assert {"blades.m[0]", "blades.m[1]"} <= set(numbers_that_count(apart))
    rigid = js.load("table1", ["parts.neighbour=rigid"]).scene
    assert "drive.phase[1]" not in numbers_that_count(rigid)


ORBITS = {
    "x": ("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]),
    "a small moment": ("fig09_best", ["contact.gamma=2.6"]),
    "period 2": ("fig09_best", ["contact.gamma=3.1"]),
    "a block's own inertia": ("table1_light", ["drive.M_0=0.1", "contact.gamma=2.5"]),
    "printed moments": ("fig10b", []),
}


@pytest.mark.release(only=["a block's own inertia"])
@pytest.mark.full
@pytest.mark.parametrize(("name", "more"), ORBITS.values(), ids=ORBITS)
def test_relative_effects_are_those_of_differences(name, more):
    orbit = js.orbit(js.load(name, more).scene, method=js.RungeKutta(steps=400))
    found = js.gradient(orbit.cycle().scene, "all", orbit=orbit)
    assert found.kind == "periodic"
    by = differences(orbit, found.wrt, 1e-5)
    for effect in found.effects:
        step, _ = effect_step(effect.key, effect.number)
        # Fourth-order differences; what they miss, rounding included, is below a ten thousandth of the largest.
        assert abs(by[effect.key] * step - effect.change) <= 1e-4 * abs(found.effects[0].change)
    # Control: effects of twice the step are told from these.
    assert abs(2 * by[found.effects[0].key] * effect_step(*found.effects[0][:2])[0] / found.effects[0].change - 1) > 0.9


@pytest.mark.full
def test_effects_are_stored_and_drawn(reopened):
    short = {"method": js.RungeKutta(steps=100), "most_periods": 64}
    found = js.gradient(SCENE, ["shroud.gap", "contact.gamma"], **short)
    again = reopened(found)
    assert again.effects == found.effects
    assert repr(again) == repr(found)
    assert len(again.plot().axes) == 1
    assert again.plot(title="Mine").get_suptitle() == "Mine"
    with pytest.raises(js.InputError, match="pick a lane"):
        _ = js.gradient(js.scenes_from({"contact.gamma": [1.0, 2.5]}, SCENE), ["shroud.gap"], **short).effects
