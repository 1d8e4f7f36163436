"""Accuracy against cost: measured settings, and those that are chosen for an accuracy."""

import itertools
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from side_by_side import scene_of, with_parts

import jaxshroud as js
from jaxshroud import load
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.march.method import choices
from jaxshroud.march.stability import stiffest
from jaxshroud.orbits import short_runs
from jaxshroud.orbits.short_runs import HORIZON, end_states, state_errors, trajectory_ends
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.vary import vary
from jaxshroud.verbs import arguments, trade
from jaxshroud.verbs import trials as accuracy
from jaxshroud.verbs.accuracy import Choice, Setting, accuracy_level, by_series
from jaxshroud.verbs.trade import REFERENCE_SETTING, SETTINGS, adaptive, by_setting, neighbourhood
from jaxshroud.verbs.trials import PARALLEL, STIFFNESS_CLASSES, TILTED, choose, missed_lanes

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from accuracy import in_class  # type: ignore[attr-defined]

CLASSES = list(itertools.product((TILTED, PARALLEL), range(len(STIFFNESS_CLASSES))))
GAMMA = np.linspace(0.05, 8, 64)[:, None]

FEW = (
    by_setting(Setting("rk4", "cubic", "float64", 1.0)),
    by_setting(Setting("rk4", "cubic", "float64", 0.25)),
    by_setting(Setting("rk4", "none", "float64", 0.25)),
    by_setting(Setting("tsit5", "cubic", "float32", 1.0)),
    *(by_setting(Setting("rk4", "cubic", "float64", 0.5, width)) for width in (1 / 8, 1 / 64)),
    adaptive("Tsit5", 1e-6, 1 / 64),
)


SMALL = {"motion": ("x",), "friction": "none"}


@pytest.fixture(scope="module")
def measured(table1):
    scene = with_parts(table1, motion=("x", "y"), friction="none")
    return js.trade(scene, methods=FEW, lanes=16, transient=8, n_periods=8)


@pytest.mark.release
@pytest.mark.full
def test_errors_fall_with_the_step_and_with_located_events(measured):
    coarse, fine, unlocated, single, *_ = measured
    assert coarse.state_error > 50 * fine.state_error
    assert unlocated.state_error > 10 * fine.state_error  # control: events at the ends of steps
    assert coarse.gradient > 50 * fine.gradient
    assert np.isnan(single.gradient)
    assert np.isnan(unlocated.gradient)
    assert fine.P_d < coarse.P_d
    assert all(m.cost > 0 and 0 <= m.period <= 1 for m in measured)


@pytest.mark.release
@pytest.mark.full
def test_smooth_contact_is_an_approximation_of_the_spring(measured):
    *_, wide, narrow, adaptive = measured
    assert narrow.state_error < wide.state_error / 2
    assert narrow.state_error > 1e-4  # of the width: the march's own is finer
    assert adaptive.state_error == pytest.approx(narrow.state_error, rel=0.1)
    assert narrow.gradient < wide.gradient / 2
    assert adaptive.gradient < wide.gradient / 2


@pytest.mark.release
@pytest.mark.full
def test_a_scene_without_contact_is_traded_against_adaptive_solvers(table1):
    ways = [SETTINGS["none"][0], adaptive("Tsit5", 1e-3), adaptive("Tsit5", 1e-7), adaptive("Kvaerno5", 1e-6)]
    scene = with_parts(table1, contact="none", **SMALL)
    own, coarse, fine, implicit = js.trade(scene, methods=ways, lanes=8, n_periods=4, transient=4)
    assert own.kind == "closed form"
    assert own.state_error == 0.0
    assert fine.state_error < coarse.state_error / 100
    assert fine.P_d < 1e-5
    assert implicit.state_error < 1e-2
    assert np.isnan([one.gradient for one in (own, coarse, implicit)]).all()  # there is no gap to close


@pytest.mark.release
@pytest.mark.full
def test_smooth_contact_is_traded_against_adaptive_solvers(table1):
    ways = [by_setting(Setting("rk4", "cubic", "float64", 1.0)), adaptive("Tsit5", 1e-7)]
    scene = with_parts(table1, 1e-5, contact="smooth", **SMALL)
    for found in js.trade(scene, methods=ways, lanes=8, transient=0, n_periods=4):
        assert found.state_error < 1e-4
        assert found.P_d < 1e-3
        assert found.gradient < 1e-2


@pytest.mark.full
def test_a_settings_error_is_that_of_nearly_all_lanes(table1, monkeypatch):
    # One stopped lane in forty is passed over, twenty are not.
    errors = iter([np.array([1e-3] * 39 + [np.nan]), np.array([1e-3] * 20 + [np.nan] * 20)])
    monkeypatch.setattr(trade, "state_errors", lambda *_: next(errors))
    methods = [js.RungeKutta(steps=steps) for steps in (200, 400)]
    scene = with_parts(table1, **SMALL)
    few, many = js.trade(scene, methods=methods, lanes=40, n_periods=2, transient=2)
    assert [few.state_error, few.state_error_median] == [1e-3, 1e-3]
    assert [many.state_error, many.state_error_median] == [np.inf, np.inf]


def test_a_neighbourhood_is_the_scene_and_others_near_it(table1):
    near = neighbourhood(table1, 8)
    np.testing.assert_allclose(near.shroud.gap[0], table1.shroud.gap)
    assert 0 < np.max(np.abs(near.shroud.gap / table1.shroud.gap - 1)) <= 0.05


def test_all_harmonics_of_a_drive_scatter_alike(table1):
    drive = js.Drive(500.0, None, None, None, 0.0, harmonic=(js.Harmonic(1, 40.0, 0.5), js.Harmonic(2, 10.0, 0.5)))
    level = neighbourhood(replace(table1, drive=drive), 8).drive.level
    assert level[0] == 1
    assert 0 < np.max(np.abs(level - 1)) <= 0.05


@pytest.mark.parametrize(("asked", "value"), [("fast", 1e-3), ("balanced", 1e-6), ("1e-4", 1e-4), (1e-10, 1e-10)])
def test_accuracies_have_names_and_numbers(asked, value):
    assert accuracy_level(asked) == value


@pytest.mark.parametrize("asked", ["best", "1", "1e-12", "nan"])
def test_other_accuracies_are_refused(asked):
    with pytest.raises(ValueError, match="fast, balanced, reference"):
        accuracy_level(asked)


@pytest.mark.release  # studies/promises.py judges many more
@pytest.mark.full
@pytest.mark.parametrize(("tilt", "index"), CLASSES)
def test_promised_accuracies_are_kept_on_unseen_scenes(tilt, index):
    # Five scenes of each class that the table has not seen, and eight lanes around each.
    scenes = in_class(np.random.default_rng(77 + len(STIFFNESS_CLASSES) * tilt + index), tilt, index, 5)
    lanes = jax.tree.map(lambda *a: jnp.concatenate(a), *(neighbourhood(s, 8) for s in scenes))
    turn = stiffest(lanes, 1)
    judges = (REFERENCE_SETTING._replace(product=0.08), by_series(16, 1e-15, 0.25))  # of two kinds
    exact = [end_states(lanes, judge.steps(*turn), judge.method).motions for judge in judges]
    apart = state_errors(*exact)  # between nearly parallel faces Dormand-Prince 8 errs by up to 1e-7
    promised = [choice for a in (1e-2, 1e-3, 1e-6, 1e-9) if (choice := choose(lanes, 1, a)).promised]
    assert promised
    for choice in promised:
        got = end_states(lanes, choice.steps, choice.method).motions
        error = np.minimum(*(state_errors(got, one) for one in exact))
        missed = ~((error <= choice.accuracy) & (apart <= max(choice.accuracy, 1e-6)))
        assert np.mean(missed) <= 0.05, str(choice)
        assert np.all(missed_lanes(lanes, choice)[error > 2 * choice.accuracy])  # and these carry a warning


@pytest.mark.release  # studies/promises.py
@pytest.mark.full
def test_growth_of_errors_is_taken_into_account():
    # Nearly parallel faces, which the table has not seen: what it has for 1e-6 misses it in a third of the lanes.
    lanes = scenes_at(load("fig09", ["drive.M_0=0.1"]).scene, ["contact.gamma"], GAMMA)
    exact = end_states(lanes, 3000, REFERENCE_SETTING.method).motions
    missed = lambda c: np.mean(~(state_errors(end_states(lanes, c.steps, c.method).motions, exact) <= c.accuracy))
    balanced = choose(lanes, 1, "balanced")
    assert balanced.promised
    assert missed(balanced) <= 0.05
    # Light blades rock through flat contact: what that drops decides on what follows.
    light = scenes_at(load("fig09", ["drive.M_0=0.5", "blades.I=2.46e-5"]).scene, ["contact.gamma"], GAMMA)
    reference = choose(light, 1, "reference")
    assert not reference.promised
    assert 1e-10 < reference.reached < 1e-5
    assert f"{reference.reached:.0e} is the best for 95 % of runs" in str(reference)
    tilted = accuracy.Setting(*accuracy._accuracy_table()[TILTED][0]["1e-06"])  # control: enough for tilted faces
    assert missed(Choice(1e-6, tilted, tilted.steps(*stiffest(lanes, 1)), True)) > 0.1


WRONG = Choice(1e-8, Setting("rk4", "cubic", "float64", 1.0), 100, True)  # far too coarse for what it is said to reach


@pytest.mark.full
def test_a_promise_that_is_broken_is_found(table1):
    assert missed_lanes(neighbourhood(table1, 8), WRONG).all()


# A light pair whose faces stay nearly parallel: three periods from rest by the extended precision of studies/parallel.
ROCKING = {
    **{"I": 2.6662122015484206e-05, "gap": 1.6636526057646887e-05, "k": 280377.6753563163, "F_0": 21.882709755271915},
    **{"M_0": 0.1764794511913392, "mu": 0.11835921613926517, "k_d": 949034.2627287111, "omega": 885.4992082024374},
    **{"beta": 0.5976882679475947, "alpha": 1.2322072880310668, "phase": (1.1153690233115698, 4.256961676901363)},
}
ROCKED = [
    *(5.9665945000201516e-05, -5.966594500020152e-05, 6.514843675540385e-06, -6.514843675540385e-06),
    *(-2.7032653531310443e-05, -2.4592737350731207e-05, 0.15494588705414236, -0.15494588705414242),
    *(0.020050513621621448, -0.020050513621621448, 0.13082852396079592, -0.45615692488987875),
]


@pytest.mark.full
def test_rocking_faces_keep_an_accuracy_near_rounding():
    # Some 5,000 case switches. Where each of them waited for the angles to differ by their rounding, orders, steps and
    # tolerances agreed to 2e-12 on what was 6.7e-9 off.
    pairs = [reference.table1(**ROCKING), reference.table1(**ROCKING | {"gap": 1e-3})]
    choice = Choice(1e-9, by_series(14, 1e-13)._replace(flat_return=6e-6), 300, True)
    lanes = jax.tree.map(lambda *a: jnp.stack(a), *map(scene_of, pairs))
    rocked = end_states(lanes, choice.steps, choice.method).motions[:1]
    assert state_errors(rocked, np.array([ROCKED]))[0] < 1e-11
    assert not missed_lanes(lanes, choice).any()


@pytest.mark.full
def test_who_asks_for_an_accuracy_in_python_is_warned_of_lanes_that_miss_it(table1, monkeypatch):
    monkeypatch.setattr(arguments, "choose", lambda *_, **__: WRONG)
    with pytest.warns(js.AccuracyWarning, match="1 of 1 runs may miss the accuracy of 1e-08"):
        js.simulate(table1, n_periods=1, method=1e-8)
    with pytest.warns(js.AccuracyWarning, match="1 of 1"):
        js.power(table1, n_periods=4, transient=0, method=1e-8)
    with pytest.warns(js.AccuracyWarning, match="2 of 2"):
        js.sweep(table1, {"shroud.gap": [2e-5, 3e-5]}, n_periods=4, transient=0, method=1e-8)


@pytest.mark.full
def test_the_least_accuracy_is_had_in_float64():
    # Between nearly parallel faces float32 errs by some per cent: the table does not have it.
    assert {setting[2] for row in itertools.chain(*accuracy._accuracy_table()) for setting in row.values()} == {
        "float64"
    }
    scene = load("table1_light").scene
    found = js.sweep(scene, {"shroud.gap": [2e-5, 3e-5]}, n_periods=3, transient=0, method=1e-2)
    assert not found.inaccurate.any()


def test_positions_and_rates_are_judged_each_by_their_own_largest():
    exact = np.concatenate([np.full((1, 6), 1e-4), np.full((1, 6), 1.0)], axis=1)
    off = exact.copy()
    off[0, 2] += 1e-9
    np.testing.assert_allclose(state_errors(off, exact), 1e-5, rtol=1e-6)  # 1e-9 of the largest of all twelve


@pytest.mark.full
def test_the_table_is_ordered(table1):
    for row in itertools.chain(*accuracy._accuracy_table()):
        assert list(row) == [f"{at:.0e}" for at in sorted((float(a) for a in row), reverse=True)]
    stiff, soft = (choose(vary(table1, "contact.gamma", g), 0, "fast") for g in (1e3, 1.0))
    assert stiff.steps > 2 * soft.steps  # of which no choice has less than 200
    assert stiff.setting.tolerance <= soft.setting.tolerance / 1e3


@pytest.mark.release(only=["method1"])
@pytest.mark.full
@pytest.mark.parametrize("method", [js.RungeKutta(steps=200), js.Taylor(12, 1e-8, steps=200)])
def test_both_ways_to_the_horizon_agree(table1, method):
    lanes = scenes_at(table1, ["contact.gamma"], GAMMA[:2])
    ends = [way(lanes, 200, choices(method)) for way in (end_states, trajectory_ends)]
    np.testing.assert_allclose(*(end.motions for end in ends), rtol=1e-12, atol=1e-15)
    assert ends[0].trials == ends[1].trials > HORIZON * 100 * len(lanes.drive.omega)


@pytest.mark.full
def test_the_choice_takes_a_tenth_of_the_run_and_few_programs(table1):
    tried = []

    def ends(scenes, steps, method, tick):
        tried.append((len(scenes.drive.omega), method.as_static.with_tolerance()))
        return end_states(scenes, steps, method, tick)

    lanes = scenes_at(table1, ["contact.gamma"], np.tile(GAMMA, (4, 1)))
    for periods, most in ((5, LANES_PER_CALL), (60, 2 * LANES_PER_CALL), (300, accuracy.MAX_PROBED_LANES)):
        tried.clear()
        assert choose(lanes, 1, "balanced", lane_periods=len(GAMMA) * 4 * periods, ends=ends).promised
        work = sum(count for count, _ in tried) * HORIZON
        assert work <= max(0.1 * len(GAMMA) * 4 * periods, 2 * LANES_PER_CALL * HORIZON)  # a chunk, if the run is short
        assert tried[0][0] <= most
    assert len({method for _, method in tried}) == 1  # a setting and the finer one are one program
    tried.clear()
    choose(lanes, 1, "balanced", lane_periods=0, ends=ends)
    assert not tried  # the word of the table
    choose(lanes, 1, "balanced", ends=ends)
    assert tried[0][0] == accuracy.MAX_PROBED_LANES


LIGHT = ["drive.M_0=0.3"]  # of table1_light: its faces rock until they become flat


def rocking_without_end(monkeypatch, events_of: list[float]) -> None:
    """Marches that differ by 1e-5 whatever the method, with as many events as a share of flat contact lets happen."""
    rng = np.random.default_rng(0)

    def run_lanes(scenes, states, plan, ticker):
        events = np.full((len(scenes.drive.omega), 1), round(HORIZON / plan.method.flat_return), np.int32)
        events_of.append(float(events.sum()))
        return SimpleNamespace(samples=len(events), log=SimpleNamespace(counters=SimpleNamespace(flat=events)))

    monkeypatch.setattr(short_runs, "run_lanes", run_lanes)
    monkeypatch.setattr(short_runs, "motions_at", lambda n, _: 1 + 1e-5 * rng.random((n, 12)))


@pytest.mark.parametrize(("periods", "settings"), [(3, 1), (400, 2)])
def test_trials_end_with_a_tenth_of_the_steps_of_the_run(monkeypatch, periods, settings):
    # Each finer setting has four times the events of the one before it, and none is accurate. The events of all trials
    # are a tenth of those of the run at most, or those of one setting where that is more.
    events_of: list[float] = []
    rocking_without_end(monkeypatch, events_of)
    lanes = scenes_at(load("table1_light", LIGHT).scene, ["contact.gamma"], np.linspace(1, 3, 20)[:, None])
    choice = choose(lanes, 1, 1e-9, lane_periods=20 * periods)
    of_run = events_of[-2] / HORIZON * periods
    assert sum(events_of) <= max(0.1 * of_run, sum(events_of[:2]))
    assert len(events_of) == 2 * settings
    assert not choice.promised
    assert "not confirmed: 95 % of runs keep" in str(choice)


def test_lanes_that_were_tried_are_not_tried_again(monkeypatch):
    events_of: list[float] = []
    rocking_without_end(monkeypatch, events_of)
    lanes = scenes_at(load("table1_light", LIGHT).scene, ["contact.gamma"], np.linspace(1, 3, 20)[:, None])
    choice = choose(lanes, 1, 1e-9, lane_periods=60)
    marches = len(events_of)
    assert missed_lanes(lanes, choice).all()
    assert len(events_of) == marches
    others = scenes_at(load("table1_light", LIGHT).scene, ["contact.gamma"], np.linspace(1, 2, 20)[:, None])
    for more, scenes in enumerate((others, jax.tree.map(lambda a: a[::-1], lanes)), 1):
        assert missed_lanes(scenes, choice).all()
        assert len(events_of) == marches + 2 * more


@pytest.mark.full
def test_a_short_sweep_of_rocking_faces_ends():
    # The second of five settings takes four times the processor time of the first to try, the third twenty times.
    lanes = scenes_at(load("table1_light", LIGHT).scene, ["contact.gamma"], np.linspace(1, 3, 20)[:, None])
    choice = choose(lanes, 1, 1e-9, lane_periods=60)
    assert choice.curtailed
    assert choice.method.taylor.tolerance == 1e-10
    assert 1e-9 < choice.reached < 1e-6
