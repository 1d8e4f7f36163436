"""What README has told people to write goes on working: a list that only grows."""

import shlex

import pytest

from jaxshroud.cli import commands as cli
from jaxshroud.verbs import trade

# As README has had them; what is appended makes them small, of a model that other tests compile too.
SMALL = "--set 'parts.motion=[\"x\"]'"
SHORT = f"{SMALL} --periods 2 --steps-per-period 200"
COMMANDS = [
    ("jaxshroud sweep fig09 --out fig09", f"{SHORT} --transient 1 --num 3"),
    ("jaxshroud scenes", ""),
    ("jaxshroud simulate fig10b --periods 20 --out run.nc", SHORT),
    ("jaxshroud simulate fig10b --periods 20 --from run.nc --out more.nc", SHORT),
    (
        'jaxshroud sweep table1 --along shroud.gap --start "0.005 mm" --stop "0.2 mm" --num 200 --out gap',
        f"{SHORT} --num 3",
    ),
    (
        "jaxshroud sweep table1 --along contact.gamma --values 1,2,4 "
        "--along drive.F_0 --start 10 --stop 80 --num 8 --out grid",
        f"{SHORT} --num 2",
    ),
    ("jaxshroud power fig15b --out power", f"{SHORT} --transient 1"),
    (
        "jaxshroud gradient fig10b --wrt shroud.gap,contact.gamma --check --out gradient.json",
        "--set blades.c_x=40",  # so that it settles soon
    ),
    (
        "jaxshroud tune table1 --set drive.M_0=10 --over shroud.gap=5um:200um --over contact.gamma=0.1:10 "
        "--range drive.F_0=20,40,60,80 --steps-per-period 200 --periods 64 --transient 64 --out tuned",
        f"{SHORT} --steps-per-period 100 --transient 2 --scan 4 --starts 1 --updates 1 --map 2",
    ),
    (
        "jaxshroud sweep table1 --along contact.gamma --start 0 --stop 8 --num 500 --accuracy balanced --out balanced",
        f"{SMALL} --periods 2 --num 3",
    ),
    (
        "jaxshroud trade table1 --out trade",
        f"{SMALL} --set parts.friction=none --lanes 8 --periods 4 --transient 4",
    ),
    ('jaxshroud explain table1 --set \'parts.motion=["x", "y"]\'', ""),
    ('jaxshroud explain table1 --set \'parts.motion=["x", "y"]\'', ""),
    ("jaxshroud plot gap", ""),
]
MADE = {
    **{key: {"sweep.nc", "sweep.png", "summary.json"} for key in ("fig09", "gap", "grid", "balanced")},
    "power": {"power.json", "power.png"},
    "tuned": {"tune.json", "tune.png", "best.toml"},
    "trade": {"trade.json", "trade.png"},
}
PYTHON = """
import jax

jax.config.update("jax_enable_x64", True)
import jaxshroud as js

scene = js.load("table1").scene
run = js.simulate(scene, n_periods=20)
curve = js.sweep(scene, {"contact.gamma": [1.0, 2.0, 4.0]}, n_periods=64, transient=200)
print(curve.P_d, curve.P_d_ci, curve.period_number)
exact = js.RungeKutta("dopri8", steps=100)  # or precision="float32" for speed; see below
fine = js.sweep(scene, {"contact.gamma": [1.0, 2.0, 4.0]}, n_periods=64, method=exact)
"""


@pytest.mark.full
def test_commands_of_readme(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trade, "SETTINGS", {contact: ways[:2] for contact, ways in trade.SETTINGS.items()})
    for command, smaller in COMMANDS:
        assert cli.main(shlex.split(f"{command} {smaller}")[1:]) == 0, (command, capsys.readouterr().err)
    assert {"run.nc", "more.nc", "gradient.json"} <= {p.name for p in tmp_path.iterdir()}
    for name, files in MADE.items():
        assert files <= {p.name for p in (tmp_path / name).iterdir()}


@pytest.mark.full
def test_python_of_readme(capsys):
    small = 'js.load("table1", [\'parts.motion=["x"]\']).scene'
    assert PYTHON.count('js.load("table1").scene') == 1
    made = {}
    exec(PYTHON.replace('js.load("table1").scene', small), made)
    assert made["curve"].P_d.shape == made["fine"].P_d.shape == (3,)
    assert "[" in capsys.readouterr().out
