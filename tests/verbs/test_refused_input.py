"""What is wrong is refused where it is given, in one line that says how to mend it."""

import copy
import json
import pickle
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from command_line import refused, status_of
from command_line import run as run_command

import jaxshroud as js
from jaxshroud.batch.limits import MAX_LANE_PERIODS, check_memory, check_size
from jaxshroud.cli import commands as cli
from jaxshroud.cli import describe
from jaxshroud.cli.commands import join_negative_values
from jaxshroud.cli.run_options import asked_method, load_scene, print_march
from jaxshroud.cli.sweep import with_axes
from jaxshroud.march.method import FAST, Choices, choices
from jaxshroud.march.tableau import tableau
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.scene import Contact
from jaxshroud.verbs.arguments import plan_march, resolve_options

pytestmark = pytest.mark.full

X = "--set parts.motion=[x] --steps-per-period 200"

# Words that choose

PYTHON = """
import json
import jax
jax.config.update("jax_enable_x64", True)
import jaxshroud as js
from jaxshroud.verbs.gradient import differences

scene = js.load("table1").scene
orbit = None
tries = {
    "locate": lambda: js.RungeKutta(locate="nonsense"),
    "replaced": lambda: js.RungeKutta().replace(locate="cubik"),
    "precision": lambda: js.RungeKutta(precision="float16"),
    "tableau": lambda: js.RungeKutta("dopri"),
    "no tableau": lambda: js.RungeKutta(8),
    "steps": lambda: js.RungeKutta(steps=0.5),
    "order": lambda: js.Taylor(order=3),
    "tolerance": lambda: js.Taylor(tolerance=2.0),
    "explicit": lambda: js.rollout(scene, method=js.Taylor()),
    "accuracy": lambda: js.simulate(scene, method="rk4"),
    "name": lambda: js.tableau("dopri"),
    "contact": lambda: js.Parts(contact="hertz"),
    "neighbour": lambda: js.Parts()._replace(neighbour="rigd"),
    "friction": lambda: js.Parts(friction="bilinera"),
    "motion": lambda: js.Parts(motion=("y",)),
    "direction": lambda: js.sweep(scene, {"contact.gamma": [1.0, 2.0]}, n_periods=1, direction="Forward"),
    "of": lambda: js.gradient(scene, ["shroud.gap"], of=lambda run: run),
    "differences": lambda: differences(orbit, ["shroud.gap"], 1e-3, of="Pd"),
    "no quantity": lambda: js.gradient(scene, ["shroud.gap"], of="p_d"),
    "goal": lambda: js.tune(scene, {"shroud.gap": (1e-5, 1e-4)}, goal="wrst"),
    "reading": lambda: js.Contact(None, 2.5, "lever"),
    "part": lambda: js.Scene(scene.blades, "x", scene.contact, scene.friction, scene.drive),
    "start": lambda: js.Scene(scene.blades, scene.shroud, scene.contact, scene.friction, scene.drive, "x"),
}
told = {}
for name, attempt in tries.items():
    try:
        attempt()
        told[name] = "accepted"
    except ValueError as error:
        told[name] = str(error)
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told():
    """What Python says of wrong words; in a process without the tests' own type checks, which would come first."""
    done = subprocess.run([sys.executable, "-c", PYTHON], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "expected"),
    {
        "locate": "`locate` cannot be 'nonsense'; did you mean `none`?",
        "replaced": "did you mean `cubic`?",
        "precision": "did you mean `float64`?",
        "tableau": "`tableau` cannot be 'dopri'; did you mean `dopri8`?",
        "no tableau": 'must be a Tableau, e.g. "dopri8" or tableau("dopri8")',
        "steps": '`steps` must be a whole number or "auto", but is 0.5',
        "order": "`order` must be a whole number from 4 to 24, but is 3",
        "tolerance": "`tolerance` must be a number from 1e-16 to 0.1, but is 2.0",
        "explicit": "needs a number of `steps` here; js.method_for chooses a method",
        "accuracy": "but is 'rk4'; a method of that name is js.RungeKutta(\"rk4\")",
        "name": "did you mean `dopri8`?",
        "contact": "`contact` cannot be 'hertz'; known are spring, smooth, none",
        "neighbour": "did you mean `rigid`?",
        "friction": "did you mean `bilinear`?",
        "motion": "must be one of ('x',)",
        "direction": "did you mean `forward`?",
        "of": "`of` cannot be <function",
        "differences": "`found` must be an Orbit, but is None.",
        "no quantity": "did you mean `P_d`?",
        "goal": "did you mean `worst`?",
        "reading": "did you mean `levers`?",
        "part": "`shroud` must be a Shroud, e.g. that of another scene, scene.shroud, but is 'x'",
        "start": "`initial` must be a Motion",
    }.items(),
)
def test_words_are_checked_in_python(name, expected, told):
    assert expected in told[name]


def test_a_checked_tuple_is_a_tuple_as_before():
    method = Choices(tableau("dopri8"), "cubic", False, "float32")
    assert method == Choices(tableau=tableau("dopri8"), locate="cubic", ledger=False, precision="float32")
    assert method._replace(ledger=True).ledger
    assert hash(copy.copy(method)) == hash(pickle.loads(pickle.dumps(method)))
    assert Choices._make(method) == method
    assert FAST[1] == FAST.locate == "cubic"
    assert Parts(("x",))._asdict() == dict(zip(Parts._fields, (("x",), *Parts()[1:]), strict=True))


def test_a_method_is_named_in_words():
    method = js.RungeKutta("dopri8", precision="float32")
    assert method == js.RungeKutta(tableau("dopri8"), precision="float32") != js.RungeKutta("dopri8")
    assert hash(copy.copy(method)) == hash(pickle.loads(pickle.dumps(method)))
    assert str(method) == str(choices(method)) == "dopri8, events by cubic, float32"
    assert method.replace(locate="bisection") == js.RungeKutta("dopri8", precision="float32", locate="bisection")
    assert choices(method) == Choices(tableau("dopri8"), "cubic", False, "float32")
    assert choices(method, ledger=True).ledger


def test_an_accuracy_is_told_with_the_method_that_it_chose():
    file = js.load("table1", ['parts.motion=["x"]', "run.periods=1"])
    chosen = js.method_for(file.scene, 1e-3)
    by_accuracy, by_method = (js.simulate(file.scene, n_periods=1, method=how) for how in (1e-3, chosen))
    assert by_accuracy.accuracy.startswith("accuracy 1e-03: ")
    assert by_method.accuracy is None
    assert by_accuracy.march == by_method.march == chosen
    assert (by_accuracy.steps_per_period, by_accuracy.method) == (chosen.steps, str(choices(chosen)))


def test_a_reading_may_be_a_word_or_a_list():
    assert Contact(None, 2.5, ["levers"]).reading == Contact(None, 2.5, "levers").reading == {"levers"}
    assert len(Contact(None, 2.5, "printed").reading) == 6


AXES = "--set sweep.along="


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("simulat table1", "did you mean `simulate`?"),
        ("sweep fig09 --direction Forward --out s", "did you mean `forward`?"),
        ("sweep fig09 --set sweep.direction=forwrd --out s", "did you mean `forward`?"),
        ("sweep fig09 --set parts.contact=smoth --out s", "did you mean `smooth`?"),
        ("simulate table1 --locate cubik --out a.nc", "did you mean `cubic`?"),
        ("tune table1 --goal wrst --over shroud.gap=1um:2um --out t", "did you mean `worst`?"),
        ("gradient table1 --of Pd --wrt shroud.gap --out g.json", "did you mean `P_d`?"),
        ("gradient table1 --wrt shroud.gap --relative --out g.png", "must not end in .png"),
        ("explain table1 --accuracy banana", "must be fast, balanced, reference or a number"),
        ("explain table1 --accuracy balancd", "did you mean `balanced`?"),
        ("simulate table1 --set parts.contact=none --accuracy banana --out a.nc", "must be fast, balanced"),
        ("simulate table1 --set parts.contact=none --accuracy fast --tableau rk4 --out a.nc", "chooses --tableau"),
        ("explain table1 --set parts.contact=smooth --set contact.width=5um --accuracy fast", "not for smooth contact"),
        (
            "basins table1 --set parts.motion=[x] --plane y[0],theta[0] --out b",
            "there is no y in this model, which has x",
        ),
        ("branch table1 --along initial.x --start 0 --stop 1mm --num 0 --out b", "initial.x is where a run starts"),
        ("response table1 --along initial.x[0] --start 0 --stop 1mm --out b", "initial.x[0] is where a run starts"),
        # Values of an axis
        ("sweep fig09 --along shroud.gap --values 1mm,2 --out s", '"2" has no unit, but "1mm" before it has'),
        ("sweep fig09 --along shroud.gap --start 1mm --stop 2 --num 3 --out s", '"2" has no unit'),
        ("sweep fig09 --along contact.gamma --values 3,,2 --out s", "value 2 of 3 is empty"),
        ("sweep fig09 --along contact.gamma --values 3,2, --out s", "value 3 of 3 is empty"),
        ("sweep fig09 --num 1e20 --out s", "--num must be a whole number"),
        ("sweep fig09 --num 100000000000000000000 --out s", "--num must be at most 10000000"),
        ("sweep fig09 --along '' --num 5 --out s", "the scene has no number ``"),
        ("sweep fig09 --values '' --out s", "is not a number with a unit"),
        ("sweep fig09 --num 5 --along contact.gamma --out s", "--along contact.gamma comes after what describes it"),
        ("sweep table1 --num 3 --out s", "--along KEY before it"),
        (
            f"sweep table1 {AXES}'[contact.gamma, shroud.gap]' --set sweep.values=[[1,2],[1e-5,2e-5]] --num 3 --out s",
            "sweeps 2 keys",
        ),
        (f"sweep table1 {AXES}contact.gamma --set sweep.values=[1,2,4] --num 3 --out s", "lists its values"),
        ("tune table1 --over shroud.gap=1um:2 --out t", "has no unit"),
        # Numbers that no scene has
        ("check table1_points --set contact.points=[[0.01],[0.02]]", "must be a number of points, or a list"),
        ("check table1_points --set contact.points=[0.01,[0.02]]", "must be a number of points, or a list"),
        ("check table1_points --set contact.shares=[[0.5],[0.5]]", "must be a list with a number for each point"),
        ("check table1 --set drive.F_0=1e300", "F_0 = 1e+300 must be at most 1e+30 in magnitude"),
        ("check table1 --set blades.m=1e-300", "m = 1e-300 must be at least 1e-30"),
        ("check table1 --set drive.harmonic=[]", "drive.harmonic is a list of tables of a file; set one of its"),
        ("gradient table1_light --wrt nothing.at --out g.json", "the scene has no number `nothing.at`; known are"),
        (
            "tune table1 --over shroud.gap=1um:2um --tolerance row.mistuning= --out t",
            "is one of rows of blades; give it",
        ),
        ("scatter table1 --tolerance row.mistuning=0.02 --out t", "is one of rows of blades; give it a [row]"),
    ],
)
def test_words_are_checked_on_the_command_line(line, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = refused(capsys, line)
    assert expected in told
    assert len(told) < 300


@pytest.mark.release
def test_explain_marches_as_the_accuracy_says(capsys):
    run_command("explain table1 --set parts.motion=[x] --accuracy balanced")
    told = capsys.readouterr()
    assert "accuracy 1e-06: taylor" in told.out
    assert "accuracy 1e-06: taylor" in told.err


def test_an_accuracy_that_has_no_choice_is_told(capsys):
    options = cli.parser().parse_args(["explain", "table1", "--set", "parts.contact=none", "--accuracy", "1e-4"])
    file = load_scene(options)
    resolved = resolve_options(file.scene, method=asked_method(file, options))
    print_march(file, options, resolved.lanes, plan_march(resolved, resolved.lanes, FAST))
    assert "--accuracy has no choice" in capsys.readouterr().err


# Runs that go on


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A stored run of a reduced model that ends in contact."""
    path = tmp_path_factory.mktemp("run") / "run.nc"
    run_command(f"simulate table1 {X} --set shroud.gap=-0.1mm --periods 1 --out {path}")
    with xr.open_dataset(path, engine="h5netcdf") as ds:
        assert ds["mode"].to_numpy()[-1] > 0
    return path


def _with(name, value):
    def change(ds):
        ds[name][-1] = value

    return change


def _without(name):
    return lambda ds: ds.__delitem__(name) if name in ds else ds.attrs.__delitem__(name)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_without("v_x"), "lacks v_x over time and blade"),
        (_without("u_s"), "lacks u_s over time"),
        (_without("scene"), "its scene"),
        (_without("status"), "attribute status is no number"),
        (_with("x", np.nan), "last x is not finite"),
        (_with("u_s", np.nan), "last u_s is not finite"),
        (_with("mode", 9), "ends in mode 9 and case"),
        (_with("mode", 4), "ends in mode 4 and case"),
        (_with("mode", 0), "ends in mode 0 and case"),
        (_with("case", 0), "and case 0, which this model has not"),
        (_with("case", 7), "and case 7"),
        (lambda ds: ds.isel(time=slice(0, 0)), "lacks x over time and blade"),
        (lambda ds: ds.isel(blade=slice(0, 1)), "lacks x over time and blade"),
        (lambda ds: ds.attrs.update(end_turns="x"), "attribute end_turns is no number"),
        (lambda ds: ds.attrs.update(status=12), "the run stopped (status 12)"),
    ],
)
def test_a_damaged_run_is_not_gone_on_from(change, expected, run, capsys, tmp_path):
    ds = xr.load_dataset(run, engine="h5netcdf")
    changed = change(ds)
    (ds if changed is None else changed).to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    told = refused(capsys, f"simulate table1 {X} --from {tmp_path}/changed.nc --out {tmp_path}/a.nc")
    assert "changed.nc: " in told
    assert expected in told


def test_a_run_of_another_model_is_not_gone_on_from(run, capsys, tmp_path):
    told = refused(capsys, f"simulate table1 --from {run} --out {tmp_path}/a.nc")
    assert "its model has motion = [x], but this one [x, y, theta]" in told


def test_other_values_are_welcome_and_told(run, capsys, tmp_path):
    words = f"simulate table1 {X} --set shroud.gap=-0.1mm --periods 1 --from {run} --out {tmp_path}/a.nc"
    run_command(f"{words} --set friction.mu=0.25")
    assert "friction.mu was 0.5, is 0.25" in capsys.readouterr().err
    run_command(f"{words} --force")
    assert "going on" not in capsys.readouterr().err


# Values of an axis


def axes(line):
    """The axes that a command asks for."""
    options = cli.parser().parse_args(join_negative_values(line.split()))
    return {a.key: a.values.tolist() for a in with_axes(load_scene(options), options).axes}


def test_a_sweep_of_one_scene_is_a_lane():
    scene = js.load("table1", ['parts.motion=["x"]']).scene
    short = {"n_periods": 3, "transient": 1, "method": js.RungeKutta(steps=100)}
    alone = js.sweep(scene, **short)
    both = js.sweep(js.stack_scenes([scene, scene]), **short)
    assert alone.P_d.shape == (1,)
    np.testing.assert_array_equal(alone.P_d, both.P_d[:1])
    with pytest.raises(js.InputError, match="must name one or two keys"):
        js.sweep(scene, {}, **short)


def test_values_below_zero_are_no_options():
    for words, values in (
        ("--start -2mm --stop -1mm --num 2", [-2e-3, -1e-3]),
        ("--values -1mm,2mm", [-1e-3, 2e-3]),
        ("--values -.5,1e-3", [-0.5, 1e-3]),
        ("--values=1,2mm", [1.0, 2e-3]),
    ):
        assert axes(f"sweep table1 --along shroud.gap {words} --out s") == {"shroud.gap": values}


def test_only_the_values_of_options_are_joined_to_them():
    assert join_negative_values(["plot", "--", "-1.nc"]) == ["plot", "--", "-1.nc"]
    assert join_negative_values(["--phase=1", "-1", "--out", "-2", "-x"]) == ["--phase=1", "-1", "--out=-2", "-x"]


def test_a_full_memory_is_no_fault_of_the_input(capsys, monkeypatch):
    def full():
        raise MemoryError

    monkeypatch.setattr(describe, "shipped", full)
    assert status_of("scenes") == 1
    assert capsys.readouterr().err == "the machine failed: out of memory\n"


def test_a_number_alone_changes_the_scenes_own_sweep():
    whole = axes("sweep fig09 --out s")["contact.gamma"]
    (few,) = axes("sweep fig09 --num 120 --out s").values()
    np.testing.assert_array_equal(few, np.linspace(whole[0], whole[-1], 120))
    (moved,) = axes("sweep fig09 --start 2 --num 5 --out s").values()
    np.testing.assert_array_equal(moved, np.linspace(2, whole[-1], 5))
    assert axes("sweep fig09 --values 1,2 --out s") == {"contact.gamma": [1.0, 2.0]}


VERBS = next(a.choices for a in cli.parser()._actions if a.dest == "verb")


@pytest.mark.parametrize("verb", VERBS)
def test_every_help_text_is_formatted(verb):
    told = VERBS[verb].format_help()
    assert "example:" in told
    assert "{'" not in told  # argparse's own values, where a % is not escaped
    assert "%(" not in told


# Extremes


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (f"simulate table1 --set run.periods=1{'0' * 30} --out a.nc", "less than or equal to 2147483647"),
        (f"simulate table1 --set run.periods={'9' * 5000} --out a.nc", "must be a valid integer"),
        (f"simulate table1 --set blades.m=0x{'f' * 5000} --out a.nc", "thousands of digits"),
        (f"simulate table1 --periods {'9' * 5000} --out a.nc", "must be at most 2147483647"),
        ("simulate table1 --periods 2000000000 --steps-per-period 200 --out a.nc", "GiB are free"),
        ("simulate table1 --steps-per-period 99999999 --out a.nc", "must be at most 10000000"),
        ("sweep fig09 --periods 2000000000 --out s", "lane-periods"),
        (f"sweep fig09 --set sweep.num=1{'0' * 30} --out s", "num must be at most 10000000"),
        ("power fig15a --periods 2000000000 --out s", "GiB are free"),
        ("trade table1 --lanes 1000000000 --out s", "lane-periods"),
        ("simulate tab\0le1 --out a.nc", "holds a NUL"),
        ("simulate table1 --out \udcff.nc", "no UTF-8"),
        (f"simulate {'x' * 5000} --out a.nc", "no such file or shipped scene"),
        (f"simulate table1 --out {'x' * 5000}.nc", "cannot be looked up"),
        (f"plot {'x' * 5000}", "cannot be looked up"),
        ("explain table1 --set drive.omega=1e-3", "the drive is too slow"),
    ],
)
def test_extremes_are_refused(line, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = refused(capsys, line)
    assert expected in told
    assert len(told) < 1000


def test_a_file_of_digits_or_brackets_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text in (f"[run]\nperiods = {'9' * 5000}", f"a = {'[' * 5000}"):
        (tmp_path / "scene.toml").write_text(text)
        assert "scene.toml: not valid TOML" in refused(capsys, "simulate scene.toml --out a.nc")


def test_caps_hold_in_python():
    check_size(10, 0, MAX_LANE_PERIODS // 10**6)
    with pytest.raises(ValueError, match=r"1e\+11 lane-periods \(lanes x periods\) are more than the 1e\+10"):
        check_size(10, 0, MAX_LANE_PERIODS)
    with pytest.raises(ValueError, match=r"it would take some 9\.31e\+08 GiB of memory, but .* GiB are free"):
        check_memory("it", 10**18)


# Any JSON


@pytest.mark.parametrize(
    ("text", "told"),
    [
        *((text, "not a result of jaxshroud") for text in ("null", "3", "[1, 2]", '"x"', "{}")),
        *((text, "not a result of jaxshroud") for text in ('{"title": 3}', '{"n": 1, "settings": 2}')),
        *((text, "cannot be read") for text in ("[" * 100_000 + "]" * 100_000, "[" * 100, "9" * 5000, "", "\0")),
        ('{"of": "P_d", "kind": "periodic", "level": 1.0}', "holds derivatives"),
        ('{"runs": 3, "motions": {}}', "summary of a sweep"),
    ],
)
def test_plot_says_what_a_file_is_where_it_is_no_result(text, told, capsys, tmp_path):
    (tmp_path / "a.json").write_text(text)
    assert told in refused(capsys, f"plot {tmp_path}/a.json")


TUNED = {
    "title": "a tuning",
    "goal": "mean",
    "design": {"shroud.gap": 2e-5},
    "over": {"shroud.gap": [1e-5, 2e-5]},
    "points": [[[1e-5]], [[2e-5]]],
    "scores": [[1.0], [2.0]],
    "polished": [[2e-5]],
    "polished_scores": [2.0],
    "best_between": {"shroud.gap": [1e-5, 2e-5]},
    "scanned": [[1e-5], [2e-5]],
    "scanned_scores": [1.0, 2.0],
    "scanned_ci": [0.1, 0.1],
    "map": None,
}


def test_plot_draws_a_tuning(capsys, tmp_path):
    (tmp_path / "tune.json").write_text(json.dumps(TUNED))
    run_command(f"plot {tmp_path}/tune.json")
    assert (tmp_path / "tune.png").stat().st_size > 10_000
    run_command(f"plot {tmp_path} --out {tmp_path}/b.png")
    for damage in ({"points": 3}, {"scores": []}, {"over": None}, {"title": ["x"]}):
        (tmp_path / "tune.json").write_text(json.dumps({**TUNED, **damage}))
        if status_of(f"plot {tmp_path}/tune.json") == 2:
            assert "tune.json: the result" in capsys.readouterr().err


def test_axes_that_are_no_text_are_no_result(run, capsys, tmp_path):
    ds = xr.load_dataset(run, engine="h5netcdf")
    ds.attrs |= {"kind": "sweep", "axes": 3}
    ds.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    assert "lacks status, P_d, period_number" in refused(capsys, f"plot {tmp_path}/a.nc")
