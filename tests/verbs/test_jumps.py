"""Jumps of sweeps in both directions: folds are, flips, resonances and free blades are none."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.runs import SweepHandover
from jaxshroud.scene.config import load, parse
from jaxshroud.signals.orbit_distance import SweptMotion
from jaxshroud.verbs.jumps import SweptLane, _jumps

STEPS = {"method": js.RungeKutta(steps=100)}
ONE = ['parts.motion=["x"]']


def jumps_along(curve, start, stop):
    """Whether a period-1 orbit at curve(value) is told to jump between two values."""

    def motion_at(value, _):
        return SweptMotion(np.full((8, 1), curve(value)), 1, True)

    lanes = [SweptLane(value=v, motion=motion_at(v, None), end=SweepHandover()) for v in (start, stop)]
    return _jumps(*lanes, motion_at)


@pytest.mark.parametrize("where", [0.0, 0.013, 0.5, 0.77, 0.999])
def test_what_stays_when_the_step_is_halved_is_a_jump(where):
    assert jumps_along(lambda v: 0.3 * v + (v >= where), 0.0 if where else -0.01, 1.0)
    # A step five halvings of which are a line of 1/32 of it, the root of a flip, and a resonance a quarter as wide.
    for curve in (lambda v: v, lambda v: np.sqrt(max(v - where, 0.0)), lambda v: 1 / np.hypot(1, (v - where) * 4)):
        assert not jumps_along(curve, 0.0, 1.0)


def test_free_blades_never_jump():
    # Free motion dies out in 160 periods, so that none of these runs has settled, and the resonance is 3 rad/s wide.
    scene = js.load("table1", [*ONE, "blades.c_x=0.1", "shroud.gap=1m"]).scene
    along = {"drive.omega": np.linspace(900, 1400, 13)}
    swept = js.sweep(scene, along, direction="both", n_periods=8, transient=8, **STEPS)
    assert swept.steep.any()  # at the resonance: it was called a jump
    assert not swept.jump.any()
    assert swept.jumps == swept.steep_places == {}
    opened = js.SweepResult(swept.data.drop_vars("jump"))  # where nobody has looked closer
    assert opened.jumps == {}
    assert set(opened.steep_places) == {"forward", "backward"}
    assert "steep forward" in opened.summary()


TWO_ORDERS = """
[[drive.harmonic]]
order = 1
F = 60
beta = 0.5
[[drive.harmonic]]
order = 2
F = 20
beta = 0.5
"""


@pytest.mark.full
def test_loads_of_two_orders_on_free_blades_make_no_jumps():
    kept = [line for line in load("table1").text().splitlines() if line.split(" = ")[0] not in ("beta", "F_0", "M_0")]
    apart = [*ONE, "blades.c_x=8", "shroud.gap=0.5", "drive.F_x_mean=200"]
    scene = parse("\n".join([*kept, TWO_ORDERS]), "own.toml", apart).scene
    along = {"drive.omega": np.linspace(400, 700, 13)}
    swept = js.sweep(scene, along, direction="both", n_periods=16, transient=150, method=js.RungeKutta(steps=60))
    assert swept.steep.any()
    assert swept.jumps == {}


@pytest.mark.full
@pytest.mark.parametrize("num", [13, pytest.param(31), pytest.param(200, marks=pytest.mark.release)])
def test_folds_are_jumps_at_any_number_of_values(num):
    # The folds of this march are at 2.0205 and 2.4617; beside them lanes leave slowly, and may need one value more.
    scene = js.load("table1", [*ONE, "blades.c_x=5"]).scene
    values = np.linspace(1.9, 2.6, num)
    swept = js.sweep(scene, {"contact.gamma": values}, direction="both", n_periods=32, **STEPS)
    ((up,), (down,)) = swept.jumps["forward"], swept.jumps["backward"]
    assert 0 < up - 2.4617 < values[1] - values[0]
    assert 0 < 2.0205 - down < values[1] - values[0]


@pytest.mark.full
def test_flips_are_no_jumps():
    scene = js.load("table1", ONE).scene
    swept = js.sweep(scene, {"contact.gamma": np.linspace(2.9, 4.2, 13)}, direction="both", n_periods=32, **STEPS)
    assert set(np.unique(swept.period_number)) >= {1, 2}
    assert swept.jumps == {}
