"""What the command line makes of wrong input, and what its files hold."""

import tomllib

import jax
import numpy as np
import pytest
import xarray as xr
from command_line import read_json, refused, run, status_of
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud import shipped, simulate, sweep
from jaxshroud.results.base import open as js_open
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.config import load, parse

SMALL = "--set parts.motion=[x]"  # a model that is compiled quickly


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """One trajectory of 3 periods, and one of 2 with its continuation."""
    out = tmp_path_factory.mktemp("runs")
    base = "simulate fig10d --steps-per-period 200 --every 2"
    run(f"{base} --periods 3 --out {out}/long.nc")
    run(f"{base} --periods 2 --out {out}/first.nc")
    run(f"{base} --periods 1 --from {out}/first.nc --out {out}/second.nc")
    return out


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep of five values with one lane that leaves the angle range."""
    out = tmp_path_factory.mktemp("sweep") / "new" / "dir"
    short = "--periods 4 --transient 2 --steps-per-period 200 --ledger"
    run(f"sweep table1 --along drive.M_0 --values 20,60,100,3000,110 {short} --out {out}")
    return out


@pytest.mark.full
def test_trajectory_file(stored):
    ds = xr.open_dataset(stored / "long.nc")
    assert dict(ds.sizes) == {"time": 301, "blade": 2}
    assert ds["x"].dims == ("time", "blade")
    assert ds["mode"].dims == ("time",)
    T = 2 * np.pi / ds.attrs["omega"]
    assert_allclose(ds["time"], np.arange(301) * T / 100, rtol=1e-12)
    assert np.all(ds["x"].isel(time=0) == 0)
    apart = ds["mode"] == 0
    assert np.all(np.isnan(ds["u_s"]) == apart)
    assert np.all((ds["case"] == 0) == apart)
    assert ds["x"].attrs["units"] == "m"
    assert ds.attrs["status"] == 0
    assert tomllib.loads(ds.attrs["scene"])["contact"]["gamma"] == 7.5


def test_a_run_goes_on_from_a_file(stored):
    whole, second = (xr.open_dataset(stored / f"{n}.nc") for n in ("long", "second"))
    tail = whole.isel(time=slice(200, None))
    # The same arithmetic, but for the drive's phase being rebuilt from the file.
    assert_allclose(second["x"], tail["x"], rtol=0, atol=1e-12 * float(np.abs(whole["x"]).max()))
    assert_allclose(second["time"], tail["time"], rtol=1e-12)
    assert_array_equal(second["mode"], tail["mode"])
    assert_allclose(second["u_s"], tail["u_s"], rtol=0, atol=1e-12 * float(np.abs(whole["x"]).max()))


def test_sweep_files(swept):
    ds = xr.open_dataset(swept / "sweep.nc")
    assert dict(ds.sizes) == {"M_0": 5, "period": 4, "blade": 2}
    assert ds["period"].to_numpy().tolist() == [3, 4, 5, 6]
    assert ds["status"].to_numpy().tolist() == [0, 0, 0, 3, 0]
    assert "ANGLE_OUT_OF_RANGE" in ds["status"].attrs["flag_meanings"]
    assert ds["x"].dims == ("M_0", "period", "blade")
    assert {"P", "P_0", "P_d", "P_d_ci", "P_d_settled", "period_number", "settled", "energy_residual"} <= set(ds)
    assert {"time_apart", "onset_slip", "onset_stick", "grazing", "switch_14"} <= set(ds)
    assert read_json(swept / "summary.json")["status"] == {"OK": 4, "ANGLE_OUT_OF_RANGE": 1}
    assert sorted(p.name for p in swept.iterdir()) == ["summary.json", "sweep.nc", "sweep.png"]


@pytest.mark.release
@pytest.mark.full
def test_samples_at_a_phase_lie_on_the_trajectory(tmp_path):
    words = "sweep fig10d --along contact.gamma --values 7.5,2.5 --periods 2 --transient 0 --steps-per-period 200"
    run(f"{words} --phase {np.pi / 2} --out {tmp_path}/s")
    ds = xr.open_dataset(tmp_path / "s" / "sweep.nc")
    found = simulate(load("fig10d").scene, n_periods=3, method=js.RungeKutta(steps=200))
    # the lead-in has the same steps, so only rounding differs, amplified over 2 periods
    assert_allclose(ds["x"][0], found.motion.x[[250, 450]], rtol=1e-8)


def test_plot_does_not_simulate(stored, swept, monkeypatch, capsys):
    monkeypatch.setattr("jaxshroud.batch.runs.STEPPED", None)
    monkeypatch.setattr("jaxshroud.verbs.simulate.trajectories", None)
    for source, picture in ((swept, swept / "sweep.png"), (stored / "long.nc", stored / "long.png")):
        before = picture.stat().st_mtime_ns if picture.exists() else 0
        run(f"plot {source}")
        assert picture.stat().st_mtime_ns > before


@pytest.mark.release
@pytest.mark.full
def test_pictures_of_a_stored_run(stored, swept, tmp_path, capsys):
    for words in ("--kind all --width 90mm", "--kind loop --unit um --title ''"):
        run(f"plot {stored}/long.nc {words} --out {tmp_path}/a.svg --force")
        assert "<text" in (tmp_path / "a.svg").read_text()
    run(f"plot {swept} --format pdf")
    assert (swept / "sweep.pdf").exists()
    for line, told in (
        (f"plot {swept} --kind loop", "is a sweep"),
        (f"plot {stored}/long.nc --xlabel time", "several x axes"),
        (f"animate {swept}/sweep.nc --out {tmp_path}/a.gif", "not a run"),
        (f"animate {stored}/long.nc --out {tmp_path}/a.avi", "ends in .gif"),
    ):
        assert told in refused(capsys, line)


@pytest.mark.full
def test_events_and_forces_are_stored_where_asked_for(stored, tmp_path):
    ds = xr.open_dataset(stored / "long.nc")
    assert {"N", "F", "v", "u", "contact_point"} <= set(ds.data_vars)
    assert "event_t" not in ds
    run(f"simulate fig10d {SMALL} --steps-per-period 200 --periods 3 --events --out {tmp_path}/e.nc")
    both = js_open(tmp_path / "e.nc")
    assert len(both.events.t) == 2 * (sum(both.counters.values()) - both.counters["grazing"])
    assert np.all(np.diff(both.events.t) >= 0)


def test_scenes_are_listed_one_a_line(capsys):
    run("scenes")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("simulate nothing --out a.nc", ("nothing", "no such file or shipped scene")),
        ("simulate table1 --set friction.kd=1 --out a.nc", ("[friction] has no key `kd`", "`k_d`")),
        ("simulate table1 --set blades.m=-1 --out a.nc", ("[blades] m", "greater than 0")),
        ("simulate table1 --set shroud.gap=nan --out a.nc", ("[shroud] gap", "finite")),
        ("simulate table1 --periods 0 --out a.nc", ("--periods", "at least 1")),
        ("simulate table1 --steps-per-period 5 --out a.nc", ("table1", "omega_max h", "use at least")),
        ("simulate table1 --out a.txt", ("a.txt", ".nc")),
        ("simulate table1 --out no/such/a.nc", ("no/such", "make it first")),
        ("sweep table1 --along contact.gama --values 1,2 --out s", ("contact.gama", "`contact.gamma`")),
        ("sweep table1 --along contact.gamma --values 1 --out s", ("contact.gamma", "at least two")),
        ("sweep table1 --along contact.gamma --start 1 --stop 2 --num 1 --out s", ("at least two",)),
        ("sweep table1 --along contact.gamma --start 1 --stop 2 --num x --out s", ("--num", "whole number")),
        ("sweep table1 --values 1,2 --out s", ("--values", "--along KEY before it")),
        ("sweep table1 --out s", ("[sweep] is missing", "--along")),
        ("sweep fig09 --phase 7 --out s", ("--phase", "[0, 2 pi)")),
        ("power table1 --tolerance 0 --out s", ("--tolerance", "positive")),
        ("tune table1 --over shroud.gap=5um:20um --spread friction.mu=x --out s", ("--spread", "KEY=PERCENT")),
        (
            "tune table1 --over shroud.gap=5um:20um --tolerance friction.mu=2 --out s",
            ("friction.mu", "end of its scatter"),
        ),
        ("tune table1 --over shroud.gap=5um:20um --at-least 30 --out s", ("table1", "say what scatters")),
        ("plot nothing", ("nothing", "no such file")),
        ("simulate table1 --accuracy superb --out a.nc", ("--accuracy", "fast, balanced, reference")),
        ("simulate table1 --accuracy fast --tableau rk4 --out a.nc", ("--accuracy chooses --tableau itself",)),
        ("simulate table1 --set drive.omega=1e-3 --steps-per-period auto --out a.nc", ("auto", "too slow")),
        ("simulate table1 --set parts.contact=smooth --out a.nc", ("[contact] lacks `width`",)),
        ("simulate table1 --set contact.width=1e-6 --out a.nc", ("[contact] width is for smooth contact",)),
        ("simulate table1 --set parts.fricton=none --out a.nc", ("[parts]", "`friction`")),
        ("sweep table1 --along contact.width --values 1e-6,2e-6 --out s", ("contact.width", "not smooth")),
        ("plot .", (". is empty; was the run interrupted?",)),
        ("convert . --out a.csv", (".: is a folder", "sweep.nc")),
        ("sweep table1 --along contact.gamma --values 1,2 --out=", ("--out", "is empty")),
        ("plot a.nc --width 9", ("--width", "a length is needed", "90mm")),
        ("plot a.nc --width 9mm", ("from 40 to 1000 mm",)),
        ("plot a.nc --kind histry", ("--kind", "`history`")),
        ("plot a.nc --out b.png --format pdf", ("b.png", "--format pdf")),
        ("animate a.nc --out b.gif --factor -1", ("--factor", "above zero")),
        ("simulate", ("SCENE", "--help")),
        ("gradient fig10b --wrt shroud.gaps --out g", ("no number `shroud.gaps`; did you mean `shroud.gap`?",)),
        *((f"gradient fig10b --wrt shroud.gap --sigma={n} --out g", ("--sigma",)) for n in ("0", "-1", "nan", "inf")),
        *(
            (f"sweep fig09 --out s --period-tol={tolerance}", ("--period-tol must be a number of at least 0",))
            for tolerance in ("nan", "-1e-3", "inf")
        ),
        ("tune table1 --over shroud.gap=1e-5 --out t", ("KEY=LOW:HIGH",)),
        ("tune table1 --over shroud.gap=1e-5:1e-4 --range drive.F_0 --out t", ("KEY=A,B,C",)),
        ("tune table1 --over shroud.gap=1e-5:1e-4 --range drive.F_0=20 --out t", ("--set drive.F_0=20",)),
        ("tune table1 --over shroud.gaps=1:2 --out t", ("no number",)),
        ("tune table1 --over shroud.gap=1e-4:1e-5 --out t", ("in order",)),
        ("tune table1 --over shroud.gap=1e-5:1e-4 --most-force=-1 --out t", ("positive",)),
        ("orbit table1 --tolerance 0 --out o", ("must be a number above zero",)),
        ("orbit table1 --most-periods 3 --out o", ("at least 64",)),
        ("lyapunov table1 --periods 0 --out o", ("at least 1",)),
        ("lyapunov table1 --transient=-1 --out o", ("at least 0",)),
        ("branch table1 --along contact.gamma --out b", ("give --start and --stop",)),
        ("branch table1 --along contact.gamma --start 2 --stop 2.6 --at 9 --out b", ("outside of its range",)),
        ("basins table1 --plane x[0] --out b", ("two numbers",)),
        ("basins table1 --start=-1mm --out b", ("a value for each",)),
        ("check table1 --engine-orders 0..3", ("must be positive numbers",)),
        ("check table1 --engine-orders 3..1", ("must be positive numbers",)),
        ("check table1 --engine-orders 1,a", ("must be a number, but is 'a'",)),
        ("check table1 --engine-orders 1..", ("must be a number, but is '1..'",)),
        ("check table1 --stop 1450", ("a circular frequency is needed; give e.g. 1450rpm",)),
        ("check table1 --stop '3 mm'", ("a circular frequency is needed",)),
        ("check table1 --start 2000rpm --stop 1000rpm", ("must be a range from 0 on",)),
    ],
)
def test_wrong_input_is_one_line(words, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    error = refused(capsys, words)
    assert all(t in error for t in told), error
    assert list(tmp_path.glob("*.nc")) == []


def test_results_are_kept_unless_forced(stored, swept, capsys):
    (stored / "summary.json").touch()
    for words in (f"simulate table1 --out {stored}/long.nc", f"sweep fig09 --out {swept}"):
        assert "exists and is kept; give --force" in refused(capsys, words)
    for verb in ("orbit", "lyapunov"):
        assert "summary.json: exists and is kept; give --force" in refused(capsys, f"{verb} table1 --out {stored}")


def test_damaged_files_are_named(stored, tmp_path, capsys):
    half = tmp_path / "half.nc"
    data = (stored / "long.nc").read_bytes()
    half.write_bytes(data[: len(data) // 2])
    for words in (f"plot {half}", f"simulate table1 --from {half} --out {tmp_path}/a.nc"):
        assert "half.nc: not a complete result file" in refused(capsys, words)
    (tmp_path / "s").mkdir()
    xr.Dataset(attrs={"kind": "sweep", "axes": "gamma"}).to_netcdf(tmp_path / "s" / "sweep.nc", engine="h5netcdf")
    assert "sweep.nc: lacks status, P_d" in refused(capsys, f"plot {tmp_path}/s")
    with pytest.raises(js.StoreError, match="lacks status"):
        js.open(tmp_path / "s" / "sweep.nc")
    (tmp_path / "power.json").write_text('{"n": [1, 2')
    assert "power.json: cannot be read" in refused(capsys, f"plot {tmp_path}")


@pytest.mark.parametrize(
    "words",
    [
        "power table1 --steps-per-period 3",  # refused once its steps are known
        "tune table1 --over no.key=1:2",
        "sweep table1 --along contact.gamma --values 1,2 --periods 2 --tableau rk5",
        "gradient table1 --wrt no.key",
    ],
)
def test_a_refused_command_leaves_no_folder(words, tmp_path, capsys):
    refused(capsys, f"{words} --out {tmp_path}/new/out")
    assert not [*tmp_path.iterdir()]


def test_an_interrupted_command_leaves_no_folder_and_one_that_was_there(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxshroud.power", interrupted)
    (tmp_path / "own").mkdir()
    for name in ("out", "own"):
        assert status_of(f"power table1 --steps-per-period 400 --out {tmp_path}/{name}") == 130
    assert [path.name for path in tmp_path.iterdir()] == ["own"]
    assert capsys.readouterr().err.count("interrupted; nothing was written") == 2


@pytest.mark.parametrize(("place", "why"), [("file", "File exists"), ("file/out", "Not a directory")])
def test_a_folder_that_cannot_be_made_is_refused_at_once(place, why, tmp_path, capsys):
    (tmp_path / "file").write_text("of somebody else")
    told = refused(capsys, f"power table1 --out {tmp_path}/{place}")
    assert told == f"{tmp_path / place}: cannot be made ({why}); choose another --out"


@pytest.mark.full
def test_power_files(tmp_path, capsys):
    run(f"power fig10a --transient 40 --periods 64 --steps-per-period 200 --out {tmp_path}")
    data = read_json(tmp_path / "power.json")
    assert data["final"]["stable"]
    assert data["n"][-1] == data["final"]["n"] == 64
    assert data["P_d"][-1] == pytest.approx(data["final"]["P_d"], rel=1e-12)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["power.json", "power.nc", "power.png"]
    assert js.open(tmp_path / "power.nc").final["P_d"] == data["final"]["P_d"]
    with pytest.raises(js.StoreError, match=r"power\.nc"):
        js.open(tmp_path / "power.json")


@pytest.mark.release
@pytest.mark.full
def test_methods_by_name(tmp_path):
    words = (
        f"sweep table1 {SMALL} --along contact.gamma --values 1,2.5 --transient 0 --periods 2 --steps-per-period 200"
    )
    methods = {
        "rk4, events by cubic, float64": "",
        "dopri8, events by bisection, float64": "--tableau dopri8 --locate bisection",
        "tsit5, events by cubic, float32": "--tableau tsit5 --precision float32",
    }
    for i, (label, options) in enumerate(methods.items()):
        run(f"{words} {options} --out {tmp_path}/{i}")
        ds = xr.open_dataset(tmp_path / f"{i}" / "sweep.nc")
        assert (ds.attrs["method"], ds.attrs["steps_per_period"]) == (label, 200)
        assert "energy_residual" not in ds


@pytest.mark.release
@pytest.mark.full
def test_each_method_has_its_own_limit_of_stability(tmp_path, capsys):
    # omega_max h = 3.6: beyond RK4's 2.84, within Dormand-Prince 8's 4.09.
    words = f"simulate table1 --periods 1 --steps-per-period 25 --out {tmp_path}/run.nc"
    assert "is unstable" in refused(capsys, words)
    run(f"{words} --tableau dopri8")


def test_float64_is_not_lost_silently(table1):
    single = jax.tree.map(lambda a: a.astype("float32"), table1)
    with pytest.raises(ValueError, match="Float64 is requested"):
        sweep(single, {"contact.gamma": [1.0, 2.0]}, n_periods=1, method=js.RungeKutta(steps=400), transient=0)
    with pytest.raises(ValueError, match="steps_per_period"):
        sweep(table1, {"contact.gamma": [1.0]}, n_periods=1, method=js.RungeKutta(steps=4), transient=0)


@pytest.mark.full
def test_gradient_command(tmp_path, capsys):
    out = tmp_path / "gradient.json"
    words = f"gradient fig10b --wrt shroud.gap,contact.gamma --check --out {out}"
    run(words)
    told = capsys.readouterr().out
    for part in ("periodic", "dP_d/d shroud.gap", "nearest bifurcation", "step 1e-05", "slowest onset", "onset_slip"):
        assert part in told
    data = read_json(out)
    assert data["kind"] == "periodic"
    assert data["flags"] == []
    assert data["orbit"]["period_number"] == 1
    assert len(data["orbit"]["multipliers"]) == 13
    assert max(data["check"]["relative_error"].values()) < 1e-7
    assert "exists" in refused(capsys, words)


@pytest.mark.full
def test_gradient_command_in_chaos(tmp_path, capsys):
    out = tmp_path / "gradient.json"
    small = "--pairs 8 --periods 16 --transient 16 --steps-per-period 200"
    run(f"gradient table1 --set contact.gamma=5.5 {small} --wrt contact.gamma --check --out {out}")
    data = read_json(out)
    assert data["kind"] == "smoothed"
    assert "aperiodic" in data["flags"]
    assert data["ci"]["contact.gamma"] > 0
    assert data["check"] == {}
    assert "no check" in capsys.readouterr().err


@pytest.mark.full
def test_tune_command(tmp_path, capsys):
    out = tmp_path / "tuned"
    over = "--over shroud.gap=5um:0.2mm --over contact.gamma=0.1:10 --range drive.F_0=40,60 --most-force 1kN"
    short = "--steps-per-period 100 --periods 16 --transient 32 --scan 8 --starts 2 --updates 2 --map 4"
    words = f"tune table1 {SMALL} {over} {short} --out {out}"
    run(words)
    told = capsys.readouterr().out
    for part in ("mean P_d", "half the step", "four times as long", "another start, 3", "verdict"):
        assert part in told
    data = read_json(out / "tune.json")
    assert 5e-6 <= data["design"]["shroud.gap"] <= 2e-4
    assert data["most_force"] == 1000
    assert np.shape(data["map"]["objective"]) == (4, 4)
    assert (out / "tune.png").stat().st_size > 10_000
    best = load(out / "best.toml").scene
    assert float(best.shroud.gap) == data["design"]["shroud.gap"]
    kept = load(out / "best.toml").run
    assert (kept.periods, kept.transient, kept.steps_per_period) == (16, 32, 100)
    assert data["feasible"]
    assert "infeasible" not in told
    assert "exists" in refused(capsys, words)


@pytest.mark.release
@pytest.mark.full
def test_tune_command_without_a_map(tmp_path, capsys):
    out = tmp_path / "tuned"
    short = "--accuracy 1e-4 --periods 8 --transient 8 --scan 4 --starts 1 --updates 1"
    run(f"tune table1 {SMALL} --over friction.mu=0:1 {short} --goal worst --most-force 1e-9N --out {out}")
    told = capsys.readouterr()
    assert told.out.splitlines()[1].startswith("infeasible")
    data = read_json(out / "tune.json")
    assert data["map"] is None
    assert next(iter(data)) == "feasible"
    assert not data["feasible"]
    # The steps are those of the accuracy, by the stiffest design.
    assert f"{data['steps_per_period']} steps" in told.err
    assert "float64" in data["method"]
    assert (out / "tune.png").exists()


def test_automatic_steps_are_printed(tmp_path, capsys):
    run(f"simulate table1 --periods 1 --steps-per-period auto --out {tmp_path}/a.nc")
    assert "steps_per_period = 455, by the stiffness of the scene" in capsys.readouterr().err


@pytest.mark.full
def test_explain_tells_what_is_left_out(capsys):
    run("explain table1 --set parts.motion=x,y --set friction.mu=0")
    told = capsys.readouterr().out
    assert "motion: ('x', 'y')" in told
    assert "of the full" in told
    assert 'friction = "none" gives the same motion' in told
    run("explain table1 --set parts.contact=none")
    assert "closed form" in capsys.readouterr().out


@pytest.mark.release  # the command is on its page, which tests/test_docs.py runs
@pytest.mark.full
def test_trade_files(tmp_path, capsys, monkeypatch):
    from jaxshroud.verbs import trade

    short = {contact: ways[:2] for contact, ways in trade.SETTINGS.items()}
    monkeypatch.setattr(trade, "SETTINGS", short)
    words = f"trade table1 {SMALL} --set parts.friction=none --lanes 8 --periods 4 --transient 4"
    run(f"{words} --out {tmp_path}")
    assert "none reaches it" in capsys.readouterr().out
    data = read_json(tmp_path / "trade.json")
    assert [row["kind"] for row in data["settings"]] == ["rk4", "rk4"]
    assert any(row["front"] for row in data["settings"])
    assert (tmp_path / "trade.png").stat().st_size > 10_000


def test_the_model_of_a_scene_is_kept_in_its_file(tmp_path):
    file = load("table1", ['parts.motion=["x"]', "parts.friction=none"])
    again = parse(file.text(), "again")
    assert again.scene.parts == file.scene.parts
    assert file.scene.parts.motion == ("x",)


@pytest.mark.parametrize(
    ("fails", "error"),
    [
        ("gradient", np.linalg.LinAlgError("Singular matrix")),
        ("gradient", NumericalError("The march stops in this scene; there is nothing to differentiate.")),
        ("tune", np.linalg.LinAlgError("SVD did not converge")),
    ],
)
def test_a_numerical_failure_is_no_wrong_input(fails, error, tmp_path, capsys, monkeypatch):
    def failing(*_, **__):
        raise error

    monkeypatch.setattr(js, fails, failing)
    words = {"gradient": "--wrt shroud.gap", "tune": "--over shroud.gap=1e-5:1e-4"}[fails]
    assert status_of(f"{fails} table1 {words} --out {tmp_path}/out.json") == 1
    assert capsys.readouterr().err == f"numerical failure: {error}\n"


@pytest.mark.full
def test_a_scene_that_stops_is_a_numerical_failure(tmp_path, capsys):
    # Two blocks turned beyond their angle range within the first period.
    assert status_of(f"gradient fig10b --set drive.M_0=3000 --wrt shroud.gap --out {tmp_path}/g.json") == 1
    told = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("periods: ")]
    assert told == ["numerical failure: The march stops in this scene; there is nothing to differentiate."]


@pytest.mark.full
def test_the_best_lane_of_a_sweep_over_one_blade_is_named(capsys, tmp_path):
    short = "--periods 2 --transient 0 --steps-per-period 100"
    along = "--along initial.x[0] --values 0,1e-4"
    run(f"sweep table1 {SMALL} --set blades.c_x=40 {along} {short} --out {tmp_path}/s")
    assert ", at initial.x[0] = " in capsys.readouterr().out
