"""Every verb where nothing happens: faces that never touch or always stick, no drive, one period, lane or sample.

These are the commonest states of real shrouds. Each verb gives a result whose words and picture can be made, or refuses
in one line what has no answer.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from command_line import sets, status_of

import jaxshroud as js
from jaxshroud.plotting.pictures import PAGES

IN_X = ['parts.motion=["x"]', "blades.c_x=40"]
NEVER, UNMOVED = "shroud.gap=1", "drive.M_0=0"
CASES = {
    "never touches": [NEVER],
    "always stuck": ["shroud.gap=-1e-3", "friction.mu=50"],
    "no drive": ["drive.F_0=0", UNMOVED],
    "one blade undriven": [NEVER, "drive.F_0=[0, 60]", UNMOVED],
    "no friction": [NEVER, 'parts.friction="none"'],
    "one period": [NEVER],
    "one lane": [NEVER],
    "every = the run": [NEVER],
}
RK4, STEPS = js.RungeKutta(steps=100), 100
SETTLED = 24  # periods, after which exp(-24 pi c_x / m omega) of the start is left: rounding
SHORT = {"n_periods": 4, "transient": 2, "method": RK4}
SEARCH = js.SearchOptions(4, 1, 1)
DATA = {"omega [rad/s]": [500.0, 536.0, 560.0], "x_rms_left [m]": [1e-4, 2e-4, 1e-4]}
ALONG = {"drive.omega": [500.0, 536.0]}
FROM_TO = {"start": 500.0, "stop": 560.0, "most_points": 4}
VERBS = {
    "simulate": lambda scene, how: js.simulate(scene, n_periods=how["n_periods"], method=RK4),
    "simulate events": lambda scene, how: js.simulate(scene, events=True, n_periods=how["n_periods"], method=RK4),
    "simulate series": lambda scene, how: js.simulate(scene, events=True, n_periods=1, method=js.Taylor(8, steps=20)),
    "sweep": lambda scene, how: js.sweep(scene, ALONG, ledger=True, forces=True, amplitudes=True, **how),
    "power": lambda scene, how: js.power(scene, forces=True, amplitudes=True, **how),
    "diagnose": lambda scene, how: js.diagnose(scene, transient=how["transient"], method=RK4),
    "orbit": lambda scene, how: js.orbit(scene, amplitudes=True, method=RK4),
    "lyapunov": lambda scene, how: js.lyapunov(scene, **how),
    "sweep lyapunov": lambda scene, how: js.sweep(scene, ALONG, lyapunov=True, **how),
    "gradient": lambda scene, how: js.gradient(scene, ["shroud.gap", "contact.gamma"], **how),
    "gradient of x": lambda scene, how: js.gradient(scene, ["shroud.gap"], of="x_peak", **how),
    "table": lambda scene, how: js.table(scene, {"contact.gamma": [1.0, 2.0]}, **how),
    "scatter": lambda scene, how: js.scatter(scene, {"shroud.gap": 1e-6}, draws=4, **how),
    "tune": lambda scene, how: js.tune(scene, {"contact.gamma": (1.0, 2.0)}, search=SEARCH, **how),
    "tune x": lambda scene, how: js.tune(scene, {"contact.gamma": (1.0, 2.0)}, of="x_rms", search=SEARCH, **how),
    "report": lambda scene, how: js.report(scene, draws=4, starts=4, **how),
    "trade": lambda scene, how: js.trade(scene, methods=[RK4], lanes=8, n_periods=how["n_periods"], transient=2),
    "branch": lambda scene, how: js.branch(scene, "drive.omega", **FROM_TO, method=RK4),
    "response": lambda scene, how: js.response(scene, num=3, **FROM_TO, **how),
    "attractors": lambda scene, how: js.attractors(scene, 4, most_periods=64, method=RK4),
    "basins": lambda scene, how: js.basins(scene, num=3, most_periods=64, method=RK4),
    "fit": lambda scene, how: js.fit(
        scene, DATA, {"blades.k_x": (9e4, 1.1e5)}, scan=4, starts=1, most_periods=64, method=RK4
    ),
    "rollout": lambda scene, how: js.rollout(scene, n_periods=how["n_periods"], method=RK4),
    "check": lambda scene, how: js.check(scene),
    "explain": lambda scene, how: js.explain(scene),
}
UNCOMPARED = ("no drive", "one blade undriven")  # the left blade does not vibrate without contact: P_0 = 0
COMPARING = ("power", "gradient", "table", "scatter", "tune", "tune x", "report", "trade")
OF_MANY = ("simulate", "sweep", "power", "orbit", "lyapunov", "sweep lyapunov", "gradient", "gradient of x")
LONG = ("report", "trade", "fit", "tune x", "basins", "sweep lyapunov", "gradient of x")
COMMONEST = ("never touches", "always stuck")
EVERY_DAY = {
    "simulate events": ("always stuck", "no drive"),
    "sweep": ("never touches", "always stuck"),
    "gradient": ("always stuck",),
    "check": ("no drive",),
}


def set_of(verb, case):
    """The marks of a verb in a case; what is refused costs next to nothing."""
    if verb in COMPARING and case in UNCOMPARED:
        return ()
    if case in EVERY_DAY.get(verb, ()):
        return ()
    often = case in COMMONEST and verb not in LONG
    return (pytest.mark.full,) if often else (pytest.mark.full, pytest.mark.release)


def scene_of(case):
    scene = js.load("table1", [*IN_X, *CASES[case]]).scene
    return jax.tree.map(lambda a: a[None], scene) if case == "one lane" else scene


@pytest.mark.full(but=["always stuck", "no drive"])
@pytest.mark.parametrize("case", [pytest.param(case, marks=set_of("simulate events", case)) for case in CASES])
def test_the_case_is_empty(case):
    scene = js.load("table1", [*IN_X, *CASES[case]]).scene
    start = js.simulate(scene, n_periods=SETTLED, every=STEPS, method=RK4).last
    run = js.simulate(scene, start, n_periods=2, events=True, method=RK4)
    stuck = case == "always stuck"
    assert (run.mode == (js.Mode.STICK if stuck else js.Mode.APART)).all()
    assert run.events.t.size == 0  # whatever is stored of events has none, and what each of them has
    assert run.events.motion.x.shape == (0, 2)
    assert all(not np.any(number) for number in run.counters.values())
    # The blades that are driven move, and no others: by half a picometre of rounding against tens of micrometres.
    moves = np.ptp(run.motion.x, axis=0) > 5e-13
    drives = {"no drive": [False, False], "one blade undriven": [False, True]}.get(case, [True, True])
    np.testing.assert_array_equal(moves, drives)


PAIRS = [
    pytest.param(verb, case, id=f"{verb}-{case}", marks=set_of(verb, case))
    for verb in VERBS
    for case in CASES
    if (case != "one lane" or verb in OF_MANY) and (case != "every = the run" or verb == "simulate")
]


@pytest.mark.parametrize(("verb", "case"), PAIRS)
def test_every_verb_where_nothing_happens(verb, case):
    scene, how = scene_of(case), {**SHORT, **({"n_periods": 1} if case == "one period" else {})}
    if verb in COMPARING and case in UNCOMPARED:
        with pytest.raises(js.InputError, match="does not vibrate without contact"):
            VERBS[verb](scene, how)
        return
    every = {"every": STEPS * how["n_periods"]} if case == "every = the run" else {}
    result = js.simulate(scene, **every, n_periods=4, method=RK4) if every else VERBS[verb](scene, how)
    assert repr(result)
    assert getattr(result, "failed", 0) == 0
    if case != "always stuck" or "simulate" not in verb:  # a start in overlap has an onset
        assert not any(np.any(n) for n in (getattr(result, "counters", None) or {}).values())
    if isinstance(result, js.Result):
        result.summary() if hasattr(result, "summary") else None
        if set_of(verb, case) and case != "one lane":
            draw(result)


def draw(result):
    """The picture of a result of a kind that has one."""
    if type(result).stored_as in PAGES:
        result.plot()
        plt.close("all")


ROW = ["row.blades=2", "row.closed=false", "drive.engine_order=1", *IN_X]
ROW_VERBS = {
    "simulate": lambda row: js.simulate(row, n_periods=2, method=RK4),
    "sweep": lambda row: js.sweep(row, ALONG, ledger=True, amplitudes=True, **SHORT),
    "power": lambda row: js.power(row, **SHORT),
    "orbit": lambda row: js.orbit(row, method=RK4),
    "diagnose": lambda row: js.diagnose(row, transient=2, method=RK4),
    "gradient": lambda row: js.gradient(row, ["shroud.gap"], **SHORT),
    "table": lambda row: js.table(row, {"contact.gamma": [1.0, 2.0]}, **SHORT),
    "mistune": lambda row: js.mistune(row, ALONG, n_patterns=2, **SHORT),
    "tune": lambda row: js.tune(row, {"contact.gamma": (1.0, 2.0)}, search=SEARCH, **SHORT),
    "check": js.check,
}
ROW_COMPARING = ("power", "gradient", "table", "mistune", "tune")
ROW_CASES = ("never touches", "always stuck", "no drive", "one blade undriven")


@pytest.mark.full
@pytest.mark.parametrize("case", ROW_CASES)
@pytest.mark.parametrize(
    "verb",
    [pytest.param(v, marks=pytest.mark.release) if v not in ("power", "sweep", "check") else v for v in ROW_VERBS],
)
def test_every_verb_of_rows_where_nothing_happens(verb, case):
    row = js.load("row_ring12", [*ROW, *CASES[case]]).scene
    if verb in ROW_COMPARING and case == "no drive":  # one blade undriven is a row that vibrates
        with pytest.raises(js.InputError, match="no blade of the row vibrates"):
            ROW_VERBS[verb](row)
        return
    result = ROW_VERBS[verb](row)
    assert repr(result)
    assert getattr(result, "failed", 0) == 0
    if hasattr(result, "summary"):
        result.summary()
    if isinstance(result, js.Result):
        draw(result)


COMMANDS = {
    "simulate": "--events --out run.nc",
    "sweep": "--along contact.gamma --values 1,2 --forces --amplitudes --out out",
    "power": "--forces --amplitudes --out out",
    "diagnose": "--out out",
    "orbit": "--out out",
    "lyapunov": "--out out",
    "gradient": "--wrt shroud.gap --relative --out gradient.json",
    "tune": "--over contact.gamma=1:2 --scan 4 --starts 1 --updates 1 --out out",
    "scatter": "--tolerance shroud.gap=1um --samples 4 --out out",
    "report": "--samples 4 --starts 4 --out report.html",
    "trade": "--lanes 8 --out out",
    "branch": "--along drive.omega --start 500 --stop 560 --num 2 --out out",
    "response": "--start 500 --stop 560 --num 3 --out out",
    "attractors": "--starts 4 --out out",
    "basins": "--num 3 --out out",
    "check": "--out out",
    "explain": "",
}


@pytest.mark.full
@pytest.mark.release
@pytest.mark.parametrize("case", ["never touches", "always stuck", "no drive", "one blade undriven", "one period"])
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_where_nothing_happens(command, case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    periods = f"run.periods={1 if case == 'one period' else 4}"
    changes = sets(*IN_X, *CASES[case], periods, "run.transient=2", "run.steps_per_period=100")
    compared = command in COMPARING and case in UNCOMPARED
    assert status_of(f"{command} table1 {changes} {COMMANDS[command]}") == (2 if compared else 0)
    told = capsys.readouterr()
    assert "nan %" not in told.out
    if compared:
        assert "does not vibrate without contact" in told.err
        assert len(told.err.splitlines()) == 1
